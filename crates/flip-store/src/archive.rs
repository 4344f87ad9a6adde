//! Archives: files in the folder `audit` that hold audit records of doses long past, moved out of
//! the table.
//!
//! ```text
//! audit/<first>-<last>-<sha256>.jsonl.gz      a record a line, as it was hashed; each unbroken row of one weighing's records is a member of its own
//! audit_away                                  which records are in which member, and the hashes before and at its end
//! ```
//!
//! So a weighing can be read without the others, each member is verified by the chain, and a lost
//! file breaks the chain nowhere else.

use super::audit::{AuditRecord, Written};
use super::row::Columns;
use super::sql::has_table;
use super::{Error, Result, Store};
use crate::artifacts::sha256_hex;
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::AnyConnection;
use sqlx::any::AnyRow;
use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

/// Name of the folder in the data folder.
pub(super) const FOLDER: &str = "audit";
/// The action whose record names a file.
pub(super) const DEED: &str = "archive audit";
/// Files named by the record, with their hashes.
pub(super) const NAMED: &str = "SELECT body ->> '$.file' AS file, body ->> '$.sha256' AS sha256 FROM audit \
    WHERE weighing IS NULL AND kind = 'person' AND body ->> '$.action' = 'archive audit' ORDER BY seq";
/// Maximum unpacked size of a member, bytes: anything larger was not written here.
const UNPACKED_MAX: u64 = 1 << 30;

/// An archive that is missing or damaged.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct LostArchive {
    /// The file, in the data folder.
    pub file: String,
    /// Position of the first of its records.
    pub first: i64,
    /// Position of the last.
    pub last: i64,
    /// What is wrong with it.
    pub why: String,
}

/// Record of an archive file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Named {
    pub file: String,
    pub sha256: String,
    pub first: i64,
    pub last: i64,
    pub records: i64,
    pub weighings: i64,
    /// All of its weighings had ended before this.
    pub before: Timestamp,
}

/// Consecutive records of one weighing that are stored in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Away {
    pub first: i64,
    pub last: i64,
    pub weighing: String,
    pub before: String,
    pub hash: String,
    pub file: String,
    pub start: u64,
    pub bytes: u64,
}

/// The archive folder.
#[derive(Clone, Debug)]
pub(super) struct Archives {
    folder: PathBuf,
}

impl Archives {
    pub(super) fn in_folder(folder: PathBuf) -> Self {
        Self { folder }
    }

    /// The folder.
    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    /// Whether there are any files.
    pub(super) fn any(&self) -> bool {
        fs::read_dir(&self.folder).is_ok_and(|mut found| found.next().is_some())
    }

    /// Path of a file named by the record.
    ///
    /// # Errors
    /// [`Error::Corrupt`]: not a name assigned here.
    fn path(&self, file: &str) -> Result<PathBuf> {
        let name = file
            .strip_prefix("audit/")
            .and_then(|rest| rest.strip_suffix(".jsonl.gz"))
            .unwrap_or_default();
        let is_ours = !name.is_empty() && name.bytes().all(|b| b.is_ascii_hexdigit() || b == b'-');
        match is_ours {
            true => Ok(self.folder.join(format!("{name}.jsonl.gz"))),
            false => Err(Error::Corrupt(format!("`{file}` is no name of an archive"))),
        }
    }

    /// The bytes of a file, unchecked.
    ///
    /// # Errors
    /// [`Error::File`]; [`Error::Corrupt`]: its name.
    pub(super) fn bytes(&self, file: &str) -> Result<Vec<u8>> {
        let path = self.path(file)?;
        fs::read(&path).map_err(|source| Error::File { path, source })
    }

    /// The bytes of a file, which must have this SHA-256.
    ///
    /// # Errors
    /// [`Error::File`], [`Error::Corrupt`].
    pub(super) fn get(&self, file: &str, sha256: &str) -> Result<Vec<u8>> {
        let bytes = self.bytes(file)?;
        match sha256_hex(&bytes) == sha256 {
            true => Ok(bytes),
            false => Err(Error::Corrupt(format!("{file} does not hold what was archived"))),
        }
    }

    /// Store a file durably: when this returns, a record may name it.
    ///
    /// # Errors
    /// [`Error::File`]
    pub(super) fn put(&self, file: &str, bytes: &[u8]) -> Result<()> {
        let path = self.path(file)?;
        let failed = |source| Error::File { path: path.clone(), source };
        DirBuilder::new().recursive(true).mode(0o700).create(&self.folder).map_err(failed)?;
        let part = self.folder.join(format!("{}.part", super::new_id()));
        let written = OpenOptions::new().create_new(true).write(true).mode(0o600).open(&part);
        written
            .and_then(|mut it| it.write_all(bytes).and_then(|()| it.sync_all()))
            .map_err(failed)?;
        fs::rename(&part, &path).map_err(failed)?;
        let parent = self.folder.parent().unwrap_or(&self.folder);
        [&self.folder, parent]
            .into_iter()
            .try_for_each(|it| File::open(it)?.sync_all())
            .map_err(failed)
    }

    /// The records of a member, verified from the hash before them to that of the last.
    ///
    /// # Errors
    /// [`Error::File`], [`Error::Corrupt`]: they are lost.
    pub(super) fn read(&self, away: &Away) -> Result<Vec<Written>> {
        let path = self.path(&away.file)?;
        let text = unpacked(&path, away).map_err(|source| Error::File { path, source })?;
        let damaged = |why: String| Error::Corrupt(format!("{}: {why}", away.file));
        let lines = text
            .lines()
            .map(serde_json::from_str)
            .collect::<std::result::Result<Vec<Written>, _>>();
        let records = lines.map_err(|error| damaged(error.to_string()))?;
        check(&records, away).map_err(damaged)?;
        Ok(records)
    }
}

/// The lines of a member.
fn unpacked(path: &Path, away: &Away) -> std::io::Result<String> {
    let mut file = File::open(path)?;
    file.seek(SeekFrom::Start(away.start))?;
    let mut text = String::new();
    GzDecoder::new(file.take(away.bytes)).take(UNPACKED_MAX).read_to_string(&mut text)?;
    Ok(text)
}

/// Check the records of a member.
fn check(records: &[Written], away: &Away) -> std::result::Result<(), String> {
    let mut previous = &away.before;
    for (record, seq) in records.iter().zip(away.first..) {
        if let Some(why) = record.flaw(seq, previous) {
            return Err(format!("record {seq}: {why}"));
        }
        // The table finds the records of a weighing by this name: another name there would hide
        // them.
        if record.weighing.as_ref() != Some(&away.weighing) {
            let of = record.weighing.as_deref().unwrap_or("no weighing");
            return Err(format!(
                "record {seq} is of {of}, the table of archives says {}",
                away.weighing
            ));
        }
        previous = &record.hash;
    }
    let whole = records.last().is_some_and(|last| last.seq == away.last && last.hash == away.hash);
    whole.then_some(()).ok_or_else(|| format!("does not end with record {}", away.last))
}

/// Records as a member; the same records yield the same bytes.
pub(super) fn member(records: &[Written]) -> Result<Vec<u8>> {
    let failed = |error: std::io::Error| Error::Corrupt(format!("cannot be compressed: {error}"));
    let mut packed = GzEncoder::new(Vec::new(), Compression::default());
    for record in records {
        let line = super::row::json(record)? + "\n";
        packed.write_all(line.as_bytes()).map_err(failed)?;
    }
    packed.finish().map_err(failed)
}

impl Store {
    /// The records of a member; if it is lost, one record that states this.
    pub(super) fn archived(&self, away: &Away) -> Result<Vec<AuditRecord>> {
        match self.archives.read(away) {
            Ok(records) => records.into_iter().map(Written::record).collect(),
            Err(error) if error.is_lost_part() => Ok(vec![stands_for(away, &error)]),
            Err(error) => Err(error),
        }
    }
}

/// Why a file is lost, without revealing where the data folder is.
pub(super) fn why_lost(file: &str, error: &Error) -> String {
    match error {
        Error::File { source, .. } => format!("{file}: {source}"),
        other => other.to_string(),
    }
}

/// A placeholder for records that are lost.
fn stands_for(away: &Away, error: &Error) -> AuditRecord {
    let Away { first, last, weighing, file, .. } = away;
    let why = why_lost(file, error);
    AuditRecord {
        seq: *first,
        at: Timestamp::from_unix_ms(0),
        weighing: Some(weighing.clone()),
        kind: "lost".to_owned(),
        body: serde_json::json!({ "archive": file, "first": first, "last": last, "why": why }),
        hash: away.hash.clone(),
    }
}

/// Order in which members are searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Order {
    Newest,
    Oldest,
}

/// Members that hold records after the first and before the second position, at most `limit`; of
/// one weighing if given.
pub(super) async fn aways(
    connection: &mut AnyConnection,
    weighing: Option<&str>,
    (after, before): (i64, i64),
    order: Order,
    limit: i64,
) -> Result<Vec<Away>> {
    if !has_table(connection, "audit_away").await? {
        return Ok(Vec::new());
    }
    const OF_ONE: &str = "SELECT away.*, audit.body ->> '$.file' AS file FROM audit_away AS away JOIN audit ON audit.seq = away.archive \
                          WHERE away.weighing = $3 AND away.last > $1 AND away.first < $2 ORDER BY away.first";
    const NEWEST: &str = "SELECT away.*, audit.body ->> '$.file' AS file FROM audit_away AS away JOIN audit ON audit.seq = away.archive \
                          WHERE away.last > $1 AND away.first < $2 ORDER BY away.first DESC LIMIT $3";
    const OLDEST: &str = "SELECT away.*, audit.body ->> '$.file' AS file FROM audit_away AS away JOIN audit ON audit.seq = away.archive \
                          WHERE away.last > $1 AND away.first < $2 ORDER BY away.last LIMIT $3";
    let sql = match (weighing, order) {
        (Some(_), _) => OF_ONE,
        (None, Order::Newest) => NEWEST,
        (None, Order::Oldest) => OLDEST,
    };
    let query = sqlx::query(sql).bind(after).bind(before);
    let query = match weighing {
        Some(weighing) => query.bind(weighing),
        None => query.bind(limit),
    };
    let mut found =
        query.fetch_all(connection).await?.iter().map(away).collect::<Result<Vec<_>>>()?;
    if weighing.is_some() && order == Order::Newest {
        found.reverse();
    }
    Ok(found)
}

/// Number of members named by the table.
pub(super) async fn count(connection: &mut AnyConnection) -> Result<i64> {
    if !has_table(connection, "audit_away").await? {
        return Ok(0);
    }
    Ok(sqlx::query_scalar("SELECT count(*) FROM audit_away").fetch_one(connection).await?)
}

/// Number of records in members; of one weighing if given.
pub(super) async fn count_records(
    connection: &mut AnyConnection,
    weighing: Option<&str>,
) -> Result<i64> {
    if !has_table(connection, "audit_away").await? {
        return Ok(0);
    }
    let sql = "SELECT CAST(coalesce(sum(last - first + 1), 0) AS BIGINT) FROM audit_away WHERE $1 IS NULL OR weighing = $1";
    Ok(sqlx::query_scalar(sql).bind(weighing).fetch_one(connection).await?)
}

/// How the table's entry for a file differs from the record that names it, even if the file is
/// gone.
pub(super) async fn not_as_named(
    connection: &mut AnyConnection,
    archive: i64,
    named: &Named,
) -> Result<Option<Error>> {
    let sql = "SELECT CAST(coalesce(sum(last - first + 1), 0) AS BIGINT), count(DISTINCT weighing), coalesce(min(first), 0), coalesce(max(last), 0) \
               FROM audit_away WHERE archive = $1 AND first BETWEEN $2 AND $3";
    let query = sqlx::query_as(sql).bind(archive).bind(named.first).bind(named.last);
    let found: (i64, i64, i64, i64) = query.fetch_one(connection).await?;
    let said = (named.records, named.weighings, named.first, named.last);
    let why = |(records, weighings, first, last)| {
        format!("{records} records of {weighings} weighings, {first} to {last}")
    };
    Ok((found != said).then(|| {
        let (file, found, said) = (&named.file, why(found), why(said));
        Error::Corrupt(format!("{file}: the table of archives says {found}; {said} were archived"))
    }))
}

/// Hash of the record at this position, in the table or an archive; `None` if there is none.
pub(super) async fn hash_at(connection: &mut AnyConnection, seq: i64) -> Result<Option<String>> {
    let sql = "SELECT hash FROM audit WHERE seq = $1";
    if let Some(hash) = sqlx::query_scalar(sql).bind(seq).fetch_optional(&mut *connection).await? {
        return Ok(Some(hash));
    }
    if !has_table(connection, "audit_away").await? {
        return Ok(None);
    }
    // Queried where a member ends or begins.
    let sql = "SELECT hash FROM audit_away WHERE last = $1 UNION ALL SELECT before FROM audit_away WHERE first = $1 + 1";
    Ok(sqlx::query_scalar(sql).bind(seq).fetch_optional(connection).await?)
}

fn away(row: &AnyRow) -> Result<Away> {
    let size = |column: &str| -> Result<u64> {
        let value: i64 = row.plain(column)?;
        u64::try_from(value).map_err(|_| Error::Corrupt(format!("{column}: {value} is no size")))
    };
    Ok(Away {
        first: row.plain("first")?,
        last: row.plain("last")?,
        weighing: row.plain("weighing")?,
        before: row.plain("before")?,
        hash: row.plain("hash")?,
        file: row.plain("file")?,
        start: size("start")?,
        bytes: size("bytes")?,
    })
}
