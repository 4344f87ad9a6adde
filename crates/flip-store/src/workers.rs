//! The processes that compute jobs: who is there, and when each was last heard of.
//!
//! What this says is for people. Whether a job may be taken is decided by its lease alone
//! (`ledger.rs`).

use super::row::{Columns, json};
use super::sql::Flag;
use super::{Result, Store, Tx};
use flip_core::domain::job::JobKind;
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;
use std::collections::{HashMap, HashSet};

/// How long one that has ended, or was lost, is remembered, ms: a week.
const REMEMBERED_MS: i64 = 7 * 86_400_000;

/// A process that computes jobs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Worker {
    /// Its id, new at each start: the owner of the jobs that it computes.
    pub id: String,
    /// Its name: that of its machine, unless it was given one.
    pub name: String,
    /// The version of FLIP.
    pub version: String,
    /// The kinds of jobs that it takes.
    pub kinds: Vec<JobKind>,
    /// On how many threads it computes.
    pub threads: u32,
    /// Whether it answers requests, too.
    pub serves: bool,
    /// Its graphics card, on which it computes jobs that ask for one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub card: Option<String>,
    /// When it started.
    pub started_at: Timestamp,
    /// When it was last heard of.
    pub heard_at: Timestamp,
    /// When it ended in order; absent while it works, and if it was lost.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ended_at: Option<Timestamp>,
    /// The jobs that it computes or helps with.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub jobs: Vec<String>,
}

/// The name of this machine, `flip` if it has none.
pub fn machine_name() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let name: String = name.trim().chars().take(100).collect();
    if name.is_empty() { "flip".to_owned() } else { name }
}

impl Store {
    /// The processes of the last week that compute jobs, the one that started last first.
    pub async fn workers(&self) -> Result<Vec<Worker>> {
        let sql = "SELECT id, seq, owner FROM job WHERE state = 'running' AND owner IS NOT NULL \
                   UNION SELECT j.id, j.seq, p.owner FROM portion p JOIN job j ON j.id = p.job \
                   WHERE j.state = 'running' AND p.owner IS NOT NULL AND p.done_at IS NULL ORDER BY seq";
        let mut computing = HashMap::<String, Vec<String>>::new();
        for row in sqlx::query(sql).fetch_all(&self.reader).await? {
            computing.entry(row.plain("owner")?).or_default().push(row.plain("id")?);
        }
        let sql = "SELECT * FROM worker ORDER BY started_at DESC, id DESC";
        let mut workers: Vec<Worker> = sqlx::query(sql)
            .fetch_all(&self.reader)
            .await?
            .iter()
            .map(worker)
            .collect::<Result<_>>()?;
        for worker in &mut workers {
            worker.jobs = computing.remove(&worker.id).unwrap_or_default();
        }
        Ok(workers)
    }

    /// The other workers that may help with a job of this kind: they were heard of since `heard_after`,
    /// have this version, and compute no job of their own of these kinds, which fill a machine.
    pub async fn helpers(
        &self,
        ours: &Worker,
        kind: JobKind,
        filling: &[JobKind],
        heard_after: Timestamp,
    ) -> Result<Vec<Worker>> {
        let sql = "SELECT owner, kind FROM job WHERE state = 'running' AND owner IS NOT NULL";
        let mut busy = HashSet::<String>::new();
        for row in sqlx::query(sql).fetch_all(&self.reader).await? {
            // A kind that is not known here fills no machine that could help.
            if row.word("job", "kind").is_ok_and(|kind: JobKind| filling.contains(&kind)) {
                busy.insert(row.plain("owner")?);
            }
        }
        let sql = "SELECT * FROM worker WHERE ended_at IS NULL AND heard_at > $1 AND version = $2 AND id <> $3";
        let rows = sqlx::query(sql).bind(heard_after.unix_ms()).bind(&ours.version).bind(&ours.id);
        let workers: Vec<Worker> =
            rows.fetch_all(&self.reader).await?.iter().map(worker).collect::<Result<_>>()?;
        let may = |it: &Worker| it.kinds.contains(&kind) && !busy.contains(&it.id);
        Ok(workers.into_iter().filter(may).collect())
    }

    /// The running jobs of a worker that somebody wants cancelled.
    pub async fn cancelled_of(&self, worker: &str) -> Result<Vec<String>> {
        let sql = "SELECT id FROM job WHERE owner = $1 AND state = 'running' AND cancel_requested";
        Ok(sqlx::query_scalar(sql).bind(worker).fetch_all(&self.reader).await?)
    }
}

impl Tx {
    /// Note that a worker started, and forget those that nobody has heard of for a week.
    pub async fn insert_worker(&mut self, new: &Worker) -> Result<()> {
        let old = "DELETE FROM worker WHERE heard_at < $1";
        let old = sqlx::query(old).bind(new.started_at.unix_ms() - REMEMBERED_MS);
        old.execute(&mut *self.inner).await?;
        let sql = "INSERT INTO worker (id, name, version, kinds, threads, serves, started_at, heard_at, card) \
                   VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9)";
        sqlx::query(sql)
            .bind(&new.id)
            .bind(&new.name)
            .bind(&new.version)
            .bind(json(&new.kinds)?)
            .bind(i64::from(new.threads))
            .bind(new.serves)
            .bind(new.started_at.unix_ms())
            .bind(new.heard_at.unix_ms())
            .bind(&new.card)
            .execute(&mut *self.inner)
            .await?;
        Ok(())
    }

    /// Note that a worker is there. `false`: it is not remembered any more.
    pub async fn worker_heard(&mut self, id: &str, now: Timestamp) -> Result<bool> {
        let sql = "UPDATE worker SET heard_at = $2 WHERE id = $1";
        let done = sqlx::query(sql).bind(id).bind(now.unix_ms()).execute(&mut *self.inner).await?;
        Ok(done.rows_affected() > 0)
    }

    /// Note that a worker ended in order.
    pub async fn worker_ended(&mut self, id: &str, now: Timestamp) -> Result<()> {
        let sql = "UPDATE worker SET ended_at = $2, heard_at = $2 WHERE id = $1";
        sqlx::query(sql).bind(id).bind(now.unix_ms()).execute(&mut *self.inner).await?;
        Ok(())
    }
}

fn worker(row: &AnyRow) -> Result<Worker> {
    let Flag(serves) = row.plain("serves")?;
    Ok(Worker {
        id: row.plain("id")?,
        name: row.plain("name")?,
        version: row.plain("version")?,
        kinds: row.json("kinds")?,
        threads: row.count("threads")?,
        serves,
        card: row.plain("card")?,
        started_at: row.time("started_at")?,
        heard_at: row.time("heard_at")?,
        ended_at: row.maybe_time("ended_at")?,
        jobs: Vec::new(),
    })
}
