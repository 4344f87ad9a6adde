//! The benches of a database: which there are, which process has each, what others ask of it
//! (`bench_requests.rs`), and what is in whose container.
//!
//! A store speaks for one bench, by its name. In a data folder that is the one process there is. In
//! a server's database a process *has* the bench: a lock that ends with its connection keeps a
//! second process out, a lease tells the others that it is there, and a fence, raised whenever the
//! bench changes hands, is proved in each transaction in which the bench's thread writes. So who has
//! lost a bench can record nothing, and what cannot be recorded does not move.

use super::row::Columns;
use super::{Error, Result, Store, Tx, new_id, now, postgres};
use crate::audit::About;
use flip_core::domain::bench::BenchKind;
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;
use sqlx::postgres::PgConnection;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

/// Name of the bench where nobody names one.
pub const DEFAULT_BENCH: &str = "bench";
/// How long a process that is not heard of keeps its bench, ms.
pub const LEASE_MS: i64 = 15_000;
/// Most benches of a database: a record's position must be a number that JSON keeps exactly.
const BENCHES_MAX: i64 = 8192;

/// The bench that a store speaks for.
#[derive(Debug, Clone)]
pub(super) struct Speaks {
    pub name: Arc<str>,
    /// Its chain of the audit trail.
    pub chain: i64,
}

impl Default for Speaks {
    fn default() -> Self {
        Self { name: DEFAULT_BENCH.into(), chain: 0 }
    }
}

impl Speaks {
    /// The key of its rows in tables that hold one of each bench.
    pub(super) fn one(&self) -> i64 {
        1 + self.chain
    }
}

/// That this process has its bench.
#[derive(Debug)]
pub(super) struct Owned {
    owner: String,
    fence: AtomicI64,
}

/// What a bench's container holds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Loaded {
    /// Powder id.
    pub powder: String,
    /// Its lot, if it was said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lot: Option<String>,
    /// Since when.
    pub at: Timestamp,
}

/// A bench of the database.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BenchRow {
    /// Its name.
    pub name: String,
    /// What it is; absent if no process has had it yet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kind: Option<BenchKind>,
    /// The process that has it (`GET /v1/workers`); absent if none has.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub owner: Option<String>,
    /// The machine on which that runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub machine: Option<String>,
    /// Since when that process has it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub since: Option<Timestamp>,
    /// When that process was last heard of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub heard_at: Option<Timestamp>,
    /// Whether a process has it and was heard of in the last 15 s: whether it carries out doses.
    pub served: bool,
    /// Why it is latched, if it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latch: Option<String>,
    /// Why nothing starts on it until a person resumes, if so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held: Option<String>,
    /// The weighing that moves.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moving: Option<String>,
    /// How many weighings wait for it.
    pub waiting: u32,
    /// What its container holds, if it was said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub holds: Option<Loaded>,
}

const BENCHES: &str = "SELECT b.*, \
    (SELECT reason FROM latch WHERE bench_name = b.name AND cleared_at IS NULL) AS latch, \
    (SELECT reason FROM bench_hold WHERE bench_name = b.name AND resumed_at IS NULL) AS held, \
    (SELECT id FROM weighing WHERE bench_name = b.name AND state IN ('armed', 'dosing', 'settling')) AS moving, \
    (SELECT count(*) FROM weighing WHERE bench_name = b.name AND state IN ('planned', 'awaiting_vial')) AS waiting \
    FROM bench b ORDER BY b.name";

impl Store {
    /// The name of the bench that this store speaks for.
    pub fn bench_name(&self) -> &str {
        &self.bench.name
    }

    /// The id by which this process has its bench, in a server's database.
    pub fn bench_owner(&self) -> Option<&str> {
        self.owned.get().map(|owned| owned.owner.as_str())
    }

    /// All benches, by name.
    pub async fn benches(&self) -> Result<Vec<BenchRow>> {
        let at = now();
        let rows = sqlx::query(BENCHES).fetch_all(&self.reader).await?;
        rows.iter().map(|row| bench(row, at)).collect()
    }

    /// The same store, speaking for another bench, which this process does not have; `None` if there
    /// is none of that name.
    pub async fn at_bench(&self, name: &str) -> Result<Option<Self>> {
        let chain = "SELECT chain FROM bench WHERE name = $1";
        let chain = sqlx::query_scalar(chain).bind(name).fetch_optional(&self.reader).await?;
        Ok(chain.map(|chain| Self {
            bench: Speaks { name: name.into(), chain },
            owned: Arc::default(),
            recorder: None,
            ..self.clone()
        }))
    }

    /// Make sure that there is a bench of this name, and speak for it.
    pub(super) async fn speak_for(&mut self, name: &str) -> Result<()> {
        if let Some(there) = self.at_bench(name).await? {
            self.bench = there.bench;
            return Ok(());
        }
        let mut tx = self.write().await?;
        let next = "SELECT CASE WHEN $1 THEN 0 ELSE coalesce(max(chain), 0) + 1 END FROM bench";
        let next = sqlx::query_scalar(next).bind(name == DEFAULT_BENCH);
        let chain: i64 = next.fetch_one(&mut *tx.inner).await?;
        if chain >= BENCHES_MAX {
            return Err(Error::Server(format!("it has {chain} benches, the most there may be")));
        }
        // Another process may have been quicker.
        let sql = "INSERT INTO bench (name, chain) VALUES ($1, $2) ON CONFLICT (name) DO NOTHING";
        sqlx::query(sql).bind(name).bind(chain).execute(&mut *tx.inner).await?;
        tx.commit().await?;
        if let Some(there) = self.at_bench(name).await? {
            self.bench = there.bench;
        }
        Ok(())
    }

    /// Get the lock of the bench, which this connection keeps.
    ///
    /// # Errors
    /// [`Error::Served`] while another process has it.
    pub(super) async fn lock_bench(&self, alone: &mut PgConnection) -> Result<()> {
        match postgres::lock_bench(alone, self.bench.chain).await {
            Err(Error::Locked) => Err(self.served_by().await?),
            locked => locked,
        }
    }

    /// Have the bench of a server's database, whose lock this process got when it opened it. From
    /// here on whoever had it can record nothing.
    ///
    /// # Errors
    /// [`Error::ReadOnly`], [`Error::Locked`], [`Error::Unreachable`] and others.
    pub async fn take_bench(&self) -> Result<()> {
        if self.recorder.is_none() || self.owned.get().is_some() {
            return Ok(());
        }
        let owner = format!("flip-{}", new_id());
        let mut tx = self.write().await?;
        let fence = tx.change_hands(Some(&owner)).await?;
        tx.commit().await?;
        self.owned.get_or_init(|| Owned { owner, fence: fence.into() });
        Ok(())
    }

    /// Who has the bench, as a refusal.
    async fn served_by(&self) -> Result<Error> {
        let bench = self.bench.name.to_string();
        let found = self.benches().await?.into_iter().find(|it| it.name == bench);
        let machine = found.as_ref().and_then(|it| it.machine.clone());
        let heard = found.and_then(|it| it.heard_at);
        let heard_s = heard.map_or(0, |at| (now().unix_ms() - at.unix_ms()).max(0) / 1000);
        let machine = machine.unwrap_or_else(|| "another process".to_owned());
        Ok(Error::Served { bench, machine, heard_s })
    }

    /// Tell the others that this process still has its bench. One that was taken for lost, and that
    /// nobody else has taken since, is taken again.
    ///
    /// # Errors
    /// [`Error::Disowned`]: the bench has changed hands, and what moves must stop; called again, this
    /// takes it back unless another process has it.
    pub async fn renew_bench(&self, kind: BenchKind) -> Result<()> {
        let (Some(owned), Some(server)) = (self.owned.get(), &self.server) else { return Ok(()) };
        let fence = owned.fence.load(Ordering::SeqCst);
        let until = now().unix_ms() + LEASE_MS;
        match server.renew((&self.bench.name, &owned.owner, fence), until, kind.name()).await {
            Ok(true) => return Ok(()),
            Ok(false) => {}
            Err(error) => {
                // Its lock may be another's by now.
                drop(self.write_for_bench().await?);
                return Err(error);
            }
        }
        let mut tx = self.write().await?;
        let free = "SELECT count(*) FROM bench WHERE name = $1 AND owner IS NULL";
        let free = sqlx::query_scalar::<_, i64>(free).bind(&*self.bench.name);
        if free.fetch_one(&mut *tx.inner).await? > 0 {
            let fence = tx.change_hands(Some(&owned.owner)).await?;
            tx.commit().await?;
            owned.fence.store(fence, Ordering::SeqCst);
        }
        Err(Error::Disowned(self.bench.name.to_string()))
    }

    /// Give the bench back: the process ends in order.
    pub(super) async fn give_bench_back(&self) -> Result<()> {
        let Some(owned) = self.owned.get() else { return Ok(()) };
        let mut tx = self.write().await?;
        let sql = "UPDATE bench SET owner = NULL, lease_until = NULL WHERE name = $1 AND owner = $2 AND fence = $3";
        sqlx::query(sql)
            .bind(&*self.bench.name)
            .bind(&owned.owner)
            .bind(owned.fence.load(Ordering::SeqCst))
            .execute(&mut *tx.inner)
            .await?;
        tx.commit().await
    }

    /// Begin a transaction in which the bench's thread or its owner writes: only while this process
    /// has the bench.
    ///
    /// # Errors
    /// As [`Self::write`]; [`Error::Disowned`].
    pub async fn write_for_bench(&self) -> Result<Tx> {
        let mut tx = self.write().await?;
        tx.prove_bench().await?;
        Ok(tx)
    }

    /// The same for what a dose records on its way. In a server's database it waits for nobody but
    /// writers of this bench's own chain.
    ///
    /// # Errors
    /// As [`Self::write_for_bench`].
    pub async fn write_record(&self) -> Result<Tx> {
        let Some(recorder) = &self.recorder else { return self.write_for_bench().await };
        let begun = async {
            let inner = recorder.begin_with(postgres::BEGIN).await?;
            let mut tx = self.transaction(inner);
            tx.lock_chain(self.bench.chain).await?;
            tx.prove_bench().await?;
            Ok(tx)
        };
        begun.await.inspect_err(|error| self.note_written(Some(error)))
    }
}

impl Tx {
    /// Check that this process still has its bench. A store that has none to lose passes.
    async fn prove_bench(&mut self) -> Result<()> {
        let Some(owned) = self.store.owned.get() else { return Ok(()) };
        let sql = "SELECT fence FROM bench WHERE name = $1 AND owner = $2";
        let fence: Option<i64> = sqlx::query_scalar(sql)
            .bind(&*self.store.bench.name)
            .bind(&owned.owner)
            .fetch_optional(&mut *self.inner)
            .await?;
        match fence == Some(owned.fence.load(Ordering::SeqCst)) {
            true => Ok(()),
            false => Err(Error::Disowned(self.store.bench.name.to_string())),
        }
    }

    /// The bench changes hands: from here on whoever had it can record nothing. Returns the fence.
    async fn change_hands(&mut self, owner: Option<&str>) -> Result<i64> {
        // What its owner records right now comes before this, or not at all.
        self.lock_chain(self.store.bench.chain).await?;
        let sql = "UPDATE bench SET owner = $2, machine = coalesce($3, machine), fence = fence + 1, lease_until = $4, since = $5 \
                   WHERE name = $1 RETURNING fence";
        let at = now().unix_ms();
        let fence = sqlx::query_scalar(sql)
            .bind(&*self.store.bench.name)
            .bind(owner)
            .bind(owner.map(|_| super::workers::machine_name()))
            .bind(owner.map(|_| at + LEASE_MS))
            .bind(owner.map(|_| at));
        Ok(fence.fetch_one(&mut *self.inner).await?)
    }

    /// Take the bench from an owner that was lost. `false`: it has been heard of, or another process
    /// has taken it.
    pub async fn take_from_lost_owner(&mut self, now: Timestamp) -> Result<bool> {
        let sql =
            "SELECT count(*) FROM bench WHERE name = $1 AND owner IS NOT NULL AND lease_until < $2";
        let lost = sqlx::query_scalar::<_, i64>(sql).bind(&*self.store.bench.name);
        if lost.bind(now.unix_ms()).fetch_one(&mut *self.inner).await? == 0 {
            return Ok(false);
        }
        self.change_hands(None).await?;
        Ok(true)
    }

    /// Say what the bench's container holds from now on; `None`: nothing.
    pub async fn load_bench(&mut self, loaded: Option<&Loaded>, now: Timestamp) -> Result<()> {
        let sql = "UPDATE bench SET powder = $2, lot = $3, loaded_at = $4 WHERE name = $1";
        sqlx::query(sql)
            .bind(&*self.store.bench.name)
            .bind(loaded.map(|it| it.powder.clone()))
            .bind(loaded.and_then(|it| it.lot.clone()))
            .bind(loaded.map(|it| it.at.unix_ms()))
            .execute(&mut *self.inner)
            .await?;
        let mut said = serde_json::json!({ "action": "load", "holds": loaded });
        self.name_bench(&mut said);
        self.audit_at_bench(About { weighing: None, kind: "person" }, &said, now).await?;
        self.emit(super::bench::BENCH_TOPIC, "loaded", &said).await
    }

    /// Write the bench's name into what is recorded of it, unless it is the one that needs no name.
    pub(super) fn name_bench(&self, said: &mut serde_json::Value) {
        if self.store.bench_name() != DEFAULT_BENCH {
            said["bench_name"] = self.store.bench_name().into();
        }
    }

    /// The chain of a bench.
    pub(super) async fn chain_of(&mut self, name: &str) -> Result<i64> {
        if name == self.store.bench_name() {
            return Ok(self.store.bench.chain);
        }
        let chain = "SELECT chain FROM bench WHERE name = $1";
        let chain = sqlx::query_scalar(chain).bind(name).fetch_optional(&mut *self.inner).await?;
        Ok(chain.unwrap_or(0))
    }
}

fn bench(row: &AnyRow, at: Timestamp) -> Result<BenchRow> {
    let lease_until: Option<i64> = row.plain("lease_until")?;
    let owner: Option<String> = row.plain("owner")?;
    let powder: Option<String> = row.plain("powder")?;
    let holds = match (powder, row.maybe_time("loaded_at")?) {
        (Some(powder), Some(at)) => Some(Loaded { powder, lot: row.plain("lot")?, at }),
        _ => None,
    };
    let heard_at = lease_until.map(|until| Timestamp::from_unix_ms(until - LEASE_MS));
    Ok(BenchRow {
        name: row.plain("name")?,
        kind: row.maybe_word("bench", "kind")?,
        served: owner.is_some() && lease_until.is_some_and(|until| until >= at.unix_ms()),
        owner,
        machine: row.plain("machine")?,
        since: row.maybe_time("since")?,
        heard_at,
        latch: row.plain("latch")?,
        held: row.plain("held")?,
        moving: row.plain("moving")?,
        waiting: row.count("waiting")?,
        holds,
    })
}

#[cfg(test)]
mod tests;
