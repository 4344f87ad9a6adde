//! Counts of jobs and weighings, for monitoring.

use super::row::Columns;
use super::{Result, Store, now};
use flip_core::domain::job::{JobKind, JobState};
use flip_core::domain::weighing::{Outcome, WeighingState};
use sqlx::any::AnyRow;

/// Counts of jobs and weighings; zero counts are omitted.
#[derive(Debug, Clone, PartialEq)]
pub struct Counts {
    /// Jobs by kind and state.
    pub jobs: Vec<((JobKind, JobState), u32)>,
    /// Weighings by state, and outcome once they have one.
    pub weighings: Vec<((WeighingState, Option<Outcome>), u32)>,
    /// Waiting time of the oldest waiting entry, s, of `jobs` and of `weighings`; 0 if none waits.
    pub waits_s: [(&'static str, f64); 2],
}

impl Store {
    /// All counts.
    pub async fn counts(&self) -> Result<Counts> {
        let sql = "SELECT kind, state, min(seq) AS seq, count(*) AS n FROM job GROUP BY kind, state ORDER BY kind, state";
        let jobs = sqlx::query(sql).fetch_all(&self.reader).await?;
        let sql = "SELECT state, outcome, min(seq) AS seq, count(*) AS n FROM weighing GROUP BY state, outcome ORDER BY state, outcome NULLS FIRST";
        let weighings = sqlx::query(sql).fetch_all(&self.reader).await?;
        let sql = "SELECT (SELECT min(created_at) FROM job WHERE state = 'queued') AS job, \
                   (SELECT min(created_at) FROM weighing WHERE outcome IS NULL AND started_at IS NULL) AS weighing";
        let oldest = sqlx::query(sql).fetch_one(&self.reader).await?;
        let waits_s = |column| {
            let since: Option<i64> = oldest.plain(column)?;
            Ok::<_, super::Error>(
                since.map_or(0.0, |ms| (now().unix_ms() - ms).max(0) as f64 / 1000.0),
            )
        };
        Ok(Counts {
            waits_s: [("jobs", waits_s("job")?), ("weighings", waits_s("weighing")?)],
            jobs: jobs.iter().map(job).collect::<Result<_>>()?,
            weighings: weighings.iter().map(weighing).collect::<Result<_>>()?,
        })
    }
}

fn job(row: &AnyRow) -> Result<((JobKind, JobState), u32)> {
    Ok(((row.word("job", "kind")?, row.word("job", "state")?), row.count("n")?))
}

fn weighing(row: &AnyRow) -> Result<((WeighingState, Option<Outcome>), u32)> {
    let state = row.word("weighing", "state")?;
    Ok(((state, row.maybe_word("weighing", "outcome")?), row.count("n")?))
}
