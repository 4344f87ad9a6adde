//! Calibrations: from a flowability to parameter sets.

use super::{App, Result};
use crate::domain::parameters::ParameterSet;
use crate::domain::powder::Flowability;
use crate::store::jobs::Job;
use crate::store::page::{Page, PageQuery};
use crate::store::trials::Trial;
use serde::{Deserialize, Serialize};

/// What to calibrate: a powder, or a bare angle of repose. Everything else has a default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CalibrationRequest {
    /// Powder id; its newest automated measurement (else manual) is the target.
    pub powder: Option<String>,
    /// Target angle of repose instead of a powder, degrees.
    pub repose_deg: Option<f64>,
    /// Parameter sets to find, 1 to 50; default 10.
    pub sets: Option<u32>,
    /// Accepted difference between simulated and measured angle, 0.1 to 10 degrees; default 1.5.
    pub tolerance_deg: Option<f64>,
    /// Grains in a simulated heap, 200 to 20000; default 2000.
    pub particles: Option<u32>,
    /// Most simulations of the search, 10 to 2000; default 150.
    pub trials_max: Option<u32>,
    /// Seed; default 1.
    pub seed: Option<u64>,
}

/// A calibration: its job, what it aims at, and once it has succeeded what it found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Calibration {
    /// The job; the calibration has the same id.
    pub job: Job,
    /// Powder id; absent for a bare angle.
    pub powder: Option<String>,
    /// What it aims at.
    pub target: Flowability,
    /// Every setting of the search and of the heap experiment.
    #[schema(value_type = Object)]
    pub settings: serde_json::Value,
    /// What it found; absent until it has succeeded.
    pub result: Option<CalibrationResult>,
}

/// What a calibration found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CalibrationResult {
    /// Simulations of the search.
    pub evaluations: u32,
    /// Simulations with fresh seeds that checked candidates.
    pub verification_runs: u32,
    /// The sets it kept.
    pub sets: Vec<CalibrationSet>,
    /// Mean of the sets' errors, degrees.
    pub mean_error_deg: f64,
    /// Standard deviation of the sets' errors, degrees.
    pub sd_error_deg: f64,
}

/// One set that a calibration kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CalibrationSet {
    /// Content address of the nine values.
    pub id: String,
    /// The nine values.
    pub parameters: ParameterSet,
    /// Mean simulated angle over its runs, degrees.
    pub repose_deg: f64,
    /// Standard deviation over its runs, degrees.
    pub repose_sd_deg: f64,
    /// Simulations behind the mean.
    pub runs: u32,
    /// Absolute difference between mean and target, degrees.
    pub error_deg: f64,
}

impl App {
    /// Queue a calibration. `false`: the same one was asked for before, and this is its job.
    pub async fn start_calibration(&self, _request: CalibrationRequest) -> Result<(Job, bool)> {
        self.stub()
    }

    /// One calibration.
    pub async fn calibration(&self, _id: &str) -> Result<Calibration> {
        self.stub()
    }

    /// Calibrations, newest first.
    pub async fn calibrations(&self, _page: PageQuery) -> Result<Page<Calibration>> {
        self.stub()
    }

    /// Trials of a calibration in order; pages of up to 5000.
    pub async fn trials(&self, _calibration: &str, _page: PageQuery) -> Result<Page<Trial>> {
        self.stub()
    }
}
