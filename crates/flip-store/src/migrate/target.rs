//! The side that is written: a database with FLIP's tables and no rows, in one transaction.

use super::catalogue::{Catalogue, quoted};
use super::files::Beside;
use super::rows::{TableRows, tallies};
use crate::archive::Archives;
use crate::artifacts::Artifacts;
use crate::audit::AuditVerification;
use crate::lock::DataLock;
use crate::open::archives;
use crate::sqlite::{self, DATABASE};
use crate::{Error, Result, Storage, Store, postgres, sound, sql::Flag, verify};
use sqlx::any::AnyConnectOptions;
use sqlx::postgres::PgConnection;
use sqlx::{Any, AnyPool, AssertSqlSafe, Connection, Executor, Transaction};
use std::fs::{self, File};
use std::path::{Path, PathBuf};

/// Tables that a migration puts rows into: a database with rows in any other was used.
pub(super) const FILLED_BY_MIGRATIONS: [&str; 1] = ["installation"];
/// What a folder may hold that is no data of FLIP's.
const NO_DATA: [&str; 2] = ["flip.lock", "lost+found"];

/// A store that is filled. Dropped before its end, it is as it was.
pub(super) struct Target {
    pub tx: Transaction<'static, Any>,
    pub artifacts: Artifacts,
    pub archives: Archives,
    /// Artifacts outside the folder, where nothing was before.
    new_artifacts: Option<Artifacts>,
    opened: Opened,
}

enum Opened {
    Folder { beside: Beside, to: PathBuf, writer: AnyPool },
    Server { files: NewFiles, writer: AnyPool, alone: PgConnection },
}

/// The copy as it was read back.
pub(super) struct ReadBack {
    pub audit: AuditVerification,
    pub database_bytes: u64,
}

impl Target {
    /// Make the tables; nothing is seeded.
    ///
    /// # Errors
    /// [`Error::Occupied`], [`Error::Filled`]: somebody's data is there; [`Error::Held`],
    /// [`Error::Server`], [`Error::Newer`], [`Error::Unreachable`], [`Error::Full`], [`Error::File`];
    /// [`Error::ArtifactsTaken`], [`Error::ArtifactsAway`], [`Error::Artifacts`].
    pub async fn prepare(side: &Storage, from: &Artifacts) -> Result<Self> {
        let mut made = match side.server() {
            None => Self::folder(side).await?,
            Some(address) => Self::server(address, side).await?,
        };
        made.empty().await?;
        made.new_artifacts = made.artifacts.check_new(from).await?;
        Ok(made)
    }

    async fn folder(side: &Storage) -> Result<Self> {
        let to = side.folder();
        let beside = Beside::for_new(to)?;
        let folder = &beside.folder;
        let (artifacts, archives) = (side.artifacts_beside(folder), archives(folder));
        sound::prepare(folder, &folder.join(DATABASE), (&artifacts, &archives))?;
        let file = sqlite::prepared(folder).await?;
        sqlite::check_library(&file).await?;
        sqlite::migrations().run(&file).await.map_err(sqlx::Error::from)?;
        let writer = sqlite::writer(folder).await?;
        file.close().await;
        let tx = writer.begin_with("BEGIN IMMEDIATE").await?;
        let to = to.to_owned();
        let opened = Opened::Folder { beside, to, writer };
        Ok(Self { tx, artifacts, archives, new_artifacts: None, opened })
    }

    async fn server(address: &AnyConnectOptions, side: &Storage) -> Result<Self> {
        let data_dir = side.folder();
        let files = NewFiles::in_folder(data_dir)?;
        let alone = postgres::prepare(address).await?;
        let writer = postgres::writer(address.clone()).await?;
        let mut tx = writer.begin_with(postgres::BEGIN).await?;
        postgres::lock(&mut tx).await?;
        tx.execute(postgres::PATIENT).await?;
        let (artifacts, archives) = (side.artifacts(), archives(data_dir));
        let opened = Opened::Server { files, writer, alone };
        Ok(Self { tx, artifacts, archives, new_artifacts: None, opened })
    }

    /// Refuse rows of anybody's, and remove those of the migrations.
    async fn empty(&mut self) -> Result<()> {
        let catalogue = Catalogue::of(&mut self.tx).await?;
        for table in catalogue.tables().map(|table| &table.name) {
            let name = quoted(table);
            if FILLED_BY_MIGRATIONS.contains(&table.as_str()) {
                self.tx.execute(AssertSqlSafe(format!("DELETE FROM {name}"))).await?;
                continue;
            }
            let sql = AssertSqlSafe(format!("SELECT EXISTS (SELECT 1 FROM {name})"));
            let Flag(filled) = sqlx::query_scalar(sql).fetch_one(&mut *self.tx).await?;
            if filled {
                let table = table.clone();
                return Err(Error::Filled { database: self.database().await?, table });
            }
        }
        Ok(())
    }

    async fn database(&mut self) -> Result<String> {
        match &self.opened {
            Opened::Folder { to, .. } => Ok(to.display().to_string()),
            Opened::Server { .. } => {
                let name = sqlx::query_scalar("SELECT current_database()::text");
                Ok(name.fetch_one(&mut *self.tx).await?)
            }
        }
    }

    /// Read the copy back, and keep it if it is what was copied. A folder is read once more from its
    /// file before it gets its name; a server's transaction is read before it is committed.
    ///
    /// # Errors
    /// [`Error::Corrupt`], [`Error::Damaged`]: something else came back; [`Error::Full`],
    /// [`Error::Unreachable`] and others. Nothing is kept.
    pub async fn keep(self, copied: &[TableRows]) -> Result<ReadBack> {
        let Self { mut tx, archives, opened, new_artifacts, .. } = self;
        let copy = (&archives, copied);
        match opened {
            Opened::Folder { beside, to, writer } => {
                let kept = async {
                    tx.commit().await?;
                    let read = read_folder(&beside.folder, writer, copy).await?;
                    beside.put_in_place(&to)?;
                    Ok(read)
                };
                or_discard(kept.await, new_artifacts.as_ref()).await
            }
            Opened::Server { mut files, writer, alone } => {
                let read = read_server(&mut tx, copy).await;
                let read = or_discard(read, new_artifacts.as_ref()).await?;
                // From here on the rows may be there, even if the answer is lost on the way.
                files.keep();
                tx.commit().await?;
                writer.close().await;
                alone.close().await?;
                Ok(read)
            }
        }
    }

    /// Remove what is not removed with the folder, and everything else with it.
    pub async fn discard(self) {
        if let Some(artifacts) = &self.new_artifacts {
            artifacts.discard().await;
        }
    }
}

/// A result; after an error, artifacts that were copied to an empty place are removed again.
pub(crate) async fn or_discard<T>(done: Result<T>, new: Option<&Artifacts>) -> Result<T> {
    if let (Err(_), Some(artifacts)) = (&done, new) {
        artifacts.discard().await;
    }
    done
}

async fn read_folder(
    folder: &Path,
    writer: AnyPool,
    (archives, copied): (&Archives, &[TableRows]),
) -> Result<ReadBack> {
    let database_bytes = put_down(folder, writer).await?;
    let store = Store::open_to_read(folder).await?;
    let audit = read_back(&mut store.long.begin().await?, archives, copied).await?;
    store.close().await;
    Ok(ReadBack { audit, database_bytes })
}

async fn read_server(
    tx: &mut Transaction<'_, Any>,
    (archives, copied): (&Archives, &[TableRows]),
) -> Result<ReadBack> {
    let audit = read_back(tx, archives, copied).await?;
    let size = sqlx::query_scalar("SELECT pg_database_size(current_database())");
    let size: i64 = size.fetch_one(&mut **tx).await?;
    Ok(ReadBack { audit, database_bytes: size.unsigned_abs() })
}

/// Everything into the file, on the disk, and whole; returns its size.
async fn put_down(folder: &Path, writer: AnyPool) -> Result<u64> {
    writer.execute("PRAGMA wal_checkpoint(TRUNCATE)").await?;
    writer.close().await;
    let database = folder.join(DATABASE);
    let synced = File::open(&database).and_then(|file| file.sync_all());
    let size = synced.and_then(|()| fs::metadata(&database).map(|it| it.len()));
    let size = size.map_err(|source| Error::File { path: database.clone(), source })?;
    sound::check(&database).await?;
    Ok(size)
}

async fn read_back(
    tx: &mut Transaction<'_, Any>,
    archives: &Archives,
    copied: &[TableRows],
) -> Result<AuditVerification> {
    let found = tallies(tx).await?;
    for wanted in copied {
        let back = found.iter().find(|it| it.table == wanted.table);
        if back != Some(wanted) {
            let rows = back.map_or(0, |it| it.rows);
            return Err(Error::Corrupt(format!(
                "table {}: {} rows were copied, and {rows} others came back: nothing was kept",
                wanted.table, wanted.rows
            )));
        }
    }
    verify::verified(tx, archives, None).await
}

/// The files next to a server's database: removed if dropped before they are kept.
struct NewFiles {
    folder: PathBuf,
    was_there: bool,
    kept: bool,
    _lock: DataLock,
}

impl NewFiles {
    fn in_folder(folder: &Path) -> Result<Self> {
        let was_there = folder.exists();
        let is_data = |name: &std::ffi::OsStr| !NO_DATA.iter().any(|it| *it == name);
        let mut found = fs::read_dir(folder).into_iter().flatten().flatten();
        if (was_there && !folder.is_dir()) || found.any(|it| is_data(&it.file_name())) {
            return Err(Error::Occupied(folder.to_owned()));
        }
        sound::make_folder(folder)?;
        let lock = DataLock::take(folder)?;
        Ok(Self { folder: folder.to_owned(), was_there, kept: false, _lock: lock })
    }

    fn keep(&mut self) {
        self.kept = true;
    }
}

impl Drop for NewFiles {
    fn drop(&mut self) {
        if self.kept {
            return;
        }
        // Where one cannot be removed, the next copy says that the folder is not empty.
        if !self.was_there {
            let _ = fs::remove_dir_all(&self.folder);
            return;
        }
        for name in ["blobs", crate::archive::FOLDER] {
            let _ = fs::remove_dir_all(self.folder.join(name));
        }
    }
}
