//! Calibrated parameter sets.

use super::page::{Page, Window};
use super::row::{Columns, json};
use super::sql::Number;
use super::{Result, Store, Tx, now};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;

/// A parameter set kept by a calibration: the simulated twin of a powder. Never changes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CalibratedSet {
    /// Content address: `ps-` and 16 hexadecimal digits.
    pub id: String,
    /// Powder id; absent for a calibration to a bare angle.
    pub powder: Option<String>,
    /// The calibration that produced it.
    pub calibration: String,
    /// The nine values.
    pub parameters: ParameterSet,
    /// Mean simulated angle of repose over its runs, degrees.
    pub repose_deg: f64,
    /// Standard deviation over its runs, degrees; absent for a single run.
    pub repose_sd_deg: Option<f64>,
    /// Number of simulations behind the mean.
    pub runs: u32,
    /// Simulated minus measured angle, absolute, degrees.
    pub error_deg: f64,
    /// The extended version of the simulator at whose reference conditions it piles at this angle;
    /// absent for the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub simulator: Option<String>,
    /// When it was stored.
    pub created_at: Timestamp,
}

/// A set to be stored by a calibration.
#[derive(Debug, Clone)]
pub struct NewSet {
    pub parameters: ParameterSet,
    pub repose_deg: f64,
    pub repose_sd_deg: Option<f64>,
    pub runs: u32,
    pub error_deg: f64,
    pub simulator: Option<String>,
}

impl Store {
    /// Calibrated sets, newest first; of one powder if given.
    pub async fn parameter_sets(
        &self,
        powder: Option<&str>,
        window: Window,
    ) -> Result<Page<CalibratedSet>> {
        let query = match powder {
            Some(powder) => {
                let sql = "SELECT * FROM parameter_set WHERE powder = $3 AND seq < $1 ORDER BY seq DESC LIMIT $2";
                sqlx::query(sql).bind(window.before()).bind(window.rows()).bind(powder)
            }
            None => {
                let sql = "SELECT * FROM parameter_set WHERE seq < $1 ORDER BY seq DESC LIMIT $2";
                sqlx::query(sql).bind(window.before()).bind(window.rows())
            }
        };
        window.page_of(&query.fetch_all(&self.reader).await?, calibrated_set)
    }

    /// Sets of a powder calibrated under a version of the simulator, `None` being the base, newest
    /// first.
    pub async fn sets_under(
        &self,
        powder: &str,
        simulator: Option<&str>,
        window: Window,
    ) -> Result<Page<CalibratedSet>> {
        let sql = "SELECT * FROM parameter_set WHERE powder = $3 AND simulator IS NOT DISTINCT FROM $4 AND seq < $1 ORDER BY seq DESC LIMIT $2";
        let query =
            sqlx::query(sql).bind(window.before()).bind(window.rows()).bind(powder).bind(simulator);
        window.page_of(&query.fetch_all(&self.reader).await?, calibrated_set)
    }

    /// One calibrated set; if several calibrations kept the same values, the latest.
    pub async fn parameter_set(&self, id: &str) -> Result<Option<CalibratedSet>> {
        let row =
            sqlx::query("SELECT * FROM parameter_set WHERE id = $1 ORDER BY seq DESC LIMIT 1")
                .bind(id)
                .fetch_optional(&self.reader)
                .await?;
        row.as_ref().map(calibrated_set).transpose()
    }

    /// The sets kept by a calibration, in its order.
    pub async fn sets_of_calibration(&self, calibration: &str) -> Result<Vec<CalibratedSet>> {
        let sql = "SELECT * FROM parameter_set WHERE calibration = $1 ORDER BY position";
        sqlx::query(sql)
            .bind(calibration)
            .fetch_all(&self.reader)
            .await?
            .iter()
            .map(calibrated_set)
            .collect()
    }
}

impl Tx {
    /// Store the set that a calibration kept at `position`.
    pub async fn insert_parameter_set(
        &mut self,
        calibration: &str,
        powder: Option<&str>,
        position: u32,
        set: &NewSet,
    ) -> Result<()> {
        let sql = "INSERT INTO parameter_set \
                   (id, powder, calibration, position, parameters, repose_deg, repose_sd_deg, runs, error_deg, created_at, \
                   simulator) VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11)";
        sqlx::query(sql)
            .bind(set.parameters.id())
            .bind(powder)
            .bind(calibration)
            .bind(i64::from(position))
            .bind(json(&set.parameters)?)
            .bind(set.repose_deg)
            .bind(set.repose_sd_deg.map(Number))
            .bind(i64::from(set.runs))
            .bind(set.error_deg)
            .bind(now().unix_ms())
            .bind(&set.simulator)
            .execute(&mut *self.inner)
            .await?;
        Ok(())
    }
}

fn calibrated_set(row: &AnyRow) -> Result<CalibratedSet> {
    Ok(CalibratedSet {
        id: row.plain("id")?,
        powder: row.plain("powder")?,
        calibration: row.plain("calibration")?,
        parameters: row.json("parameters")?,
        repose_deg: row.plain("repose_deg")?,
        repose_sd_deg: row.plain("repose_sd_deg")?,
        runs: row.count("runs")?,
        error_deg: row.plain("error_deg")?,
        simulator: row.plain("simulator")?,
        created_at: row.time("created_at")?,
    })
}
