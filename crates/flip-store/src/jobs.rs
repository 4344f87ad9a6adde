//! Jobs as seen by callers: created, listed, cancelled. The workers' side is in `ledger.rs`.

use super::page::{Page, Window};
use super::row::{Columns, word};
use super::{Result, Store, Tx};
use flip_core::domain::job::{JobKind, JobState, Progress};
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::sqlite::SqliteRow;

/// A job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// Id; a calibration, training, evaluation, investigation or measurement of the angle of repose
    /// has the id of its job.
    pub id: String,
    /// What it computes.
    pub kind: JobKind,
    /// Its state.
    pub state: JobState,
    /// Its progress.
    pub progress: Progress,
    /// How often a worker has started or resumed it.
    pub attempts: u32,
    /// A cancellation was requested and has not been carried out yet.
    pub cancelling: bool,
    /// When it was created.
    pub created_at: Timestamp,
    /// When a worker first started it.
    pub started_at: Option<Timestamp>,
    /// When it ended.
    pub finished_at: Option<Timestamp>,
    /// Why it failed, or why its last attempt did.
    pub error: Option<String>,
}

/// A job with its specification and result, as JSON.
#[derive(Debug, Clone)]
pub struct JobRow {
    pub job: Job,
    pub spec: String,
    pub result: Option<String>,
}

/// Topic of a job's events.
pub fn job_topic(id: &str) -> String {
    format!("job:{id}")
}

impl Store {
    /// Jobs, newest first; of one kind or state if given.
    pub async fn jobs(
        &self,
        kind: Option<JobKind>,
        state: Option<JobState>,
        window: Window,
    ) -> Result<Page<Job>> {
        // Without specification and result, which may be half a megabyte each.
        let sql = "SELECT seq, id, kind, state, fraction, message, attempts, cancel_requested, created_at, started_at, finished_at, error \
                   FROM job WHERE seq < ?1 AND (?3 IS NULL OR kind = ?3) AND (?4 IS NULL OR state = ?4) \
                   ORDER BY seq DESC LIMIT ?2";
        let rows = sqlx::query(sql)
            .bind(window.before())
            .bind(window.rows())
            .bind(kind.as_ref().map(word))
            .bind(state.as_ref().map(word))
            .fetch_all(&self.reader)
            .await?;
        window.page_of(&rows, job)
    }

    /// Jobs of one kind, newest first, with all their data.
    pub async fn whole_jobs(&self, kind: JobKind, window: Window) -> Result<Page<JobRow>> {
        let sql = "SELECT * FROM job WHERE seq < ?1 AND kind = ?3 ORDER BY seq DESC LIMIT ?2";
        let rows = sqlx::query(sql)
            .bind(window.before())
            .bind(window.rows())
            .bind(word(&kind))
            .fetch_all(&self.reader)
            .await?;
        window.page_of(&rows, job_row)
    }

    /// One job.
    pub async fn job(&self, id: &str) -> Result<Option<JobRow>> {
        let row = sqlx::query("SELECT * FROM job WHERE id = ?1")
            .bind(id)
            .fetch_optional(&self.reader)
            .await?;
        row.as_ref().map(job_row).transpose()
    }

    /// The latest successful calibration of a powder, or of a bare angle (exactly), under this
    /// version of the simulator, `None` being the base.
    pub async fn newest_calibration(
        &self,
        powder: Option<&str>,
        repose_deg: f64,
        simulator: Option<&str>,
    ) -> Result<Option<String>> {
        let sql = "SELECT id FROM job WHERE kind = 'calibration' AND state = 'succeeded' \
                   AND spec ->> '$.calibration.powder' IS ?1 \
                   AND (?1 IS NOT NULL OR spec ->> '$.calibration.target.repose_deg' = ?2) \
                   AND spec ->> '$.calibration.under.simulator' IS ?3 ORDER BY seq DESC LIMIT 1";
        let query = sqlx::query_scalar(sql).bind(powder).bind(repose_deg).bind(simulator);
        Ok(query.fetch_optional(&self.reader).await?)
    }
}

impl Tx {
    /// Queue a job. `false`: a job with the same specification is queued, running or has succeeded,
    /// and that one is returned.
    pub async fn insert_job(
        &mut self,
        id: &str,
        kind: JobKind,
        spec: &str,
        spec_sha256: &[u8],
        now: Timestamp,
    ) -> Result<(Job, bool)> {
        let sql =
            "SELECT * FROM job WHERE spec_sha256 = ?1 AND state NOT IN ('failed', 'cancelled')";
        if let Some(row) =
            sqlx::query(sql).bind(spec_sha256).fetch_optional(&mut *self.inner).await?
        {
            return Ok((job(&row)?, false));
        }
        let sql = "INSERT INTO job (id, kind, spec, spec_sha256, state, message, created_at) \
                   VALUES (?1, ?2, ?3, ?4, 'queued', 'waits for a worker', ?5) RETURNING *";
        let row = sqlx::query(sql)
            .bind(id)
            .bind(word(&kind))
            .bind(spec)
            .bind(spec_sha256)
            .bind(now.unix_ms())
            .fetch_one(&mut *self.inner)
            .await?;
        Ok((self.announce_job(&row).await?, true))
    }

    /// Request that a job end: a queued one is cancelled at once, a running one once its worker
    /// notices. `None`: it has already ended, or never existed.
    pub async fn request_cancel(&mut self, id: &str, now: Timestamp) -> Result<Option<Job>> {
        let sql = "UPDATE job SET cancel_requested = 1,
                       finished_at = CASE state WHEN 'queued' THEN ?2 END,
                       state = CASE state WHEN 'queued' THEN 'cancelled' ELSE state END
                   WHERE id = ?1 AND state IN ('queued', 'running') RETURNING *";
        let row =
            sqlx::query(sql).bind(id).bind(now.unix_ms()).fetch_optional(&mut *self.inner).await?;
        match row {
            Some(row) => Ok(Some(self.announce_job(&row).await?)),
            None => Ok(None),
        }
    }

    /// Notify followers of a job's new state.
    pub(super) async fn announce_job(&mut self, row: &SqliteRow) -> Result<Job> {
        let job = job(row)?;
        self.emit(&job_topic(&job.id), "state", &job).await?;
        Ok(job)
    }
}

fn job_row(row: &SqliteRow) -> Result<JobRow> {
    Ok(JobRow { job: job(row)?, spec: row.plain("spec")?, result: row.plain("result")? })
}

pub(super) fn job(row: &SqliteRow) -> Result<Job> {
    let state: JobState = row.word("job", "state")?;
    Ok(Job {
        id: row.plain("id")?,
        kind: row.word("job", "kind")?,
        state,
        progress: Progress { fraction: row.plain("fraction")?, message: row.plain("message")? },
        attempts: row.count("attempts")?,
        cancelling: row.plain::<bool>("cancel_requested")? && !state.is_terminal(),
        created_at: row.time("created_at")?,
        started_at: row.maybe_time("started_at")?,
        finished_at: row.maybe_time("finished_at")?,
        error: row.plain("error")?,
    })
}
