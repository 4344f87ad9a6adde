//! All SQL and all stored files: one database and a folder of content-addressed artifacts.
//!
//! The database is a file of SQLite in that folder, or one on a server of PostgreSQL. Statements are
//! written once, for both: `sql.rs` says how, `sqlite.rs` and `postgres.rs` hold what only one has.
//!
//! There is one writer at a time, except that what a dose records on a bench of a server's database
//! waits for nobody but that bench's own writers (`benches.rs`).
//!
//! One connection writes and four read; two more read for answers that grow with the whole history.
//! A transaction that writes begins with a lock that only one has. In SQLite that is `BEGIN
//! IMMEDIATE`: a deferred one that reads first and writes later can fail with a snapshot conflict,
//! which the busy timeout does not cover.

pub mod archive;
pub mod archiving;
pub mod artifacts;
pub mod audit;
pub mod audit_search;
pub mod backup;
pub mod bench;
pub mod bench_requests;
pub mod benches;
pub mod checklist;
mod clock;
pub mod counts;
pub mod current_simulator;
mod error;
pub mod evaluations;
pub mod events;
pub mod health;
pub mod holds;
pub mod jobs;
pub mod labels;
pub mod ledger;
mod lock;
pub mod migrate;
pub mod node_actions;
pub mod observations;
mod open;
pub mod page;
pub mod pan;
pub mod parameter_sets;
pub mod piles;
mod place;
pub mod policies;
pub mod portions;
mod postgres;
pub mod powders;
mod row;
pub mod said;
pub mod simulators;
mod sound;
pub mod spoonfuls;
mod sql;
mod sqlite;
mod stock;
pub mod stops;
mod storage;
pub mod tokens;
mod trail;
pub mod trials;
pub mod verify;
pub mod webhooks;
mod weighing_rows;
pub mod weighing_search;
pub mod weighings;
pub mod who;
pub mod withdrawals;
pub mod workers;

pub use clock::now;
pub use error::{Error, Result};
pub use storage::Storage;

use archive::Archives;
use artifacts::Artifacts;
use benches::{Owned, Speaks};
use events::Told;
use lock::DataLock;
use place::Place;
use postgres::Server;
use sqlx::{Any, AnyPool, Transaction};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use tempfile::TempDir;
use tokio::sync::watch;

/// An open data folder. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Store {
    reader: AnyPool,
    /// One more read connection, for queries that must not wait behind other readers.
    apart: AnyPool,
    /// For answers that grow with the whole history: nobody else waits for these.
    long: AnyPool,
    /// `None` when opened read-only.
    writer: Option<AnyPool>,
    artifacts: Artifacts,
    archives: Archives,
    /// Number of the latest committed event.
    newest_event: watch::Sender<i64>,
    /// The database on a server; `None` when it is the file in the data folder.
    server: Option<Arc<Server>>,
    /// What shows that the data folder is where it was: SQLite's file, else the lock; `None` for a
    /// database on a server beside the process that serves it.
    place: Option<Place>,
    /// The bench that this store speaks for.
    bench: Speaks,
    /// That this process has it, in a server's database.
    owned: Arc<OnceLock<Owned>>,
    /// For what doses record in a server's database: they wait for no other transaction of this
    /// process either.
    recorder: Option<AnyPool>,
    /// Error of the last write transaction, if it failed.
    unwritten: Arc<Mutex<Option<String>>>,
    /// Held until the last clone is gone.
    lock: Option<Arc<DataLock>>,
    /// The folder of the migrated copy that is read in place of an older database; removed with the
    /// last clone.
    _copied: Option<Arc<TempDir>>,
}

impl Store {
    /// Begin a write transaction.
    ///
    /// # Errors
    /// [`Error::ReadOnly`]; [`Error::Locked`] when the write lock is not free within the timeouts;
    /// [`Error::Gone`].
    pub async fn write(&self) -> Result<Tx> {
        let writer = self.writer()?;
        self.is_in_place()?;
        let begun = self.begin(writer).await;
        let inner = begun.inspect_err(|error| self.note_written(Some(error)))?;
        Ok(self.transaction(inner))
    }

    fn transaction(&self, inner: Transaction<'static, Any>) -> Tx {
        let (events, chains, unnamed) = Default::default();
        Tx { inner, store: self.clone(), events, chains, unnamed }
    }

    /// Begin with the lock that only one transaction has.
    async fn begin(&self, writer: &AnyPool) -> Result<Transaction<'static, Any>> {
        if !self.is_postgres() {
            return Ok(writer.begin_with("BEGIN IMMEDIATE").await?);
        }
        // In two steps: a transaction that does not get the lock must be rolled back.
        let mut begun = writer.begin_with(postgres::BEGIN).await?;
        postgres::lock(&mut begun).await?;
        Ok(begun)
    }

    /// Whether other processes may compute jobs of this database.
    pub fn is_shared(&self) -> bool {
        self.is_postgres()
    }

    fn is_postgres(&self) -> bool {
        self.server.is_some()
    }

    /// The write connection.
    ///
    /// # Errors
    /// [`Error::ReadOnly`].
    pub fn writer(&self) -> Result<&AnyPool> {
        self.writer.as_ref().ok_or(Error::ReadOnly)
    }

    /// Remember whether a transaction was written, for health checks.
    fn note_written(&self, error: Option<&Error>) {
        let mut unwritten = self.unwritten.lock().unwrap_or_else(PoisonError::into_inner);
        // Closing is not an error.
        *unwritten = error.filter(|error| !error.is_closed()).map(ToString::to_string);
    }

    /// Check that the database is still where it was opened.
    ///
    /// # Errors
    /// [`Error::Gone`]
    pub fn is_in_place(&self) -> Result<()> {
        self.place.as_ref().map_or(Ok(()), Place::check)
    }

    /// Artifacts: checkpoints and traces.
    pub fn artifacts(&self) -> &Artifacts {
        &self.artifacts
    }

    /// Close every connection, after checkpointing the write-ahead log into the database.
    /// Idempotent.
    pub async fn close(&self) {
        if self.writer.as_ref().is_some_and(|writer| !writer.is_closed())
            && let Err(error) = self.give_bench_back().await
        {
            tracing::warn!(%error, "the bench was not given back; others call it lost when its lease ends");
        }
        if let Some(server) = &self.server {
            server.close().await;
        }
        // Readers would block the checkpoint.
        self.reader.close().await;
        self.apart.close().await;
        self.long.close().await;
        if let Some(recorder) = &self.recorder {
            recorder.close().await;
        }
        if let Some(writer) = self.writer.as_ref().filter(|writer| !writer.is_closed()) {
            if !self.is_postgres()
                && let Err(error) =
                    sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(writer).await
            {
                tracing::warn!(%error, "the write-ahead log was not checkpointed; SQLite does it at the next start");
            }
            writer.close().await;
        }
    }
}

/// A write transaction. Dropping it rolls everything back.
#[derive(Debug)]
pub struct Tx {
    inner: Transaction<'static, Any>,
    store: Store,
    /// What is told at the end: only then, so that events become visible in the order of their
    /// numbers.
    events: Vec<Told>,
    /// Chains of the audit trail that nobody else adds to until the end.
    chains: Vec<i64>,
    /// Artifacts that this transaction's rows no longer name.
    unnamed: Vec<String>,
}

impl Tx {
    /// Commit durably, then notify followers of events, and remove files that no row names any
    /// more.
    ///
    /// # Errors
    /// [`Error::Database`], [`Error::Gone`]: nothing was written.
    pub async fn commit(mut self) -> Result<()> {
        self.store.is_in_place()?;
        let committed = match self.tell_events().await {
            Ok(newest) => self.inner.commit().await.map_err(Error::from).map(|()| newest),
            Err(error) => Err(error),
        };
        self.store.note_written(committed.as_ref().err());
        if let Some(seq) = committed? {
            events::tell(&self.store.newest_event, seq);
        }
        for sha256 in self.unnamed {
            if let Err(error) = self.store.forget_artifact(&sha256).await {
                tracing::warn!(sha256, %error, "a file that no row names was left; the next start removes it");
            }
        }
        Ok(())
    }
}

/// A new id: 48 bits of time, then random bits, so that ids sort by age.
pub fn new_id() -> String {
    uuid::Uuid::now_v7().to_string()
}

#[cfg(test)]
mod either_tests;
#[cfg(test)]
mod testing;
