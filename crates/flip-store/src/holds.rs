//! Holds of the bench: after a stop nothing starts until a person resumes.

use super::bench::BENCH_TOPIC;
use super::row::Columns;
use super::{Result, Store, Tx};
use crate::audit::About;
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;

/// A held bench, on which nothing starts until a person resumes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Held {
    /// Since when.
    pub at: Timestamp,
    /// Why it is held.
    pub reason: String,
    /// Who held it, if known.
    pub by: Option<String>,
}

/// The open hold.
const OPEN: &str =
    "SELECT at, reason, held_by FROM bench_hold WHERE resumed_at IS NULL AND bench_name = $1";

impl Store {
    /// Whether the bench is held, and why.
    pub async fn held(&self) -> Result<Option<Held>> {
        let row = sqlx::query(OPEN).bind(self.bench_name());
        row.fetch_optional(&self.reader).await?.as_ref().map(held).transpose()
    }
}

impl Tx {
    /// Hold the bench; if it is held already, the first reason stays.
    pub async fn hold_bench(&mut self, held: &Held) -> Result<()> {
        let sql = "INSERT INTO bench_hold (at, reason, held_by, bench_name) VALUES ($1, $2, $3, $4) ON CONFLICT DO NOTHING";
        let row = sqlx::query(sql).bind(held.at.unix_ms()).bind(&held.reason).bind(&held.by);
        let row = row.bind(&*self.store.bench.name);
        if row.execute(&mut *self.inner).await?.rows_affected() == 0 {
            return Ok(());
        }
        let said = self.named(held)?;
        self.audit(About { weighing: None, kind: "hold" }, &said, held.at).await?;
        self.emit(BENCH_TOPIC, "held", &said).await
    }

    /// Resume the bench, so that doses can start again. `false`: it was not held.
    pub async fn resume_bench(&mut self, by: &str, note: &str, now: Timestamp) -> Result<bool> {
        let open = sqlx::query(OPEN).bind(&*self.store.bench.name);
        let Some(open) = open.fetch_optional(&mut *self.inner).await? else {
            return Ok(false);
        };
        let sql = "UPDATE bench_hold SET resumed_at = $1, resumed_by = $2, note = $3 WHERE resumed_at IS NULL AND bench_name = $4";
        let row = sqlx::query(sql).bind(now.unix_ms()).bind(by).bind(note);
        row.bind(&*self.store.bench.name).execute(&mut *self.inner).await?;
        let mut said =
            serde_json::json!({ "action": "resume", "by": by, "note": note, "held": held(&open)? });
        self.name_bench(&mut said);
        self.audit_at_bench(About { weighing: None, kind: "person" }, &said, now).await?;
        self.emit(BENCH_TOPIC, "resumed", &said).await?;
        Ok(true)
    }
}

fn held(row: &AnyRow) -> Result<Held> {
    Ok(Held { at: row.time("at")?, reason: row.plain("reason")?, by: row.plain("held_by")? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{now, testing};

    #[tokio::test]
    async fn a_hold_keeps_its_first_reason_and_outlives_the_process_until_a_person_resumes() {
        let folder = tempfile::tempdir().unwrap();
        let store = testing::open(folder.path()).await.unwrap();
        let first = Held { at: now(), reason: "stop".into(), by: Some("Ada".into()) };
        let mut tx = store.write().await.unwrap();
        assert!(!tx.resume_bench("Ada", "", now()).await.unwrap());
        tx.hold_bench(&first).await.unwrap();
        tx.hold_bench(&Held { reason: "again".into(), ..first.clone() }).await.unwrap();
        tx.commit().await.unwrap();
        store.close().await;
        drop(store);
        let store = testing::open(folder.path()).await.unwrap();
        assert_eq!(store.held().await.unwrap(), Some(first));
        let mut tx = store.write().await.unwrap();
        assert!(tx.resume_bench("Ada", "vial exchanged", now()).await.unwrap());
        tx.commit().await.unwrap();
        assert_eq!(
            (store.held().await.unwrap(), store.verify_audit(None).await.unwrap().records),
            (None, 4)
        );
    }
}
