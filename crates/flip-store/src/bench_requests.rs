//! What other processes ask of a bench's owner: a row, and an event that wakes it. The owner answers
//! in the row, which wakes whoever asked.

use super::bench::BENCH_TOPIC;
use super::row::{Columns, json};
use super::{Result, Store, Tx};
use flip_core::domain::timestamp::Timestamp;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// How long a request is kept after nobody may carry it out any more, ms: a day. What it did is in
/// the audit trail.
const KEPT_MS: i64 = 24 * 3600 * 1000;

/// A request to the owner of a bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BenchRequest<T> {
    /// Its id.
    pub id: String,
    /// What is asked.
    pub body: T,
    /// Later than this it is not carried out.
    pub until: Timestamp,
}

impl Store {
    /// Requests to the bench that this store speaks for that nobody has answered, oldest first.
    pub async fn open_bench_requests<T: DeserializeOwned>(&self) -> Result<Vec<BenchRequest<T>>> {
        let sql = "SELECT id, body, until FROM bench_request WHERE bench_name = $1 AND answered_at IS NULL ORDER BY seq LIMIT 100";
        let rows = sqlx::query(sql).bind(self.bench_name()).fetch_all(&self.apart).await?;
        let request = |row: &sqlx::any::AnyRow| {
            Ok(BenchRequest {
                id: row.plain("id")?,
                body: row.json("body")?,
                until: row.time("until")?,
            })
        };
        rows.iter().map(request).collect()
    }

    /// The answer to a request, if it has one.
    pub async fn bench_answer<T: DeserializeOwned>(&self, id: &str) -> Result<Option<T>> {
        let sql = "SELECT answer FROM bench_request WHERE id = $1 AND answered_at IS NOT NULL";
        let row = sqlx::query(sql).bind(id).fetch_optional(&self.apart).await?;
        row.map(|row| row.json("answer")).transpose()
    }
}

impl Tx {
    /// Ask something of the owner of the bench that the store speaks for. Those of days ago are
    /// deleted.
    pub async fn ask_bench(
        &mut self,
        request: &BenchRequest<impl Serialize>,
        now: Timestamp,
    ) -> Result<()> {
        sqlx::query("DELETE FROM bench_request WHERE until < $1")
            .bind(now.unix_ms() - KEPT_MS)
            .execute(&mut *self.inner)
            .await?;
        let sql = "INSERT INTO bench_request (id, bench_name, body, asked_at, until) VALUES ($1, $2, $3, $4, $5)";
        sqlx::query(sql)
            .bind(&request.id)
            .bind(&*self.store.bench.name)
            .bind(json(&request.body)?)
            .bind(now.unix_ms())
            .bind(request.until.unix_ms())
            .execute(&mut *self.inner)
            .await?;
        let said = self.named(&serde_json::json!({ "request": request.id }))?;
        self.emit(BENCH_TOPIC, "asked", &said).await
    }

    /// Answer a request. `false`: it has an answer already.
    pub async fn answer_bench_request(
        &mut self,
        id: &str,
        answer: &impl Serialize,
        now: Timestamp,
    ) -> Result<bool> {
        let sql = "UPDATE bench_request SET answer = $2, answered_at = $3 WHERE id = $1 AND answered_at IS NULL";
        let row = sqlx::query(sql).bind(id).bind(json(answer)?).bind(now.unix_ms());
        if row.execute(&mut *self.inner).await?.rows_affected() == 0 {
            return Ok(false);
        }
        let said = self.named(&serde_json::json!({ "request": id }))?;
        self.emit(BENCH_TOPIC, "answered", &said).await?;
        Ok(true)
    }
}
