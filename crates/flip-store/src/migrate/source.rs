//! The side that is copied: opened to read, as of one moment.

use crate::archive::Archives;
use crate::artifacts::Artifacts;
use crate::lock::DataLock;
use crate::open::{archives, artifacts, connections};
use crate::stock::{self, Stock};
use crate::{Error, Result, Storage, Store, now, postgres, sound, sql::Flag};
use sqlx::postgres::PgConnection;
use sqlx::{Any, AnyPool, Connection, Executor, Transaction};
use std::path::Path;

/// A store that is read. Its transaction sees one moment, whatever a running server writes.
pub(crate) struct Source {
    pub tx: Transaction<'static, Any>,
    pub artifacts: Artifacts,
    pub archives: Archives,
    name: String,
    opened: Opened,
    /// Kept while it is copied, if nobody else may serve it meanwhile.
    _alone: (Option<DataLock>, Option<PgConnection>),
}

/// What is closed in the end.
enum Opened {
    Folder(Box<Store>),
    Server(AnyPool),
}

impl Source {
    /// Open it, even while it is served: a copy of one moment.
    ///
    /// # Errors
    /// [`Error::Absent`], [`Error::Damaged`], [`Error::Newer`], [`Error::Unstarted`],
    /// [`Error::Server`], [`Error::Unreachable`].
    pub async fn beside(side: &Storage) -> Result<Self> {
        Self::open(side, (None, None)).await
    }

    /// Open it, and let nobody serve it until this is dropped: what was written after the copy would
    /// be lost.
    ///
    /// # Errors
    /// As [`Self::beside`]; [`Error::Held`].
    pub async fn alone(side: &Storage) -> Result<Self> {
        if !side.is_on_server() {
            has_database(side.folder())?;
        }
        let lock = DataLock::take(side.folder())?;
        let server = match side.server() {
            None => None,
            Some(address) => {
                check_started(side).await?;
                let mut connection = PgConnection::connect(address.database_url.as_str()).await?;
                postgres::serve_alone(&mut connection).await?;
                Some(connection)
            }
        };
        let mut opened = Self::open(side, (Some(lock), server)).await?;
        opened.check_idle().await?;
        Ok(opened)
    }

    async fn open(side: &Storage, alone: (Option<DataLock>, Option<PgConnection>)) -> Result<Self> {
        let folder = side.folder();
        let (tx, opened) = match side.server() {
            None => {
                has_database(folder)?;
                let absent = || Error::Absent(folder.to_owned());
                let store = Store::examine(folder).await?.ok_or_else(absent)?;
                (store.long.begin().await?, Opened::Folder(Box::new(store)))
            }
            Some(address) => {
                // With a wrong folder, every file would be called lost.
                let missing = |source| Error::File { path: folder.to_owned(), source };
                std::fs::read_dir(folder).map_err(missing)?;
                check_started(side).await?;
                let reader = postgres::readers(address.clone(), connections(1)).await?;
                let mut tx = reader.begin().await?;
                tx.execute(postgres::PATIENT).await?;
                (tx, Opened::Server(reader))
            }
        };
        let (artifacts, archives) = (side.artifacts(), archives(folder));
        let name = side.to_string();
        Ok(Self { tx, artifacts, archives, name, opened, _alone: alone })
    }

    /// Refuse a store whose jobs a worker computes: what it writes after the copy would be lost.
    async fn check_idle(&mut self) -> Result<()> {
        let sql = "SELECT EXISTS (SELECT 1 FROM job WHERE state = 'running' AND lease_until >= $1 AND $2)";
        let Flag(computed) = sqlx::query_scalar(sql)
            .bind(now().unix_ms())
            .bind(matches!(self.opened, Opened::Server(_)))
            .fetch_one(&mut *self.tx)
            .await?;
        if computed { Err(Error::Worked(self.name.clone())) } else { Ok(()) }
    }

    /// Refuse rows from before the audit trail that are not in it yet: only in their own folder does
    /// a start know which those are. This is the first question, and sets the moment.
    ///
    /// # Errors
    /// [`Error::Unstarted`]; [`Error::ArtifactsTaken`]: its artifacts are elsewhere.
    pub async fn check_started(&mut self) -> Result<()> {
        if matches!(stock::stock(&mut self.tx).await?, Stock::NotTaken) {
            return Err(Error::Unstarted(self.name.clone()));
        }
        let installation: String =
            sqlx::query_scalar("SELECT id FROM installation").fetch_one(&mut *self.tx).await?;
        self.artifacts.are_of(&installation).await
    }

    /// End the transaction and the connections.
    pub async fn close(self) -> Result<()> {
        self.tx.rollback().await?;
        match self.opened {
            Opened::Folder(store) => store.close().await,
            Opened::Server(pool) => pool.close().await,
        }
        Ok(())
    }
}

/// Refuse a server's database of another schema.
async fn check_started(side: &Storage) -> Result<()> {
    match side.is_served_ready().await? {
        true => Ok(()),
        false => Err(Error::Unstarted(side.to_string())),
    }
}

fn has_database(folder: &Path) -> Result<()> {
    let files = (&artifacts(folder), &archives(folder));
    match sound::is_there(folder, &folder.join(crate::sqlite::DATABASE), files)? {
        true => Ok(()),
        false => Err(Error::Absent(folder.to_owned())),
    }
}
