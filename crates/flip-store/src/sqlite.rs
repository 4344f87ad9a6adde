//! SQLite: how the database of a data folder is opened, copied and migrated.
//!
//! What is asked of both databases goes through pools that are opened by a URL, which has no place
//! for SQLite's settings: each of their connections makes those when it is opened. What only SQLite
//! has (its file, its checks, its copies) uses a connection of SQLite's own.

use super::open::{ACQUIRE_TIMEOUT, connections};
use super::{Error, Result};
use sqlx::any::{AnyConnectOptions, AnyPoolOptions};
use sqlx::migrate::Migrator;
use sqlx::sqlite::{
    SqliteAutoVacuum, SqliteConnectOptions, SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous,
};
use sqlx::{AnyPool, Executor, Row, SqlitePool};
use std::path::Path;
use std::time::Duration;
use tempfile::TempDir;

/// Name of the database in the data folder.
pub(super) const DATABASE: &str = "flip.db";
/// How long a statement waits for another connection's lock; what sqlx sets by itself.
const BUSY_TIMEOUT: Duration = Duration::from_secs(5);
/// How long a health check waits for a lock.
const GIVES_UP: Duration = Duration::from_millis(250);
/// The first SQLite version whose write-ahead log cannot be reset under a reader (3.7.0 to 3.51.2
/// can corrupt the file).
const SQLITE_MIN: [u32; 3] = [3, 51, 3];
/// What a connection that writes does not keep in the file. A committed intent to weigh must
/// survive a power cut.
const TO_WRITE: &str = "PRAGMA synchronous = FULL; PRAGMA journal_size_limit = 67108864";

/// The only write connection of a process, to a database that [`prepared`] has opened.
pub(super) async fn writer(data_dir: &Path) -> Result<AnyPool> {
    let options = connections(1).acquire_timeout(ACQUIRE_TIMEOUT);
    let options = options.after_connect(|connection, _| {
        Box::pin(async move { connection.execute(TO_WRITE).await.map(drop) })
    });
    Ok(options.connect_with(at(data_dir, "rw")?).await?)
}

/// Connections that read the database in this folder.
pub(super) async fn readers(data_dir: &Path, options: AnyPoolOptions) -> Result<AnyPool> {
    Ok(options.connect_with(at(data_dir, "ro")?).await?)
}

/// As [`readers()`], connected when they are first used.
pub(super) fn lazy_readers(data_dir: &Path, options: AnyPoolOptions) -> Result<AnyPool> {
    Ok(options.connect_lazy_with(at(data_dir, "ro")?))
}

/// The database in this folder, as a URL. Every byte of the path is escaped: the parser of URLs
/// would read `?`, `%` and `..` as its own.
fn at(data_dir: &Path, mode: &str) -> Result<AnyConnectOptions> {
    let path = data_dir.join(DATABASE);
    let path: String =
        path.as_os_str().as_encoded_bytes().iter().map(|byte| format!("%{byte:02X}")).collect();
    Ok(format!("sqlite:{path}?mode={mode}").parse()?)
}

/// A connection of SQLite's own that writes: it makes the settings that stay in the file.
pub(super) async fn prepared(data_dir: &Path) -> Result<SqlitePool> {
    let options = connection(data_dir)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        .auto_vacuum(SqliteAutoVacuum::Incremental);
    Ok(one().connect_with(options).await?)
}

/// A connection of SQLite's own that reads.
pub(super) async fn to_read(data_dir: &Path) -> Result<SqlitePool> {
    Ok(one().connect_with(connection(data_dir).read_only(true)).await?)
}

fn one() -> SqlitePoolOptions {
    SqlitePoolOptions::new().max_connections(1).max_lifetime(None).idle_timeout(None)
}

fn connection(data_dir: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(data_dir.join(DATABASE))
        .foreign_keys(true)
        .busy_timeout(BUSY_TIMEOUT)
}

/// A connection to an existing database with short waits.
pub(super) fn connection_that_gives_up(database: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new().filename(database).busy_timeout(GIVES_UP)
}

/// A copy of an older database, in a temporary folder, brought to this program's schema.
pub(super) async fn migrated_copy(older: &SqlitePool) -> Result<TempDir> {
    let temporary = std::env::temp_dir();
    let failed = |source| Error::File { path: temporary.clone(), source };
    let folder = TempDir::with_prefix("flip-").map_err(failed)?;
    copy_database(older, &folder.path().join(DATABASE)).await?;
    let writer = one().connect_with(connection(folder.path())).await?;
    migrations().run(&writer).await.map_err(sqlx::Error::from)?;
    writer.close().await;
    Ok(folder)
}

/// Copy a database, with everything that is still in its write-ahead log, to a file that is not
/// there yet.
pub(super) async fn copy_database(database: &SqlitePool, to: &Path) -> Result<()> {
    let name = to.to_string_lossy().into_owned();
    sqlx::query("VACUUM INTO $1").bind(name).execute(database).await?;
    Ok(())
}

/// FLIP's migrations. A folder from before migration 23 names those of a queue library, too.
pub(super) fn migrations() -> Migrator {
    let mut migrations = sqlx::migrate!("../../migrations/sqlite");
    migrations.set_ignore_missing(true);
    migrations
}

/// Refuse an SQLite that can corrupt the file.
///
/// # Errors
/// [`Error::Old`]
pub(super) async fn check_library(pool: &SqlitePool) -> Result<()> {
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
    use crate::testing;

    #[test]
    fn versions_are_compared_as_numbers() {
        assert!(["3.51.3", "3.51.10", "3.100.0", "4.0.0"].into_iter().all(is_new_enough));
        assert!(!["3.51.2", "3.9.99", "3.46.0", ""].into_iter().any(is_new_enough));
    }

    #[tokio::test]
    async fn a_folder_may_have_any_name() {
        if testing::only_sqlite_has("a file") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        for name in ["50 %2f?mode=memory#x", "sqlite:", "a/../ä"] {
            let data = folder.path().join(name);
            std::fs::create_dir_all(&data).unwrap();
            let store = crate::Store::open(&data).await.unwrap();
            assert!(store.newest_event().await.is_ok());
            store.close().await;
            assert!(data.join(DATABASE).metadata().unwrap().len() > 0, "{name}");
        }
    }
}
