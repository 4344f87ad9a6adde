//! Results of evaluations.

use serde::{Deserialize, Serialize};

/// Errors of one controller in one cell of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct EvaluationRow {
    /// `policy`, `untrained`, `fixed` or `schedule`.
    pub controller: String,
    /// Powder id.
    pub powder: String,
    /// Target mass, mg.
    pub target_mg: f64,
    /// Number of weighings.
    pub n: u32,
    /// Mean absolute error, mg.
    pub mae_mg: f64,
    /// Standard deviation of the signed error, mg.
    pub sd_mg: f64,
    /// Mean signed error, mg; positive is too much.
    pub bias_mg: f64,
    /// Share of weighings above the target.
    pub over_share: f64,
    /// Share of weighings that dispensed nothing.
    pub zero_share: f64,
    /// Mean number of shakes.
    pub shakes_mean: f64,
}

/// Errors of one controller over all cells of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct EvaluationSummary {
    /// `policy`, `untrained`, `fixed` or `schedule`.
    pub controller: String,
    /// Mean absolute error, mg.
    pub mae_mg: f64,
    /// 95 % confidence interval of the mean absolute error, mg: lower and upper end.
    pub ci95: [f64; 2],
    /// Standard deviation of the absolute error over all weighings, mg.
    pub sd_trials_mg: f64,
    /// Standard deviation within cells, pooled, mg.
    pub sd_within_cells_mg: f64,
}
