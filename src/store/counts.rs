//! How much there is of what, for those who watch over the service.

use super::row::Columns;
use super::{Result, Store};
use crate::domain::job::{JobKind, JobState};
use crate::domain::weighing::{Outcome, WeighingState};
use sqlx::sqlite::SqliteRow;

/// Jobs and weighings, counted; what there is none of is left out.
#[derive(Debug, Clone, PartialEq)]
pub struct Counts {
    /// Jobs by kind and state.
    pub jobs: Vec<((JobKind, JobState), u32)>,
    /// Weighings by state, and outcome once they have one.
    pub weighings: Vec<((WeighingState, Option<Outcome>), u32)>,
}

impl Store {
    /// Everything counted.
    pub(crate) async fn counts(&self) -> Result<Counts> {
        let sql = "SELECT kind, state, count(*) AS n FROM job GROUP BY kind, state ORDER BY kind, state";
        let jobs = sqlx::query(sql).fetch_all(&self.reader).await?;
        let sql = "SELECT state, outcome, count(*) AS n FROM weighing GROUP BY state, outcome ORDER BY state, outcome";
        let weighings = sqlx::query(sql).fetch_all(&self.reader).await?;
        Ok(Counts {
            jobs: jobs
                .iter()
                .map(|row| Ok(((row.word("kind")?, row.word("state")?), row.count("n")?)))
                .collect::<Result<_>>()?,
            weighings: weighings.iter().map(weighing).collect::<Result<_>>()?,
        })
    }
}

fn weighing(row: &SqliteRow) -> Result<((WeighingState, Option<Outcome>), u32)> {
    let ended = row.plain::<Option<String>>("outcome")?.is_some();
    let outcome = if ended { Some(row.word("outcome")?) } else { None };
    Ok(((row.word("state")?, outcome), row.count("n")?))
}
