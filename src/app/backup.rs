//! Copies of a data folder, and data folders of copies.

use flip_store::Error as StoreError;
use flip_store::backup::{self, Copied};
use std::path::Path;

/// Why nothing was copied.
#[derive(Debug, thiserror::Error)]
pub enum BackupError {
    /// What was asked for cannot be done: there is nothing to copy, or something is there already.
    #[error("{0}")]
    Refused(String),
    /// Anything else.
    #[error("{0}")]
    Failed(String),
}

/// Copy a data folder, also while `flip serve` holds it, to a folder that is not there yet or is empty. The copy was read back: the database hangs
/// together, its audit trail was gone through, each file is what its name says.
///
/// # Errors
/// [`BackupError`]; nothing is left behind.
pub async fn back_up(data_dir: &Path, to: &Path) -> Result<Copied, BackupError> {
    backup::copy(data_dir, to).await.map_err(BackupError::of)
}

/// Make a data folder of a backup; the backup stays as it is. Nothing is written over. Its bench is held until a person resumes: what was poured since
/// the backup, the database does not know. Its tokens are revoked in the new folder, because the backup does not know which have been revoked since;
/// `keep_tokens` leaves them as the backup has them.
///
/// # Errors
/// [`BackupError`]; nothing is left behind.
pub async fn restore(backup: &Path, data_dir: &Path, keep_tokens: bool) -> Result<Copied, BackupError> {
    backup::restore(backup, data_dir, keep_tokens).await.map_err(BackupError::of)
}

impl BackupError {
    fn of(error: StoreError) -> Self {
        let message = error.to_string();
        match error {
            StoreError::Occupied(_) | StoreError::Absent(_) | StoreError::Newer(_) => Self::Refused(message),
            _ => Self::Failed(message),
        }
    }
}
