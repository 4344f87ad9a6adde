//! Who the server is: its UUID and name, kept in the data folder so that it is the same server after
//! a restart. The UUID is the installation's, by which workcells of MADSci know it too; a folder of
//! an earlier version keeps its own.

use serde::{Deserialize, Serialize};
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use uuid::Uuid;

/// Folder for what the server keeps, in the data folder.
const FOLDER: &str = "sila";
/// File with [`Kept`].
const FILE: &str = "server.json";
/// Name until somebody sets one.
const NAME: &str = "FLIP powder doser";

/// What is kept of the server, and where.
#[derive(Debug)]
pub struct NamePlate {
    /// The folder, which also holds the certificate.
    pub folder: PathBuf,
    kept: Mutex<Kept>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Kept {
    uuid: Uuid,
    name: String,
    /// Names and addresses for which the certificate was made.
    #[serde(default)]
    certified: Vec<String>,
    /// The lock, while somebody holds it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    lock: Option<HeldLock>,
}

/// The lock of the server.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeldLock {
    /// What the client that locked it sends with its calls.
    pub identifier: String,
    /// The reservation of the bench behind it.
    pub reservation: String,
    /// After how long without a call it ends, s.
    pub seconds: u32,
}

impl NamePlate {
    /// That of a data folder; made the first time, with the installation's UUID.
    ///
    /// # Errors
    /// The file cannot be read or written.
    pub fn of(data_dir: &Path, installation: &str) -> io::Result<Self> {
        let folder = data_dir.join(FOLDER);
        fs::create_dir_all(&folder)?;
        let kept = match fs::read(folder.join(FILE)) {
            Ok(text) => serde_json::from_slice(&text)?,
            Err(error) if error.kind() == ErrorKind::NotFound => Kept {
                uuid: installation.parse().map_err(io::Error::other)?,
                name: NAME.to_owned(),
                certified: Vec::new(),
                lock: None,
            },
            Err(error) => return Err(error),
        };
        let plate = Self { folder, kept: Mutex::new(kept) };
        plate.change(|_| {})?;
        Ok(plate)
    }

    /// The server's UUID.
    pub fn uuid(&self) -> Uuid {
        self.kept().uuid
    }

    /// The server's name.
    pub fn name(&self) -> String {
        self.kept().name.clone()
    }

    /// Names the server.
    ///
    /// # Errors
    /// As [`NamePlate::of`].
    pub fn set_name(&self, name: &str) -> io::Result<()> {
        self.change(|kept| name.clone_into(&mut kept.name))
    }

    /// Names and addresses for which the certificate was made.
    pub fn certified(&self) -> Vec<String> {
        self.kept().certified.clone()
    }

    /// Notes for which names and addresses the certificate was made.
    ///
    /// # Errors
    /// As [`NamePlate::of`].
    pub fn set_certified(&self, names: Vec<String>) -> io::Result<()> {
        self.change(|kept| kept.certified = names)
    }

    /// The lock.
    pub fn lock(&self) -> Option<HeldLock> {
        self.kept().lock.clone()
    }

    /// Notes who holds the lock.
    ///
    /// # Errors
    /// As [`NamePlate::of`].
    pub fn set_lock(&self, lock: Option<HeldLock>) -> io::Result<()> {
        self.change(|kept| kept.lock = lock)
    }

    /// A change counts once it is in the file.
    fn change(&self, how: impl FnOnce(&mut Kept)) -> io::Result<()> {
        let mut kept = self.kept();
        let mut changed = kept.clone();
        how(&mut changed);
        // In one step, so that a crash leaves the file as it was.
        let (file, beside) = (self.folder.join(FILE), self.folder.join(format!("{FILE}.new")));
        fs::write(&beside, serde_json::to_vec_pretty(&changed)?)?;
        fs::rename(&beside, &file)?;
        *kept = changed;
        Ok(())
    }

    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_server_is_the_same_after_a_restart() {
        let data = tempfile::tempdir().unwrap();
        let ids = [1, 2].map(|it| Uuid::from_u128(it).to_string());
        let first = NamePlate::of(data.path(), &ids[0]).unwrap();
        assert_eq!((first.uuid().to_string(), first.name().as_str()), (ids[0].clone(), NAME));
        first.set_name("bench 3").unwrap();
        let again = NamePlate::of(data.path(), &ids[1]).unwrap();
        assert_eq!((again.uuid(), again.name().as_str()), (first.uuid(), "bench 3"));
    }
}
