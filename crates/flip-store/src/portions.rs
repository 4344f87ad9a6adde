//! Portions: pieces of a running job that any worker may compute, for a job on several machines.
//!
//! ```text
//!  cut under the job's lease           claim                   finish
//! ---------------------------> [waits] -----> [is computed] ----------> [done]
//!                                 ^                 |
//!                                 +-----------------+
//!                          given back, or its lease has ended
//! ```
//!
//! The job's own worker drops the row of a portion that waits when it takes it back, and of one that is
//! done when it has received what it gave.
//!
//! A claim of a portion has a number as that of a job has, and what carries an older one changes
//! nothing. Portions are of one attempt at their job: they end with it.

use super::ledger::Lease;
use super::row::{Columns, word};
use super::sql::Parts;
use super::{Result, Store, Tx};
use flip_core::domain::job::JobKind;
use flip_core::domain::timestamp::Timestamp;
use sqlx::AssertSqlSafe;
use sqlx::any::AnyRow;
use tokio::sync::watch;

/// How often others may claim a portion. One that was given up so often is for the job's own worker:
/// it may be what ends those who compute it.
pub const CLAIMS_MAX: i64 = 3;

/// A portion to store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewPortion {
    /// Id.
    pub id: String,
    /// Position in the order in which portions are to be taken.
    pub number: i64,
    /// What kind of experiments it holds.
    pub kind: &'static str,
    /// These, encoded.
    pub experiments: Vec<u8>,
}

/// A portion that was claimed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Portion {
    /// Id.
    pub id: String,
    /// Its job.
    pub job: String,
    /// Number of the claim.
    pub fence: i64,
    /// What kind of experiments it holds.
    pub kind: String,
    /// These, encoded.
    pub experiments: Vec<u8>,
}

/// Where a portion stands, for the worker that cut it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Stands {
    /// Nobody computes it.
    Waits,
    /// A worker computes it.
    Taken,
    /// What it gave, encoded.
    Done(Vec<u8>),
}

/// The condition that a portion's job runs, in the attempt that cut it, and is to go on.
const WANTED: &str =
    "j.state = 'running' AND j.fence = p.attempt AND NOT j.cancel_requested AND j.lease_until >= ";

impl Store {
    /// Counts up when a portion was cut, claimed, done or dropped by any process. Only with a database on
    /// a server: with one that is not, there are no portions.
    pub fn watch_portions(&self) -> watch::Receiver<u64> {
        self.server.as_ref().map_or_else(|| watch::channel(0).1, |server| server.watch_portions())
    }

    /// Whether a portion waits that this worker may claim: of a job of these kinds.
    pub async fn has_portion(
        &self,
        worker: &str,
        kinds: &[JobKind],
        now: Timestamp,
    ) -> Result<bool> {
        let Some(next) = next(self.is_postgres(), "SELECT count(*) FROM (", worker, kinds, now)
        else {
            return Ok(false);
        };
        let mut asked = next;
        asked.push(") AS waiting");
        let waiting: i64 = asked.scalar().fetch_one(&self.reader).await?;
        Ok(waiting > 0)
    }

    /// The portions that this worker computes and that are still wanted, each with the number of its
    /// claim.
    pub async fn portions_of(&self, worker: &str, now: Timestamp) -> Result<Vec<(String, i64)>> {
        let sql = format!(
            "SELECT p.id, p.fence FROM portion p JOIN job j ON j.id = p.job \
             WHERE p.owner = $1 AND p.done_at IS NULL AND {WANTED} $2"
        );
        let rows = sqlx::query(AssertSqlSafe(sql)).bind(worker).bind(now.unix_ms());
        let rows = rows.fetch_all(&self.reader).await?;
        rows.iter().map(|row| Ok((row.plain("id")?, row.plain("fence")?))).collect()
    }

    /// The portions of an attempt, in order, each with where it stands.
    pub async fn portions(&self, of: &Lease, now: Timestamp) -> Result<Vec<(String, Stands)>> {
        let sql = "SELECT id, owner, lease_until, outcomes FROM portion WHERE job = $1 AND attempt = $2 ORDER BY number";
        let rows = sqlx::query(sql).bind(&of.job).bind(of.fence).fetch_all(&self.reader).await?;
        let stands = |row: &AnyRow| -> Result<Stands> {
            let lease: Option<i64> = row.plain("lease_until")?;
            Ok(match row.plain::<Option<Vec<u8>>>("outcomes")? {
                Some(outcomes) => Stands::Done(outcomes),
                None if lease.is_some_and(|until| until >= now.unix_ms()) => Stands::Taken,
                None => Stands::Waits,
            })
        };
        rows.iter().map(|row| Ok((row.plain("id")?, stands(row)?))).collect()
    }
}

impl Tx {
    /// Cut portions off a running job.
    ///
    /// # Errors
    /// [`Error::Fenced`](super::Error::Fenced) without the job's lease.
    pub async fn cut_portions(&mut self, of: &Lease, new: &[NewPortion]) -> Result<()> {
        self.prove(of).await?;
        let sql = "INSERT INTO portion (id, job, attempt, number, kind, experiments) VALUES ($1, $2, $3, $4, $5, $6)";
        for portion in new {
            sqlx::query(sql)
                .bind(&portion.id)
                .bind(&of.job)
                .bind(of.fence)
                .bind(portion.number)
                .bind(portion.kind)
                .bind(&portion.experiments)
                .execute(&mut *self.inner)
                .await?;
        }
        Ok(())
    }

    /// Claim the first portion that waits, of a job of these kinds, until `until`.
    pub async fn claim_portion(
        &mut self,
        worker: &str,
        kinds: &[JobKind],
        now: Timestamp,
        until: Timestamp,
    ) -> Result<Option<Portion>> {
        let postgres = self.store.is_postgres();
        let Some(next) = next(postgres, "", worker, kinds, now) else { return Ok(None) };
        let Some(id) = next.scalar::<String>().fetch_optional(&mut *self.inner).await? else {
            return Ok(None);
        };
        let sql = "UPDATE portion SET owner = $2, fence = fence + 1, lease_until = $3 WHERE id = $1 RETURNING *";
        let row = sqlx::query(sql).bind(id).bind(worker).bind(until.unix_ms());
        let row = row.fetch_one(&mut *self.inner).await?;
        Ok(Some(Portion {
            id: row.plain("id")?,
            job: row.plain("job")?,
            fence: row.plain("fence")?,
            kind: row.plain("kind")?,
            experiments: row.plain("experiments")?,
        }))
    }

    /// Renew the lease of a portion, unless the claim of it does not count any more.
    pub async fn renew_portion(
        &mut self,
        portion: &Portion,
        worker: &str,
        until: Timestamp,
    ) -> Result<()> {
        let sql = "UPDATE portion SET lease_until = $4 \
                   WHERE id = $1 AND fence = $2 AND owner = $3 AND done_at IS NULL";
        let renewed = sqlx::query(sql).bind(&portion.id).bind(portion.fence).bind(worker);
        renewed.bind(until.unix_ms()).execute(&mut *self.inner).await?;
        Ok(())
    }

    /// Store what a portion gave. `false`: this claim of it does not count any more, and nothing was
    /// written.
    pub async fn finish_portion(
        &mut self,
        portion: &Portion,
        worker: &str,
        outcomes: &[u8],
        now: Timestamp,
    ) -> Result<bool> {
        let sql = "UPDATE portion SET outcomes = $4, done_at = $5, lease_until = NULL \
                   WHERE id = $1 AND fence = $2 AND owner = $3 AND done_at IS NULL";
        let done = sqlx::query(sql).bind(&portion.id).bind(portion.fence).bind(worker);
        let done = done.bind(outcomes).bind(now.unix_ms()).execute(&mut *self.inner).await?;
        Ok(done.rows_affected() > 0)
    }

    /// Give a portion back that was not computed to its end.
    pub async fn release_portion(&mut self, portion: &Portion, worker: &str) -> Result<()> {
        let sql = "UPDATE portion SET owner = NULL, lease_until = NULL \
                   WHERE id = $1 AND fence = $2 AND owner = $3 AND done_at IS NULL";
        let given = sqlx::query(sql).bind(&portion.id).bind(portion.fence).bind(worker);
        given.execute(&mut *self.inner).await?;
        Ok(())
    }

    /// Give all portions back that a worker computes.
    pub async fn release_portions(&mut self, worker: &str) -> Result<()> {
        let sql = "UPDATE portion SET owner = NULL, lease_until = NULL WHERE owner = $1 AND done_at IS NULL";
        sqlx::query(sql).bind(worker).execute(&mut *self.inner).await?;
        Ok(())
    }

    /// Drop a portion that nobody computes. `false`: somebody does, or has.
    pub async fn take_portion_back(&mut self, id: &str, now: Timestamp) -> Result<bool> {
        let sql = "DELETE FROM portion WHERE id = $1 AND done_at IS NULL AND (lease_until IS NULL OR lease_until < $2)";
        let gone = sqlx::query(sql).bind(id).bind(now.unix_ms()).execute(&mut *self.inner).await?;
        Ok(gone.rows_affected() > 0)
    }

    /// Drop a portion, whoever computes it.
    pub async fn drop_portion(&mut self, id: &str) -> Result<()> {
        sqlx::query("DELETE FROM portion WHERE id = $1").bind(id).execute(&mut *self.inner).await?;
        Ok(())
    }

    /// Drop the portions of one attempt at a job, whoever computes them.
    pub async fn drop_portions(&mut self, of: &Lease) -> Result<()> {
        let sql = "DELETE FROM portion WHERE job = $1 AND attempt = $2";
        sqlx::query(sql).bind(&of.job).bind(of.fence).execute(&mut *self.inner).await?;
        Ok(())
    }

    /// Drop the portions of all attempts at a job: one begins or ends.
    pub(super) async fn end_portions(&mut self, job: &str) -> Result<()> {
        let sql = "DELETE FROM portion WHERE job = $1";
        sqlx::query(sql).bind(job).execute(&mut *self.inner).await?;
        Ok(())
    }
}

/// The query of the first portion that a worker may claim: of the job that was requested first. Its own
/// jobs' portions a worker takes back instead. `None` without kinds.
fn next(
    postgres: bool,
    before: &str,
    worker: &str,
    kinds: &[JobKind],
    now: Timestamp,
) -> Option<Parts> {
    let (first, others) = kinds.split_first()?;
    let mut next = Parts::new(postgres, before);
    next.push("SELECT p.id FROM portion p JOIN job j ON j.id = p.job WHERE p.done_at IS NULL AND (p.lease_until IS NULL OR p.lease_until < ")
        .push_bind(now.unix_ms())
        .push(") AND p.fence < ")
        .push_bind(CLAIMS_MAX)
        .push(" AND j.owner <> ")
        .push_bind(worker.to_owned())
        .push(" AND ")
        .push(WANTED)
        .push_bind(now.unix_ms())
        .push(" AND j.kind IN (")
        .push_bind(word(first));
    for kind in others {
        next.push(", ").push_bind(word(kind));
    }
    next.push(") ORDER BY j.seq, p.number LIMIT 1");
    Some(next)
}

#[cfg(test)]
mod tests;
