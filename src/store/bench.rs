//! The bench's own rows: whether it is latched, and the checks that weighings refer to.

use super::row::{Columns, json, word};
use super::{Result, Store, Tx};
use crate::domain::bench_check::CheckKind;
use crate::domain::timestamp::Timestamp;
use crate::store::audit::About;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sqlx::sqlite::SqliteRow;

/// A bench that nobody may use until a person has looked at it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Latch {
    /// Since when.
    pub at: Timestamp,
    /// Why, and what to look at.
    pub reason: String,
    /// The weighing that it came from.
    pub weighing: Option<String>,
}

/// Topic of the bench's events.
pub const BENCH_TOPIC: &str = "bench";

impl Store {
    /// Why the bench is latched, if it is.
    pub(crate) async fn latch(&self) -> Result<Option<Latch>> {
        let row = sqlx::query("SELECT * FROM latch WHERE cleared_at IS NULL").fetch_optional(&self.reader).await?;
        row.as_ref().map(latch).transpose()
    }

    /// As [`Store::latch`], on a connection that nobody else waits for.
    pub(crate) async fn latch_apart(&self) -> Result<Option<Latch>> {
        let row = sqlx::query("SELECT * FROM latch WHERE cleared_at IS NULL").fetch_optional(&self.apart).await?;
        row.as_ref().map(latch).transpose()
    }

    /// The newest check of this kind, and when it was made.
    pub(crate) async fn newest_check<T: DeserializeOwned>(&self, kind: CheckKind) -> Result<Option<(Timestamp, T)>> {
        let sql = "SELECT at, body FROM bench_check WHERE kind = ?1 ORDER BY seq DESC LIMIT 1";
        let row = sqlx::query(sql).bind(word(&kind)).fetch_optional(&self.reader).await?;
        row.map(|row| Ok((row.time("at")?, row.json("body")?))).transpose()
    }
}

impl Tx {
    /// Latch the bench; where it is latched already the first reason stays.
    pub(crate) async fn latch_bench(&mut self, reason: &str, weighing: Option<&str>, now: Timestamp) -> Result<()> {
        let sql = "INSERT INTO latch (at, reason, weighing) VALUES (?1, ?2, ?3) ON CONFLICT DO NOTHING RETURNING *";
        let row = sqlx::query(sql).bind(now.unix_ms()).bind(reason).bind(weighing);
        let Some(row) = row.fetch_optional(&mut *self.inner).await? else { return Ok(()) };
        let latched = latch(&row)?;
        self.audit(About { weighing, kind: "latch" }, &latched, now).await?;
        self.emit(BENCH_TOPIC, "latched", &latched).await
    }

    /// Why the bench is latched, if it is, seen from inside the transaction.
    pub(crate) async fn latch(&mut self) -> Result<Option<Latch>> {
        let sql = "SELECT * FROM latch WHERE cleared_at IS NULL";
        sqlx::query(sql).fetch_optional(&mut *self.inner).await?.as_ref().map(latch).transpose()
    }

    /// A person has looked. `None`: it was not latched.
    pub(crate) async fn clear_latch(&mut self, by: &str, note: &str, now: Timestamp) -> Result<Option<Latch>> {
        let sql = "UPDATE latch SET cleared_at = ?1, cleared_by = ?2, note = ?3 WHERE cleared_at IS NULL RETURNING *";
        let row = sqlx::query(sql).bind(now.unix_ms()).bind(by).bind(note).fetch_optional(&mut *self.inner).await?;
        let Some(latched) = row.as_ref().map(latch).transpose()? else { return Ok(None) };
        let said = serde_json::json!({ "action": "clear", "by": by, "note": note, "latch": latched });
        self.audit(About { weighing: latched.weighing.as_deref(), kind: "person" }, &said, now).await?;
        self.emit(BENCH_TOPIC, "cleared", &said).await?;
        Ok(Some(latched))
    }

    /// Keep a check of the bench.
    pub(crate) async fn insert_check(&mut self, kind: CheckKind, body: &impl Serialize, now: Timestamp) -> Result<()> {
        let sql = "INSERT INTO bench_check (at, kind, body) VALUES (?1, ?2, ?3)";
        sqlx::query(sql).bind(now.unix_ms()).bind(word(&kind)).bind(json(body)?).execute(&mut *self.inner).await?;
        let said = serde_json::json!({ "check": word(&kind), "found": body });
        self.audit(About { weighing: None, kind: "check" }, &said, now).await
    }
}

fn latch(row: &SqliteRow) -> Result<Latch> {
    Ok(Latch { at: row.time("at")?, reason: row.plain("reason")?, weighing: row.plain("weighing")? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::now;

    #[tokio::test]
    async fn a_latched_bench_keeps_its_first_reason_until_a_person_clears_it() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let mut tx = store.write().await.unwrap();
        assert_eq!(tx.clear_latch("nobody", "", now()).await.unwrap(), None);
        tx.latch_bench("the process ended", Some("w-1"), now()).await.unwrap();
        tx.latch_bench("again", None, now()).await.unwrap();
        tx.commit().await.unwrap();
        let latched = store.latch().await.unwrap().unwrap();
        assert_eq!((latched.reason.as_str(), latched.weighing.as_deref()), ("the process ended", Some("w-1")));
        let mut tx = store.write().await.unwrap();
        assert_eq!(tx.clear_latch("Ada", "vial emptied", now()).await.unwrap(), Some(latched));
        tx.commit().await.unwrap();
        assert_eq!(store.latch().await.unwrap(), None);
        assert_eq!(store.verify_audit(None).await.unwrap().records, 2);
    }
}
