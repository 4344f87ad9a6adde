//! Piles imaged for a powder's angle of repose, with their raw frames.

use super::row::{Columns, json};
use super::{Result, Store, Tx};
use flip_core::domain::pile::{Measurement, Outline};
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;

/// One pile.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pile {
    /// Number within its measurement, from 1.
    pub number: u32,
    /// When its frames had arrived.
    pub at: Timestamp,
    /// Result from the frames; absent if they were refused.
    pub measured: Option<Measurement>,
    /// Why they were refused.
    pub refusal: Option<String>,
    /// Its raw frames, in order of arrival.
    pub frames: Vec<FrameFiles>,
    /// Where in the picture is what was measured; absent if the frames were refused, and for a pile
    /// measured before it was kept.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outline: Option<Outline>,
}

/// The three files of a frame as received, each by its SHA-256.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameFiles {
    /// A 16-bit grey PNG, or raw Z16.
    pub depth: String,
    /// An 8-bit RGB PNG.
    pub colour: String,
    /// JSON: intrinsics, unit of depth, time.
    pub description: String,
}

impl FrameFiles {
    /// A part by its name.
    pub fn part(&self, name: &str) -> Option<&str> {
        match name {
            "depth" => Some(&self.depth),
            "colour" => Some(&self.colour),
            "description" => Some(&self.description),
            _ => None,
        }
    }
}

impl Store {
    /// Piles of a measurement, in order.
    pub async fn piles(&self, job: &str) -> Result<Vec<Pile>> {
        let rows = sqlx::query("SELECT number, body FROM pile WHERE job = $1 ORDER BY number");
        rows.bind(job)
            .fetch_all(&self.reader)
            .await?
            .iter()
            .map(|row: &AnyRow| row.json("body"))
            .collect()
    }

    /// Number of camera measurements requested for a powder.
    pub async fn repose_runs(&self, powder: &str) -> Result<u32> {
        let sql = "SELECT coalesce(max(CAST(spec ->> '$.repose.run' AS BIGINT)), 0) AS runs FROM job \
                   WHERE kind = 'repose' AND spec ->> '$.repose.powder' = $1";
        sqlx::query(sql).bind(powder).fetch_one(&self.reader).await?.count("runs")
    }
}

impl Tx {
    /// Add the next pile of a measurement; its files are already stored.
    pub async fn insert_pile(&mut self, job: &str, pile: &Pile) -> Result<()> {
        let insert = sqlx::query("INSERT INTO pile (job, number, body) VALUES ($1, $2, $3)");
        insert
            .bind(job)
            .bind(i64::from(pile.number))
            .bind(json(pile)?)
            .execute(&mut *self.inner)
            .await?;
        Ok(())
    }
}
