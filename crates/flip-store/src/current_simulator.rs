//! The version of the simulator used where none is given.

use super::row::Columns;
use super::{Result, Store, Tx, now};
use flip_core::domain::timestamp::Timestamp;
use serde::Serialize;
use sqlx::any::AnyRow;

/// Topic of the event emitted by a choice.
pub const SIMULATOR_TOPIC: &str = "simulator";

/// A choice; `None` is the base.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// Version.
    pub version: Option<String>,
    /// When it was made.
    pub chosen_at: Timestamp,
    /// Why, if anyone said so.
    pub reason: Option<String>,
}

/// Contents of the event of a choice.
#[derive(Serialize)]
struct Chosen<'a> {
    version: Option<&'a str>,
    before: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<&'a str>,
}

impl Store {
    /// The latest choice, and the one before it; empty if there has been none.
    pub async fn simulator_choices(&self) -> Result<Vec<Choice>> {
        let rows = sqlx::query("SELECT * FROM current_simulator ORDER BY seq DESC LIMIT 2")
            .fetch_all(&self.reader);
        rows.await?.iter().map(choice).collect()
    }
}

impl Tx {
    /// Choose an existing version, or the base, for this reason. Choosing the current version
    /// changes nothing.
    pub async fn choose_simulator(
        &mut self,
        version: Option<&str>,
        reason: Option<&str>,
    ) -> Result<()> {
        let newest = "SELECT * FROM current_simulator ORDER BY seq DESC LIMIT 1";
        let newest = sqlx::query(newest)
            .fetch_optional(&mut *self.inner)
            .await?
            .as_ref()
            .map(choice)
            .transpose()?;
        let before = newest.and_then(|newest| newest.version);
        if before.as_deref() == version {
            return Ok(());
        }
        let sql = "INSERT INTO current_simulator (version, chosen_at, reason) VALUES ($1, $2, $3)";
        sqlx::query(sql)
            .bind(version)
            .bind(now().unix_ms())
            .bind(reason)
            .execute(&mut *self.inner)
            .await?;
        let chosen = Chosen { version, before: before.as_deref(), reason };
        self.audit_deed(
            None,
            "choose simulator",
            serde_json::json!({ "simulator": chosen }),
            now(),
        )
        .await?;
        self.emit(SIMULATOR_TOPIC, "current", &chosen).await
    }
}

fn choice(row: &AnyRow) -> Result<Choice> {
    Ok(Choice {
        version: row.plain("version")?,
        chosen_at: row.time("chosen_at")?,
        reason: row.plain("reason")?,
    })
}
