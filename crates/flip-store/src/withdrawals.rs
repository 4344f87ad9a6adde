//! Measurements and observations that no longer count. Their rows stay, with the reason beside them.

use super::observations::PowderObservation;
use super::powders::Measurement;
use super::row::Columns;
use super::who::Who;
use super::{Result, Store, Tx, now};
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use sqlx::any::AnyRow;

/// Why a measurement no longer counts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Withdrawn {
    /// When it was withdrawn.
    pub at: Timestamp,
    /// By whom, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
    /// The reason given.
    pub reason: String,
    /// Id of the corrected measurement that took its place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub replaced_by: Option<String>,
}

impl Store {
    /// Every measurement there ever was, withdrawn ones too, oldest first.
    pub async fn ever_measured(&self) -> Result<Vec<Measurement>> {
        let rows = sqlx::query("SELECT * FROM measurement_all ORDER BY seq");
        let rows = rows.fetch_all(&self.reader).await?;
        rows.iter().map(super::powders::measurement).collect()
    }

    /// Every observation there ever was, withdrawn ones too, oldest first.
    pub async fn ever_observed(&self) -> Result<Vec<PowderObservation>> {
        let rows = sqlx::query("SELECT * FROM observation_all ORDER BY seq");
        let rows = rows.fetch_all(&self.reader).await?;
        rows.iter().map(super::observations::observation).collect()
    }
}

impl Tx {
    /// A measurement of a powder, if it exists.
    pub async fn measurement(&mut self, powder: &str, id: &str) -> Result<Option<Measurement>> {
        let query = sqlx::query("SELECT * FROM measurement_all WHERE powder = $1 AND id = $2");
        let row = query.bind(powder).bind(id).fetch_optional(&mut *self.inner).await?;
        row.as_ref().map(super::powders::measurement).transpose()
    }

    /// An observation of a powder, if it exists.
    pub async fn observation(
        &mut self,
        powder: &str,
        id: &str,
    ) -> Result<Option<PowderObservation>> {
        let query = sqlx::query("SELECT * FROM observation_all WHERE powder = $1 AND id = $2");
        let row = query.bind(powder).bind(id).fetch_optional(&mut *self.inner).await?;
        row.as_ref().map(super::observations::observation).transpose()
    }

    /// Withdraw a measurement or an observation that counts.
    pub async fn withdraw(
        &mut self,
        id: &str,
        reason: &str,
        replaced_by: Option<&str>,
    ) -> Result<Withdrawn> {
        let by = Who::now().map(|who| who.name);
        let sql = "INSERT INTO withdrawal (id, reason, replaced_by, at, by) VALUES ($1, $2, $3, $4, $5) \
                   RETURNING at AS withdrawn_at, by AS withdrawn_by, reason, replaced_by";
        let row = sqlx::query(sql)
            .bind(id)
            .bind(reason)
            .bind(replaced_by)
            .bind(now().unix_ms())
            .bind(by)
            .fetch_one(&mut *self.inner)
            .await?;
        match withdrawn(&row)? {
            Some(withdrawn) => Ok(withdrawn),
            None => Err(super::Error::Corrupt("a withdrawal has no time".to_owned())),
        }
    }
}

/// Why the measurement or observation of this row no longer counts; `None` if it does.
pub(super) fn withdrawn(row: &AnyRow) -> Result<Option<Withdrawn>> {
    let Some(at) = row.maybe_time("withdrawn_at")? else { return Ok(None) };
    Ok(Some(Withdrawn {
        at,
        by: row.plain("withdrawn_by")?,
        reason: row.plain("reason")?,
        replaced_by: row.plain("replaced_by")?,
    }))
}

/// What the record says of a withdrawal.
pub fn said(id: &str, withdrawn: &Withdrawn) -> Value {
    json!({ "id": id, "reason": withdrawn.reason, "replaced_by": withdrawn.replaced_by, "at": withdrawn.at })
}
