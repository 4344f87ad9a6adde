//! The only SQL and the only files: one SQLite database and a folder of content-addressed artifacts.
//!
//! One connection writes and four read. A transaction that writes begins with `BEGIN IMMEDIATE`: a deferred one that
//! read first and writes later can fail with a snapshot conflict that the busy time-out does not wait for.

pub mod artifacts;
pub mod audit;
pub mod bench;
pub mod counts;
pub mod current_simulator;
pub mod evaluations;
pub mod events;
pub mod holds;
pub mod jobs;
pub mod ledger;
mod lock;
pub mod observations;
mod open;
pub mod page;
pub mod pan;
pub mod parameter_sets;
pub mod piles;
mod place;
pub mod policies;
pub mod powders;
mod row;
pub mod simulators;
pub mod tokens;
pub mod trials;
pub mod weighings;

use crate::domain::timestamp::Timestamp;
use artifacts::Artifacts;
use lock::DataLock;
use place::Place;
use sqlx::{Sqlite, SqliteConnection, SqlitePool, Transaction};
use std::path::PathBuf;
use std::sync::Arc;
use tokio::sync::watch;

/// SQLite's primary result codes (sqlite.org/rescode.html).
const SQLITE_BUSY: u32 = 5;
const SQLITE_LOCKED: u32 = 6;
const SQLITE_IOERR: u32 = 10;
const SQLITE_FULL: u32 = 13;

/// Why the store did not do what it was asked.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Another process holds the data folder.
    #[error("flip serve holds this database ({0}): stop it, or ask it through its API")]
    Held(PathBuf),
    /// The writer's fence is not the row's any more: somebody else has the job, or it has ended.
    #[error("the job has been taken over or has ended")]
    Fenced,
    /// Opened to read only.
    #[error("the database was opened to read only")]
    ReadOnly,
    /// The SQLite in this program is older than the one that fixed the reset of the write-ahead log.
    #[error("SQLite {0} is too old: 3.51.3 or newer is needed")]
    Old(String),
    /// The file that is written is no longer the one at its path.
    #[error("{0} is no longer the database that is being written: it was moved, removed or replaced")]
    Gone(PathBuf),
    /// What was read is not what was written.
    #[error("{0}")]
    Corrupt(String),
    /// The database says no.
    #[error(transparent)]
    Database(#[from] sqlx::Error),
    /// The file system says no.
    #[error("{path}: {source}")]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

impl Error {
    /// The store has been closed.
    pub fn is_closed(&self) -> bool {
        matches!(self, Self::Database(sqlx::Error::PoolClosed))
    }

    /// What is in the way of a record, and what a person can do about it.
    pub fn remedy(&self) -> String {
        match self.sqlite_code() {
            Some(SQLITE_BUSY | SQLITE_LOCKED) => "another program holds the database: close it there".to_owned(),
            Some(SQLITE_FULL) => "the disk is full: make room".to_owned(),
            Some(SQLITE_IOERR) => format!("the disk does not take it ({self}): make room, or mend it"),
            _ if matches!(self, Self::Database(sqlx::Error::PoolTimedOut)) => {
                "the database is in use and was not given back in time: close other programs that hold it".to_owned()
            }
            _ if matches!(self, Self::Gone(_)) => format!("{self}. Put it back, and start FLIP again"),
            _ => self.to_string(),
        }
    }

    /// SQLite's primary result code, where it is SQLite that says no.
    fn sqlite_code(&self) -> Option<u32> {
        let Self::Database(sqlx::Error::Database(error)) = self else { return None };
        // The low byte of an extended code.
        error.code()?.parse::<u32>().ok().map(|code| code & 0xff)
    }
}

/// What every function of the store returns.
pub type Result<T> = std::result::Result<T, Error>;

/// One opened data folder. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Store {
    reader: SqlitePool,
    /// `None` when opened to read only.
    writer: Option<SqlitePool>,
    artifacts: Artifacts,
    /// Where the database is.
    place: Place,
    /// Number of the newest event that is committed.
    newest_event: watch::Sender<i64>,
    /// Held until the last clone is gone.
    _lock: Option<Arc<DataLock>>,
}

impl Store {
    /// Begin a transaction that writes.
    ///
    /// # Errors
    /// [`Error::ReadOnly`]; [`Error::Database`] when the write lock is not free within the time-outs.
    pub async fn write(&self) -> Result<Tx> {
        let inner = self.writer()?.begin_with("BEGIN IMMEDIATE").await?;
        Ok(Tx { inner, store: self.clone(), newest_event: None, unnamed: Vec::new() })
    }

    /// The connection that writes, for the queue library, which brings its own statements.
    ///
    /// # Errors
    /// [`Error::ReadOnly`].
    pub(crate) fn writer(&self) -> Result<&SqlitePool> {
        self.writer.as_ref().ok_or(Error::ReadOnly)
    }

    /// Connections that read, for statements about the queue library's tables.
    pub(crate) fn reader(&self) -> &SqlitePool {
        &self.reader
    }

    /// The database is still where it was opened.
    ///
    /// # Errors
    /// [`Error::Gone`]
    pub(crate) fn is_in_place(&self) -> Result<()> {
        self.place.check()
    }

    /// Artifacts: checkpoints and traces.
    pub fn artifacts(&self) -> &Artifacts {
        &self.artifacts
    }

    /// Close every connection, after moving the write-ahead log into the database. Once is enough; more does no harm.
    pub async fn close(&self) {
        // Readers would keep the log from being moved.
        self.reader.close().await;
        if let Some(writer) = self.writer.as_ref().filter(|writer| !writer.is_closed()) {
            if let Err(error) = sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(writer).await {
                tracing::warn!(%error, "the write-ahead log was not checkpointed; SQLite does it at the next start");
            }
            writer.close().await;
        }
    }
}

/// A transaction that writes. Dropping it undoes everything.
#[derive(Debug)]
pub struct Tx {
    inner: Transaction<'static, Sqlite>,
    store: Store,
    newest_event: Option<i64>,
    /// Artifacts that rows named until this transaction.
    unnamed: Vec<String>,
}

impl Tx {
    /// Make it durable, then wake whoever follows events, and remove files that no row names any more.
    ///
    /// # Errors
    /// [`Error::Database`], [`Error::Gone`]: nothing was written.
    pub async fn commit(self) -> Result<()> {
        self.store.place.check()?;
        self.inner.commit().await?;
        if let Some(seq) = self.newest_event {
            self.store.newest_event.send_if_modified(|newest| std::mem::replace(newest, seq.max(*newest)) < seq);
        }
        for sha256 in self.unnamed {
            if let Err(error) = self.store.forget_artifact(&sha256).await {
                tracing::warn!(sha256, %error, "a file that no row names was left; the next start removes it");
            }
        }
        Ok(())
    }

    /// The connection, for the queue library.
    pub(crate) fn connection(&mut self) -> &mut SqliteConnection {
        &mut self.inner
    }
}

/// The wall clock.
pub fn now() -> Timestamp {
    let since_1970 = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    Timestamp::from_unix_ms(since_1970.as_millis() as i64)
}

/// A new id: 48 bits of time, then randomness, so that ids sort by age.
pub fn new_id() -> String {
    uuid::Uuid::now_v7().to_string()
}
