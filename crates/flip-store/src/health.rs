//! Whether the store can do its work now: asked by those who watch over the service.

use super::open::connection_that_gives_up;
use super::{Error, Result, Store};
use serde::Serialize;
use sqlx::{ConnectOptions, Connection};
use std::sync::PoisonError;

/// Room that must be left on the data folder's disk, bytes: a dose writes about 170 kB, so this is room for about fifty.
pub const FREE_MIN: u64 = 8 << 20;

/// One thing that was looked at.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Check {
    /// It is as it should be.
    pub ok: bool,
    /// What is wrong, and what to do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

impl Check {
    /// From what was found to be wrong, if anything.
    pub fn of(why: Option<String>) -> Self {
        Self { ok: why.is_none(), why }
    }

    fn from_result(result: Result<()>) -> Self {
        Self::of(result.err().map(|error| error.to_string()))
    }
}

/// What the store needs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Health {
    /// Room on the disk.
    pub disk: Check,
    /// The database can be written.
    pub database: Check,
    /// The data folder is where it was.
    pub folder: Check,
    /// The lock on it is ours.
    pub lock: Check,
}

impl Store {
    /// Look at everything that writing needs. Nobody's work waits for it, and after a quarter of a second it takes a locked database for one.
    pub async fn health(&self) -> Health {
        // A database elsewhere would be made anew by its name, or answer for the one that is gone.
        let database = if self.place.check().is_ok() { self.try_to_write().await } else { self.place.check() };
        // Looked at last: where it went away meanwhile, that is why the database fails.
        let folder = self.place.check();
        Health {
            disk: Check::of(self.lack_of_room()),
            database: Check::from_result(database),
            folder: Check::from_result(folder),
            lock: Check::of(self.lack_of_lock()),
        }
    }

    async fn try_to_write(&self) -> Result<()> {
        match self.begin_and_end().await {
            // Our own transaction may be a long one. Another program's lock makes ours fail in the end, and then this is not asked.
            Err(Error::Locked) if self.writer()?.num_idle() == 0 && !self.failed_last() => Ok(()),
            tried => tried,
        }
    }

    fn failed_last(&self) -> bool {
        self.unwritten.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    /// On a connection of its own. Where the last transaction failed one is written, to see whether it still does.
    async fn begin_and_end(&self) -> Result<()> {
        let failed = self.failed_last();
        let mut connection = connection_that_gives_up(self.place.path()).connect().await?;
        let mut transaction = connection.begin_with("BEGIN IMMEDIATE").await?;
        let _: i64 = sqlx::query_scalar("SELECT count(*) FROM (SELECT 1 FROM audit LIMIT 1)")
            .fetch_one(&mut *transaction)
            .await?;
        if !failed {
            transaction.rollback().await?;
        } else {
            // The number that it has: a page is written, and nothing is changed.
            let version: i64 = sqlx::query_scalar("PRAGMA user_version").fetch_one(&mut *transaction).await?;
            sqlx::query(sqlx::AssertSqlSafe(format!("PRAGMA user_version = {version}")))
                .execute(&mut *transaction)
                .await?;
            transaction.commit().await?;
            self.note_written(None);
        }
        Ok(connection.close().await?)
    }

    fn lack_of_room(&self) -> Option<String> {
        let folder = self.place.path().parent()?;
        let free = match rustix::fs::statvfs(folder) {
            Ok(disk) => disk.f_bavail.saturating_mul(disk.f_frsize),
            Err(error) => return Some(format!("the disk of {} cannot be asked: {error}", folder.display())),
        };
        let mib = |bytes: u64| bytes >> 20;
        (free < FREE_MIN).then(|| {
            format!(
                "{} MiB are free on the disk of {}, {} are needed: make room",
                mib(free),
                folder.display(),
                mib(FREE_MIN)
            )
        })
    }

    fn lack_of_lock(&self) -> Option<String> {
        let held = self.lock.as_ref().is_some_and(|lock| lock.is_in_place());
        (!held).then(|| "flip.lock was removed or replaced while FLIP ran: start FLIP anew".to_owned())
    }
}
