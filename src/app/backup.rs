//! Backups of a data folder, and restoring them.

use flip_store::Error as StoreError;
use flip_store::backup::{self, Copied};
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

/// Copies a data folder, even while `flip serve` holds it, to a folder that does not exist yet or
/// is empty. The copy is verified: the database is consistent, its audit trail was checked, and
/// each file matches its name.
///
/// # Errors
/// [`BackupError`]; nothing is left behind.
pub async fn back_up(data_dir: &Path, to: &Path) -> Result<Copied, BackupError> {
    backup::copy(data_dir, to).await.map_err(BackupError::of)
}

/// Restores a data folder from a backup, which is left unchanged. Nothing is overwritten. The bench
/// is held until a person resumes: the database does not know what was poured since the backup.
/// Tokens are revoked in the new folder, because the backup does not know which have been revoked
/// since; `keep_tokens` leaves them as they are in the backup.
///
/// # Errors
/// [`BackupError`]; nothing is left behind.
pub async fn restore(
    backup: &Path,
    data_dir: &Path,
    keep_tokens: bool,
) -> Result<Copied, BackupError> {
    backup::restore(backup, data_dir, keep_tokens).await.map_err(BackupError::of)
}

impl BackupError {
    fn of(error: StoreError) -> Self {
        let message = error.to_string();
        match error {
            StoreError::Occupied(_) | StoreError::Absent(_) | StoreError::Newer(_) => {
                Self::Refused(message)
            }
            _ => Self::Failed(message),
        }
    }
}
