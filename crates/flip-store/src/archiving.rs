//! Moves audit records of doses long past from the table into archives (`archive.rs`).
//!
//! The file is written, read back and compared before the record names it, and the rows are deleted
//! in the transaction that names it: whenever a process ends, each record is in the table or in a
//! file that the record names. A file that nothing names yet is rewritten byte for byte by the next
//! attempt.

use super::archive::{Away, DEED, Named, hash_at, member};
use super::artifacts::sha256_hex;
use super::audit::{About, CHAIN, Written, beginning, chain_start};
use super::lock::ArchivingLock;
use super::{Error, Result, Store, Tx, now};
use flip_core::domain::timestamp::Timestamp;
use serde::Serialize;
use std::collections::HashSet;

/// Kinds of the records that are moved: none of them is of a person.
pub(super) const KINDS: [&str; 5] = ["state", "sent", "received", "reading", "decision"];
/// Records per file. Recording of a dose waits while this many rows are deleted.
const RECORDS_MAX: i64 = 10_000;
/// Records moved for a weighing that ended before a given day. Its intent, its outcome and people's
/// actions stay in the table: rows are compared with them.
const BULK: &str = "SELECT audit.* FROM audit JOIN weighing ON weighing.id = audit.weighing \
    WHERE audit.seq > $1 AND weighing.outcome IS NOT NULL AND weighing.finished_at < $2 \
    AND audit.kind IN ('state', 'sent', 'received', 'reading', 'decision') ORDER BY audit.seq LIMIT $3";
// A file holds records of one chain, whose own record names it.

/// What was moved into archives.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Archived {
    /// Weighings that had ended before this were selected.
    pub before: Option<Timestamp>,
    /// Weighings whose records were moved.
    pub weighings: usize,
    /// Records moved.
    pub records: i64,
    /// The files, in the data folder.
    pub files: Vec<String>,
    /// Their size, bytes.
    pub bytes: u64,
}

/// A file that nothing names yet.
struct Packed {
    named: Named,
    bytes: Vec<u8>,
    aways: Vec<Away>,
}

impl Store {
    /// Move the readings, messages, decisions and phases of weighings that ended before this into
    /// files.
    ///
    /// # Errors
    /// [`Error::ReadOnly`]; [`Error::Archiving`]: another process is archiving, and nothing was
    /// moved; [`Error::Corrupt`]: the record is not what was written, and nothing was moved from
    /// there on; [`Error::File`], [`Error::Full`], [`Error::Locked`]: everything moved so far is in
    /// the files that the record names, the rest is where it was.
    pub async fn archive_audit(&self, before: Timestamp) -> Result<Archived> {
        let _lock = ArchivingLock::beside(self.archives.folder())?;
        let mut done = Archived { before: Some(before), ..Archived::default() };
        let (mut after, mut weighings) = (0, HashSet::new());
        loop {
            let mut records = self.bulk_after(after, before).await?;
            let start = records.first().map_or(0, |first| chain_start(first.seq));
            records.retain(|record| chain_start(record.seq) == start);
            let Some(last) = records.last() else { break };
            after = last.seq;
            weighings.extend(records.iter().filter_map(|record| record.weighing.clone()));
            let packed = self.pack(&records, before).await?;
            self.archives.put(&packed.named.file, &packed.bytes)?;
            self.read_back(&packed, &records)?;
            self.move_away(&packed).await?;
            done.records += packed.named.records;
            done.bytes += packed.bytes.len() as u64;
            done.files.push(packed.named.file);
        }
        done.weighings = weighings.len();
        Ok(done)
    }

    async fn bulk_after(&self, after: i64, before: Timestamp) -> Result<Vec<Written>> {
        let query = sqlx::query(BULK).bind(after).bind(before.unix_ms()).bind(RECORDS_MAX);
        query.fetch_all(&self.long).await?.iter().map(Written::of).collect()
    }

    /// Pack these records into a file; returns it with the position of each member.
    async fn pack(&self, records: &[Written], before: Timestamp) -> Result<Packed> {
        let (mut bytes, mut aways) = (Vec::new(), Vec::new());
        for run in records.chunk_by(|a, b| a.seq + 1 == b.seq && a.weighing == b.weighing) {
            let packed = member(run)?;
            aways.push(self.away(run, (bytes.len() as u64, packed.len() as u64)).await?);
            bytes.extend(packed);
        }
        let (Some(first), Some(last)) = (records.first(), records.last()) else {
            unreachable!("not empty")
        };
        let (first, last, sha256) = (first.seq, last.seq, sha256_hex(&bytes));
        let file = format!("audit/{first:010}-{last:010}-{}.jsonl.gz", &sha256[..16]);
        aways.iter_mut().for_each(|away| away.file.clone_from(&file));
        let weighings =
            records.iter().map(|record| &record.weighing).collect::<HashSet<_>>().len() as i64;
        let named =
            Named { file, sha256, first, last, records: records.len() as i64, weighings, before };
        Ok(Packed { named, bytes, aways })
    }

    /// Describe consecutive records, after verifying them.
    async fn away(&self, run: &[Written], (start, bytes): (u64, u64)) -> Result<Away> {
        let (Some(first), Some(last)) = (run.first(), run.last()) else {
            unreachable!("not empty")
        };
        let before = hash_at(&mut *self.long.acquire().await?, first.seq - 1)
            .await?
            .unwrap_or_else(beginning);
        let mut previous = &before;
        for (record, seq) in run.iter().zip(first.seq..) {
            if let Some(why) = record.flaw(seq, previous) {
                let advice = "`flip audit verify` checks the whole record; it was left where it is";
                return Err(Error::Corrupt(format!(
                    "record {seq} of the audit trail: {why}. {advice}"
                )));
            }
            previous = &record.hash;
        }
        let (weighing, hash) = (first.weighing.clone().unwrap_or_default(), last.hash.clone());
        let file = String::new();
        Ok(Away { first: first.seq, last: last.seq, weighing, before, hash, file, start, bytes })
    }

    /// Verify that the file on disk holds these records.
    fn read_back(&self, packed: &Packed, records: &[Written]) -> Result<()> {
        self.archives.get(&packed.named.file, &packed.named.sha256)?;
        let mut read = Vec::new();
        for away in &packed.aways {
            read.extend(self.archives.read(away)?);
        }
        match read == records {
            true => Ok(()),
            false => Err(Error::Corrupt(format!(
                "{} was not read back as it was written",
                packed.named.file
            ))),
        }
    }

    /// Name the file in the record, and delete its contents from the table.
    async fn move_away(&self, packed: &Packed) -> Result<()> {
        let mut tx = self.write().await?;
        tx.name_archive(packed).await?;
        tx.commit().await?;
        // Only this shrinks SQLite's file; without it the space is available for other rows.
        if !self.is_postgres()
            && let Err(error) =
                sqlx::query("PRAGMA incremental_vacuum(2000)").fetch_all(self.writer()?).await
        {
            tracing::warn!(%error, "the database keeps the room of what was archived");
        }
        Ok(())
    }
}

impl Tx {
    async fn name_archive(&mut self, packed: &Packed) -> Result<()> {
        let mut said = serde_json::to_value(&packed.named)
            .map_err(|error| Error::Corrupt(error.to_string()))?;
        said["action"] = DEED.into();
        let chain = packed.named.first / CHAIN;
        let about = About { weighing: None, kind: "person" };
        let archive = self.audit_in(chain, about, &said, now()).await?;
        for away in &packed.aways {
            // Detects another process's work where the file system has no locks.
            let left = "SELECT count(*) FROM audit WHERE seq BETWEEN $1 AND $2";
            let left = sqlx::query_scalar::<_, i64>(left).bind(away.first).bind(away.last);
            if left.fetch_one(&mut *self.inner).await? != away.last - away.first + 1 {
                return Err(Error::Archiving);
            }
            self.insert_away(away, archive).await?;
            let gone = sqlx::query("DELETE FROM audit WHERE seq BETWEEN $1 AND $2")
                .bind(away.first)
                .bind(away.last);
            gone.execute(&mut *self.inner).await?;
        }
        Ok(())
    }

    async fn insert_away(&mut self, away: &Away, archive: i64) -> Result<()> {
        let sql = "INSERT INTO audit_away (first, last, weighing, before, hash, archive, start, bytes) \
                   VALUES ($1, $2, $3, $4, $5, $6, $7, $8)";
        sqlx::query(sql)
            .bind(away.first)
            .bind(away.last)
            .bind(&away.weighing)
            .bind(&away.before)
            .bind(&away.hash)
            .bind(archive)
            .bind(away.start as i64)
            .bind(away.bytes as i64)
            .execute(&mut *self.inner)
            .await?;
        Ok(())
    }
}
