//! Evaluations of controllers.

use super::{Conditions, Day, Device, Job, Labels, Spoon, Under, is_default};
use crate::app;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Result of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct EvaluationResult {
    /// One row for each controller, powder and target.
    pub rows: Vec<EvaluationRow>,
    /// One row for each controller.
    pub summary: Vec<EvaluationSummary>,
    /// The graphics card that it was computed on; absent for the processor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub card: Option<String>,
}

answer! { app::EvaluationResult => EvaluationResult { rows, summary, card } }

/// What to evaluate. Everything has a default.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EvaluationRequest {
    /// Policy id; default the newest, or the shipped one until a policy is trained.
    pub policy: Option<String>,
    /// Any of `policy`, `untrained`, `fixed`, `schedule`, `dispenser`, `pid`, `fuzzy`, `paced`;
    /// default all. A policy named by its id is always included.
    pub controllers: Option<Vec<String>>,
    /// Powder ids; default the five published ones.
    pub powders: Option<Vec<String>>,
    /// Target masses, mg, each within what the spoon holds; default 15 and 20.
    pub targets_mg: Option<Vec<f64>>,
    /// Weighings per powder and target, 1 to 100; default 5.
    pub repeats: Option<u32>,
    /// Readability (display step) of the balance, 0.01 to 10 mg; default 1.
    pub readability_mg: Option<f64>,
    /// Maximum steps per weighing, 1 to 100; default 10.
    pub max_shakes: Option<u32>,
    /// Grains on the spoon, 500 to 4000; default 2500, about 37 mg. Their mass is all the powder
    /// there is, so a target must lie within it.
    pub particles: Option<u32>,
    /// Mechanisms missing from the base simulator, by name with their amplitudes, as
    /// `{"rotation": 1}`; default none. No policy has met them in training.
    #[serde(default)]
    pub extensions: BTreeMap<String, f64>,
    /// Shake as the bench's arm was measured to shake (`flip bench calibrate-shake`); default as in
    /// the simulator.
    #[serde(default)]
    pub as_calibrated: bool,
    /// Substep of the simulator, 10 to 160 us; default 80. Half of it takes twice as long. Errors at
    /// another than the usual substep do not count for which policy weighs best.
    #[serde(default)]
    pub substep_us: Option<u32>,
    /// The spoon used for dosing; default FLIP's own, which holds about 40 mg.
    #[serde(default)]
    pub spoon: Option<Spoon>,
    /// What simulates: the processor, or a graphics card of this process or of a worker. A card's doses
    /// have the statistics of the processor's and other bytes, and do not count for which policy weighs
    /// best.
    #[serde(default)]
    pub device: Device,
    /// Seed; default 1.
    pub seed: Option<u64>,
    /// Extended simulator version, `sv-…`; default the base.
    #[serde(default)]
    pub simulator: Option<String>,
    /// Conditions of the version on the bench, each within the range of its campaign, as
    /// `{"relative_humidity_pct": 65}`.
    #[serde(default)]
    #[schema(value_type = std::collections::BTreeMap<String, super::Condition>)]
    pub conditions: Day,
    /// What the caller writes on it, to find it again.
    #[serde(default)]
    pub labels: Labels,
}

request! { EvaluationRequest => app::EvaluationRequest {
    policy, controllers, powders, targets_mg, repeats, readability_mg, max_shakes, particles,
    extensions, as_calibrated, substep_us, spoon, device, seed, simulator, conditions, labels,
} }

/// An evaluation: its job, its settings, and the errors once it has succeeded.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Evaluation {
    /// The job; the evaluation has the same id.
    pub job: Job,
    /// Policy id.
    pub policy: String,
    /// Controllers compared.
    pub controllers: Vec<String>,
    /// Powder ids.
    pub powders: Vec<String>,
    /// Target masses, mg.
    pub targets_mg: Vec<f64>,
    /// Weighings per powder and target.
    pub repeats: u32,
    /// Readability (display step) of the balance, mg.
    pub readability_mg: f64,
    /// Maximum steps per weighing.
    pub max_shakes: u32,
    /// What was on the spoon.
    pub conditions: Conditions,
    /// The extended simulator version and the conditions given; absent for the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub under: Option<Under>,
    /// What it simulates on; absent for the processor.
    #[serde(skip_serializing_if = "is_default")]
    pub device: Device,
    /// Seed.
    pub seed: u64,
    /// The errors; absent until it has succeeded.
    pub result: Option<EvaluationResult>,
}

answer! { app::Evaluation => Evaluation {
    job, policy, controllers, powders, targets_mg, repeats, readability_mg, max_shakes, conditions,
    under, device, seed, result,
} }

/// Errors of one controller in one cell of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
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

answer! { flip_store::evaluations::EvaluationRow => EvaluationRow {
    controller, powder, target_mg, n, mae_mg, sd_mg, bias_mg, over_share, zero_share, shakes_mean,
    seconds_mean,
} }

/// Errors of one controller over all cells of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
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

answer! { flip_store::evaluations::EvaluationSummary => EvaluationSummary {
    controller, mae_mg, ci95, sd_trials_mg, sd_within_cells_mg, bias_mg, over_share, zero_share,
    shakes_mean, seconds_mean,
} }
