//! The audit trail: everything that happened on the bench, in order, each record chained to the
//! previous one by its hash.
//!
//! ```text
//! hash = SHA-256 of  previous hash LF seq LF milliseconds since 1970 LF weighing LF kind LF body     (in hexadecimal; 64 zeros before the first)
//! ```
//!
//! There is a chain for each bench, so that benches do not wait for each other. The records of the
//! n-th begin at 1 + n * 2^40; the 0th is that of the bench named `bench`, and of everything that
//! belongs to no bench.
//!
//! `verify.rs` verifies it, `trail.rs` reads it, `archive.rs` moves old records into files. The
//! database refuses to change or delete a record, and editing the file by other means breaks the
//! chain. A chain truncated at its end looks whole: to detect that, keep a hash elsewhere, as a
//! printed certificate does, and check whether the chain still holds it.

use super::archive::LostArchive;
use super::row::{Columns, json};
use super::said::ChangedOther;
use super::verify::ChangedRow;
use super::weighings::{RetryKey, Weighing};
use super::who::Who;
use super::{Error, Result, Tx};
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use sqlx::any::AnyRow;

/// One record of the audit trail.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AuditRecord {
    /// Position; without gaps within a bench's chain.
    pub seq: i64,
    /// When.
    pub at: Timestamp,
    /// The weighing it belongs to.
    pub weighing: Option<String>,
    /// `intent`, `state`, `sent`, `received`, `reading`, `decision`, `outcome`, `person`, `latch`,
    /// `hold`, `check`, `pile`, `rows` (rows as written) or `stock`; `lost` stands for records of
    /// an archive that is gone.
    pub kind: String,
    /// Contents: for a `state` its name, else an object whose fields depend on the kind.
    pub body: serde_json::Value,
    /// Hash of this record and, through the previous one, of all before.
    pub hash: String,
}

/// Whether the audit trail is intact.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditVerification {
    /// Records checked.
    pub records: i64,
    /// Hash of the last record of the first chain; 64 zeros if there is none.
    pub last_hash: String,
    /// The first record that is not what was written, and why.
    pub broken: Option<AuditBreak>,
    /// Whether the requested hash is in the chain.
    pub holds_hash: Option<bool>,
    /// Weighings whose rows do not match the record, at most a hundred; the first of them is in
    /// `broken` too.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub changed: Vec<ChangedRow>,
    /// Other rows that do not match the record (tokens, measurements, state of the bench), at most
    /// a hundred; the first of all is in `broken` too.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub others: Vec<ChangedOther>,
    /// Archives that are missing or damaged: their records are lost, and nothing else. The first of
    /// them is in `broken` too.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub archives: Vec<LostArchive>,
    /// The chains of further benches: absent where there is one bench.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub chains: Vec<AuditChain>,
}

/// One further chain.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditChain {
    /// Position of its last record.
    pub last_seq: i64,
    /// Hash of its last record.
    pub last_hash: String,
}

/// Where an audit trail is broken.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditBreak {
    /// Position of the record.
    pub seq: i64,
    /// What is wrong with it.
    pub why: String,
}

/// Record of an outcome.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct OutcomeRecord {
    #[serde(flatten)]
    pub weighing: Weighing,
    /// SHA-256 of the file with the ticks.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trace: Option<String>,
    /// Of weighings found without a record of their own; others have it in the record of their
    /// intent.
    #[serde(flatten)]
    pub key: RetryKey,
}

/// Subject of an audit record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct About<'a> {
    pub weighing: Option<&'a str>,
    pub kind: &'a str,
}

/// A record in the form in which it is hashed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Written {
    pub seq: i64,
    /// Milliseconds since 1970-01-01 UTC.
    pub at: i64,
    pub weighing: Option<String>,
    pub kind: String,
    /// JSON, byte for byte.
    pub body: String,
    pub hash: String,
}

pub(super) fn beginning() -> String {
    "0".repeat(64)
}

fn chained(previous: &str, seq: i64, at_ms: i64, about: About<'_>, body: &str) -> String {
    let weighing = about.weighing.unwrap_or_default();
    hex::encode(Sha256::digest(format!(
        "{previous}\n{seq}\n{at_ms}\n{weighing}\n{}\n{body}",
        about.kind
    )))
}

/// Positions from the beginning of a chain to that of the next.
pub(super) const CHAIN: i64 = 1 << 40;

/// The position before the first of the chain that holds this one.
pub(super) fn chain_start(seq: i64) -> i64 {
    (seq / CHAIN) * CHAIN
}

impl About<'_> {
    /// Whether such a record belongs to a bench.
    fn is_of_bench(&self) -> bool {
        self.weighing.is_some() || matches!(self.kind, "latch" | "hold" | "check" | "pile")
    }
}

impl Tx {
    /// Append a record to the chain of the store's bench, if it is of a bench, else to the first.
    pub async fn audit(
        &mut self,
        about: About<'_>,
        body: &impl Serialize,
        now: Timestamp,
    ) -> Result<()> {
        let chain = if about.is_of_bench() { self.store.bench.chain } else { 0 };
        self.audit_in(chain, about, body, now).await.map(drop)
    }

    /// Append a record to the chain of the store's bench.
    pub(super) async fn audit_at_bench(
        &mut self,
        about: About<'_>,
        body: &impl Serialize,
        now: Timestamp,
    ) -> Result<()> {
        self.audit_in(self.store.bench.chain, about, body, now).await.map(drop)
    }

    /// Nobody else adds to this chain until the transaction ends.
    pub(super) async fn lock_chain(&mut self, chain: i64) -> Result<()> {
        if self.store.is_postgres() && !self.chains.contains(&chain) {
            super::postgres::lock_chain(&mut self.inner, chain).await?;
            self.chains.push(chain);
        }
        Ok(())
    }

    /// Append a record to a chain; returns its position.
    pub(super) async fn audit_in(
        &mut self,
        chain: i64,
        about: About<'_>,
        body: &impl Serialize,
        now: Timestamp,
    ) -> Result<i64> {
        self.lock_chain(chain).await?;
        let start = chain * CHAIN;
        let body = match about.kind {
            "person" | "intent" => json(&signed(body)?)?,
            _ => json(body)?,
        };
        let last =
            "SELECT seq, hash FROM audit WHERE seq > $1 AND seq <= $2 ORDER BY seq DESC LIMIT 1";
        let last = sqlx::query(last).bind(start).bind(start + CHAIN);
        let (seq, previous) = match last.fetch_optional(&mut *self.inner).await? {
            Some(row) => (row.plain::<i64>("seq")? + 1, row.plain::<String>("hash")?),
            None => (start + 1, beginning()),
        };
        let hash = chained(&previous, seq, now.unix_ms(), about, &body);
        sqlx::query("INSERT INTO audit (seq, at, weighing, kind, body, hash) VALUES ($1, $2, $3, $4, $5, $6)")
            .bind(seq)
            .bind(now.unix_ms())
            .bind(about.weighing)
            .bind(about.kind)
            .bind(body)
            .bind(hash)
            .execute(&mut *self.inner)
            .await?;
        Ok(seq)
    }
}

impl Tx {
    /// Record a person's action on a weighing or the bench.
    pub async fn audit_person(
        &mut self,
        weighing: Option<&str>,
        action: &str,
        now: Timestamp,
    ) -> Result<()> {
        self.audit_deed(weighing, action, serde_json::json!({}), now).await
    }

    /// Record a person's action; `details` is an object with further fields.
    pub async fn audit_deed(
        &mut self,
        weighing: Option<&str>,
        action: &str,
        mut details: serde_json::Value,
        now: Timestamp,
    ) -> Result<()> {
        details["action"] = action.into();
        self.audit(About { weighing, kind: "person" }, &details, now).await
    }
}

/// The body of an action, with the caller's identity if known.
fn signed(body: &impl Serialize) -> Result<serde_json::Value> {
    let mut body = serde_json::to_value(body).map_err(|error| Error::Corrupt(error.to_string()))?;
    if let (Some(who), Some(fields)) = (Who::now(), body.as_object_mut()) {
        fields.insert("who".to_owned(), serde_json::json!(who));
    }
    Ok(body)
}

impl Written {
    /// A row of the table.
    pub(super) fn of(row: &AnyRow) -> Result<Self> {
        Ok(Self {
            seq: row.plain("seq")?,
            at: row.plain("at")?,
            weighing: row.plain("weighing")?,
            kind: row.plain("kind")?,
            body: row.plain("body")?,
            hash: row.plain("hash")?,
        })
    }

    /// Check it as the `seq`-th record after this hash; returns what is wrong.
    pub(super) fn flaw(&self, seq: i64, previous: &str) -> Option<String> {
        if self.seq != seq {
            return Some(format!("record {seq} is missing"));
        }
        let about = About { weighing: self.weighing.as_deref(), kind: &self.kind };
        let hash = chained(previous, seq, self.at, about, &self.body);
        (hash != self.hash)
            .then(|| "it is not what was written, or the one before it is not".to_owned())
    }

    /// The record in the form returned to callers.
    pub(super) fn record(self) -> Result<AuditRecord> {
        let body = serde_json::from_str(&self.body)
            .map_err(|error| Error::Corrupt(format!("body: {error}")))?;
        let Self { seq, weighing, kind, hash, .. } = self;
        Ok(AuditRecord { seq, at: Timestamp::from_unix_ms(self.at), weighing, kind, body, hash })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Store, now, testing};

    async fn with_records(folder: &std::path::Path, n: i64) -> Store {
        let store = testing::open(folder).await.unwrap();
        for k in 0..n {
            let mut tx = store.write().await.unwrap();
            let about = About { weighing: Some("w"), kind: "reading" };
            tx.audit(about, &serde_json::json!({ "mass_mg": k }), now()).await.unwrap();
            tx.commit().await.unwrap();
        }
        store
    }

    #[tokio::test]
    async fn a_chain_is_whole_until_somebody_edits_the_file_and_the_database_itself_refuses() {
        let folder = tempfile::tempdir().unwrap();
        let store = with_records(folder.path(), 5).await;
        let whole = store.verify_audit(None).await.unwrap();
        // Including the two for the rows that a new database begins with.
        assert_eq!((whole.records, &whole.broken), (7, &None));
        let writer = store.writer().unwrap();
        for sql in ["UPDATE audit SET body = '{}' WHERE seq = 3", "DELETE FROM audit WHERE seq = 5"]
        {
            let refused = sqlx::query(sql).execute(writer).await.unwrap_err().to_string();
            assert!(refused.contains("only ever added to"), "{refused}");
        }
        let tampered = [
            ("UPDATE audit SET body = '{\"mass_mg\":9}' WHERE seq = 3", 3),
            ("UPDATE audit SET at = at + 1 WHERE seq = 2", 2),
            ("DELETE FROM audit WHERE seq = 1", 2),
        ];
        for trigger in ["audit_stays", "audit_keeps"] {
            testing::drop_trigger(&store, trigger, "audit").await;
        }
        for (sql, seq) in tampered {
            sqlx::query(sql).execute(writer).await.unwrap();
            let broken = store.verify_audit(None).await.unwrap().broken.unwrap();
            assert_eq!(broken.seq, seq, "{sql}: {}", broken.why);
        }
    }

    #[tokio::test]
    async fn a_chain_that_was_cut_off_no_longer_holds_the_hash_that_somebody_kept() {
        let folder = tempfile::tempdir().unwrap();
        let store = with_records(folder.path(), 3).await;
        let kept = store.verify_audit(None).await.unwrap().last_hash;
        assert_eq!(store.verify_audit(Some(&kept)).await.unwrap().holds_hash, Some(true));
        let writer = store.writer().unwrap();
        testing::drop_trigger(&store, "audit_keeps", "audit").await;
        sqlx::query("DELETE FROM audit WHERE seq = 5").execute(writer).await.unwrap();
        let cut = store.verify_audit(Some(&kept)).await.unwrap();
        assert_eq!((cut.broken, cut.holds_hash), (None, Some(false)));
    }
}
