//! Moving a store: everything of one into another, empty one, between a folder with SQLite and a
//! database of PostgreSQL, in either direction.
//!
//! Rows keep their ids and numbers. They are read as of one moment, written in one transaction in
//! the order of their references, so that every rule and trigger of the target holds as ever, and
//! read back: counts, a hash over each table, the audit trail. What fails leaves nothing.

mod catalogue;
mod cell;
mod counters;
pub(crate) mod files;
mod rows;
pub(crate) mod source;
pub(crate) mod target;

use super::{Result, Storage, Store};
use catalogue::Catalogue;
use files::Files;
pub use rows::TableRows;
use serde::Serialize;
use source::Source;
use std::path::PathBuf;
use target::Target;

/// What has been done so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CopyProgress<'a> {
    /// So many files of so many were copied and read back.
    Files {
        /// Copied.
        done: usize,
        /// All that there are.
        of: usize,
    },
    /// So many rows of a table were written.
    Rows {
        /// The table.
        table: &'a str,
        /// Written.
        done: u64,
    },
    /// All rows were written; they are read back.
    ReadingBack,
}

/// Contents of a moved store, as read back.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Migrated {
    /// The folder of its files.
    pub folder: PathBuf,
    /// Its tables, in the order in which they were written.
    pub tables: Vec<TableRows>,
    /// Size of its database, bytes.
    pub database_bytes: u64,
    /// Files next to the database, including archives of the audit trail, verified by their hashes.
    pub files: usize,
    /// Files named by rows that are missing or damaged where they came from, by SHA-256, or by name
    /// for an archive: their contents are lost, and nothing else.
    pub lost: Vec<String>,
    /// The damaged archives among them: they were copied as they are.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub damaged: Vec<String>,
    /// Records of the audit trail.
    pub records: i64,
    /// Hash of the last one, for `flip audit verify --hash`.
    pub last_hash: String,
    /// Why the audit trail is not what was written, if so: the copy keeps it as it is.
    pub audit_broken: Option<String>,
}

/// Move a store to go on working there. Nobody may serve it meanwhile, and what it was is left as it
/// is. The target must be new: a folder that is missing or empty, and a database without rows.
///
/// # Errors
/// [`Error::Held`](crate::Error::Held) while either is served;
/// [`Error::Occupied`](crate::Error::Occupied), [`Error::Filled`](crate::Error::Filled): the target
/// is not new; [`Error::Absent`](crate::Error::Absent),
/// [`Error::Unstarted`](crate::Error::Unstarted), [`Error::Newer`](crate::Error::Newer),
/// [`Error::Damaged`](crate::Error::Damaged): the source cannot be copied;
/// [`Error::Unfit`](crate::Error::Unfit): a value cannot be stored there; errors of the server and
/// of the disk. The target is as it was.
pub async fn migrate(
    from: &Storage,
    to: &Storage,
    progress: &(dyn Fn(CopyProgress<'_>) + Sync),
) -> Result<Migrated> {
    copy(Source::alone(from).await?, to, progress).await
}

/// As [`migrate`], from a source that is open.
pub(crate) async fn copy(
    mut from: Source,
    to: &Storage,
    progress: &(dyn Fn(CopyProgress<'_>) + Sync),
) -> Result<Migrated> {
    from.check_started().await?;
    let mut target = Target::prepare(to, &from.artifacts).await?;
    let (files, tables) = match copy_into(&mut target, from, progress).await {
        Ok(copied) => copied,
        Err(error) => {
            target.discard().await;
            return Err(error);
        }
    };
    progress(CopyProgress::ReadingBack);
    let found = target.keep(&tables).await?;
    Ok(Migrated {
        folder: to.folder().to_owned(),
        tables,
        database_bytes: found.database_bytes,
        files: files.whole,
        lost: files.lost,
        damaged: files.damaged,
        records: found.audit.records,
        last_hash: found.audit.last_hash,
        audit_broken: found.audit.broken.map(|it| format!("record {}: {}", it.seq, it.why)),
    })
}

async fn copy_into(
    target: &mut Target,
    mut from: Source,
    progress: &(dyn Fn(CopyProgress<'_>) + Sync),
) -> Result<(Files, Vec<TableRows>)> {
    // Files first: a running server removes those that its rows no longer name.
    let files = files::copy(
        &mut from.tx,
        (&from.artifacts, &from.archives),
        (&target.artifacts, &target.archives),
        progress,
    )
    .await?;
    let tables = copy_rows(&mut from, target, progress).await?;
    from.close().await?;
    Ok((files, tables))
}

async fn copy_rows(
    from: &mut Source,
    to: &mut Target,
    progress: &(dyn Fn(CopyProgress<'_>) + Sync),
) -> Result<Vec<TableRows>> {
    let (here, there) = (Catalogue::of(&mut from.tx).await?, Catalogue::of(&mut to.tx).await?);
    let mut tables = Vec::new();
    for (here, there) in here.matched(&there)? {
        let copied = rows::copy((&mut from.tx, here), (&mut to.tx, there), progress).await?;
        counters::go_on(&mut to.tx, there, counters::last(&mut from.tx, here).await?).await?;
        tables.push(copied);
    }
    Ok(tables)
}

impl Store {
    /// Count and hash the rows of each table, as of one moment. Two stores with the same rows answer
    /// the same, whatever databases they have.
    ///
    /// # Errors
    /// [`Error::Database`](crate::Error::Database), [`Error::Corrupt`](crate::Error::Corrupt).
    pub async fn table_rows(&self) -> Result<Vec<TableRows>> {
        rows::tallies(&mut *self.long.begin().await?).await
    }
}

#[cfg(test)]
mod tests;
