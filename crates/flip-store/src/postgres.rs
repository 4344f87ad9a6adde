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
const TO_WRITE: &str = "SET lock_timeout = '5s'; \
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
    /// Holds the lock of the process that serves the database, until it is closed.
    alone: Mutex<Option<PgConnection>>,
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

impl Server {
    /// Follow the events of a database that is [`prepare`]d, also those that other processes write.
    pub fn new(
        options: AnyConnectOptions,
        alone: Option<PgConnection>,
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
        Self { options, following: following.abort_handle(), portions, alone }
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

    /// Whether this process still has the database to itself. The lock is lost with its connection,
    /// as when the server starts again, and then taken anew.
    ///
    /// # Errors
    /// [`Error::Held`], [`Error::Unreachable`].
    pub async fn is_alone(&self) -> Result<()> {
        let mut alone = self.alone.lock().await;
        let Some(connection) = alone.as_mut() else { return Err(sqlx::Error::PoolClosed.into()) };
        if connection.ping().await.is_err() {
            let mut again = PgConnection::connect(self.options.database_url.as_str()).await?;
            serve_alone(&mut again).await?;
            *alone = Some(again);
        }
        Ok(())
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

/// What a process repairs when it starts (leases, interrupted doses) is sound only if it is alone.
pub(super) async fn serve_alone(connection: &mut PgConnection) -> Result<()> {
    // The server may not have noticed yet that the process before has ended.
    connection.execute("SET lock_timeout = '2s'").await?;
    // The letters "FLIQ".
    let locked = connection.execute("SELECT pg_advisory_lock(1179404625)").await;
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
mod tests {
    use super::*;
    use crate::{Store, now, testing};
    use sqlx::{AssertSqlSafe, Row};
    use std::collections::BTreeMap;

    /// A cluster, whatever the other tests run on; `None`, and why, where there is none.
    fn cluster() -> Option<&'static testing::Cluster> {
        testing::cluster().inspect_err(|why| println!("left out: {why}")).ok()
    }

    #[tokio::test]
    async fn both_databases_have_the_same_tables_columns_and_indexes() {
        let Some(cluster) = cluster() else { return };
        let folder = tempfile::tempdir().unwrap();
        let (ours, theirs) = (folder.path().join("sqlite"), folder.path().join("postgres"));
        let ours = Store::open(&ours).await.unwrap();
        let theirs = testing::open_on(&cluster.database_of(&theirs).await, &theirs).await.unwrap();
        let columns = async |store: &Store, sql: &'static str| -> BTreeMap<String, Vec<String>> {
            let mut found = BTreeMap::<_, Vec<_>>::new();
            for row in sqlx::query(sql).fetch_all(&store.reader).await.unwrap() {
                found.entry(row.get::<String, _>(0)).or_default().push(row.get::<String, _>(1));
            }
            found.values_mut().for_each(|columns| columns.sort());
            found
        };
        let sqlite = "SELECT s.name, c.name FROM sqlite_schema s, pragma_table_info(s.name) c \
                      WHERE s.type IN ('table', 'view') AND s.name NOT LIKE '%sqlite%' AND s.name NOT LIKE '%sqlx%'";
        let postgres = "SELECT table_name::text, column_name::text FROM information_schema.columns \
                        WHERE table_schema = 'public' AND table_name NOT LIKE '%sqlx%'";
        assert_eq!(columns(&ours, sqlite).await, columns(&theirs, postgres).await);
        let sqlite =
            "SELECT tbl_name, name FROM sqlite_schema WHERE type = 'index' AND sql IS NOT NULL";
        let postgres = "SELECT tablename::text, indexname::text FROM pg_indexes WHERE schemaname = 'public' \
                        AND indexname NOT LIKE '%\\_key' AND indexname NOT LIKE '%\\_pkey'";
        assert_eq!(columns(&ours, sqlite).await, columns(&theirs, postgres).await);
    }

    #[tokio::test]
    async fn events_of_other_processes_are_heard_and_a_lock_is_waited_for() {
        let Some(cluster) = cluster() else { return };
        let folder = tempfile::tempdir().unwrap();
        let url = cluster.database_of(folder.path()).await;
        let store = testing::open_on(&url, folder.path()).await.unwrap();
        let mut heard = store.watch_events();
        let mut other = PgConnection::connect(&url).await.unwrap();
        let before = *heard.borrow_and_update();
        for _ in 0..2 {
            let mut tx = other.begin_with(BEGIN).await.unwrap();
            tx.execute("SELECT pg_advisory_xact_lock(1179404624)").await.unwrap();
            let insert =
                "INSERT INTO event (topic, kind, data, at) VALUES ('bench', 'held', '{}', 0)";
            tx.execute(insert).await.unwrap();
            assert!(
                !store.health().await.database.ok,
                "another process writes, and takes its time"
            );
            tx.commit().await.unwrap();
            let soon = tokio::time::timeout(POLL * 5, heard.changed()).await;
            soon.expect("heard").unwrap();
        }
        assert_eq!(*heard.borrow_and_update(), before + 2);
        let elsewhere = tempfile::tempdir().unwrap();
        let second = testing::open_on(&url, elsewhere.path()).await;
        assert!(matches!(second, Err(Error::Held(_))), "{second:?}");
        let mut tx = other.begin_with(BEGIN).await.unwrap();
        tx.execute("SELECT pg_advisory_xact_lock(1179404624)").await.unwrap();
        sqlx::query("SET lock_timeout = '50ms'").execute(store.writer().unwrap()).await.unwrap();
        assert!(matches!(store.write().await, Err(Error::Locked)));
        tx.rollback().await.unwrap();
        let mut tx = store.write().await.unwrap();
        tx.emit("bench", "held", &serde_json::json!({})).await.unwrap();
        tx.commit().await.unwrap();
        assert!(*heard.borrow_and_update() > before + 2);
        store.close().await;
        let error = store.write().await.unwrap_err();
        assert!(error.is_closed(), "{error}");
    }

    #[tokio::test]
    async fn a_record_survives_a_writer_that_is_cut_off_and_a_newer_database_is_refused() {
        let Some(cluster) = cluster() else { return };
        let folder = tempfile::tempdir().unwrap();
        let url = cluster.database_of(folder.path()).await;
        let store = testing::open_on(&url, folder.path()).await.unwrap();
        let mut other = PgConnection::connect(&url).await.unwrap();
        let cut = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity \
                   WHERE datname = current_database() AND pid <> pg_backend_pid()";
        let mut tx = store.write().await.unwrap();
        tx.audit_person(None, "looked", now()).await.unwrap();
        other.execute(cut).await.unwrap();
        let refused = tx.commit().await.unwrap_err();
        assert!(matches!(refused, Error::Unreachable(_)), "{refused:?}");
        let mut tx = store.write().await.unwrap();
        tx.audit_person(None, "looked again", now()).await.unwrap();
        tx.commit().await.unwrap();
        let found = store.verify_audit(None).await.unwrap();
        assert_eq!((found.records, found.broken), (3, None));
        store.close().await;
        drop(store);
        let newer = "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) \
                     VALUES (99, 'later', true, ''::bytea, 0)";
        other.execute(newer).await.unwrap();
        let refused = testing::open_on(&url, folder.path()).await.err();
        assert!(matches!(refused, Some(Error::Newer(99))), "{refused:?}");
        let refused = testing::open_on("mysql://root@localhost/x", folder.path()).await.err();
        assert!(matches!(refused, Some(Error::Server(_))), "{refused:?}");
    }

    #[tokio::test]
    async fn a_committed_transaction_is_on_the_disk() {
        let Some(cluster) = cluster() else { return };
        let folder = tempfile::tempdir().unwrap();
        let url = cluster.database_of(folder.path()).await;
        let mut other = PgConnection::connect(&url).await.unwrap();
        let name: String = sqlx::query_scalar("SELECT current_database()::text")
            .fetch_one(&mut other)
            .await
            .unwrap();
        let careless = format!("ALTER DATABASE {name} SET synchronous_commit = off");
        other.execute(AssertSqlSafe(careless)).await.unwrap();
        // A service opens it on whatever thread is free.
        let path = folder.path().to_owned();
        let opened = tokio::spawn(async move { testing::open_on(&url, &path).await });
        let store = opened.await.unwrap().unwrap();
        let set: String = sqlx::query_scalar("SELECT current_setting('synchronous_commit')")
            .fetch_one(store.writer().unwrap())
            .await
            .unwrap();
        assert_eq!(set, "on");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn what_was_committed_is_there_after_a_crash_of_the_server_and_work_goes_on() {
        if cluster().is_none() {
            return;
        }
        let cluster = std::sync::Arc::new(testing::Cluster::start(true).unwrap());
        let folder = tempfile::tempdir().unwrap();
        let url = cluster.database_of(folder.path()).await;
        let store = testing::open_on(&url, folder.path()).await.unwrap();
        let mut heard = store.watch_events();
        let record = async || {
            let mut tx = store.write().await?;
            tx.audit_person(None, "looked", now()).await?;
            tx.emit("bench", "held", &serde_json::json!({})).await?;
            tx.commit().await
        };
        let (mut committed, mut failed) = (0, 0);
        for _ in 0..2 {
            let crashing = cluster.clone();
            let crash = tokio::task::spawn_blocking(move || crashing.crash());
            let mut after = 0;
            while after < 10 {
                after += i32::from(crash.is_finished());
                match record().await {
                    Ok(()) => committed += 1,
                    Err(Error::Unreachable(_) | Error::Busy) => {
                        failed += 1;
                        tokio::time::sleep(POLL / 20).await;
                    }
                    Err(other) => panic!("{other:?}"),
                }
            }
            crash.await.unwrap();
        }
        assert!(committed >= 20, "{committed} were committed, {failed} failed");
        // Of one that failed nobody knows, but no other is missing.
        let found = store.verify_audit(None).await.unwrap();
        let expected = committed + 2..=committed + failed + 2;
        assert!(expected.contains(&found.records), "{} of {expected:?}", found.records);
        assert_eq!(found.broken, None);
        let health = store.health().await;
        assert!(health.lock.ok && health.database.ok, "{health:?}");
        let elsewhere = tempfile::tempdir().unwrap();
        let second = testing::open_on(&url, elsewhere.path()).await;
        assert!(matches!(second, Err(Error::Held(_))), "{second:?}");
        // And events of others are heard again.
        heard.borrow_and_update();
        let mut other = PgConnection::connect(&url).await.unwrap();
        let insert = "INSERT INTO event (topic, kind, data, at) VALUES ('bench', 'held', '{}', 0)";
        other.execute(insert).await.unwrap();
        tokio::time::timeout(POLL * 5, heard.changed()).await.expect("heard").unwrap();
    }
}
