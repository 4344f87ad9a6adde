//! Jobs: long computations that are queued, watched, cancelled and resumed.

use serde::{Deserialize, Serialize};

/// Kind of job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JobKind {
    /// From a measured flowability to parameter sets.
    Calibration,
    /// From parameter sets to a policy.
    Training,
    /// Measures a policy's errors on the simulated bench.
    Evaluation,
    /// Finds from measured angles what the simulator gets wrong.
    Investigation,
    /// From camera frames of piles to an angle of repose.
    Repose,
}

/// State of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// Waiting for a worker.
    Queued,
    /// Running; a worker holds its lease.
    Running,
    /// Done; the result is stored.
    Succeeded,
    /// Failed; the error states the reason.
    Failed,
    /// Cancelled on request.
    Cancelled,
}

impl JobState {
    /// Whether the job has ended for good.
    pub fn is_terminal(self) -> bool {
        matches!(self, Self::Succeeded | Self::Failed | Self::Cancelled)
    }
}

/// Progress of a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// 0 to 1.
    pub fraction: f64,
    /// Current activity in readable form, e.g. `trial 12, 4 of 10 sets`.
    pub message: String,
}
