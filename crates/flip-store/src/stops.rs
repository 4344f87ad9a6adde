//! Who stopped a weighing: as the record has it.

use super::row::Columns;
use super::{Result, Store};
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};

/// A person's stop of a weighing.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stopped {
    /// When.
    pub at: Timestamp,
    /// By whom: the name of the token; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
}

impl Store {
    /// The first stop of a weighing by a person.
    pub async fn stop_of(&self, weighing: &str) -> Result<Option<Stopped>> {
        let sql = "SELECT at, body ->> '$.who.name' AS by FROM audit WHERE weighing = $1 \
                   AND kind = 'person' AND body ->> '$.action' = 'stop' ORDER BY seq LIMIT 1";
        let row = sqlx::query(sql).bind(weighing).fetch_optional(&self.reader).await?;
        row.map(|row| Ok(Stopped { at: row.time("at")?, by: row.plain("by")? })).transpose()
    }
}
