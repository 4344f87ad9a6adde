//! Opening a store: lock, connect, check, migrate, seed.

use super::archive::{self, Archives};
use super::artifacts::Artifacts;
use super::benches::Speaks;
use super::clock;
use super::events::NEWEST;
use super::lock::DataLock;
use super::place::Place;
use super::postgres::{self, Server};
use super::sqlite::{self, DATABASE};
use super::storage::Storage;
use super::{Error, Result, Store, sound};
use sqlx::AnyPool;
use sqlx::any::{AnyConnectOptions, AnyPoolOptions};
use sqlx::postgres::PgConnection;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tempfile::TempDir;
use tokio::sync::watch;

/// How long to wait for the write connection: longer than two other users wait for another
/// program's lock.
pub(super) const ACQUIRE_TIMEOUT: Duration = Duration::from_secs(10);
/// Number of read connections.
const READERS: u32 = 4;
/// Number of read connections for long answers only.
const LONG_READERS: u32 = 2;

/// What a process that serves a database on a server holds.
struct Held {
    place: Place,
    lock: Arc<DataLock>,
}

impl Store {
    /// Open for reading and writing; create, migrate and seed what is stored when needed. One
    /// process at a time has the folder; of a server's database, one has each bench.
    ///
    /// # Errors
    /// [`Error::Held`] while another process has the folder; [`Error::Served`] while one has the
    /// bench; [`Error::Lost`],
    /// [`Error::Damaged`], [`Error::Newer`]: nothing was changed; [`Error::Old`], [`Error::Server`],
    /// [`Error::Unreachable`], [`Error::Database`], [`Error::File`]; [`Error::ArtifactsTaken`],
    /// [`Error::ArtifactsAway`], [`Error::Artifacts`].
    pub async fn open(storage: impl Into<Storage>) -> Result<Self> {
        let storage = storage.into();
        let folder = storage.folder();
        sound::make_folder(folder)?;
        let mut store = match storage.server() {
            None => Self::open_file(&storage, DataLock::take(folder)?).await?,
            Some(address) => {
                let lock = DataLock::share(folder)?;
                if folder.join(DATABASE).exists() {
                    return Err(Error::Two(folder.to_owned()));
                }
                let mut alone = postgres::prepare_to_serve(address).await?;
                let held = Held { place: Place::of(lock.path())?, lock: Arc::new(lock) };
                let mut store = Self::connect(&storage, address, true, Some(held)).await?;
                store.speak_for(storage.bench()).await?;
                store.lock_bench(&mut alone).await?;
                store.follow(address, Some(alone));
                store
            }
        };
        store.speak_for(storage.bench()).await?;
        store.seed_published_powders().await?;
        store.take_stock().await?;
        store.claim_artifacts().await?;
        store.sweep_artifacts().await?;
        Ok(store)
    }

    async fn open_file(storage: &Storage, lock: DataLock) -> Result<Self> {
        let data_dir = storage.folder();
        let database = data_dir.join(DATABASE);
        sound::prepare(data_dir, &database, (&storage.artifacts(), &archives(data_dir)))?;
        let file = sqlite::prepared(data_dir).await?;
        sqlite::check_library(&file).await?;
        sound::check(&database).await?;
        sound::check_version(&file, &sqlite::migrations()).await?;
        sqlite::migrations().run(&file).await.map_err(sqlx::Error::from)?;
        let writer = sqlite::writer(data_dir).await?;
        // Not the last one: that would move the write-ahead log into the database.
        file.close().await;
        Self::assemble(storage, Some(writer), Some(Arc::new(lock)), None).await
    }

    /// Connect to a database on a server that has this program's schema.
    async fn connect(
        storage: &Storage,
        address: &AnyConnectOptions,
        writes: bool,
        held: Option<Held>,
    ) -> Result<Self> {
        let folder = storage.folder();
        let writer = if writes { Some(postgres::writer(address.clone()).await?) } else { None };
        let pool = async |max| postgres::readers(address.clone(), connections(max)).await;
        let (reader, apart, long) =
            (pool(READERS).await?, pool(1).await?, pool(LONG_READERS).await?);
        clock::set(&apart).await?;
        let newest_event = watch::Sender::new(newest_event(&reader).await?);
        // Only who has a bench records doses.
        let recorder = match &held {
            Some(_) => Some(postgres::writer(address.clone()).await?),
            None => None,
        };
        let (place, lock) = held.map(|Held { place, lock }| (place, lock)).unzip();
        let mut store = Self {
            reader,
            apart,
            long,
            writer,
            artifacts: storage.artifacts(),
            archives: archives(folder),
            newest_event,
            server: None,
            place,
            bench: Speaks::default(),
            owned: Arc::default(),
            recorder,
            unwritten: Arc::default(),
            lock,
            _copied: None,
        };
        store.follow(address, None);
        Ok(store)
    }

    /// Follow the events that other processes write, and keep the locks of this connection.
    fn follow(&mut self, address: &AnyConnectOptions, alone: Option<PgConnection>) {
        let alone = (alone, self.bench.chain);
        let (newest, reader) = (self.newest_event.clone(), self.apart.clone());
        self.server = Some(Arc::new(Server::new(address.clone(), alone, newest, reader)));
    }

    /// Open what is there read-only, even while another process writes.
    ///
    /// A file of an older FLIP is left as it is, and a migrated copy of it, as of this moment, is
    /// read instead; the copy is removed with the last clone of the store.
    ///
    /// # Errors
    /// [`Error::Database`] when there is none; [`Error::Newer`]; [`Error::Older`] and
    /// [`Error::Unreachable`] of a server.
    pub async fn open_to_read(storage: impl Into<Storage>) -> Result<Self> {
        let storage = storage.into();
        if let Some(address) = storage.server() {
            postgres::check_schema(address).await?;
            return Self::connect(&storage, address, false, None).await;
        }
        let data_dir = storage.folder();
        let database = sqlite::to_read(data_dir).await?;
        sound::check_version(&database, &sqlite::migrations()).await?;
        let copied = match sound::is_older(&database, &sqlite::migrations()).await? {
            true => Some(sqlite::migrated_copy(&database).await?),
            false => None,
        };
        database.close().await;
        Self::assemble(&storage, None, None, copied).await
    }

    /// As [`Self::open_to_read`], after the checks made at every startup; `None` if there is no
    /// database yet, or on a server none of this schema.
    ///
    /// # Errors
    /// Those of a startup: [`Error::Lost`], [`Error::Damaged`], [`Error::Newer`]; [`Error::File`] of
    /// the temporary folder.
    pub async fn examine(storage: impl Into<Storage>) -> Result<Option<Self>> {
        let storage = storage.into();
        if let Some(address) = storage.server() {
            return match postgres::has_schema(address).await? {
                true => Ok(Some(Self::connect(&storage, address, false, None).await?)),
                false => Ok(None),
            };
        }
        let data_dir = storage.folder();
        let database = data_dir.join(DATABASE);
        if !sound::is_there(data_dir, &database, (&storage.artifacts(), &archives(data_dir)))? {
            return Ok(None);
        }
        sound::check(&database).await?;
        Ok(Some(Self::open_to_read(storage).await?))
    }

    /// Open what is there alongside the process that holds it: for short transactions that need no
    /// worker.
    ///
    /// # Errors
    /// [`Error::Database`] when there is none; those of [`Self::open_to_read`] of a server.
    pub async fn open_beside(storage: impl Into<Storage>) -> Result<Self> {
        let storage = storage.into();
        if let Some(address) = storage.server() {
            postgres::check_schema(address).await?;
            return Self::connect(&storage, address, true, None).await;
        }
        let data_dir = storage.folder();
        let file = sqlite::prepared(data_dir).await?;
        sound::check_version(&file, &sqlite::migrations()).await?;
        let writer = sqlite::writer(data_dir).await?;
        file.close().await;
        Self::assemble(&storage, Some(writer), None, None).await
    }

    async fn assemble(
        storage: &Storage,
        writer: Option<AnyPool>,
        lock: Option<Arc<DataLock>>,
        copied: Option<TempDir>,
    ) -> Result<Self> {
        let data_dir = storage.folder();
        let holds_database = copied.as_ref().map_or(data_dir, TempDir::path);
        let pool = async |max| sqlite::readers(holds_database, connections(max)).await;
        let (reader, apart) = (pool(READERS).await?, pool(1).await?);
        let long = sqlite::lazy_readers(holds_database, connections(LONG_READERS))?;
        let newest_event = watch::Sender::new(newest_event(&reader).await?);
        Ok(Self {
            reader,
            apart,
            long,
            writer,
            artifacts: storage.artifacts(),
            archives: archives(data_dir),
            newest_event,
            server: None,
            place: Some(Place::of(&holds_database.join(DATABASE))?),
            bench: Speaks::default(),
            owned: Arc::default(),
            recorder: None,
            unwritten: Arc::default(),
            lock,
            _copied: copied.map(Arc::new),
        })
    }
}

async fn newest_event(pool: &AnyPool) -> Result<i64> {
    Ok(sqlx::query_scalar(NEWEST).fetch_one(pool).await?)
}

/// Connections are kept: one that is reopened may lead to another file.
pub(super) fn connections(max: u32) -> AnyPoolOptions {
    sqlx::any::install_default_drivers();
    AnyPoolOptions::new().max_connections(max).max_lifetime(None).idle_timeout(None)
}

pub(super) fn artifacts(data_dir: &Path) -> Artifacts {
    Artifacts::in_folder(data_dir.join("blobs"))
}

pub(super) fn archives(data_dir: &Path) -> Archives {
    Archives::in_folder(data_dir.join(archive::FOLDER))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use sqlx::Row;

    #[tokio::test]
    async fn a_fresh_folder_is_durable_checked_and_holds_the_published_powders() {
        if testing::only_sqlite_has("a file") {
            return;
        }
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
        if testing::only_sqlite_has("a file") {
            return;
        }
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
        let storage = testing::storage(folder.path()).await;
        Store::open(&storage).await.unwrap().close().await;
        let store = Store::open(&storage).await.unwrap();
        let second = Store::open(&storage).await;
        assert!(matches!(second, Err(Error::Held(_) | Error::Served { .. })), "{second:?}");
        let reader = Store::open_to_read(&storage).await.unwrap();
        let count: i64 = sqlx::query_scalar("SELECT count(*) FROM measurement")
            .fetch_one(&reader.reader)
            .await
            .unwrap();
        assert_eq!(count, 10);
        assert!(matches!(reader.write().await, Err(Error::ReadOnly)));
        assert!(Store::examine(&storage).await.unwrap().is_some());
        let beside = Store::open_beside(&storage).await.unwrap();
        let mut tx = beside.write().await.unwrap();
        tx.audit_person(None, "looked", crate::now()).await.unwrap();
        tx.commit().await.unwrap();
        assert_eq!(store.verify_audit(None).await.unwrap().records, 3);
    }

    #[tokio::test]
    async fn a_database_that_nobody_has_served_is_not_opened_beside() {
        let folder = tempfile::tempdir().unwrap();
        let storage = testing::storage(folder.path()).await;
        assert!(Store::examine(&storage).await.unwrap().is_none());
        let refused =
            [Store::open_to_read(&storage).await.err(), Store::open_beside(&storage).await.err()];
        for refused in refused {
            let refused = refused.unwrap();
            assert_eq!(matches!(refused, Error::Older), testing::on_postgres(), "{refused}");
        }
        // Nor do two databases share a folder.
        Store::open(folder.path()).await.unwrap().close().await;
        let refused = Store::open(&storage).await.err();
        assert_eq!(matches!(refused, Some(Error::Two(_))), testing::on_postgres(), "{refused:?}");
    }
}
