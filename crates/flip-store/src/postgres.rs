//! PostgreSQL: how a database on a server is opened, checked and migrated, and how this process
//! hears of what others write into it.

use super::open::{ACQUIRE_TIMEOUT, connections};
use super::{Error, Result};
use sqlx::any::{AnyConnectOptions, AnyPoolOptions};
use sqlx::migrate::Migrator;
use sqlx::postgres::{PgConnection, PgListener};
use sqlx::{AnyConnection, AnyPool, Connection, Executor};
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::AbortHandle;

/// The oldest server that FLIP is tested with.
const VERSION_MIN: i64 = 15;
/// Events are told on this channel (`migrations/postgres`).
const CHANNEL: &str = "flip_event";
/// How often events are looked for all the same: a lost connection tells nothing.
const POLL: Duration = Duration::from_secs(1);

/// How a transaction that writes begins. It takes the one lock of all writers, as in SQLite: what
/// it reads stays true until it has written, events become visible in the order of their numbers,
/// and the audit trail is one chain. The snapshots of `READ COMMITTED` begin after the lock.
pub(super) const BEGIN: &str =
    "BEGIN ISOLATION LEVEL READ COMMITTED; SELECT pg_advisory_xact_lock(5065680);";
/// As [`BEGIN`], for a health check, which does not wait long.
const BEGIN_OR_GIVE_UP: &str = "BEGIN ISOLATION LEVEL READ COMMITTED; SET LOCAL lock_timeout = '250ms'; \
     SELECT pg_advisory_xact_lock(5065680);";
/// What a committed transaction says must survive a power cut; settings that promise more stay.
const TO_WRITE: &str = "SET lock_timeout = '5s'; \
     SELECT set_config('synchronous_commit', 'on', false) WHERE current_setting('synchronous_commit') = 'off'";
/// A transaction that reads sees one moment, as in SQLite.
const TO_READ: &str =
    "SET default_transaction_read_only = on; SET default_transaction_isolation = 'repeatable read'";

/// A database on a server. Following its events ends with it.
pub(super) struct Server {
    options: AnyConnectOptions,
    following: AbortHandle,
}

impl std::fmt::Debug for Server {
    /// Without the address, which may hold a password.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Server")
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop_following();
    }
}

impl Server {
    /// Follow the events of a database, also those that other processes write.
    pub fn new(options: AnyConnectOptions, newest: watch::Sender<i64>, reader: AnyPool) -> Self {
        let url = options.database_url.to_string();
        let following = tokio::spawn(async move {
            while !reader.is_closed() {
                if let Err(error) = follow(&url, &newest, &reader).await {
                    tracing::warn!(%error, "events of other processes are not heard; trying again");
                }
                tokio::time::sleep(POLL).await;
            }
        });
        Self { options, following: following.abort_handle() }
    }

    /// End following events.
    pub fn stop_following(&self) {
        self.following.abort();
    }

    /// Begin a transaction that writes and roll it back, on a connection of its own.
    ///
    /// # Errors
    /// [`Error::Locked`], [`Error::Unreachable`] and others.
    pub async fn try_to_write(&self) -> Result<()> {
        let mut connection = AnyConnection::connect_with(&self.options).await?;
        let mut transaction = connection.begin_with(BEGIN_OR_GIVE_UP).await?;
        // A server that only follows another one refuses to number a transaction.
        transaction.execute("SELECT pg_current_xact_id()::text").await?;
        transaction.rollback().await?;
        Ok(connection.close().await?)
    }
}

async fn follow(url: &str, newest: &watch::Sender<i64>, reader: &AnyPool) -> sqlx::Result<()> {
    let mut listener = PgListener::connect(url).await?;
    listener.listen(CHANNEL).await?;
    loop {
        // What was written before listening began, or while a connection was lost.
        let seq: i64 = sqlx::query_scalar(super::events::NEWEST).fetch_one(reader).await?;
        super::events::tell(newest, seq);
        while let Ok(told) = tokio::time::timeout(POLL, listener.try_recv()).await {
            let Some(told) = told? else { break };
            super::events::tell(newest, told.payload().parse().unwrap_or_default());
        }
    }
}

/// The address of a database.
///
/// # Errors
/// [`Error::Server`] if this is none.
pub(super) fn address(url: &str) -> Result<AnyConnectOptions> {
    if !(url.starts_with("postgres://") || url.starts_with("postgresql://")) {
        return Err(Error::Server("its address begins with postgres://".to_owned()));
    }
    url.parse().map_err(|_| Error::Server("its address is no URL".to_owned()))
}

/// Check the server, and bring the database to this program's schema.
///
/// # Errors
/// [`Error::Server`], [`Error::Newer`], [`Error::Unreachable`], [`Error::Database`].
pub(super) async fn prepare(url: &str) -> Result<()> {
    let mut connection = PgConnection::connect(url).await?;
    check_server(&mut connection).await?;
    let known = migrations();
    if let Some(newer) = newest_unknown(&mut connection, &known).await? {
        return Err(Error::Newer(newer));
    }
    known.run(&mut connection).await.map_err(sqlx::Error::from)?;
    Ok(connection.close().await?)
}

async fn check_server(connection: &mut PgConnection) -> Result<()> {
    let sql = "SELECT current_setting('server_version_num')::bigint / 10000, \
               current_setting('server_encoding'), current_setting('fsync')";
    let (version, encoding, fsync): (i64, String, String) =
        sqlx::query_as(sql).fetch_one(connection).await?;
    if version < VERSION_MIN {
        let why = format!("it is PostgreSQL {version}; {VERSION_MIN} or newer is needed");
        return Err(Error::Server(why));
    }
    if encoding != "UTF8" {
        return Err(Error::Server(format!("its text is {encoding}; UTF8 is needed")));
    }
    if fsync != "on" {
        tracing::warn!(
            "the server does not wait for its disk (fsync is off): a power cut loses doses"
        );
    }
    Ok(())
}

/// The first migration of the database that this program does not know.
async fn newest_unknown(connection: &mut PgConnection, known: &Migrator) -> Result<Option<i64>> {
    let table = "SELECT to_regclass('_sqlx_migrations') IS NOT NULL";
    if !sqlx::query_scalar(table).fetch_one(&mut *connection).await? {
        return Ok(None);
    }
    let versions = "SELECT version FROM _sqlx_migrations ORDER BY version";
    let versions: Vec<i64> = sqlx::query_scalar(versions).fetch_all(connection).await?;
    let unknown = |version: &i64| !known.iter().any(|migration| migration.version == *version);
    Ok(versions.into_iter().find(unknown))
}

/// FLIP's migrations of PostgreSQL.
pub(super) fn migrations() -> Migrator {
    sqlx::migrate!("../../migrations/postgres")
}

/// The only write connection of a process.
pub(super) async fn writer(address: AnyConnectOptions) -> Result<AnyPool> {
    let options = connections(1).acquire_timeout(ACQUIRE_TIMEOUT);
    Ok(set_up(options, TO_WRITE).connect_with(address).await?)
}

/// Connections that read.
pub(super) async fn readers(
    address: AnyConnectOptions,
    options: AnyPoolOptions,
) -> Result<AnyPool> {
    Ok(set_up(options, TO_READ).connect_with(address).await?)
}

fn set_up(options: AnyPoolOptions, settings: &'static str) -> AnyPoolOptions {
    options.after_connect(move |connection, _| {
        Box::pin(async move { connection.execute(settings).await.map(drop) })
    })
}
