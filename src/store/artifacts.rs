//! Bytes by content: checkpoints and traces are files named by their SHA-256, written before the row that names them.

use super::{Error, Result, Store};
use sha2::{Digest, Sha256};
use std::collections::HashSet;
use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

/// A folder of content-addressed files: `ab/<sha256>`.
#[derive(Clone, Debug)]
pub struct Artifacts {
    folder: PathBuf,
}

impl Artifacts {
    pub(super) fn in_folder(folder: PathBuf) -> Self {
        Self { folder }
    }

    /// Store bytes durably and return their SHA-256: when this returns, a row may name them.
    ///
    /// # Errors
    /// [`Error::File`]; what was there before is untouched.
    pub fn put(&self, bytes: &[u8]) -> Result<String> {
        let sha256 = sha256_hex(bytes);
        let path = self.path(&sha256);
        if path.exists() {
            return Ok(sha256);
        }
        let failed = |source| Error::File { path: path.clone(), source };
        let folder = path.parent().unwrap_or(&self.folder);
        fs::create_dir_all(folder).map_err(failed)?;
        // A name of its own: two writers of the same bytes must not share a half-written file.
        let temporary = folder.join(format!("{}.part", super::new_id()));
        let mut file = File::create(&temporary).map_err(failed)?;
        file.write_all(bytes).and_then(|()| file.sync_all()).map_err(failed)?;
        fs::rename(&temporary, &path).map_err(failed)?;
        for folder in [folder, &self.folder] {
            File::open(folder).and_then(|f| f.sync_all()).map_err(failed)?;
        }
        Ok(sha256)
    }

    /// The bytes with this SHA-256.
    ///
    /// # Errors
    /// [`Error::File`] when there are none, [`Error::Corrupt`] when the file no longer matches its name.
    pub fn get(&self, sha256: &str) -> Result<Vec<u8>> {
        let path = self.path(sha256);
        let bytes = fs::read(&path).map_err(|source| Error::File { path: path.clone(), source })?;
        match sha256_hex(&bytes) == sha256 {
            true => Ok(bytes),
            false => Err(Error::Corrupt(format!("{} does not hold what its name says", path.display()))),
        }
    }

    /// Remove everything except the named files. Only for whoever holds the folder alone.
    fn keep_only(&self, named: &HashSet<String>) -> Result<()> {
        for folder in entries(&self.folder)? {
            for path in entries(&folder)? {
                let kept = path.file_name().and_then(|name| name.to_str()).is_some_and(|name| named.contains(name));
                if !kept {
                    remove(&path)?;
                }
            }
        }
        Ok(())
    }

    fn path(&self, sha256: &str) -> PathBuf {
        self.folder.join(sha256.get(..2).unwrap_or("__")).join(sha256)
    }
}

impl Store {
    /// Remove a file that a row named until now, unless another row does.
    pub(super) async fn forget_artifact(&self, sha256: &str) -> Result<()> {
        let sql = "SELECT EXISTS (SELECT 1 FROM job WHERE checkpoint = ?1 \
             UNION SELECT 1 FROM job WHERE kind = 'calibration' AND result ->> '$.posterior' = ?1 \
             UNION SELECT 1 FROM weighing WHERE trace = ?1 \
             UNION SELECT 1 FROM pile, json_tree(pile.body, '$.frames') WHERE json_tree.atom = ?1)";
        let named: bool = sqlx::query_scalar(sql).bind(sha256).fetch_one(&self.reader).await?;
        if named { Ok(()) } else { remove(&self.artifacts.path(sha256)) }
    }

    /// Remove files that no row names: a process that ended between file and row leaves one behind.
    pub(super) async fn sweep_artifacts(&self) -> Result<()> {
        let named = "SELECT checkpoint FROM job WHERE checkpoint IS NOT NULL \
                     UNION SELECT result ->> '$.posterior' FROM job \
                     WHERE kind = 'calibration' AND result ->> '$.posterior' IS NOT NULL \
                     UNION SELECT trace FROM weighing WHERE trace IS NOT NULL \
                     UNION SELECT json_tree.atom FROM pile, json_tree(pile.body, '$.frames') WHERE json_tree.atom IS NOT NULL";
        let named: Vec<String> = sqlx::query_scalar(named).fetch_all(&self.reader).await?;
        self.artifacts.keep_only(&named.into_iter().collect())
    }
}

/// SHA-256 in hexadecimal.
pub fn sha256_hex(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>> {
    let failed = |source| Error::File { path: folder.to_owned(), source };
    match fs::read_dir(folder) {
        Ok(found) => found.map(|entry| entry.map(|e| e.path()).map_err(failed)).collect(),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(failed(error)),
    }
}

fn remove(path: &Path) -> Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(Error::File { path: path.to_owned(), source: error }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_come_back_under_their_hash_and_damage_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let artifacts = Artifacts::in_folder(folder.path().join("blobs"));
        let sha256 = artifacts.put(b"weights").unwrap();
        assert_eq!(artifacts.put(b"weights").unwrap(), sha256);
        assert_eq!(artifacts.get(&sha256).unwrap(), b"weights");
        fs::write(artifacts.path(&sha256), b"weighs").unwrap();
        assert!(matches!(artifacts.get(&sha256), Err(Error::Corrupt(_))));
        assert!(matches!(artifacts.get(&"0".repeat(64)), Err(Error::File { .. })));
    }

    #[test]
    fn sweeping_removes_what_no_row_names_and_half_written_files() {
        let folder = tempfile::tempdir().unwrap();
        let artifacts = Artifacts::in_folder(folder.path().to_owned());
        let kept = artifacts.put(b"kept").unwrap();
        let lost = artifacts.put(b"lost").unwrap();
        fs::write(artifacts.path(&kept).with_extension("part"), b"half").unwrap();
        artifacts.keep_only(&HashSet::from([kept.clone()])).unwrap();
        assert_eq!(artifacts.get(&kept).unwrap(), b"kept");
        assert!(artifacts.get(&lost).is_err());
        assert_eq!(entries(artifacts.path(&kept).parent().unwrap()).unwrap().len(), 1);
    }
}
