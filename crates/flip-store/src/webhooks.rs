//! Addresses that are told of ends, and how far each has been told.

use super::row::Columns;
use super::{Result, Store, Tx, now};
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;

/// An address that is told of ends.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Webhook {
    /// Id: `wh-…`.
    pub id: String,
    /// Where messages go.
    pub url: String,
    /// When it was added.
    pub created_at: Timestamp,
    /// Since when messages fail; absent while they arrive.
    pub failing_since: Option<Timestamp>,
    /// Why the last message failed.
    pub error: Option<String>,
}

/// A webhook with what its messages need.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WebhookRow {
    pub webhook: Webhook,
    pub secret: Vec<u8>,
    /// The last event that it needs no message of.
    pub seq: i64,
}

fn read(row: &AnyRow) -> Result<WebhookRow> {
    let webhook = Webhook {
        id: row.plain("id")?,
        url: row.plain("url")?,
        created_at: row.time("created_at")?,
        failing_since: row.maybe_time("failing_since")?,
        error: row.plain("error")?,
    };
    Ok(WebhookRow { webhook, secret: row.plain("secret")?, seq: row.plain("seq")? })
}

impl Store {
    /// Every webhook, the oldest first.
    pub async fn webhooks(&self) -> Result<Vec<WebhookRow>> {
        let rows = sqlx::query("SELECT * FROM webhook ORDER BY created_at, id")
            .fetch_all(&self.reader)
            .await?;
        rows.iter().map(read).collect()
    }
}

impl Tx {
    /// Add a webhook, which is told what follows the newest event.
    pub async fn insert_webhook(&mut self, new: &Webhook, secret: &[u8]) -> Result<()> {
        sqlx::query(
            "INSERT INTO webhook (id, url, secret, created_at, seq)
             VALUES ($1, $2, $3, $4, (SELECT coalesce(max(seq), 0) FROM event))",
        )
        .bind(&new.id)
        .bind(&new.url)
        .bind(secret)
        .bind(new.created_at.unix_ms())
        .execute(&mut *self.inner)
        .await?;
        let said = serde_json::json!({ "webhook": { "id": new.id, "url": new.url } });
        self.audit_deed(None, "new webhook", said, now()).await
    }

    /// Remove a webhook. `false`: there is none.
    pub async fn remove_webhook(&mut self, id: &str) -> Result<bool> {
        let done = sqlx::query("DELETE FROM webhook WHERE id = $1")
            .bind(id)
            .execute(&mut *self.inner)
            .await?;
        if done.rows_affected() == 0 {
            return Ok(false);
        }
        let said = serde_json::json!({ "webhook": { "id": id } });
        self.audit_deed(None, "remove webhook", said, now()).await?;
        Ok(true)
    }

    /// Note that a webhook needs no message of events up to `seq`.
    pub async fn webhook_told(&mut self, id: &str, seq: i64) -> Result<()> {
        sqlx::query(
            "UPDATE webhook SET seq = $2, failing_since = NULL, error = NULL WHERE id = $1",
        )
        .bind(id)
        .bind(seq)
        .execute(&mut *self.inner)
        .await?;
        Ok(())
    }

    /// Note that a message failed, and why.
    pub async fn webhook_failed(&mut self, id: &str, why: &str) -> Result<()> {
        sqlx::query(
            "UPDATE webhook SET failing_since = coalesce(failing_since, $2), error = $3 WHERE id = $1",
        )
        .bind(id)
        .bind(now().unix_ms())
        .bind(why)
        .execute(&mut *self.inner)
        .await?;
        Ok(())
    }
}
