//! Jobs: long computations that are queued, watched, cancelled and resumed.

use serde::{Deserialize, Serialize};

/// Kind of job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobKind {
    /// From a flowability to parameter sets.
    Calibration,
    /// From parameter sets to a policy.
    Training,
    /// A policy's errors on the simulated bench.
    Evaluation,
    /// From measured angles to what the simulator gets wrong.
    Investigation,
    /// From piles under a camera to an angle of repose.
    Repose,
}

/// State of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// Waiting for a worker.
    Queued,
    /// Running; a worker holds its lease.
    Running,
    /// Done; the result is stored.
    Succeeded,
    /// Failed; the error gives the reason.
    Failed,
    /// Cancelled on request.
    Cancelled,
}

impl JobState {
    /// Nothing more will happen to the job.
    pub fn is_terminal(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed | Self::Cancelled)
    }
}

/// Progress of a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Progress {
    /// 0 to 1.
    pub fraction: f64,
    /// Current activity, for people: `trial 12, 4 of 10 sets`.
    pub message: String,
}
