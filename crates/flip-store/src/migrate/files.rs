//! The files of a copy: artifacts and archives, each read back, and the folder in which a copy is
//! made before it gets its name.

use super::CopyProgress;
use crate::archive::{self, Archives};
use crate::artifacts::{AT_ONCE, Artifacts, NAMED, sha256_hex};
use crate::{Error, Result, new_id};
use futures::{StreamExt, TryStreamExt, stream};
use sqlx::AnyConnection;
use std::fs::{self, DirBuilder, File};
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

/// Files as they were copied.
#[derive(Debug, Default)]
pub(crate) struct Files {
    /// How many were copied and are whole.
    pub whole: usize,
    /// Those that are missing or damaged in the original.
    pub lost: Vec<String>,
    /// The damaged archives among them.
    pub damaged: Vec<String>,
}

/// Copy every file that the rows name and read each copy back.
///
/// # Errors
/// [`Error::Database`], [`Error::Full`], [`Error::File`]; [`Error::ArtifactsAway`],
/// [`Error::Artifacts`].
pub(crate) async fn copy(
    connection: &mut AnyConnection,
    from: (&Artifacts, &Archives),
    to: (&Artifacts, &Archives),
    progress: &(dyn Fn(CopyProgress<'_>) + Sync),
) -> Result<Files> {
    let named: Vec<String> = sqlx::query_scalar(NAMED).fetch_all(&mut *connection).await?;
    let named_archives: Vec<(String, String)> =
        sqlx::query_as(archive::NAMED).fetch_all(connection).await?;
    let of = named.len() + named_archives.len();
    let mut lost = Vec::new();
    let copied = stream::iter(&named)
        .map(async |sha256| Ok::<_, Error>((copy_artifact(sha256, from.0, to.0).await?, sha256)));
    let mut copied = copied.buffered(AT_ONCE);
    let mut done = 0;
    while let Some((is_whole, sha256)) = copied.try_next().await? {
        lost.extend((!is_whole).then(|| sha256.clone()));
        done += 1;
        progress(CopyProgress::Files { done, of });
    }
    let archives = copy_archives(&named_archives, from.1, to.1)?;
    progress(CopyProgress::Files { done: of, of });
    lost.extend(archives.gone.into_iter().chain(archives.damaged.iter().cloned()));
    Ok(Files { whole: of - lost.len(), lost, damaged: archives.damaged })
}

/// Copy a file and read the copy back; `false`: it is not intact in the original.
async fn copy_artifact(sha256: &str, from: &Artifacts, to: &Artifacts) -> Result<bool> {
    match from.get(sha256).await {
        Ok(bytes) => {
            to.put(&bytes).await?;
            to.get(sha256).await?;
            Ok(true)
        }
        Err(error) if error.is_lost_part() => Ok(false),
        Err(error) => Err(error),
    }
}

/// Archives that are not intact in the original.
#[derive(Debug, Default)]
struct NotWhole {
    gone: Vec<String>,
    damaged: Vec<String>,
}

/// Copy these archives and read each copy back. A damaged one is copied as it is: its parts can be
/// read independently.
fn copy_archives(named: &[(String, String)], from: &Archives, to: &Archives) -> Result<NotWhole> {
    let mut found = NotWhole::default();
    for (file, sha256) in named {
        match from.bytes(file) {
            Ok(bytes) => {
                to.put(file, &bytes)?;
                let copied = sha256_hex(&bytes);
                to.get(file, &copied)?;
                found.damaged.extend((copied != *sha256).then(|| file.clone()));
            }
            Err(error) if error.is_lost_part() => found.gone.push(file.clone()),
            Err(error) => return Err(error),
        }
    }
    Ok(found)
}

/// A temporary folder next to a copy's destination; removed if dropped before it is renamed.
pub(crate) struct Beside {
    pub folder: PathBuf,
    parent: PathBuf,
}

impl Beside {
    /// For a destination that must be missing or empty.
    ///
    /// # Errors
    /// [`Error::Occupied`], [`Error::File`].
    pub fn for_new(to: &Path) -> Result<Self> {
        if fs::read_dir(to).is_ok_and(|mut found| found.next().is_some())
            || (to.exists() && !to.is_dir())
        {
            return Err(Error::Occupied(to.to_owned()));
        }
        let parent = match to.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent.to_owned(),
            _ => PathBuf::from("."),
        };
        let folder = parent.join(format!(".flip-{}.part", new_id()));
        let failed = |source| Error::File { path: folder.clone(), source };
        fs::create_dir_all(&parent).map_err(failed)?;
        DirBuilder::new().mode(0o700).create(&folder).map_err(failed)?;
        Ok(Self { folder, parent })
    }

    /// Rename it: replaces an empty folder at the destination, fails for anything else.
    ///
    /// # Errors
    /// [`Error::File`]
    pub fn put_in_place(&self, to: &Path) -> Result<()> {
        let failed = |source| Error::File { path: to.to_owned(), source };
        File::open(&self.folder).and_then(|folder| folder.sync_all()).map_err(failed)?;
        fs::rename(&self.folder, to).map_err(failed)?;
        File::open(&self.parent).and_then(|folder| folder.sync_all()).map_err(failed)
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        // After renaming it no longer exists.
        let _ = fs::remove_dir_all(&self.folder);
    }
}
