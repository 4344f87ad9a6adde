//! Evaluations: a policy's errors on the simulated bench, beside those of simple controllers.

use super::{App, Result};
use crate::store::evaluations::{EvaluationRow, EvaluationSummary};
use crate::store::jobs::Job;
use crate::store::page::{Page, PageQuery};
use serde::{Deserialize, Serialize};

/// What to evaluate. Everything has a default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EvaluationRequest {
    /// Policy id; default the newest.
    pub policy: Option<String>,
    /// Some of `policy`, `untrained`, `fixed`, `schedule`; default all.
    pub controllers: Option<Vec<String>>,
    /// Powder ids; default the five published ones.
    pub powders: Option<Vec<String>>,
    /// Targets, mg, each within what the spoon holds; default 15 and 20.
    pub targets_mg: Option<Vec<f64>>,
    /// Weighings in a cell, 1 to 100; default 5.
    pub repeats: Option<u32>,
    /// Step of the balance's display, 0.01 to 10 mg; default 1.
    pub readability_mg: Option<f64>,
    /// Steps of a weighing, 1 to 100; default 10.
    pub max_shakes: Option<u32>,
    /// Seed; default 1.
    pub seed: Option<u64>,
}

/// An evaluation: its job, what it runs, and once it has succeeded the errors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Evaluation {
    /// The job; the evaluation has the same id.
    pub job: Job,
    /// Policy id.
    pub policy: String,
    /// Controllers compared.
    pub controllers: Vec<String>,
    /// Powder ids.
    pub powders: Vec<String>,
    /// Targets, mg.
    pub targets_mg: Vec<f64>,
    /// Weighings in a cell.
    pub repeats: u32,
    /// Step of the balance's display, mg.
    pub readability_mg: f64,
    /// Steps of a weighing.
    pub max_shakes: u32,
    /// Seed.
    pub seed: u64,
    /// The errors; absent until it has succeeded.
    pub result: Option<EvaluationResult>,
}

/// What an evaluation found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct EvaluationResult {
    /// One row for each controller, powder and target.
    pub rows: Vec<EvaluationRow>,
    /// One row for each controller.
    pub summary: Vec<EvaluationSummary>,
}

impl App {
    /// Queue an evaluation. `false`: the same one was asked for before, and this is its job.
    pub async fn start_evaluation(&self, _request: EvaluationRequest) -> Result<(Job, bool)> {
        self.stub()
    }

    /// One evaluation.
    pub async fn evaluation(&self, _id: &str) -> Result<Evaluation> {
        self.stub()
    }

    /// Evaluations, newest first.
    pub async fn evaluations(&self, _page: PageQuery) -> Result<Page<Evaluation>> {
        self.stub()
    }
}
