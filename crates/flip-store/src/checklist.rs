//! What a person checks before a dose.

use super::row::Columns;
use super::{Result, Store, Tx, now};
use flip_core::domain::timestamp::Timestamp;

/// A lab's own checklist.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredChecklist {
    /// What to check, in order.
    pub items: Vec<String>,
    /// When it was written.
    pub changed_at: Timestamp,
}

impl Store {
    /// The newest checklist; `None` if the lab has written none.
    pub async fn checklist(&self) -> Result<Option<StoredChecklist>> {
        let row = sqlx::query("SELECT * FROM checklist ORDER BY seq DESC LIMIT 1")
            .fetch_optional(&self.reader)
            .await?;
        row.map(|row| {
            Ok(StoredChecklist { items: row.json("items")?, changed_at: row.time("changed_at")? })
        })
        .transpose()
    }
}

impl Tx {
    /// Replace the checklist.
    pub async fn change_checklist(&mut self, items: &[String]) -> Result<()> {
        let (now, items) = (now(), serde_json::json!(items));
        sqlx::query("INSERT INTO checklist (items, changed_at) VALUES ($1, $2)")
            .bind(items.to_string())
            .bind(now.unix_ms())
            .execute(&mut *self.inner)
            .await?;
        let details = serde_json::json!({ "checklist": items });
        self.audit_deed(None, "change checklist", details, now).await
    }
}
