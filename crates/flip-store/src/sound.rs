//! Checks before a data folder is used: is its database present, intact, and of a version that this
//! program knows?

use super::archive::Archives;
use super::artifacts::Artifacts;
use super::sqlite::connection_that_gives_up;
use super::{Error, Result};
use sqlx::migrate::Migrator;
use sqlx::{Connection, SqliteConnection, SqlitePool};
use std::fs::{self, DirBuilder, OpenOptions};
use std::io::ErrorKind;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::Path;

/// Up to this size a database is checked in full at each startup, bytes; a larger one without its
/// indexes, which takes a tenth of the time.
const CHECKED_IN_FULL: u64 = 64 << 20;
/// FLIP numbers its migrations from 1; those of the queue library that it used to have, in the same
/// table, are numbered by date, in 14 digits.
const OWN_MAX: i64 = 10_000_000_000;

/// Create the folder and an empty database, accessible to this user only, if there is nothing yet.
///
/// # Errors
/// [`Error::Lost`]: no database, but files that one names; [`Error::File`].
pub(super) fn prepare(
    data_dir: &Path,
    database: &Path,
    files: (&Artifacts, &Archives),
) -> Result<()> {
    is_there(data_dir, database, files)?;
    let made = OpenOptions::new().create_new(true).write(true).mode(0o600).open(database);
    match made {
        Err(error) if error.kind() != ErrorKind::AlreadyExists => {
            Err(Error::File { path: database.to_owned(), source: error })
        }
        _ => Ok(()),
    }
}

/// Whether there is a database. `false`: there is nothing yet.
///
/// # Errors
/// [`Error::Lost`]: no database, but files that one names.
pub(super) fn is_there(
    data_dir: &Path,
    database: &Path,
    files: (&Artifacts, &Archives),
) -> Result<bool> {
    let size = |path: &Path| fs::metadata(path).map_or(0, |it| it.len());
    let log = database.with_extension("db-wal");
    let is_empty = size(database) == 0;
    if is_empty && (size(&log) > 0 || files.0.any_in_data_folder()? || files.1.any()) {
        return Err(Error::Lost(data_dir.to_owned()));
    }
    Ok(!is_empty)
}

/// Create the folder, accessible to this user only; an existing one is left unchanged.
pub(super) fn make_folder(data_dir: &Path) -> Result<()> {
    let made = DirBuilder::new().recursive(true).mode(0o700).create(data_dir);
    made.map_err(|source| Error::File { path: data_dir.to_owned(), source })
}

/// Read the database and check its integrity.
///
/// # Errors
/// [`Error::Damaged`] with the first problem found.
pub(super) async fn check(database: &Path) -> Result<()> {
    // On a connection that could write: SQLite forgets the CHECKs of a database opened to read.
    let options = connection_that_gives_up(database).pragma("query_only", "on");
    let mut connection = SqliteConnection::connect_with(&options).await.map_err(damaged)?;
    let large = fs::metadata(database).is_ok_and(|it| it.len() > CHECKED_IN_FULL);
    let pragma = if large { "PRAGMA quick_check(1)" } else { "PRAGMA integrity_check(1)" };
    let found: String =
        sqlx::query_scalar(pragma).fetch_one(&mut connection).await.map_err(damaged)?;
    connection.close().await?;
    if found == "ok" { Ok(()) } else { Err(Error::Damaged(found)) }
}

/// Any error that stops the check means a damaged file, except those that mean it cannot be read
/// now.
fn damaged(error: sqlx::Error) -> Error {
    match Error::from(error) {
        Error::Database(sqlx::Error::Database(error)) => Error::Damaged(error.to_string()),
        other => other,
    }
}

/// Refuse a database migrated by a newer FLIP: this one would not know what its columns mean.
///
/// # Errors
/// [`Error::Newer`]
pub(super) async fn check_version(pool: &SqlitePool, known: &Migrator) -> Result<()> {
    let unknown = |version: &i64| !known.iter().any(|migration| migration.version == *version);
    let newer = applied(pool).await?.into_iter().find(unknown);
    newer.map_or(Ok(()), |version| Err(Error::Newer(version)))
}

/// Whether the database lacks migrations of this program.
pub(super) async fn is_older(pool: &SqlitePool, known: &Migrator) -> Result<bool> {
    let applied = applied(pool).await?;
    Ok(known.iter().any(|migration| !applied.contains(&migration.version)))
}

/// FLIP's migrations that a database has been through, in order.
async fn applied(pool: &SqlitePool) -> Result<Vec<i64>> {
    let table = "SELECT EXISTS (SELECT 1 FROM sqlite_schema WHERE name = '_sqlx_migrations')";
    if !sqlx::query_scalar::<_, bool>(table).fetch_one(pool).await? {
        return Ok(Vec::new());
    }
    let versions = "SELECT version FROM _sqlx_migrations WHERE version < $1 ORDER BY version";
    Ok(sqlx::query_scalar(versions).bind(OWN_MAX).fetch_all(pool).await?)
}
