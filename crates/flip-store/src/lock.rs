//! One process at a time: SQLite would let a second one in, but there must never be two benches or
//! two ledgers' workers.

use super::{Error, Result};
use std::fs::{File, OpenOptions, TryLockError};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

/// OS locks on a data folder; they end with the process, however that ends.
#[derive(Debug)]
pub struct DataLock {
    path: PathBuf,
    file: File,
    /// The folder itself, if its file system can lock one: a lock file can be deleted by hand, and
    /// then proves nothing.
    _folder: Option<File>,
}

impl DataLock {
    /// Take the lock without waiting.
    ///
    /// # Errors
    /// [`Error::Held`] while another process has it.
    pub fn take(data_dir: &Path) -> Result<Self> {
        Self::lock(data_dir, File::try_lock)
    }

    /// Take the lock together with others, for the files of a server's database: whoever takes it
    /// alone is kept out.
    ///
    /// # Errors
    /// [`Error::Held`] while another process has it alone.
    pub fn share(data_dir: &Path) -> Result<Self> {
        Self::lock(data_dir, File::try_lock_shared)
    }

    fn lock(
        data_dir: &Path,
        try_lock: fn(&File) -> std::result::Result<(), TryLockError>,
    ) -> Result<Self> {
        let path = data_dir.join("flip.lock");
        let failed = |source| Error::File { path: path.clone(), source };
        let held = || Error::Held(data_dir.to_owned());
        let mut options = OpenOptions::new();
        let file = options
            .create(true)
            .truncate(false)
            .write(true)
            .mode(0o600)
            .open(&path)
            .map_err(failed)?;
        match try_lock(&file) {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(held()),
            Err(TryLockError::Error(source)) => return Err(failed(source)),
        }
        let folder = File::open(data_dir).map_err(failed)?;
        let folder = match try_lock(&folder) {
            Ok(()) => Some(folder),
            Err(TryLockError::WouldBlock) => return Err(held()),
            // Not every file system can (NFS): the lock on the file has to do.
            Err(TryLockError::Error(_)) => None,
        };
        Ok(Self { path, file, _folder: folder })
    }

    /// The lock file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether the lock file is still the one that was locked.
    pub fn is_in_place(&self) -> bool {
        let ours = self.file.metadata().ok().map(|it| (it.dev(), it.ino()));
        ours.is_some() && ours == inode(&self.path)
    }
}

/// Lock for moving records into archives, which a server running alongside does not hold; it ends
/// with the process.
#[derive(Debug)]
pub(super) struct ArchivingLock {
    _file: File,
}

impl ArchivingLock {
    /// Take the lock beside the folder of the archives, without waiting.
    ///
    /// # Errors
    /// [`Error::Archiving`] while another process has it; [`Error::File`].
    pub(super) fn beside(archives: &Path) -> Result<Self> {
        let path = archives.with_extension("lock");
        let mut options = OpenOptions::new();
        let opened = options.create(true).truncate(false).write(true).mode(0o600).open(&path);
        let file = opened.map_err(|source| Error::File { path, source })?;
        match file.try_lock() {
            Err(TryLockError::WouldBlock) => Err(Error::Archiving),
            // Not every file system can (NFS): the transaction that moves records checks whether
            // they are still there.
            Ok(()) | Err(TryLockError::Error(_)) => Ok(Self { _file: file }),
        }
    }
}

/// Identity of the file at this path: device and inode.
fn inode(path: &Path) -> Option<(u64, u64)> {
    std::fs::metadata(path).ok().map(|it| (it.dev(), it.ino()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_second_taker_is_told_who_holds_it_and_gets_it_afterwards() {
        let folder = tempfile::tempdir().unwrap();
        let first = DataLock::take(folder.path()).unwrap();
        let refused = DataLock::take(folder.path()).unwrap_err();
        assert!(
            matches!(refused, Error::Held(_))
                && refused.to_string().contains("flip serve holds this database")
        );
        drop(first);
        DataLock::take(folder.path()).unwrap();
    }

    #[test]
    fn a_lock_file_that_was_deleted_by_hand_lets_no_second_process_in() {
        let folder = tempfile::tempdir().unwrap();
        let first = DataLock::take(folder.path()).unwrap();
        assert!(first.is_in_place());
        std::fs::remove_file(folder.path().join("flip.lock")).unwrap();
        assert!(matches!(DataLock::take(folder.path()), Err(Error::Held(_))));
        assert!(!first.is_in_place());
    }
}
