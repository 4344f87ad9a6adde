//! PostgreSQL: how a database on a server is opened, checked and migrated, and how this process
//! hears of what others write into it.

use super::open::{ACQUIRE_TIMEOUT, connections};
use super::{Error, Result};
use sqlx::any::{AnyConnectOptions, AnyPoolOptions};
use sqlx::migrate::Migrator;
use sqlx::postgres::{PgConnection, PgListener};
use sqlx::{AnyConnection, AnyPool, Connection, Executor, PgPool};
use std::time::{Duration, Instant};
use tokio::sync::{Mutex, watch};
use tokio::task::AbortHandle;

/// The oldest server that FLIP is tested with.
const VERSION_MIN: i64 = 15;
/// Events are told on this channel (`migrations/postgres`).
const CHANNEL: &str = "flip_event";
/// And portions on this one.
const PORTIONS: &str = "flip_portion";
/// How often events are looked for all the same: a lost connection tells nothing.
const POLL: Duration = Duration::from_secs(1);

/// How often clocks are compared.
const COMPARE: Duration = Duration::from_secs(60);

/// How a transaction that writes begins; [`lock`] follows.
pub(super) const BEGIN: &str = "BEGIN ISOLATION LEVEL READ COMMITTED";
/// What a committed transaction says must survive a power cut; settings that promise more stay.
/// Whoever stops in the middle of a transaction, or is cut off, loses it before others have waited in vain.
const TO_WRITE: &str = "SET lock_timeout = '5s'; SET idle_in_transaction_session_timeout = '3s'; \
     SELECT set_config('synchronous_commit', 'on', false) WHERE current_setting('synchronous_commit') = 'off'";
/// A transaction that reads sees one moment, as in SQLite.
const TO_READ: &str =
    "SET default_transaction_read_only = on; SET default_transaction_isolation = 'repeatable read'";

/// What a transaction sets that lasts as long as a copy of everything, or waits for files.
pub(super) const PATIENT: &str =
    "SET LOCAL statement_timeout = 0; SET LOCAL idle_in_transaction_session_timeout = 0";

/// A database on a server. Following its events ends with it.
pub(super) struct Server {
    options: AnyConnectOptions,
    following: AbortHandle,
    /// Counts up with each change of portions.
    portions: watch::Sender<u64>,
    /// Holds the locks of a process that serves the database, and its bench, until it is closed.
    alone: Mutex<Option<PgConnection>>,
    /// The chain of that bench.
    bench: i64,
}

impl std::fmt::Debug for Server {
    /// Without the address, which may hold a password.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Server")
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.following.abort();
    }
}

/// Take the one lock of all writers, until the transaction ends. So there is one writer at a time, as
/// in SQLite: what it reads stays true until it has written, events become visible in the order of
/// their numbers, and the audit trail is one chain. What it reads from here on is younger than the
/// lock, because `READ COMMITTED` looks anew at each statement.
///
/// # Errors
/// [`Error::Locked`] when it is not free within the connection's timeout.
pub(super) async fn lock(connection: &mut AnyConnection) -> Result<()> {
    // The letters "FLIP".
    connection.execute("SELECT pg_advisory_xact_lock(1179404624)").await?;
    Ok(())
}

/// Take the lock of all who add events, until the transaction ends. It is the last that any
/// transaction takes.
pub(super) async fn lock_events(connection: &mut AnyConnection) -> Result<()> {
    // The letters "FLIR".
    connection.execute("SELECT pg_advisory_xact_lock(1179404626)").await?;
    Ok(())
}

/// Take the lock of all who add to a chain of the audit trail, until the transaction ends.
pub(super) async fn lock_chain(connection: &mut AnyConnection, chain: i64) -> Result<()> {
    // The letters "FLIS".
    let sql = "SELECT CAST(pg_advisory_xact_lock(1179404627, CAST($1 AS INTEGER)) AS TEXT)";
    sqlx::query(sql).bind(chain).execute(connection).await?;
    Ok(())
}

/// Take the lock of the process that has a bench, until the connection ends.
///
/// # Errors
/// [`Error::Locked`] while another process has it.
pub(super) async fn lock_bench(connection: &mut PgConnection, chain: i64) -> Result<()> {
    // The server may not have noticed yet that the process before has ended.
    connection.execute("SET lock_timeout = '2s'").await?;
    // The letters "FLIQ".
    let sql = "SELECT pg_advisory_lock(1179404625, CAST($1 AS INTEGER))";
    sqlx::query(sql).bind(chain).execute(connection).await?;
    Ok(())
}

impl Server {
    /// Follow the events of a database that is [`prepare`]d, also those that other processes write.
    pub fn new(
        options: AnyConnectOptions,
        (alone, bench): (Option<PgConnection>, i64),
        newest: watch::Sender<i64>,
        reader: AnyPool,
    ) -> Self {
        let url = options.database_url.to_string();
        let portions = watch::Sender::new(0);
        let changed = portions.clone();
        let following = tokio::spawn(async move {
            while !reader.is_closed() {
                if let Err(error) = follow(&url, &newest, &changed, &reader).await {
                    tracing::warn!(%error, "events of other processes are not heard; trying again");
                }
                tokio::time::sleep(POLL).await;
            }
        });
        let alone = Mutex::new(alone);
        Self { options, following: following.abort_handle(), portions, alone, bench }
    }

    /// Counts up with each change of portions.
    pub fn watch_portions(&self) -> watch::Receiver<u64> {
        self.portions.subscribe()
    }

    /// End following events, and let another process serve the database.
    pub async fn close(&self) {
        self.following.abort();
        let Some(alone) = self.alone.lock().await.take() else { return };
        if let Err(error) = alone.close().await {
            tracing::warn!(%error, "the server ends this process's lock when it finds it gone");
        }
    }

    /// Whether this process still has its bench to itself. The lock is lost with its connection, as
    /// when the server starts again, and then taken anew.
    ///
    /// # Errors
    /// [`Error::Held`], [`Error::Locked`], [`Error::Unreachable`].
    pub async fn is_alone(&self) -> Result<()> {
        let mut alone = self.alone.lock().await;
        let Some(connection) = alone.as_mut() else { return Err(sqlx::Error::PoolClosed.into()) };
        if connection.ping().await.is_err() {
            let mut again = PgConnection::connect(self.options.database_url.as_str()).await?;
            serve_with_others(&mut again).await?;
            lock_bench(&mut again, self.bench).await?;
            *alone = Some(again);
        }
        Ok(())
    }

    /// Renew the lease of a bench, given by name, owner and fence, on the connection that holds its
    /// lock: it waits for no transaction. `false`: it has changed hands.
    ///
    /// # Errors
    /// As [`Self::is_alone`].
    pub async fn renew(
        &self,
        (name, owner, fence): (&str, &str, i64),
        until: i64,
        kind: &str,
    ) -> Result<bool> {
        self.is_alone().await?;
        let mut alone = self.alone.lock().await;
        let Some(connection) = alone.as_mut() else { return Err(sqlx::Error::PoolClosed.into()) };
        let sql = "UPDATE bench SET lease_until = $4, kind = $5 WHERE name = $1 AND owner = $2 AND fence = $3";
        let renewed = sqlx::query(sql).bind(name).bind(owner).bind(fence).bind(until).bind(kind);
        Ok(renewed.execute(connection).await?.rows_affected() > 0)
    }

    /// Begin a transaction that writes and roll it back, on a connection of its own.
    ///
    /// # Errors
    /// [`Error::Locked`], [`Error::Unreachable`] and others.
    pub async fn try_to_write(&self) -> Result<()> {
        let mut connection = AnyConnection::connect_with(&self.options).await?;
        let mut transaction = connection.begin_with(BEGIN).await?;
        transaction.execute("SET LOCAL lock_timeout = '250ms'").await?;
        lock(&mut transaction).await?;
        // A server that only follows another one refuses to number a transaction.
        transaction.execute("SELECT pg_current_xact_id()::text").await?;
        transaction.rollback().await?;
        Ok(connection.close().await?)
    }
}

async fn follow(
    url: &str,
    newest: &watch::Sender<i64>,
    portions: &watch::Sender<u64>,
    reader: &AnyPool,
) -> sqlx::Result<()> {
    let mut listener = PgListener::connect(url).await?;
    listener.listen_all([CHANNEL, PORTIONS]).await?;
    let mut compared = Instant::now();
    loop {
        if compared.elapsed() > COMPARE {
            super::clock::set(reader).await?;
            compared = Instant::now();
        }
        // What was written before listening began, or while a connection was lost.
        let seq: i64 = sqlx::query_scalar(super::events::NEWEST).fetch_one(reader).await?;
        super::events::tell(newest, seq);
        while let Ok(told) = tokio::time::timeout(POLL, listener.try_recv()).await {
            let Some(told) = told? else { break };
            if told.channel() == PORTIONS {
                portions.send_modify(|changes| *changes += 1);
                continue;
            }
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
        return Err(Error::Server("its address must begin with postgres://".to_owned()));
    }
    url.parse().map_err(|_| Error::Server("its address is no URL".to_owned()))
}

/// Check the server, lock the database against a second process that serves it, and bring it to this
/// program's schema. The lock ends with the connection.
///
/// # Errors
/// [`Error::Held`], [`Error::Server`], [`Error::Newer`], [`Error::Unreachable`],
/// [`Error::Database`].
pub(super) async fn prepare(address: &AnyConnectOptions) -> Result<PgConnection> {
    let url = address.database_url.as_str();
    let mut connection = PgConnection::connect(url).await?;
    check_server(&mut connection).await?;
    serve_alone(&mut connection).await?;
    let known = migrations();
    if let Some(newer) = first_unknown(&applied(&mut connection).await?, &known) {
        return Err(Error::Newer(newer));
    }
    let migrating = PgPool::connect(url).await?;
    known.run(&migrating).await.map_err(sqlx::Error::from)?;
    migrating.close().await;
    Ok(connection)
}

/// Check the server and bring the database to this program's schema, for one of the processes that
/// serve it. Nobody else may serve it while its schema changes. What the connection locks lasts as
/// long as it does.
///
/// # Errors
/// As [`prepare`].
pub(super) async fn prepare_to_serve(address: &AnyConnectOptions) -> Result<PgConnection> {
    if !has_schema(address).await? {
        match prepare(address).await {
            // Another process was quicker.
            Err(Error::Held(name)) if !has_schema(address).await? => return Err(Error::Held(name)),
            Err(Error::Held(_)) => {}
            prepared => prepared?.close().await?,
        }
    }
    let mut connection = PgConnection::connect(address.database_url.as_str()).await?;
    serve_with_others(&mut connection).await?;
    Ok(connection)
}

/// Check that a database has exactly this program's schema.
///
/// # Errors
/// [`Error::Server`], [`Error::Newer`], [`Error::Older`], [`Error::Unreachable`],
/// [`Error::Database`].
pub(super) async fn check_schema(address: &AnyConnectOptions) -> Result<()> {
    if has_schema(address).await? { Ok(()) } else { Err(Error::Older) }
}

/// The name of the database.
async fn name(connection: &mut PgConnection) -> Result<String> {
    let name = sqlx::query_scalar("SELECT current_database()::text");
    Ok(name.fetch_one(connection).await?)
}

/// Check the server; whether its database has this program's schema, `false` if an older one or
/// none.
///
/// # Errors
/// [`Error::Server`], [`Error::Newer`], [`Error::Unreachable`], [`Error::Database`].
pub(super) async fn has_schema(address: &AnyConnectOptions) -> Result<bool> {
    let mut connection = PgConnection::connect(address.database_url.as_str()).await?;
    check_server(&mut connection).await?;
    let known = migrations();
    let applied = applied(&mut connection).await?;
    connection.close().await?;
    if let Some(newer) = first_unknown(&applied, &known) {
        return Err(Error::Newer(newer));
    }
    Ok(known.iter().all(|migration| applied.contains(&migration.version)))
}

/// Let no other process serve the database, as while its schema changes or it is moved.
pub(super) async fn serve_alone(connection: &mut PgConnection) -> Result<()> {
    // The letters "FLIQ".
    serve(connection, "SELECT pg_advisory_lock(1179404625)").await
}

/// Let no other process have the database to itself.
async fn serve_with_others(connection: &mut PgConnection) -> Result<()> {
    serve(connection, "SELECT pg_advisory_lock_shared(1179404625)").await
}

async fn serve(connection: &mut PgConnection, lock: &'static str) -> Result<()> {
    // The server may not have noticed yet that the process before has ended.
    connection.execute("SET lock_timeout = '2s'").await?;
    let locked = connection.execute(lock).await;
    match locked.map_err(Error::from) {
        Err(Error::Locked) => Err(Error::Held(name(connection).await?.into())),
        locked => locked.map(drop),
    }
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

/// The migrations that a database has seen.
async fn applied(connection: &mut PgConnection) -> Result<Vec<i64>> {
    let table = "SELECT to_regclass('_sqlx_migrations') IS NOT NULL";
    if !sqlx::query_scalar(table).fetch_one(&mut *connection).await? {
        return Ok(Vec::new());
    }
    let versions = "SELECT version FROM _sqlx_migrations ORDER BY version";
    Ok(sqlx::query_scalar(versions).fetch_all(connection).await?)
}

/// The first of these migrations that this program does not know.
fn first_unknown(applied: &[i64], known: &Migrator) -> Option<i64> {
    let unknown = |version: &&i64| !known.iter().any(|migration| migration.version == **version);
    applied.iter().find(unknown).copied()
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

#[cfg(test)]
mod tests;
