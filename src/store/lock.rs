//! One process at a time: SQLite would let a second one in, but two benches or two ledgers' workers must not be.

use super::{Error, Result};
use std::fs::{File, OpenOptions, TryLockError};
use std::path::Path;

/// The operating system's lock on a data folder; it ends with the process, however that ends.
#[derive(Debug)]
pub struct DataLock {
    _file: File,
}

impl DataLock {
    /// Take the lock without waiting.
    ///
    /// # Errors
    /// [`Error::Held`] while another process has it.
    pub fn take(data_dir: &Path) -> Result<Self> {
        let path = data_dir.join("flip.lock");
        let failed = |source| Error::File { path: path.clone(), source };
        let file = OpenOptions::new().create(true).truncate(false).write(true).open(&path).map_err(failed)?;
        match file.try_lock() {
            Ok(()) => Ok(Self { _file: file }),
            Err(TryLockError::WouldBlock) => Err(Error::Held(data_dir.to_owned())),
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_second_taker_is_told_who_holds_it_and_gets_it_afterwards() {
        let folder = tempfile::tempdir().unwrap();
        let first = DataLock::take(folder.path()).unwrap();
        let refused = DataLock::take(folder.path()).unwrap_err();
        assert!(matches!(refused, Error::Held(_)) && refused.to_string().contains("flip serve holds this database"));
        drop(first);
        DataLock::take(folder.path()).unwrap();
    }
}
