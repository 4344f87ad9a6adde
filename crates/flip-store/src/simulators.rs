//! Versions of the simulator made by investigations.

use super::labels::shown;
use super::page::{Page, Window};
use super::row::Columns;
use super::{Result, Store, Tx, now};
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;

/// A version of the simulator: its base, its extensions, and their origin. Never changes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SimulatorVersion {
    /// `sv-` and 16 hexadecimal digits of the SHA-256 of its inputs: campaign, settings and base.
    pub id: String,
    /// The version that it extends.
    pub base: String,
    /// The investigation that made it.
    pub investigation: String,
    /// Causes with fitted parameters, their benefit on held-out days, and whether simulations
    /// confirmed it.
    pub body: serde_json::Value,
    /// When it was stored.
    pub created_at: Timestamp,
}

impl Store {
    /// Versions, newest first.
    pub async fn simulators(&self, window: Window) -> Result<Page<SimulatorVersion>> {
        let sql = concat!(
            "SELECT * FROM simulator_version WHERE seq < $1 AND ",
            shown!("'simulator'", "simulator_version.id", "$3", "$4"),
            " ORDER BY seq DESC LIMIT $2"
        );
        window.page_of(&self.rows_shown(sql, &window).await?, version)
    }

    /// One version.
    pub async fn simulator(&self, id: &str) -> Result<Option<SimulatorVersion>> {
        let sql = "SELECT * FROM simulator_version WHERE id = $1";
        sqlx::query(sql)
            .bind(id)
            .fetch_optional(&self.reader)
            .await?
            .as_ref()
            .map(version)
            .transpose()
    }
}

impl Tx {
    /// Store a version; an existing one is left unchanged.
    pub async fn insert_simulator(
        &mut self,
        id: &str,
        base: &str,
        investigation: &str,
        body: &str,
    ) -> Result<()> {
        let sql = "INSERT INTO simulator_version (id, base, investigation, body, created_at) \
                   VALUES ($1, $2, $3, $4, $5) ON CONFLICT (id) DO NOTHING";
        let query = sqlx::query(sql)
            .bind(id)
            .bind(base)
            .bind(investigation)
            .bind(body)
            .bind(now().unix_ms());
        query.execute(&mut *self.inner).await?;
        Ok(())
    }
}

fn version(row: &AnyRow) -> Result<SimulatorVersion> {
    Ok(SimulatorVersion {
        id: row.plain("id")?,
        base: row.plain("base")?,
        investigation: row.plain("investigation")?,
        body: row.json("body")?,
        created_at: row.time("created_at")?,
    })
}
