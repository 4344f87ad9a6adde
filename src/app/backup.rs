//! Backups of what is stored, restoring them, and moving to another database.

use super::{App, Disagreement, Storage};
use flip_store::Error as StoreError;
use flip_store::backup::{self, Copied};
use flip_store::migrate::{self, CopyProgress, Migrated};
use std::path::Path;

/// Why nothing was copied.
#[derive(Debug, thiserror::Error)]
pub enum BackupError {
    /// The request cannot be carried out: there is nothing to copy, or the target exists.
    #[error("{0}")]
    Refused(String),
    /// Anything else.
    #[error("{0}")]
    Failed(String),
}

/// Copies what is stored, even while `flip serve` holds it, to a folder that does not exist yet or
/// is empty: a data folder like any other, also of a database on a server. The copy is verified: the
/// database is consistent, its audit trail was checked, and each file matches its name.
///
/// # Errors
/// [`BackupError`]; nothing is left behind.
pub async fn back_up(
    from: impl Into<Storage>,
    to: &Path,
    progress: &(dyn Fn(CopyProgress<'_>) + Sync),
) -> Result<Copied, BackupError> {
    backup::copy_of(&from.into(), to, progress).await.map_err(BackupError::of)
}

/// Restores a backup, which is left unchanged, to a data folder or to an empty database on a server.
/// Nothing is overwritten. The bench is held until a person resumes: the database does not know what
/// was poured since the backup. Tokens are revoked in the copy, because the backup does not know
/// which have been revoked since; `keep_tokens` leaves them as they are in the backup.
///
/// # Errors
/// [`BackupError`]; nothing is left behind.
pub async fn restore(
    backup: &Path,
    to: impl Into<Storage>,
    keep_tokens: bool,
    progress: &(dyn Fn(CopyProgress<'_>) + Sync),
) -> Result<Copied, BackupError> {
    let restored = backup::restore_to(backup, &to.into(), keep_tokens, progress).await;
    restored.map_err(BackupError::of)
}

/// Moves everything to another database, which must be empty, to go on working there: from a data
/// folder to a server, or back. What is moved must not be served meanwhile, and is left as it is.
///
/// # Errors
/// [`BackupError`]; nothing is left behind.
pub async fn move_store(
    from: &Storage,
    to: &Storage,
    progress: &(dyn Fn(CopyProgress<'_>) + Sync),
) -> Result<Migrated, BackupError> {
    migrate::migrate(from, to, progress).await.map_err(BackupError::of)
}

impl App {
    /// Compares the artifacts with the rows that name them; `thorough`: reads each one, too.
    ///
    /// # Errors
    /// [`Error::Unavailable`](super::Error::Unavailable) while their bucket does not answer;
    /// [`Error::Internal`](super::Error::Internal)
    pub async fn check_artifacts(&self, thorough: bool) -> super::Result<Disagreement> {
        Ok(self.store().check_artifacts(thorough).await?)
    }
}

impl BackupError {
    fn of(error: StoreError) -> Self {
        let message = error.to_string();
        match error {
            StoreError::Occupied(_)
            | StoreError::Absent(_)
            | StoreError::Newer(_)
            | StoreError::Filled { .. }
            | StoreError::Unstarted(_)
            | StoreError::Unfit { .. }
            | StoreError::Worked(_)
            | StoreError::ArtifactsTaken(_)
            | StoreError::Held(_)
            | StoreError::Served { .. } => Self::Refused(message),
            _ => Self::Failed(message),
        }
    }
}
