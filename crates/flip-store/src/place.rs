//! Checks that the open database is still the one at its path: data written into a file that nobody
//! can find is not a record.

use super::{Error, Result};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// A file, by its path and by its identity in the file system.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Place {
    path: PathBuf,
    file: (u64, u64),
}

impl Place {
    /// The place of a file that is open.
    pub fn of(path: &Path) -> Result<Self> {
        let failed = |source| Error::File { path: path.to_owned(), source };
        Ok(Self { path: path.to_owned(), file: identity(path).map_err(failed)? })
    }

    /// Its path when it was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Check that the file is still there.
    ///
    /// # Errors
    /// [`Error::Gone`]
    pub fn check(&self) -> Result<()> {
        match identity(&self.path) {
            Ok(file) if file == self.file => Ok(()),
            _ => Err(Error::Gone(self.path.clone())),
        }
    }
}

fn identity(path: &Path) -> std::io::Result<(u64, u64)> {
    std::fs::metadata(path).map(|it| (it.dev(), it.ino()))
}

#[cfg(test)]
mod tests {
    use super::super::{Error, Store, now, testing};
    use crate::audit::About;

    #[tokio::test]
    async fn nothing_is_recorded_in_a_database_that_was_removed_or_replaced() {
        if testing::only_sqlite_has("a file") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("data");
        let store = Store::open(&data).await.unwrap();
        let record = async || {
            let mut tx = store.write().await?;
            tx.audit(About { weighing: None, kind: "person" }, &"here", now()).await?;
            tx.commit().await
        };
        record().await.unwrap();
        let away = folder.path().join("away");
        std::fs::rename(&data, &away).unwrap();
        let refused = record().await.unwrap_err();
        assert!(matches!(&refused, Error::Gone(path) if path.ends_with("flip.db")), "{refused}");
        assert!(refused.remedy().contains("no longer"), "{}", refused.remedy());
        // Another file in its place is no better.
        std::fs::create_dir(&data).unwrap();
        std::fs::copy(away.join("flip.db"), data.join("flip.db")).unwrap();
        assert!(matches!(record().await, Err(Error::Gone(_))));
        std::fs::remove_dir_all(&data).unwrap();
        std::fs::rename(&away, &data).unwrap();
        record().await.unwrap();
        assert_eq!(store.verify_audit(None).await.unwrap().records, 4);
    }

    #[tokio::test]
    async fn a_locked_database_is_not_called_a_full_disk() {
        if testing::only_sqlite_has("a file") {
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let other =
            sqlx::sqlite::SqliteConnectOptions::new().filename(folder.path().join("flip.db"));
        let other = sqlx::SqlitePool::connect_with(other).await.unwrap();
        let _held = other.begin_with("BEGIN IMMEDIATE").await.unwrap();
        sqlx::query("PRAGMA busy_timeout = 1").execute(store.writer().unwrap()).await.unwrap();
        let refused = store.write().await.unwrap_err();
        assert!(
            refused.remedy().contains("another program holds the database"),
            "{}",
            refused.remedy()
        );
    }
}
