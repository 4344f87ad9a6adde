//! Opening a data folder: lock, connect, check, migrate, seed.

use super::archive::{self, Archives};
use super::artifacts::Artifacts;
use super::lock::DataLock;
use super::place::Place;
use super::{Error, Result, Store, sound};
use sqlx::migrate::Migrator;
use sqlx::sqlite::{
    SqliteAutoVacuum, SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous,
};
use sqlx::{Row, SqlitePool};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tempfile::TempDir;
use tokio::sync::watch;

/// Name of the database in the data folder.
pub(super) const DATABASE: &str = "flip.db";
/// How long a statement waits for another connection's lock.
const BUSY_TIMEOUT: Duration = Duration::from_secs(5);
/// How long to wait for the write connection: longer than two other users wait for another
/// program's lock.
const ACQUIRE_TIMEOUT: Duration = Duration::from_secs(10);
/// How long a health check waits for a lock.
const GIVES_UP: Duration = Duration::from_millis(250);
/// Number of read connections.
const READERS: u32 = 4;
/// Number of read connections for long answers only.
const LONG_READERS: u32 = 2;
/// The first SQLite version whose write-ahead log cannot be reset under a reader (3.7.0 to 3.51.2
/// can corrupt the file).
const SQLITE_MIN: [u32; 3] = [3, 51, 3];

impl Store {
    /// Open a data folder for reading and writing; create, migrate and seed it when needed.
    ///
    /// # Errors
    /// [`Error::Held`] while another process has it; [`Error::Lost`], [`Error::Damaged`],
    /// [`Error::Newer`]: nothing was changed; [`Error::Old`], [`Error::Database`], [`Error::File`].
    pub async fn open(data_dir: &Path) -> Result<Self> {
        sound::make_folder(data_dir)?;
        let lock = DataLock::take(data_dir)?;
        let database = data_dir.join(DATABASE);
        sound::prepare(data_dir, &database, (&artifacts(data_dir), &archives(data_dir)))?;
        let writer = write_connection(connection(data_dir)).await?;
        check_library(&writer).await?;
        sound::check(&database).await?;
        sound::check_version(&writer, &migrations()).await?;
        migrations().run(&writer).await.map_err(sqlx::Error::from)?;
        let store = Self::assemble(data_dir, Some(writer), Some(Arc::new(lock)), None).await?;
        store.seed_published_powders().await?;
        store.take_stock().await?;
        store.sweep_artifacts().await?;
        Ok(store)
    }

    /// Open an existing data folder read-only, even while another process writes.
    ///
    /// The database of an older FLIP is left as it is, and a migrated copy of it, as of this
    /// moment, is read instead; the copy is removed with the last clone of the store.
    ///
    /// # Errors
    /// [`Error::Database`] when there is none; [`Error::Newer`].
    pub async fn open_to_read(data_dir: &Path) -> Result<Self> {
        let database = connections(1).connect_with(connection(data_dir).read_only(true)).await?;
        sound::check_version(&database, &migrations()).await?;
        let copied = match sound::is_older(&database, &migrations()).await? {
            true => Some(migrated_copy(&database).await?),
            false => None,
        };
        database.close().await;
        Self::assemble(data_dir, None, None, copied).await
    }

    /// As [`Self::open_to_read`], after the checks made at every startup; `None` if there is no
    /// database yet.
    ///
    /// # Errors
    /// Those of a startup: [`Error::Lost`], [`Error::Damaged`], [`Error::Newer`]; [`Error::File`] of
    /// the temporary folder.
    pub async fn examine(data_dir: &Path) -> Result<Option<Self>> {
        let database = data_dir.join(DATABASE);
        if !sound::is_there(data_dir, &database, (&artifacts(data_dir), &archives(data_dir)))? {
            return Ok(None);
        }
        sound::check(&database).await?;
        Ok(Some(Self::open_to_read(data_dir).await?))
    }

    /// Open an existing data folder alongside the process that holds it: for short transactions
    /// that need no worker.
    ///
    /// # Errors
    /// [`Error::Database`] when there is none.
    pub async fn open_beside(data_dir: &Path) -> Result<Self> {
        let writer = write_connection(connection(data_dir)).await?;
        Self::assemble(data_dir, Some(writer), None, None).await
    }

    async fn assemble(
        data_dir: &Path,
        writer: Option<SqlitePool>,
        lock: Option<Arc<DataLock>>,
        copied: Option<TempDir>,
    ) -> Result<Self> {
        let holds_database = copied.as_ref().map_or(data_dir, TempDir::path);
        let options = connection(holds_database).read_only(true);
        let reader = connections(READERS).connect_with(options.clone()).await?;
        let long = connections(LONG_READERS).connect_lazy_with(options.clone());
        let apart = connections(1).connect_with(options).await?;
        sound::check_version(&reader, &migrations()).await?;
        let newest: i64 = sqlx::query_scalar("SELECT coalesce(max(seq), 0) FROM event")
            .fetch_one(&reader)
            .await?;
        Ok(Self {
            reader,
            apart,
            long,
            writer,
            artifacts: artifacts(data_dir),
            archives: archives(data_dir),
            newest_event: watch::Sender::new(newest),
            place: Place::of(&holds_database.join(DATABASE))?,
            unwritten: Arc::default(),
            lock,
            _copied: copied.map(Arc::new),
        })
    }
}

/// A copy of an older database, in a temporary folder, brought to this program's schema.
async fn migrated_copy(older: &SqlitePool) -> Result<TempDir> {
    let temporary = std::env::temp_dir();
    let failed = |source| Error::File { path: temporary.clone(), source };
    let folder = TempDir::with_prefix("flip-").map_err(failed)?;
    copy_database(older, &folder.path().join(DATABASE)).await?;
    let writer = connections(1).connect_with(connection(folder.path())).await?;
    migrations().run(&writer).await.map_err(sqlx::Error::from)?;
    writer.close().await;
    Ok(folder)
}

/// Copy a database, with everything that is still in its write-ahead log, to a file that is not
/// there yet.
pub(super) async fn copy_database(database: &SqlitePool, to: &Path) -> Result<()> {
    let name = to.to_string_lossy().into_owned();
    sqlx::query("VACUUM INTO ?1").bind(name).execute(database).await?;
    Ok(())
}

pub(super) fn connection(data_dir: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(data_dir.join(DATABASE))
        .foreign_keys(true)
        .busy_timeout(BUSY_TIMEOUT)
}

/// A connection to an existing database with short waits.
pub(super) fn connection_that_gives_up(database: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new().filename(database).busy_timeout(GIVES_UP)
}

/// The only write connection of a process.
async fn write_connection(options: SqliteConnectOptions) -> Result<SqlitePool> {
    let options = options
        .journal_mode(SqliteJournalMode::Wal)
        // A committed intent to weigh must survive a power cut.
        .synchronous(SqliteSynchronous::Full)
        .auto_vacuum(SqliteAutoVacuum::Incremental)
        .pragma("journal_size_limit", "67108864");
    Ok(connections(1).acquire_timeout(ACQUIRE_TIMEOUT).connect_with(options).await?)
}

/// Connections are kept: one that is reopened may lead to another file.
fn connections(max: u32) -> SqlitePoolOptions {
    SqlitePoolOptions::new().max_connections(max).max_lifetime(None).idle_timeout(None)
}

pub(super) fn artifacts(data_dir: &Path) -> Artifacts {
    Artifacts::in_folder(data_dir.join("blobs"))
}

pub(super) fn archives(data_dir: &Path) -> Archives {
    Archives::in_folder(data_dir.join(archive::FOLDER))
}

/// FLIP's migrations. A folder from before migration 23 names those of a queue library, too.
fn migrations() -> Migrator {
    let mut migrations = sqlx::migrate!("../../migrations");
    migrations.set_ignore_missing(true);
    migrations
}

async fn check_library(pool: &SqlitePool) -> Result<()> {
    let version: String =
        sqlx::query("SELECT sqlite_version()").fetch_one(pool).await?.try_get(0)?;
    match is_new_enough(&version) {
        true => Ok(()),
        false => Err(Error::Old(version)),
    }
}

fn is_new_enough(version: &str) -> bool {
    let mut parts = version.split('.').map(|part| part.parse::<u32>().unwrap_or(0));
    let version: [u32; 3] = std::array::from_fn(|_| parts.next().unwrap_or(0));
    version >= SQLITE_MIN
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_are_compared_as_numbers() {
        assert!(["3.51.3", "3.51.10", "3.100.0", "4.0.0"].into_iter().all(is_new_enough));
        assert!(!["3.51.2", "3.9.99", "3.46.0", ""].into_iter().any(is_new_enough));
    }

    #[tokio::test]
    async fn a_fresh_folder_is_durable_checked_and_holds_the_published_powders() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let writer = store.writer().unwrap();
        let pragma = async |name: &'static str| -> String {
            let row = sqlx::query(name).fetch_one(writer).await.unwrap();
            row.try_get::<i64, _>(0)
                .map(|n| n.to_string())
                .or_else(|_| row.try_get::<String, _>(0))
                .unwrap()
        };
        assert_eq!(pragma("PRAGMA journal_mode").await, "wal");
        assert_eq!(pragma("PRAGMA synchronous").await, "2");
        assert_eq!(pragma("PRAGMA foreign_keys").await, "1");
        assert_eq!(pragma("SELECT count(*) FROM powder").await, "5");
        assert_eq!(pragma("SELECT count(*) FROM measurement").await, "10");
        assert_eq!(pragma("SELECT count(*) FROM sqlite_schema WHERE type = 'table' AND sql NOT LIKE '%STRICT%' AND name NOT LIKE '%sqlx%' AND name NOT LIKE 'sqlite%'").await, "0");
    }

    #[tokio::test]
    async fn damage_that_nobody_reads_is_found_at_the_start() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let writer = store.writer().unwrap();
        sqlx::query("PRAGMA ignore_check_constraints = 1").execute(writer).await.unwrap();
        let insert = "INSERT INTO job (id, kind, spec, spec_sha256, state, created_at) \
                      VALUES ('x', 'seance', '{}', randomblob(32), 'failed', 0)";
        sqlx::query(insert).execute(writer).await.unwrap();
        store.close().await;
        drop(store);
        // Who only reads it finds the same, also in a copy.
        let elsewhere = tempfile::tempdir().unwrap();
        let copied = crate::backup::copy(folder.path(), &elsewhere.path().join("copy")).await;
        let refusals = [
            Store::open(folder.path()).await.err(),
            Store::examine(folder.path()).await.err(),
            copied.err(),
        ];
        for refused in refusals {
            assert!(matches!(refused, Some(Error::Damaged(_))), "{refused:?}");
        }
    }

    #[tokio::test]
    async fn opening_again_changes_nothing_and_reading_needs_no_lock() {
        let folder = tempfile::tempdir().unwrap();
        Store::open(folder.path()).await.unwrap().close().await;
        let store = Store::open(folder.path()).await.unwrap();
        assert!(matches!(Store::open(folder.path()).await, Err(Error::Held(_))));
        let reader = Store::open_to_read(folder.path()).await.unwrap();
        let count: i64 = sqlx::query_scalar("SELECT count(*) FROM measurement")
            .fetch_one(&reader.reader)
            .await
            .unwrap();
        assert_eq!(count, 10);
        assert!(matches!(reader.write().await, Err(Error::ReadOnly)));
        drop(store);
    }
}
