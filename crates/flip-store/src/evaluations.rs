//! Results of evaluations.

use super::row::{Columns, json};
use super::{Result, Store, Tx};
use flip_core::domain::conditions::Under;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

/// Errors of one controller in one cell of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EvaluationRow {
    /// `policy`, `untrained`, `fixed`, `schedule`, `dispenser`, `pid`,
    /// `fuzzy` or `paced`.
    pub controller: String,
    /// Powder id.
    pub powder: String,
    /// Target mass, mg.
    pub target_mg: f64,
    /// Number of weighings.
    pub n: u32,
    /// Mean absolute error, mg.
    pub mae_mg: f64,
    /// Standard deviation of the absolute error, mg.
    pub sd_mg: f64,
    /// Mean signed error, mg; positive is too much.
    pub bias_mg: f64,
    /// Share of weighings more than 1 mg above the target.
    pub over_share: f64,
    /// Share of weighings that dispensed nothing.
    pub zero_share: f64,
    /// Mean number of shakes.
    pub shakes_mean: f64,
    /// Mean bench time of a weighing, s; absent from older evaluations.
    #[serde(default)]
    pub seconds_mean: Option<f64>,
}

/// Errors of one controller over all cells of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EvaluationSummary {
    /// `policy`, `untrained`, `fixed`, `schedule`, `dispenser`, `pid`,
    /// `fuzzy` or `paced`.
    pub controller: String,
    /// Mean absolute error, mg.
    pub mae_mg: f64,
    /// 95 % confidence interval of the mean absolute error, mg: lower and upper end.
    pub ci95: [f64; 2],
    /// Standard deviation of the absolute error over all weighings, mg.
    pub sd_trials_mg: f64,
    /// Mean over the cells of the standard deviation within each, mg.
    pub sd_within_cells_mg: f64,
    /// Mean signed error, mg; positive is too much. This and the following fields are absent from
    /// older evaluations.
    #[serde(default)]
    pub bias_mg: Option<f64>,
    /// Share of weighings more than 1 mg above the target.
    #[serde(default)]
    pub over_share: Option<f64>,
    /// Share of weighings that dispensed nothing.
    #[serde(default)]
    pub zero_share: Option<f64>,
    /// Mean number of shakes.
    #[serde(default)]
    pub shakes_mean: Option<f64>,
    /// Mean bench time of a weighing, s.
    #[serde(default)]
    pub seconds_mean: Option<f64>,
}

impl Store {
    /// The doses of an evaluation stored so far, by key.
    pub async fn doses<T: DeserializeOwned>(&self, evaluation: &str) -> Result<HashMap<String, T>> {
        let rows = sqlx::query("SELECT key, body FROM dose WHERE job = $1")
            .bind(evaluation)
            .fetch_all(&self.reader);
        rows.await?.iter().map(|row| Ok((row.plain("key")?, row.json("body")?))).collect()
    }
}

impl Tx {
    /// Store a dose. The key rejects one that is already stored.
    pub async fn insert_dose(
        &mut self,
        evaluation: &str,
        key: &str,
        dose: &impl Serialize,
    ) -> Result<()> {
        let sql = "INSERT INTO dose (job, key, body) VALUES ($1, $2, $3)";
        sqlx::query(sql)
            .bind(evaluation)
            .bind(key)
            .bind(json(dose)?)
            .execute(&mut *self.inner)
            .await?;
        Ok(())
    }

    /// Store a row of an evaluation. `policy` is the policy the row counts for, in weighings under
    /// this version; `None` for other controllers and unusual conditions.
    pub async fn insert_evaluation_row(
        &mut self,
        evaluation: &str,
        position: u32,
        policy: Option<&str>,
        under: Option<&Under>,
        row: &EvaluationRow,
    ) -> Result<()> {
        let sql = "INSERT INTO evaluation_row \
                   (evaluation, position, policy, powder, n, mae_mg, body, under) \
                   VALUES ($1, $2, $3, $4, $5, $6, $7, $8)";
        sqlx::query(sql)
            .bind(evaluation)
            .bind(i64::from(position))
            .bind(policy)
            .bind(&row.powder)
            .bind(i64::from(row.n))
            .bind(row.mae_mg)
            .bind(json(row)?)
            .bind(under.map(json).transpose()?)
            .execute(&mut *self.inner)
            .await?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_of_before_the_rates_were_kept_still_read() {
        let old = r#"{"controller":"fixed","mae_mg":2.0,"ci95":[1.0,3.0],"sd_trials_mg":1.0,"sd_within_cells_mg":1.0}"#;
        let summary: EvaluationSummary = serde_json::from_str(old).unwrap();
        assert_eq!((summary.mae_mg, summary.bias_mg, summary.seconds_mean), (2.0, None, None));
        let old = r#"{"controller":"fixed","powder":"salt","target_mg":15.0,"n":5,"mae_mg":2.0,"sd_mg":1.0,"bias_mg":0.0,
            "over_share":0.2,"zero_share":0.0,"shakes_mean":4.0}"#;
        let row: EvaluationRow = serde_json::from_str(old).unwrap();
        assert_eq!((row.shakes_mean, row.seconds_mean), (4.0, None));
    }
}
