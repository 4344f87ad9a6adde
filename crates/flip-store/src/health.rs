//! Health of the store: whether it can work now, for monitoring.

use super::sqlite::connection_that_gives_up;
use super::{Error, Result, Store};
use serde::Serialize;
use sqlx::{ConnectOptions, Connection};
use std::sync::PoisonError;

/// Minimum free space on the data folder's disk, bytes: a dose writes about 170 kB, so this is
/// enough for about fifty.
pub const FREE_MIN: u64 = 8 << 20;

/// Result of one check.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Check {
    /// The check passed.
    pub ok: bool,
    /// What is wrong, and what to do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

impl Check {
    /// Passed if there is no reason, else failed.
    pub fn of(why: Option<String>) -> Self {
        Self { ok: why.is_none(), why }
    }

    fn from_result(result: Result<()>) -> Self {
        Self::of(result.err().map(|error| error.to_string()))
    }
}

/// Requirements of the store.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Health {
    /// Free space on the disk.
    pub disk: Check,
    /// The database is writable.
    pub database: Check,
    /// The data folder is where it was.
    pub folder: Check,
    /// The lock on it is ours.
    pub lock: Check,
}

impl Store {
    /// Check everything needed for writing. No other work waits for it, and after a quarter of a
    /// second it treats the database as locked.
    pub async fn health(&self) -> Health {
        // A database elsewhere would be created again under its name, or answer in place of the one
        // that is gone.
        let database =
            if self.is_in_place().is_ok() { self.try_to_write().await } else { self.is_in_place() };
        let lack_of_lock = self.lack_of_lock().await;
        // Checked last: if the folder has disappeared meanwhile, that is why the database fails.
        let folder = self.is_in_place();
        Health {
            disk: Check::of(self.lack_of_room()),
            database: Check::from_result(database),
            folder: Check::from_result(folder),
            lock: Check::of(lack_of_lock),
        }
    }

    async fn try_to_write(&self) -> Result<()> {
        match self.begin_and_end().await {
            // Our own transaction may be a long one. Another program's lock makes ours fail in the
            // end, and then this branch is not reached.
            Err(Error::Locked) if self.writer()?.num_idle() == 0 && !self.failed_last() => Ok(()),
            tried => tried,
        }
    }

    fn failed_last(&self) -> bool {
        self.unwritten.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    /// Uses its own connection. If the last transaction failed, one is written to see whether it
    /// still fails.
    async fn begin_and_end(&self) -> Result<()> {
        if let Some(server) = &self.server {
            server.try_to_write().await?;
            self.note_written(None);
            return Ok(());
        }
        let failed = self.failed_last();
        let Some(place) = &self.place else { return Ok(()) };
        let mut connection = connection_that_gives_up(place.path()).connect().await?;
        let mut transaction = connection.begin_with("BEGIN IMMEDIATE").await?;
        let _: i64 = sqlx::query_scalar("SELECT count(*) FROM (SELECT 1 FROM audit LIMIT 1)")
            .fetch_one(&mut *transaction)
            .await?;
        if !failed {
            transaction.rollback().await?;
        } else {
            // Its present value: a page is written, and nothing is changed.
            let version: i64 =
                sqlx::query_scalar("PRAGMA user_version").fetch_one(&mut *transaction).await?;
            sqlx::query(sqlx::AssertSqlSafe(format!("PRAGMA user_version = {version}")))
                .execute(&mut *transaction)
                .await?;
            transaction.commit().await?;
            self.note_written(None);
        }
        Ok(connection.close().await?)
    }

    fn lack_of_room(&self) -> Option<String> {
        let folder = self.place.as_ref()?.path().parent()?;
        let free = match rustix::fs::statvfs(folder) {
            Ok(disk) => disk.f_bavail.saturating_mul(disk.f_frsize),
            Err(error) => {
                return Some(format!("the disk of {} cannot be asked: {error}", folder.display()));
            }
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

    async fn lack_of_lock(&self) -> Option<String> {
        if !self.lock.as_ref().is_some_and(|lock| lock.is_in_place()) {
            let why = "flip.lock was removed or replaced while FLIP ran: start FLIP anew";
            return Some(why.to_owned());
        }
        match &self.server {
            Some(server) => server.is_alone().await.err().map(|error| error.to_string()),
            None => None,
        }
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;
    use crate::place::Place;
    use crate::testing;
    use std::path::Path;

    #[tokio::test]
    async fn a_full_disk_is_told_with_what_is_free_and_what_is_needed() {
        let folder = tempfile::tempdir().unwrap();
        let mut store = testing::open(folder.path()).await.unwrap();
        assert_eq!(store.health().await.disk, Check { ok: true, why: None });
        // A file system without any room.
        store.place = Some(Place::of(Path::new("/proc/version")).unwrap());
        let told = store.health().await.disk;
        assert!(!told.ok && told.why.unwrap().starts_with("0 MiB are free on the disk of /proc"));
    }
}
