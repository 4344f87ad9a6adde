//! The side that is written: a database with FLIP's tables and no rows, in one transaction.

use super::catalogue::{Catalogue, quoted};
use super::files::Beside;
use super::rows::{TableRows, tallies};
use crate::archive::Archives;
use crate::artifacts::Artifacts;
use crate::audit::AuditVerification;
use crate::lock::DataLock;
use crate::open::{archives, artifacts};
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
    /// [`Error::Server`], [`Error::Newer`], [`Error::Unreachable`], [`Error::Full`], [`Error::File`].
    pub async fn prepare(side: &Storage) -> Result<Self> {
        let mut made = match side.server() {
            None => Self::folder(side.folder()).await?,
            Some(address) => Self::server(address, side.folder()).await?,
        };
        made.empty().await?;
        Ok(made)
    }

    async fn folder(to: &Path) -> Result<Self> {
        let beside = Beside::for_new(to)?;
        let folder = &beside.folder;
        let (artifacts, archives) = (artifacts(folder), archives(folder));
        sound::prepare(folder, &folder.join(DATABASE), (&artifacts, &archives))?;
        let file = sqlite::prepared(folder).await?;
        sqlite::check_library(&file).await?;
        sqlite::migrations().run(&file).await.map_err(sqlx::Error::from)?;
        let writer = sqlite::writer(folder).await?;
        file.close().await;
        let tx = writer.begin_with("BEGIN IMMEDIATE").await?;
        let to = to.to_owned();
        Ok(Self { tx, artifacts, archives, opened: Opened::Folder { beside, to, writer } })
    }

    async fn server(address: &AnyConnectOptions, data_dir: &Path) -> Result<Self> {
        let files = NewFiles::in_folder(data_dir)?;
        let alone = postgres::prepare(address).await?;
        let writer = postgres::writer(address.clone()).await?;
        let mut tx = writer.begin_with(postgres::BEGIN).await?;
        postgres::lock(&mut tx).await?;
        tx.execute(postgres::PATIENT).await?;
        let (artifacts, archives) = (artifacts(data_dir), archives(data_dir));
        Ok(Self { tx, artifacts, archives, opened: Opened::Server { files, writer, alone } })
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
        let Self { mut tx, archives, opened, .. } = self;
        match opened {
            Opened::Folder { beside, to, writer } => {
                tx.commit().await?;
                let database = put_down(&beside.folder, writer).await?;
                let store = Store::open_to_read(&beside.folder).await?;
                let audit = read_back(&mut store.long.begin().await?, &archives, copied).await?;
                store.close().await;
                beside.put_in_place(&to)?;
                Ok(ReadBack { audit, database_bytes: database })
            }
            Opened::Server { mut files, writer, alone } => {
                let audit = read_back(&mut tx, &archives, copied).await?;
                let size = sqlx::query_scalar("SELECT pg_database_size(current_database())");
                let size: i64 = size.fetch_one(&mut *tx).await?;
                // From here on the rows may be there, even if the answer is lost on the way.
                files.keep();
                tx.commit().await?;
                writer.close().await;
                alone.close().await?;
                Ok(ReadBack { audit, database_bytes: size.unsigned_abs() })
            }
        }
    }
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
