//! Measurements of powders other than the angle of repose.

use super::page::{Page, Window};
use super::row::{Columns, json};
use super::{Result, Store, Tx, new_id, now};
use flip_core::domain::observable::{Observable, Observation};
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::sqlite::SqliteRow;

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
    /// When it was registered.
    pub created_at: Timestamp,
}

impl Store {
    /// Observations of a powder, oldest first.
    pub async fn observations(
        &self,
        powder: &str,
        window: Window,
    ) -> Result<Page<PowderObservation>> {
        let rows = sqlx::query(
            "SELECT * FROM observation WHERE powder = ?1 AND seq > ?2 ORDER BY seq LIMIT ?3",
        )
        .bind(powder)
        .bind(window.after())
        .bind(window.rows())
        .fetch_all(&self.reader)
        .await?;
        window.page_of(&rows, observation)
    }

    /// Every observation, oldest first; of one powder if given.
    pub async fn all_observations(&self, powder: Option<&str>) -> Result<Vec<PowderObservation>> {
        let sql = "SELECT * FROM observation WHERE ?1 IS NULL OR powder = ?1 ORDER BY seq";
        sqlx::query(sql)
            .bind(powder)
            .fetch_all(&self.reader)
            .await?
            .iter()
            .map(observation)
            .collect()
    }

    /// Observations after a position, oldest first, at most a few thousand, and the position of the
    /// last one; of one powder if given.
    pub async fn observations_after(
        &self,
        powder: Option<&str>,
        after: i64,
    ) -> Result<(Vec<PowderObservation>, i64)> {
        let sql = "SELECT * FROM observation WHERE seq > ?2 AND (?1 IS NULL OR powder = ?1) ORDER BY seq LIMIT ?3";
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
        source: &str,
    ) -> Result<PowderObservation> {
        let sql = "INSERT INTO observation (id, powder, body, source, created_at) VALUES (?1, ?2, ?3, ?4, ?5) RETURNING *";
        let row = sqlx::query(sql)
            .bind(new_id())
            .bind(powder)
            .bind(json(observed)?)
            .bind(source)
            .bind(now().unix_ms())
            .fetch_one(&mut *self.inner)
            .await?;
        observation(&row)
    }
}

fn observation(row: &SqliteRow) -> Result<PowderObservation> {
    let Observation { observable, mean, sd, n } = row.json("body")?;
    Ok(PowderObservation {
        id: row.plain("id")?,
        powder: row.plain("powder")?,
        observable,
        mean,
        sd,
        n,
        source: row.plain("source")?,
        created_at: row.time("created_at")?,
    })
}
