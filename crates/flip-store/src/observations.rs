//! Measurements of powders other than the angle of repose.

use super::page::{Page, Window};
use super::powders::Origin;
use super::row::{Columns, json};
use super::withdrawals::{Withdrawn, withdrawn};
use super::{Result, Store, Tx, new_id, now};
use flip_core::domain::observable::{Observable, Observation};
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;

/// One registered observation of a powder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PowderObservation {
    /// Id.
    pub id: String,
    /// Powder id.
    pub powder: String,
    /// What was measured, with the settings of the experiment.
    pub observable: Observable,
    /// Mean over the repeats, in the observable's unit.
    pub mean: f64,
    /// Standard deviation over the repeats.
    pub sd: f64,
    /// Number of repeats.
    pub n: u32,
    /// Where the numbers come from.
    pub source: String,
    /// On which day it was made, as `2026-02-03`; absent if nobody said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured_on: Option<String>,
    /// When it was registered.
    pub created_at: Timestamp,
    /// Why it no longer counts; absent if it does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub withdrawn: Option<Withdrawn>,
}

impl Store {
    /// Observations of a powder, withdrawn ones too, oldest first.
    pub async fn observations(
        &self,
        powder: &str,
        window: Window,
    ) -> Result<Page<PowderObservation>> {
        let rows = sqlx::query(
            "SELECT * FROM observation_all WHERE powder = $1 AND seq > $2 ORDER BY seq LIMIT $3",
        )
        .bind(powder)
        .bind(window.after())
        .bind(window.rows())
        .fetch_all(&self.reader)
        .await?;
        window.page_of(&rows, observation)
    }

    /// Every observation that counts, oldest first; of one powder if given.
    pub async fn all_observations(&self, powder: Option<&str>) -> Result<Vec<PowderObservation>> {
        let sql = "SELECT * FROM observation_all WHERE withdrawn_at IS NULL AND ($1 IS NULL OR powder = $1) ORDER BY seq";
        sqlx::query(sql)
            .bind(powder)
            .fetch_all(&self.reader)
            .await?
            .iter()
            .map(observation)
            .collect()
    }

    /// Observations that count after a position, oldest first, at most a few thousand, and the position of the
    /// last one; of one powder if given.
    pub async fn observations_after(
        &self,
        powder: Option<&str>,
        after: i64,
    ) -> Result<(Vec<PowderObservation>, i64)> {
        let sql = "SELECT * FROM observation_all WHERE seq > $2 AND withdrawn_at IS NULL AND ($1 IS NULL OR powder = $1) ORDER BY seq LIMIT $3";
        self.batch(sql, powder, after, observation).await
    }

    /// Current observations of a powder: the latest of each equal observable, sorted by their JSON,
    /// so that the order does not depend on when they were registered.
    pub async fn observations_now(&self, powder: &str) -> Result<Vec<Observation>> {
        let mut newest: Vec<Observation> = Vec::new();
        for PowderObservation { observable, mean, sd, n, .. } in
            self.all_observations(Some(powder)).await?.into_iter().rev()
        {
            if newest.iter().all(|known| known.observable != observable) {
                newest.push(Observation { observable, mean, sd, n });
            }
        }
        let mut keyed: Vec<(String, Observation)> = newest
            .into_iter()
            .map(|known| Ok((json(&known.observable)?, known)))
            .collect::<Result<_>>()?;
        keyed.sort_by(|(a, _), (b, _)| a.cmp(b));
        Ok(keyed.into_iter().map(|(_, known)| known).collect())
    }
}

impl Tx {
    /// Add an observation of an existing powder.
    pub async fn insert_observation(
        &mut self,
        powder: &str,
        observed: &Observation,
        origin: &Origin,
    ) -> Result<PowderObservation> {
        let sql = "INSERT INTO observation (id, powder, body, source, created_at, measured_on) VALUES ($1, $2, $3, $4, $5, $6) RETURNING *, NULL AS withdrawn_at";
        let row = sqlx::query(sql)
            .bind(new_id())
            .bind(powder)
            .bind(json(observed)?)
            .bind(&origin.source)
            .bind(now().unix_ms())
            .bind(&origin.measured_on)
            .fetch_one(&mut *self.inner)
            .await?;
        observation(&row)
    }
}

pub(super) fn observation(row: &AnyRow) -> Result<PowderObservation> {
    let Observation { observable, mean, sd, n } = row.json("body")?;
    Ok(PowderObservation {
        id: row.plain("id")?,
        powder: row.plain("powder")?,
        observable,
        mean,
        sd,
        n,
        source: row.plain("source")?,
        measured_on: row.plain("measured_on")?,
        created_at: row.time("created_at")?,
        withdrawn: withdrawn(row)?,
    })
}
