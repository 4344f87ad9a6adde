//! The ledger: the jobs that wait, and which worker computes which. It is the queue, too.
//!
//! ```text
//!            claim                     succeed
//!  [queued] -------> [running] ------------------> [succeeded]
//!     ^                 | | |    fail, exhausted
//!     |  release, retry | | +--------------------> [failed]
//!     +-----------------+ |      cancel
//!                         +----------------------> [cancelled]
//! ```
//!
//! A claim returns a [`Lease`] with a fencing token one above the last. Every later write of that
//! worker carries it, and is refused once another worker has claimed the job ([`Error::Fenced`]): a
//! worker that was presumed dead and comes back cannot change anything. A lease that is not renewed
//! expires, and the job can be claimed again.
//!
//! A job gets [`FAILURES_MAX`] attempts that end in an error or a panic. An attempt whose process
//! ends is counted separately: the job is rarely the cause and resumes where it was; only after
//! [`DEATHS_MAX`] such ends is it considered the cause. Both counters restart whenever something is
//! saved: a job that makes progress is not given up.

use super::jobs::{job_topic, left_s, waits};
use super::row::Columns;
use super::{Error, Result, Store, Tx};
use flip_core::domain::device::Device;
use flip_core::domain::job::{JobKind, JobState, Progress};
use flip_core::domain::timestamp::Timestamp;
use serde::Serialize;
use sqlx::any::AnyRow;

/// Number of attempts that may end in an error or a panic before the job fails for good.
pub const FAILURES_MAX: u32 = 3;
/// Number of consecutive process ends, with nothing saved in between, before the job is considered
/// their cause.
pub const DEATHS_MAX: u32 = 12;

/// The right to compute a job, and to write to its row until another worker claims it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lease {
    /// The job.
    pub job: String,
    /// Fencing token: the number of the claim.
    pub fence: i64,
}

/// A job that may be computed now.
#[derive(Debug, Clone, PartialEq)]
pub struct Claimed {
    /// The lease.
    pub lease: Lease,
    /// Its kind.
    pub kind: JobKind,
    /// Its specification, as JSON.
    pub spec: String,
    /// SHA-256 of the artifact to resume from.
    pub checkpoint: Option<String>,
}

/// A job that waits for a worker.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Claimable {
    /// Its kind.
    pub kind: JobKind,
    /// What it computes on.
    pub device: Device,
    /// The job.
    pub job: String,
}

/// Answer to a worker's claim.
#[derive(Debug, Clone, PartialEq)]
pub enum Claim {
    /// The claim was granted.
    Granted(Claimed),
    /// Another worker's lease lasts until then.
    Held(Timestamp),
    /// There is nothing to do: the job has ended, or ends now because it was cancelled or tried too
    /// often.
    Ended,
}

impl Store {
    /// The job of each kind and device that has waited longest, oldest first: queued, or left by a
    /// worker whose lease has expired. A kind or device that is not known here waits for a program
    /// that knows it.
    pub async fn claimable(&self, now: Timestamp) -> Result<Vec<Claimable>> {
        // From the first of one sort to that of the next, each by one look into the index: a queue is long.
        let sql = concat!(
            "WITH RECURSIVE first (seq, kind, device) AS (SELECT seq, kind, device FROM job WHERE seq = (SELECT seq FROM job WHERE ",
            waits!("$1"),
            " ORDER BY kind, device, seq LIMIT 1) UNION ALL SELECT j.seq, j.kind, j.device FROM first f JOIN job j ON j.seq = \
             (SELECT seq FROM job WHERE (kind, device) > (f.kind, f.device) AND ",
            waits!("$1"),
            " ORDER BY kind, device, seq LIMIT 1)) \
             SELECT j.id, j.kind, j.device FROM first f JOIN job j ON j.seq = f.seq ORDER BY j.seq"
        );
        let rows = sqlx::query(sql).bind(now.unix_ms()).fetch_all(&self.reader).await?;
        let known = |row: &AnyRow| {
            let (kind, device) = (row.word("job", "kind").ok()?, row.word("job", "device").ok()?);
            Some(row.plain("id").map(|job| Claimable { kind, device, job }))
        };
        rows.iter().filter_map(known).collect()
    }

    /// The artifact that a job would be resumed from, by its SHA-256.
    pub async fn checkpoint_of(&self, id: &str) -> Result<Option<String>> {
        let sql = "SELECT checkpoint FROM job WHERE id = $1 AND checkpoint IS NOT NULL";
        Ok(sqlx::query_scalar(sql).bind(id).fetch_optional(&self.reader).await?)
    }

    /// Requeue running jobs that nobody computes. Sound only at startup: the lock on the data folder
    /// proves that there is no other worker. With a server there may be others: those that serve
    /// nothing, and those that have a bench.
    pub async fn end_leases(&self) -> Result<()> {
        let mut tx = self.write().await?;
        let sql = "UPDATE job SET state = 'queued', message = 'waits to go on: the process ended', deaths = deaths + 1, \
                   owner = NULL, lease_until = NULL WHERE state = 'running' AND NOT ($1 AND owner IN \
                   (SELECT id FROM worker WHERE ended_at IS NULL AND (NOT serves OR id IN (SELECT owner FROM bench)))) RETURNING *";
        let rows = sqlx::query(sql).bind(self.is_postgres()).fetch_all(&mut *tx.inner).await?;
        for row in &rows {
            let job = tx.announce_job(row).await?;
            tx.end_portions(&job.id).await?;
        }
        tx.commit().await
    }
}

impl Tx {
    /// Claim a job until `until`.
    pub async fn claim(
        &mut self,
        id: &str,
        owner: &str,
        now: Timestamp,
        until: Timestamp,
    ) -> Result<Claim> {
        let row = sqlx::query("SELECT * FROM job WHERE id = $1")
            .bind(id)
            .fetch_optional(&mut *self.inner)
            .await?;
        let Some(row) = row else { return Ok(Claim::Ended) };
        let state: JobState = row.word("job", "state")?;
        if state.is_terminal() {
            return Ok(Claim::Ended);
        }
        if state == JobState::Running && row.plain::<i64>("lease_until")? >= now.unix_ms() {
            return Ok(Claim::Held(row.time("lease_until")?));
        }
        if row.flag("cancel_requested")? {
            self.end_unclaimed(id, JobState::Cancelled, None, now).await?;
            return Ok(Claim::Ended);
        }
        let deaths = row.count("deaths")? + u32::from(state == JobState::Running);
        if deaths >= DEATHS_MAX {
            let error = format!(
                "gave up: the process ended {deaths} times during this job with nothing saved in between"
            );
            self.end_unclaimed(id, JobState::Failed, Some(&error), now).await?;
            return Ok(Claim::Ended);
        }
        self.grant(id, owner, deaths, now, until).await
    }

    async fn grant(
        &mut self,
        id: &str,
        owner: &str,
        deaths: u32,
        now: Timestamp,
        until: Timestamp,
    ) -> Result<Claim> {
        let sql = "UPDATE job SET state = 'running', fence = fence + 1, attempts = attempts + 1, deaths = $5, \
                   owner = $2, lease_until = $3, message = 'begins', started_at = coalesce(started_at, $4), \
                   claimed_at = $4, claimed_fraction = fraction \
                   WHERE id = $1 RETURNING *";
        let row = sqlx::query(sql)
            .bind(id)
            .bind(owner)
            .bind(until.unix_ms())
            .bind(now.unix_ms())
            .bind(i64::from(deaths))
            .fetch_one(&mut *self.inner)
            .await?;
        // An attempt that was lost may have left some.
        self.end_portions(id).await?;
        let job = self.announce_job(&row).await?;
        Ok(Claim::Granted(Claimed {
            lease: Lease { job: job.id, fence: row.plain("fence")? },
            kind: job.kind,
            spec: row.plain("spec")?,
            checkpoint: row.plain("checkpoint")?,
        }))
    }

    /// Drop the checkpoint of a job that ends: nothing will resume from it.
    async fn unname_checkpoint(&mut self, id: &str) -> Result<()> {
        let old = sqlx::query_scalar(
            "SELECT checkpoint FROM job WHERE id = $1 AND checkpoint IS NOT NULL",
        );
        let old: Option<String> = old.bind(id).fetch_optional(&mut *self.inner).await?;
        self.unnamed.extend(old);
        Ok(())
    }

    async fn end_unclaimed(
        &mut self,
        id: &str,
        state: JobState,
        error: Option<&str>,
        now: Timestamp,
    ) -> Result<()> {
        self.unname_checkpoint(id).await?;
        self.end_portions(id).await?;
        let sql = "UPDATE job SET state = $2, error = coalesce($3, error), owner = NULL, lease_until = NULL, \
                   checkpoint = NULL, finished_at = $4 WHERE id = $1 RETURNING *";
        let row = sqlx::query(sql)
            .bind(id)
            .bind(super::row::word(&state))
            .bind(error)
            .bind(now.unix_ms())
            .fetch_one(&mut *self.inner)
            .await?;
        self.announce_job(&row).await?;
        Ok(())
    }

    /// Renew a lease until `until`; returns whether cancellation was requested.
    pub async fn renew(&mut self, lease: &Lease, until: Timestamp) -> Result<bool> {
        let sql = "UPDATE job SET lease_until = $3 WHERE id = $1 AND fence = $2 AND state = 'running' RETURNING *";
        let row = sqlx::query(sql).bind(&lease.job).bind(lease.fence).bind(until.unix_ms());
        held(row.fetch_optional(&mut *self.inner).await?)?.flag("cancel_requested")
    }

    /// Fail unless a lease is valid. In a transaction that holds the write lock it stays valid to
    /// the end.
    pub async fn prove(&mut self, lease: &Lease) -> Result<AnyRow> {
        let sql = "SELECT * FROM job WHERE id = $1 AND fence = $2 AND state = 'running'";
        let row = sqlx::query(sql).bind(&lease.job).bind(lease.fence);
        held(row.fetch_optional(&mut *self.inner).await?)
    }

    /// Something new was saved: earlier failures and deaths no longer count.
    pub async fn advance(&mut self, lease: &Lease) -> Result<()> {
        self.prove(lease).await?;
        let sql = "UPDATE job SET failures = 0, deaths = 0, error = NULL WHERE id = $1";
        sqlx::query(sql).bind(&lease.job).execute(&mut *self.inner).await?;
        Ok(())
    }

    /// Report the progress of a job.
    pub async fn report(&mut self, lease: &Lease, progress: &Progress) -> Result<()> {
        let sql = "UPDATE job SET fraction = $3, message = $4 \
                   WHERE id = $1 AND fence = $2 AND state = 'running' RETURNING *";
        // A fraction that is not a number would violate the row's check constraint and fail the
        // job.
        let fraction =
            if progress.fraction.is_finite() { progress.fraction.clamp(0.0, 1.0) } else { 0.0 };
        let row = sqlx::query(sql)
            .bind(&lease.job)
            .bind(lease.fence)
            .bind(fraction)
            .bind(&progress.message);
        let row = held(row.fetch_optional(&mut *self.inner).await?)?;
        let reported = Reported { progress, left_s: left_s(&row)? };
        self.emit_latest(&job_topic(&lease.job), "progress", &reported).await
    }

    /// Say what a job waits for; its fraction stays.
    pub async fn say(&mut self, lease: &Lease, message: String) -> Result<()> {
        let fraction = self.prove(lease).await?.plain("fraction")?;
        self.report(lease, &Progress { fraction, message }).await
    }

    /// Set the artifact to resume from.
    pub async fn set_checkpoint(&mut self, lease: &Lease, sha256: &str) -> Result<()> {
        let old: Option<String> = self.prove(lease).await?.plain("checkpoint")?;
        self.unnamed.extend(old.filter(|old| old != sha256));
        self.advance(lease).await?;
        let sql = "UPDATE job SET checkpoint = $2 WHERE id = $1";
        sqlx::query(sql).bind(&lease.job).bind(sha256).execute(&mut *self.inner).await?;
        Ok(())
    }

    /// Record that the job succeeded, with its result.
    pub async fn succeed(&mut self, lease: &Lease, result: &str, now: Timestamp) -> Result<()> {
        self.unname_checkpoint(&lease.job).await?;
        let sql = "UPDATE job SET state = 'succeeded', result = $3, fraction = 1, message = 'done', error = NULL, \
                   owner = NULL, lease_until = NULL, checkpoint = NULL, finished_at = $4 \
                   WHERE id = $1 AND fence = $2 AND state = 'running' RETURNING *";
        let row =
            sqlx::query(sql).bind(&lease.job).bind(lease.fence).bind(result).bind(now.unix_ms());
        let row = held(row.fetch_optional(&mut *self.inner).await?)?;
        self.end_portions(&lease.job).await?;
        self.announce_job(&row).await.map(drop)
    }

    /// End the job without a result.
    pub async fn end(
        &mut self,
        lease: &Lease,
        state: JobState,
        error: Option<&str>,
        now: Timestamp,
    ) -> Result<()> {
        debug_assert!(matches!(state, JobState::Failed | JobState::Cancelled));
        self.prove(lease).await?;
        self.end_unclaimed(&lease.job, state, error, now).await
    }

    /// Fail a job whose device failed, and keep its checkpoint: another job may go on from it, on
    /// another device.
    pub async fn fail_keeping_checkpoint(
        &mut self,
        lease: &Lease,
        error: &str,
        now: Timestamp,
    ) -> Result<()> {
        let checkpoint: Option<String> = self.prove(lease).await?.plain("checkpoint")?;
        // Ended as others are, without letting go of the file.
        let sql = "UPDATE job SET checkpoint = $2 WHERE id = $1";
        let set = async |tx: &mut Self, to: Option<&String>| -> Result<()> {
            sqlx::query(sql).bind(&lease.job).bind(to).execute(&mut *tx.inner).await?;
            Ok(())
        };
        set(self, None).await?;
        self.end_unclaimed(&lease.job, JobState::Failed, Some(error), now).await?;
        set(self, checkpoint.as_ref()).await
    }

    /// Let a job that waits begin from this artifact.
    pub async fn begin_from(&mut self, id: &str, sha256: &str) -> Result<()> {
        let sql = "UPDATE job SET checkpoint = $2 WHERE id = $1 AND state = 'queued'";
        sqlx::query(sql).bind(id).bind(sha256).execute(&mut *self.inner).await?;
        Ok(())
    }

    /// Record a failed attempt: requeue the job, or fail it if this was the last attempt.
    pub async fn retry(&mut self, lease: &Lease, error: &str, now: Timestamp) -> Result<()> {
        let failures = self.prove(lease).await?.count("failures")? + 1;
        if failures >= FAILURES_MAX {
            let error =
                format!("gave up after {failures} attempts with nothing saved in between: {error}");
            return self.end_unclaimed(&lease.job, JobState::Failed, Some(&error), now).await;
        }
        let sql = "UPDATE job SET state = 'queued', failures = $2, error = $3, message = 'waits to be tried again', \
                   owner = NULL, lease_until = NULL WHERE id = $1 RETURNING *";
        let row = sqlx::query(sql)
            .bind(&lease.job)
            .bind(i64::from(failures))
            .bind(error)
            .fetch_one(&mut *self.inner)
            .await?;
        self.end_portions(&lease.job).await?;
        self.announce_job(&row).await.map(drop)
    }

    /// The worker shuts down: requeue the job as if the attempt had not happened.
    pub async fn release(&mut self, lease: &Lease) -> Result<()> {
        let sql = "UPDATE job SET state = 'queued', message = 'waits for a worker', attempts = attempts - 1, \
                   owner = NULL, lease_until = NULL WHERE id = $1 AND fence = $2 AND state = 'running' RETURNING *";
        let row = sqlx::query(sql).bind(&lease.job).bind(lease.fence);
        let row = held(row.fetch_optional(&mut *self.inner).await?)?;
        self.end_portions(&lease.job).await?;
        self.announce_job(&row).await.map(drop)
    }
}

/// The event of a progress.
#[derive(Serialize)]
struct Reported<'a> {
    #[serde(flatten)]
    progress: &'a Progress,
    #[serde(skip_serializing_if = "Option::is_none")]
    left_s: Option<f64>,
}

fn held(row: Option<AnyRow>) -> Result<AnyRow> {
    row.ok_or(Error::Fenced)
}

#[cfg(test)]
mod tests;
