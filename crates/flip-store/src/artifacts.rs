//! Content-addressed bytes: checkpoints, traces and films are files named by their SHA-256, written before
//! the row that names them. They are in a folder or in a bucket of S3.

mod address;
mod bucket;
mod folder;

use super::sql::Flag;
use super::{Error, Result, Store};
use bucket::Bucket;
pub(super) use bucket::Patience;
use folder::Folder;
use futures::{StreamExt, TryStreamExt, stream};
use object_store::path::Path as Key;
use object_store::{ObjectStore, ObjectStoreExt};
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::fmt;
use std::io::ErrorKind;
use std::path::PathBuf;
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

/// Name of the note that says whose artifacts are here; no artifact has such a name.
const OWNER: &str = "installation";
/// How many files are read or copied at a time: a bucket answers many at once.
pub(super) const AT_ONCE: usize = 8;
/// Longest wait for a bucket at a start.
const START_MAX: Duration = Duration::from_secs(30);

/// Content-addressed files, `ab/<sha256>`, in a folder or a bucket. Cheap to clone.
#[derive(Clone)]
pub struct Artifacts {
    place: Place,
    /// Whether a note says whose they are: they are not in the data folder, whose lock keeps others
    /// away.
    is_marked: bool,
}

#[derive(Clone)]
enum Place {
    Folder(Folder),
    Bucket(Bucket),
}

/// A file of ours.
struct Found {
    name: String,
    /// Where it is, below the folder or the prefix.
    at: String,
    /// Time since it was written; `None` if unknown or in the future.
    age: Option<Duration>,
}

impl Artifacts {
    /// Those of a data folder.
    pub(super) fn in_folder(folder: PathBuf) -> Self {
        Self { place: Place::Folder(Folder::new(folder)), is_marked: false }
    }

    /// Store bytes durably and return their SHA-256: when this returns, a row may name them.
    ///
    /// # Errors
    /// [`Error::File`] of a folder, [`Error::ArtifactsAway`] and [`Error::Artifacts`] of a bucket;
    /// existing contents are untouched.
    pub async fn put(&self, bytes: &[u8]) -> Result<String> {
        let sha256 = sha256_hex(bytes);
        if !matches!(&self.place, Place::Folder(folder) if folder.file(&sha256).exists()) {
            self.put_at(&key(&sha256), bytes).await?;
        }
        Ok(sha256)
    }

    async fn put_at(&self, key: &Key, bytes: &[u8]) -> Result<()> {
        let bytes = bytes.to_vec().into();
        match &self.place {
            Place::Folder(folder) => {
                let put = folder.to_write()?.put(key, bytes).await;
                put.map_err(|error| folder.failed(&folder.path().join(key.as_ref()), error))?;
                folder.sync()
            }
            Place::Bucket(bucket) => {
                let put = bucket.objects().put(key, bytes).await;
                put.map(drop).map_err(|error| bucket.failed(key.as_ref(), &error))
            }
        }
    }

    /// The bytes with this SHA-256.
    ///
    /// # Errors
    /// [`Error::File`] when there are none, [`Error::Corrupt`] when the file no longer matches its
    /// name; [`Error::ArtifactsAway`], [`Error::Artifacts`] of a bucket.
    pub async fn get(&self, sha256: &str) -> Result<Vec<u8>> {
        let key = key(sha256);
        let bytes = self.get_at(&key).await?;
        match sha256_hex(&bytes) == sha256 {
            true => Ok(bytes),
            false => Err(Error::Corrupt(format!("{self}/{key} does not hold what its name says"))),
        }
    }

    async fn get_at(&self, key: &Key) -> Result<Vec<u8>> {
        let read = async |objects: &dyn ObjectStore| objects.get(key).await?.bytes().await;
        let bytes = match &self.place {
            Place::Folder(folder) => {
                let failed = |error| folder.failed(&folder.path().join(key.as_ref()), error);
                read(&folder.to_read().map_err(failed)?).await.map_err(failed)?
            }
            Place::Bucket(bucket) => read(&*bucket.objects())
                .await
                .map_err(|error| bucket.failed(key.as_ref(), &error))?,
        };
        Ok(bytes.into())
    }

    /// Our files, complete and half-written.
    async fn files(&self) -> Result<Vec<Found>> {
        match &self.place {
            Place::Folder(folder) => folder.files(),
            Place::Bucket(bucket) => bucket.files().await,
        }
    }

    /// Remove our files that are older than the grace period and not named. Only for the one process
    /// that serves the database.
    ///
    /// If there are more than crashes could leave, none is removed: then the rows are more likely
    /// missing.
    async fn sweep(&self, named: &HashSet<String>, grace: Duration) -> Result<()> {
        let mut unnamed = self.files().await?;
        unnamed.retain(|it| !named.contains(&it.name) && it.age.is_some_and(|age| age > grace));
        if unnamed.len() > SWEPT_MAX {
            tracing::warn!(
                count = unnamed.len(),
                "files that no row names were left where they are: is this the right database?"
            );
            return Ok(());
        }
        for found in unnamed {
            self.remove(&found.at).await?;
        }
        Ok(())
    }

    async fn remove(&self, at: &str) -> Result<()> {
        match &self.place {
            Place::Folder(folder) => folder.remove(at),
            Place::Bucket(bucket) => bucket.remove(at).await,
        }
    }

    /// Whether there are any files of ours in the data folder.
    ///
    /// # Errors
    /// [`Error::File`]
    pub(super) fn any_in_data_folder(&self) -> Result<bool> {
        match &self.place {
            Place::Folder(folder) if !self.is_marked => Ok(!folder.files()?.is_empty()),
            _ => Ok(false),
        }
    }

    /// Check that a copy of `from` does not mix with what is here; returns what to [`discard`] if the
    /// copy fails. What is in the data folder goes with it, and what is copied to where it is stays.
    ///
    /// [`discard`]: Self::discard
    ///
    /// # Errors
    /// [`Error::ArtifactsTaken`]; [`Error::ArtifactsAway`], [`Error::Artifacts`], [`Error::File`].
    pub(super) async fn check_new(&self, from: &Self) -> Result<Option<Self>> {
        if !self.is_marked || self.to_string() == from.to_string() {
            return Ok(None);
        }
        if self.files().await?.is_empty() && self.owner().await?.is_none() {
            return Ok(Some(self.clone()));
        }
        let why = "holds artifacts already: name an empty folder, or another prefix";
        Err(Error::ArtifactsTaken(format!("{self} {why}")))
    }

    /// Remove all of ours from a place that was empty before.
    pub(super) async fn discard(&self) {
        let discarded = async {
            for found in self.files().await? {
                self.remove(&found.at).await?;
            }
            Ok::<_, Error>(())
        };
        if let Err(error) = discarded.await {
            tracing::warn!(%error, "what was copied was not removed again");
        }
    }

    /// Check that they can be read.
    ///
    /// # Errors
    /// [`Error::ArtifactsAway`], [`Error::Artifacts`], [`Error::File`].
    pub async fn check_reachable(&self) -> Result<()> {
        in_time(self, self.owner()).await.map(drop)
    }

    /// Whose they are, if they are not in the data folder and somebody's.
    async fn owner_elsewhere(&self) -> Result<Option<String>> {
        if self.is_marked { in_time(self, self.owner()).await } else { Ok(None) }
    }

    async fn owner(&self) -> Result<Option<String>> {
        match self.get_at(&Key::from(OWNER)).await {
            Ok(owner) => Ok(Some(String::from_utf8_lossy(&owner).trim().to_owned())),
            Err(Error::File { source, .. }) if source.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Check that they can be read and written, and are those of this installation; note that they
    /// are if nobody's were. `joins`: another process must have noted it.
    ///
    /// # Errors
    /// [`Error::ArtifactsTaken`]; [`Error::ArtifactsAway`], [`Error::Artifacts`], [`Error::File`].
    async fn claim(&self, installation: &str, joins: bool) -> Result<()> {
        if !self.is_marked {
            return Ok(());
        }
        let claimed = async {
            let owner = self.owner().await?;
            let is_noted = owner.is_some();
            if is_noted || joins {
                self.check_owner(owner, installation)?;
            }
            // Written each time: this is how a start finds out whether it can.
            let note = format!("{installation}\n");
            match self.put_at(&Key::from(OWNER), note.as_bytes()).await {
                // What is there can be read, and what must be written waits for room.
                Err(error) if is_noted && error.is_full() => {
                    tracing::warn!(%error, "there is no room for artifacts");
                    Ok(())
                }
                noted => noted,
            }
        };
        in_time(self, claimed).await
    }

    /// Check that they are those of this installation, if they are not in the data folder: elsewhere
    /// every file would be called lost.
    ///
    /// # Errors
    /// [`Error::ArtifactsTaken`]; [`Error::ArtifactsAway`], [`Error::Artifacts`], [`Error::File`].
    pub(super) async fn are_of(&self, installation: &str) -> Result<()> {
        match self.is_marked {
            true => self.check_owner(self.owner_elsewhere().await?, installation),
            false => Ok(()),
        }
    }

    fn check_owner(&self, owner: Option<String>, installation: &str) -> Result<()> {
        let why = match owner {
            Some(owner) if owner == installation => return Ok(()),
            Some(owner) => format!(
                "{self} holds the artifacts of another database (of installation {owner}; this one is {installation}): name another folder or prefix"
            ),
            None => format!(
                "{self} holds no artifacts of this database: name those that `flip serve` was started with"
            ),
        };
        Err(Error::ArtifactsTaken(why))
    }

    /// Whether a file is lost; `Some(true)` if it is there, with other contents.
    async fn lost(&self, sha256: &str) -> Result<Option<bool>> {
        match self.get(sha256).await {
            Ok(_) => Ok(None),
            Err(Error::Corrupt(_)) => Ok(Some(true)),
            Err(Error::File { source, .. }) if source.kind() == ErrorKind::NotFound => {
                Ok(Some(false))
            }
            Err(error) => Err(error),
        }
    }
}

impl fmt::Display for Artifacts {
    /// The folder, or the address of the bucket.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.place {
            Place::Folder(folder) => folder.path().display().fmt(f),
            Place::Bucket(bucket) => bucket.name().fmt(f),
        }
    }
}

impl fmt::Debug for Artifacts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Artifacts({self})")
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
        if named { Ok(()) } else { self.artifacts.remove(key(sha256).as_ref()).await }
    }

    /// Compare the files with the rows that name them; `thorough`: read each file and compare it
    /// with its name, too. A running server may be about to name a file, or to remove one.
    ///
    /// # Errors
    /// [`Error::ArtifactsTaken`]: they are another database's;
    /// [`Error::File`], [`Error::Database`]; [`Error::ArtifactsAway`], [`Error::Artifacts`].
    pub async fn check_artifacts(&self, thorough: bool) -> Result<Disagreement> {
        if let owner @ Some(_) = self.artifacts.owner_elsewhere().await? {
            self.artifacts.check_owner(owner, &self.installation().await?)?;
        }
        // Files first: one that is written and named meanwhile is not called unnamed.
        let files: BTreeSet<String> =
            self.artifacts.files().await?.into_iter().map(|it| it.name).collect();
        let rows: Vec<(String, String)> = sqlx::query_as(NAMED_BY).fetch_all(&self.long).await?;
        let mut named = BTreeMap::<String, Vec<String>>::new();
        for (namer, sha256) in rows {
            named.entry(sha256).or_default().push(namer);
        }
        let unnamed = files.iter().filter(|name| !named.contains_key(*name)).cloned().collect();
        // One that was listed is there; any other one may have been written since.
        let doubted = named.into_iter().filter(|(sha256, _)| thorough || !files.contains(sha256));
        let looked = stream::iter(doubted).map(async |(sha256, mut named_by)| {
            let lost = self.artifacts.lost(&sha256).await?;
            named_by.sort();
            Ok::<_, Error>(lost.map(|damaged| LostArtifact { sha256, named_by, damaged }))
        });
        let lost: Vec<_> = looked.buffered(AT_ONCE).try_collect().await?;
        let lost = lost.into_iter().flatten().collect();
        Ok(Disagreement { unnamed, lost })
    }

    /// Remove files that no row has named for a day: a process that ends between file and row
    /// leaves one behind.
    pub(super) async fn sweep_artifacts(&self) -> Result<()> {
        let named: Vec<String> = sqlx::query_scalar(NAMED).fetch_all(&self.reader).await?;
        self.artifacts.sweep(&named.into_iter().collect(), SWEEP_GRACE).await
    }

    /// Check that artifacts outside the data folder can be read and written, and are this
    /// database's.
    pub(super) async fn claim_artifacts(&self) -> Result<()> {
        self.artifacts.claim(&self.installation().await?, false).await
    }

    /// As a start does that serves the database, for another process that writes artifacts.
    ///
    /// # Errors
    /// [`Error::ArtifactsTaken`]: they are not those that the database was served with last;
    /// [`Error::ArtifactsAway`], [`Error::Artifacts`], [`Error::File`].
    pub async fn join_artifacts(&self) -> Result<()> {
        self.artifacts.claim(&self.installation().await?, true).await
    }
}

/// SHA-256 in hexadecimal.
pub fn sha256_hex(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
}

/// A first question, which is not waited for as long as others.
async fn in_time<T>(artifacts: &Artifacts, asked: impl Future<Output = Result<T>>) -> Result<T> {
    let late = |_| Error::ArtifactsAway {
        at: artifacts.to_string(),
        why: format!("no answer within {} s", START_MAX.as_secs()),
    };
    tokio::time::timeout(START_MAX, asked).await.map_err(late)?
}

/// Where it is, below the folder or the prefix.
fn key(sha256: &str) -> Key {
    Key::from(format!("{}/{sha256}", sha256.get(..2).unwrap_or("__")))
}

fn is_hex(name: &str, digits: usize) -> bool {
    name.len() == digits && name.bytes().all(|b| b.is_ascii_hexdigit())
}

fn is_sha256(name: &str) -> bool {
    is_hex(name, 64)
}

#[cfg(test)]
mod tests;
