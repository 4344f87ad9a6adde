//! Jobs: long computations that are queued, watched, cancelled and resumed.

use serde::{Deserialize, Serialize};

/// What a job computes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobKind {
    /// Flowability to parameter sets.
    Calibration,
    /// Parameter sets to a policy.
    Training,
    /// A policy's errors on the simulated bench.
    Evaluation,
    /// Measured angles to what the simulator gets wrong.
    Investigation,
    /// Piles under a camera to an angle of repose.
    Repose,
}

/// Where a job stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// Waits for a worker.
    Queued,
    /// A worker holds its lease.
    Running,
    /// Done; the result is stored.
    Succeeded,
    /// Gave up; the error says why.
    Failed,
    /// Ended on request.
    Cancelled,
}

impl JobState {
    /// Nothing more will happen to the job.
    pub fn is_terminal(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed | Self::Cancelled)
    }
}

/// How far a job is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Progress {
    /// 0 to 1.
    pub fraction: f64,
    /// What it is doing, for people: `trial 12, 4 of 10 sets`.
    pub message: String,
}
