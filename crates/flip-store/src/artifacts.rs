//! Content-addressed bytes: checkpoints, traces and films are files named by their SHA-256, written before
//! the row that names them.

use super::sql::Flag;
use super::{Error, Result, Store};
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, HashSet};
use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Minimum age for removing a file that no row names: a restore may bring files first and the rows
/// an hour later.
const SWEEP_GRACE: Duration = Duration::from_secs(86_400);
/// Maximum number of files swept at startup; each crash leaves one or two.
const SWEPT_MAX: usize = 100;

/// Every file named by a row.
pub(super) const NAMED: &str = "SELECT checkpoint FROM job WHERE checkpoint IS NOT NULL \
    UNION SELECT result ->> '$.posterior' FROM job WHERE kind = 'calibration' AND result ->> '$.posterior' IS NOT NULL \
    UNION SELECT result ->> '$.sha256' FROM job WHERE kind = 'film' AND result ->> '$.sha256' IS NOT NULL \
    UNION SELECT trace FROM weighing WHERE trace IS NOT NULL \
    UNION SELECT json_tree.atom FROM pile, json_tree(pile.body, '$.frames') WHERE json_tree.atom IS NOT NULL";

/// As [`NAMED`], with the rows that name them.
const NAMED_BY: &str = "SELECT 'job ' || id AS namer, checkpoint AS sha256 FROM job WHERE checkpoint IS NOT NULL \
    UNION ALL SELECT 'job ' || id, result ->> '$.posterior' FROM job WHERE kind = 'calibration' AND result ->> '$.posterior' IS NOT NULL \
    UNION ALL SELECT 'job ' || id, result ->> '$.sha256' FROM job WHERE kind = 'film' AND result ->> '$.sha256' IS NOT NULL \
    UNION ALL SELECT 'weighing ' || id, trace FROM weighing WHERE trace IS NOT NULL \
    UNION ALL SELECT 'pile ' || CAST(pile.number AS TEXT) || ' of job ' || pile.job, json_tree.atom \
    FROM pile, json_tree(pile.body, '$.frames') WHERE json_tree.atom IS NOT NULL";

/// How files and rows disagree.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Disagreement {
    /// Names of files that no row names, in order. A start removes those older than a day.
    pub unnamed: Vec<String>,
    /// Files that rows name and that are lost, in order.
    pub lost: Vec<LostArtifact>,
}

/// A file that rows name and that is missing or damaged.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LostArtifact {
    /// The name that rows know it by.
    pub sha256: String,
    /// The rows that name it, such as `weighing 01a2…`.
    pub named_by: Vec<String>,
    /// Whether there is a file, with other contents.
    pub damaged: bool,
}

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
    /// [`Error::File`]; existing contents are untouched.
    pub fn put(&self, bytes: &[u8]) -> Result<String> {
        let sha256 = sha256_hex(bytes);
        let path = self.path(&sha256);
        if path.exists() {
            return Ok(sha256);
        }
        let failed = |source| Error::File { path: path.clone(), source };
        let folder = path.parent().unwrap_or(&self.folder);
        fs::create_dir_all(folder).map_err(failed)?;
        // A unique name: two writers of the same bytes must not share a half-written file.
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
    /// [`Error::File`] when there are none, [`Error::Corrupt`] when the file no longer matches its
    /// name.
    pub fn get(&self, sha256: &str) -> Result<Vec<u8>> {
        let path = self.path(sha256);
        let bytes = fs::read(&path).map_err(|source| Error::File { path: path.clone(), source })?;
        match sha256_hex(&bytes) == sha256 {
            true => Ok(bytes),
            false => {
                Err(Error::Corrupt(format!("{} does not hold what its name says", path.display())))
            }
        }
    }

    /// Remove our files that are older than the grace period and not named. Only for the sole
    /// holder of the folder.
    ///
    /// If there are more than crashes could leave, none is removed: then the rows are more likely
    /// missing.
    fn sweep(&self, named: &HashSet<String>, grace: Duration) -> Result<()> {
        let is_named = |path: &PathBuf| file_name(path).is_some_and(|name| named.contains(name));
        let is_old = |path: &PathBuf| age(path).is_some_and(|age| age > grace);
        let unnamed: Vec<_> =
            self.files()?.into_iter().filter(|path| !is_named(path) && is_old(path)).collect();
        if unnamed.len() > SWEPT_MAX {
            let count = unnamed.len();
            tracing::warn!(
                count,
                "files that no row names were left where they are: is this the right database?"
            );
            return Ok(());
        }
        unnamed.iter().try_for_each(|path| remove(path))
    }

    /// Whether there are any files of ours.
    ///
    /// # Errors
    /// [`Error::File`]
    pub(super) fn any(&self) -> Result<bool> {
        Ok(!self.files()?.is_empty())
    }

    /// Our files, complete and half-written, recognised by their names; anything else here belongs
    /// to someone else.
    fn files(&self) -> Result<Vec<PathBuf>> {
        let is_hex = |name: &str, digits: usize| {
            name.len() == digits && name.bytes().all(|b| b.is_ascii_hexdigit())
        };
        let mut found = Vec::new();
        for folder in entries(&self.folder)? {
            let Some(prefix) = file_name(&folder).filter(|name| is_hex(name, 2) && folder.is_dir())
            else {
                continue;
            };
            let is_ours = |path: &PathBuf| {
                let whole = |name: &str| is_hex(name, 64) && name.starts_with(prefix);
                file_name(path).is_some_and(|name| whole(name) || name.ends_with(".part"))
                    && path.is_file()
            };
            found.extend(entries(&folder)?.into_iter().filter(is_ours));
        }
        Ok(found)
    }

    /// Whether a file is lost; `Some(true)` if it is there, with other contents.
    fn lost(&self, sha256: &str, thorough: bool) -> Result<Option<bool>> {
        let found = if thorough { self.get(sha256).map(drop) } else { self.is_there(sha256) };
        match found {
            Ok(()) => Ok(None),
            Err(Error::Corrupt(_)) => Ok(Some(true)),
            Err(Error::File { source, .. }) if source.kind() == ErrorKind::NotFound => {
                Ok(Some(false))
            }
            Err(error) => Err(error),
        }
    }

    fn is_there(&self, sha256: &str) -> Result<()> {
        let path = self.path(sha256);
        fs::metadata(&path).map(drop).map_err(|source| Error::File { path, source })
    }

    fn path(&self, sha256: &str) -> PathBuf {
        self.folder.join(sha256.get(..2).unwrap_or("__")).join(sha256)
    }
}

impl Store {
    /// Remove a file that a row has just stopped naming, unless another row names it.
    pub(super) async fn forget_artifact(&self, sha256: &str) -> Result<()> {
        let sql = "SELECT EXISTS (SELECT 1 FROM job WHERE checkpoint = $1 \
             UNION SELECT 1 FROM job WHERE kind = 'calibration' AND result ->> '$.posterior' = $1 \
             UNION SELECT 1 FROM job WHERE kind = 'film' AND result ->> '$.sha256' = $1 \
             UNION SELECT 1 FROM weighing WHERE trace = $1 \
             UNION SELECT 1 FROM pile, json_tree(pile.body, '$.frames') WHERE json_tree.atom = $1)";
        let Flag(named) = sqlx::query_scalar(sql).bind(sha256).fetch_one(&self.reader).await?;
        if named { Ok(()) } else { remove(&self.artifacts.path(sha256)) }
    }

    /// Compare the files with the rows that name them; `thorough`: read each file and compare it
    /// with its name, too. A running server may be about to name a file, or to remove one.
    ///
    /// # Errors
    /// [`Error::File`], [`Error::Database`].
    pub async fn check_artifacts(&self, thorough: bool) -> Result<Disagreement> {
        // Files first: one that is written and named meanwhile is not called unnamed.
        let files = self.artifacts.files()?;
        let rows: Vec<(String, String)> = sqlx::query_as(NAMED_BY).fetch_all(&self.long).await?;
        let mut named = BTreeMap::<String, Vec<String>>::new();
        for (namer, sha256) in rows {
            named.entry(sha256).or_default().push(namer);
        }
        let names = files.iter().filter_map(|path| file_name(path));
        let mut unnamed: Vec<_> =
            names.filter(|name| !named.contains_key(*name)).map(str::to_owned).collect();
        unnamed.sort();
        let mut lost = Vec::new();
        for (sha256, mut named_by) in named {
            let Some(damaged) = self.artifacts.lost(&sha256, thorough)? else { continue };
            named_by.sort();
            lost.push(LostArtifact { sha256, named_by, damaged });
        }
        Ok(Disagreement { unnamed, lost })
    }

    /// Remove files that no row has named for a day: a process that ends between file and row
    /// leaves one behind.
    pub(super) async fn sweep_artifacts(&self) -> Result<()> {
        let named: Vec<String> = sqlx::query_scalar(NAMED).fetch_all(&self.reader).await?;
        self.artifacts.sweep(&named.into_iter().collect(), SWEEP_GRACE)
    }
}

/// SHA-256 in hexadecimal.
pub fn sha256_hex(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
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
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(Vec::new()),
        Err(error) => Err(failed(error)),
    }
}

fn remove(path: &Path) -> Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            Err(Error::File { path: path.to_owned(), source: error })
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn files_that_no_row_names_and_rows_whose_file_is_lost_are_listed() {
        let folder = tempfile::tempdir().unwrap();
        let store = crate::testing::open(folder.path()).await.unwrap();
        let put = |text: &str| store.artifacts().put(text.as_bytes()).unwrap();
        let (whole, damaged, unnamed) = (put("whole"), put("damaged"), put("unnamed"));
        let gone = sha256_hex(b"gone");
        let insert = "INSERT INTO job (id, kind, spec, spec_sha256, state, created_at, checkpoint, finished_at, result) \
                      VALUES ($1, $2, '{}', $3, $4, 0, $5, $6, $7)";
        let film = format!(r#"{{"sha256":"{damaged}"}}"#);
        let rows = [
            ("a", "training", "queued", Some(&whole), None, None),
            ("b", "film", "succeeded", Some(&gone), Some(1_i64), Some(&film)),
            ("c", "training", "queued", Some(&gone), None, None),
        ];
        for (id, kind, state, checkpoint, finished_at, result) in rows {
            let row = sqlx::query(insert)
                .bind(id)
                .bind(kind)
                .bind(sha256_hex(id.as_bytes()).into_bytes()[..32].to_vec());
            let row = row.bind(state).bind(checkpoint).bind(finished_at).bind(result);
            row.execute(store.writer().unwrap()).await.unwrap();
        }
        let pile = format!(r#"{{"frames":[{{"depth":"{whole}"}},{{"depth":"{gone}"}}]}}"#);
        let sql = "INSERT INTO pile (job, number, body) VALUES ('a', 1, $1)";
        sqlx::query(sql).bind(pile).execute(store.writer().unwrap()).await.unwrap();
        fs::write(store.artifacts().path(&damaged), b"otherwise").unwrap();
        let lost = |sha256: &String, named_by: &[&str], damaged| LostArtifact {
            sha256: sha256.clone(),
            named_by: named_by.iter().map(|it| (*it).to_owned()).collect(),
            damaged,
        };
        let found = store.check_artifacts(false).await.unwrap();
        let gone = lost(&gone, &["job b", "job c", "pile 1 of job a"], false);
        assert_eq!(found, Disagreement { unnamed: vec![unnamed], lost: vec![gone.clone()] });
        let mut both = vec![gone, lost(&damaged, &["job b"], true)];
        both.sort_by(|a, b| a.sha256.cmp(&b.sha256));
        assert_eq!(store.check_artifacts(true).await.unwrap().lost, both);
    }

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
        artifacts.sweep(&HashSet::from([kept.clone()]), Duration::ZERO).unwrap();
        assert_eq!(artifacts.get(&kept).unwrap(), b"kept");
        assert!(artifacts.get(&lost).is_err());
        assert_eq!(entries(artifacts.path(&kept).parent().unwrap()).unwrap().len(), 1);
    }

    #[test]
    fn sweeping_spares_what_is_young_and_what_is_so_much_that_the_rows_must_be_missing() {
        let folder = tempfile::tempdir().unwrap();
        let artifacts = Artifacts::in_folder(folder.path().to_owned());
        let young = artifacts.put(b"a restore brought it a moment ago").unwrap();
        artifacts.sweep(&HashSet::new(), SWEEP_GRACE).unwrap();
        assert!(artifacts.get(&young).is_ok());
        let many: Vec<_> =
            (0..=SWEPT_MAX).map(|k| artifacts.put(&k.to_le_bytes()).unwrap()).collect();
        artifacts.sweep(&HashSet::new(), Duration::ZERO).unwrap();
        assert!(many.iter().all(|sha256| artifacts.get(sha256).is_ok()));
    }

    #[test]
    fn files_and_folders_of_others_are_neither_removed_nor_in_the_way() {
        let folder = tempfile::tempdir().unwrap();
        let artifacts = Artifacts::in_folder(folder.path().join("blobs"));
        let kept = artifacts.put(b"kept").unwrap();
        let foreign =
            ["README", "ab", "lost+found/x", ".snapshot/ab/y", "cd/notes.txt", "cd/deeper/z"];
        for name in foreign {
            let path = artifacts.folder.join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, b"theirs").unwrap();
        }
        artifacts.sweep(&HashSet::from([kept.clone()]), Duration::ZERO).unwrap();
        assert!(
            foreign.iter().all(|name| artifacts.folder.join(name).exists())
                && artifacts.get(&kept).is_ok()
        );
        let others = Artifacts::in_folder(folder.path().join("others"));
        fs::create_dir_all(&others.folder).unwrap();
        fs::write(others.folder.join("README"), b"theirs").unwrap();
        assert!(!others.any().unwrap() && artifacts.any().unwrap());
    }
}
