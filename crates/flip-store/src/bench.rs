//! The bench's own rows: its latch, and the checks that weighings refer to.

use super::row::{Columns, json, word};
use super::{Result, Store, Tx};
use crate::audit::About;
use flip_core::domain::bench::BenchKind;
use flip_core::domain::bench_check::CheckKind;
use flip_core::domain::timestamp::Timestamp;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;

/// A latched bench, which nobody may use until a person has checked it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Latch {
    /// Since when.
    pub at: Timestamp,
    /// Why, and what to check.
    pub reason: String,
    /// The weighing that caused it.
    pub weighing: Option<String>,
    /// Description of the bench: only a process with such a bench can clear the latch. Absent if
    /// unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bench: Option<BenchKind>,
}

/// Topic of the bench's events.
pub const BENCH_TOPIC: &str = "bench";
/// The open latch. One from before benches were stored has the bench of its weighing.
const OPEN: &str = "SELECT seq, at, reason, weighing, coalesce(bench, (SELECT bench FROM weighing WHERE id = latch.weighing)) AS bench \
                    FROM latch WHERE cleared_at IS NULL AND bench_name = $1";

impl Store {
    /// Why the bench is latched, if it is.
    pub async fn latch(&self) -> Result<Option<Latch>> {
        sqlx::query(OPEN)
            .bind(self.bench_name())
            .fetch_optional(&self.reader)
            .await?
            .as_ref()
            .map(latch)
            .transpose()
    }

    /// As [`Store::latch`], on a separate connection that nobody else waits for.
    pub async fn latch_apart(&self) -> Result<Option<Latch>> {
        let row = sqlx::query("SELECT * FROM latch WHERE cleared_at IS NULL AND bench_name = $1")
            .bind(self.bench_name())
            .fetch_optional(&self.apart)
            .await?;
        row.as_ref().map(latch).transpose()
    }

    /// The latest check of this kind, and when it was made.
    pub async fn newest_check<T: DeserializeOwned>(
        &self,
        kind: CheckKind,
    ) -> Result<Option<(Timestamp, T)>> {
        let sql = "SELECT at, body FROM bench_check WHERE kind = $1 AND bench_name = $2 ORDER BY seq DESC LIMIT 1";
        let row = sqlx::query(sql).bind(word(&kind)).bind(self.bench_name());
        let row = row.fetch_optional(&self.reader).await?;
        row.map(|row| Ok((row.time("at")?, row.json("body")?))).transpose()
    }
}

impl Tx {
    /// Latch the bench; if it is latched already, the first reason stays. Returns the current
    /// latch.
    pub async fn latch_bench(&mut self, latched: &Latch) -> Result<Latch> {
        if let Some(first) = self.latch().await? {
            return Ok(first);
        }
        let sql = "INSERT INTO latch (at, reason, weighing, bench, bench_name) VALUES ($1, $2, $3, $4, $5)";
        sqlx::query(sql)
            .bind(latched.at.unix_ms())
            .bind(&latched.reason)
            .bind(&latched.weighing)
            .bind(latched.bench.as_ref().map(word))
            .bind(&*self.store.bench.name)
            .execute(&mut *self.inner)
            .await?;
        let about = About { weighing: latched.weighing.as_deref(), kind: "latch" };
        let said = self.named(latched)?;
        self.audit(about, &said, latched.at).await?;
        self.emit(BENCH_TOPIC, "latched", &said).await?;
        Ok(latched.clone())
    }

    /// Why the bench is latched, if it is, as seen inside the transaction.
    pub async fn latch(&mut self) -> Result<Option<Latch>> {
        let row = sqlx::query(OPEN).bind(&*self.store.bench.name);
        row.fetch_optional(&mut *self.inner).await?.as_ref().map(latch).transpose()
    }

    /// Clear the latch after a person has checked the bench; returns the latch, if there was one:
    /// an arm may be latched while the bench is not.
    pub async fn clear_latch(
        &mut self,
        by: &str,
        note: &str,
        now: Timestamp,
    ) -> Result<Option<Latch>> {
        let latched = self.latch().await?;
        let sql = "UPDATE latch SET cleared_at = $1, cleared_by = $2, note = $3 WHERE cleared_at IS NULL AND bench_name = $4";
        let row = sqlx::query(sql).bind(now.unix_ms()).bind(by).bind(note);
        row.bind(&*self.store.bench.name).execute(&mut *self.inner).await?;
        let mut said =
            serde_json::json!({ "action": "clear", "by": by, "note": note, "latch": latched });
        self.name_bench(&mut said);
        let weighing = latched.as_ref().and_then(|latch| latch.weighing.as_deref());
        self.audit_at_bench(About { weighing, kind: "person" }, &said, now).await?;
        self.emit(BENCH_TOPIC, "cleared", &said).await?;
        Ok(latched)
    }

    /// Store a check of the bench.
    pub async fn insert_check(
        &mut self,
        kind: CheckKind,
        body: &impl Serialize,
        now: Timestamp,
    ) -> Result<()> {
        let sql = "INSERT INTO bench_check (at, kind, body, bench_name) VALUES ($1, $2, $3, $4)";
        sqlx::query(sql)
            .bind(now.unix_ms())
            .bind(word(&kind))
            .bind(json(body)?)
            .bind(&*self.store.bench.name)
            .execute(&mut *self.inner)
            .await?;
        let mut said = serde_json::json!({ "check": word(&kind), "found": body });
        self.name_bench(&mut said);
        self.audit(About { weighing: None, kind: "check" }, &said, now).await
    }
}

impl Tx {
    /// What is recorded of the bench, with its name.
    pub(super) fn named(&self, said: &impl Serialize) -> Result<serde_json::Value> {
        let said = serde_json::to_value(said);
        let mut said = said.map_err(|error| super::Error::Corrupt(error.to_string()))?;
        self.name_bench(&mut said);
        Ok(said)
    }
}

fn latch(row: &AnyRow) -> Result<Latch> {
    Ok(Latch {
        at: row.time("at")?,
        reason: row.plain("reason")?,
        weighing: row.plain("weighing")?,
        bench: row.maybe_word("latch", "bench")?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{now, testing};

    #[tokio::test]
    async fn a_latched_bench_keeps_its_first_reason_until_a_person_clears_it() {
        let folder = tempfile::tempdir().unwrap();
        let store = testing::open(folder.path()).await.unwrap();
        let mut tx = store.write().await.unwrap();
        let first = Latch {
            at: now(),
            reason: "the process ended".into(),
            weighing: Some("w-1".into()),
            bench: Some(BenchKind::Devices),
        };
        let again = Latch { reason: "again".into(), weighing: None, ..first.clone() };
        assert_eq!(tx.latch_bench(&first).await.unwrap(), first);
        assert_eq!(tx.latch_bench(&again).await.unwrap(), first);
        tx.commit().await.unwrap();
        assert_eq!(store.latch().await.unwrap(), Some(first.clone()));
        let mut tx = store.write().await.unwrap();
        assert_eq!(tx.clear_latch("Ada", "vial emptied", now()).await.unwrap(), Some(first));
        assert_eq!(tx.clear_latch("Ada", "the arm alone was latched", now()).await.unwrap(), None);
        tx.commit().await.unwrap();
        assert_eq!(store.latch().await.unwrap(), None);
        assert_eq!(store.verify_audit(None).await.unwrap().records, 5);
    }
}
