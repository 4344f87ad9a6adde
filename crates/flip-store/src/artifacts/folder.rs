//! Artifacts in a folder: `ab/<sha256>`.
//!
//! `object_store` writes and reads them. It lists neither its half-written files nor a folder with a
//! name that is no UTF-8 in it, so this looks for itself what is there.

use super::{Found, is_hex, is_sha256};
use crate::{Error, Result};
use object_store::local::LocalFileSystem;
use std::error::Error as _;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// A folder that may not be there yet.
#[derive(Clone, Debug)]
pub(super) struct Folder {
    path: PathBuf,
}

impl Folder {
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file with this SHA-256.
    pub fn file(&self, sha256: &str) -> PathBuf {
        self.path.join(sha256.get(..2).unwrap_or("__")).join(sha256)
    }

    pub fn to_read(&self) -> object_store::Result<LocalFileSystem> {
        Ok(LocalFileSystem::new_with_prefix(&self.path)?.with_fsync(true))
    }

    pub fn to_write(&self) -> Result<LocalFileSystem> {
        fs::create_dir_all(&self.path)
            .map_err(|source| Error::File { path: self.path.clone(), source })?;
        self.to_read().map_err(|error| self.failed(&self.path, error))
    }

    /// Put the names of the folders on the disk that a writer has made: this one, or another one
    /// that is not that far yet.
    pub fn sync(&self) -> Result<()> {
        let parent = self.path.parent().filter(|it| !it.as_os_str().is_empty());
        for folder in [&self.path, parent.unwrap_or(Path::new("."))] {
            File::open(folder)
                .and_then(|it| it.sync_all())
                .map_err(|source| Error::File { path: folder.to_owned(), source })?;
        }
        Ok(())
    }

    /// What the file system said.
    pub fn failed(&self, file: &Path, error: object_store::Error) -> Error {
        let mut at = error.source();
        while let Some(inner) = at {
            if let Some(found) = inner.downcast_ref::<io::Error>() {
                let source = found.raw_os_error().map_or(
                    io::Error::new(found.kind(), found.to_string()),
                    io::Error::from_raw_os_error,
                );
                return Error::File { path: file.to_owned(), source };
            }
            at = inner.source();
        }
        let kind = match error {
            object_store::Error::NotFound { .. } => io::ErrorKind::NotFound,
            _ => io::ErrorKind::Other,
        };
        Error::File { path: file.to_owned(), source: io::Error::new(kind, error.to_string()) }
    }

    /// Our files, complete and half-written, recognised by their names; anything else here belongs
    /// to someone else.
    pub fn files(&self) -> Result<Vec<Found>> {
        let mut found = Vec::new();
        for folder in entries(&self.path)? {
            let Some(prefix) = file_name(&folder).filter(|name| is_hex(name, 2) && folder.is_dir())
            else {
                continue;
            };
            for path in entries(&folder)? {
                let Some(name) = file_name(&path).filter(|name| is_ours(name, prefix)) else {
                    continue;
                };
                if path.is_file() {
                    let at = format!("{prefix}/{name}");
                    found.push(Found { name: name.to_owned(), at, age: age(&path) });
                }
            }
        }
        Ok(found)
    }

    /// Remove one; it may be gone already.
    pub fn remove(&self, at: &str) -> Result<()> {
        let path = self.path.join(at);
        match fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                Err(Error::File { path, source: error })
            }
            _ => Ok(()),
        }
    }
}

/// Whether a file in the folder of these two digits is an artifact or a part of one:
/// `<sha256>#<number>`, or `<id>.part` of an older FLIP.
fn is_ours(name: &str, prefix: &str) -> bool {
    let whole = match name.split_once('#') {
        Some((whole, number)) if number.bytes().all(|b| b.is_ascii_digit()) => whole,
        Some(_) => return false,
        None => name,
    };
    (is_sha256(whole) && whole.starts_with(prefix)) || name.ends_with(".part")
}

fn file_name(path: &Path) -> Option<&str> {
    path.file_name()?.to_str()
}

/// Time since the file was written; `None` if unknown or in the future.
fn age(path: &Path) -> Option<Duration> {
    fs::metadata(path).ok()?.modified().ok()?.elapsed().ok()
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let failed = |source| Error::File { path: folder.to_owned(), source };
    match fs::read_dir(folder) {
        Ok(found) => found.map(|entry| entry.map(|e| e.path()).map_err(failed)).collect(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(failed(error)),
    }
}
