//! Jobs: long computations that are queued, watched, cancelled and resumed.

use super::device::Device;
use serde::{Deserialize, Serialize};
use std::time::Duration;

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
    /// The grains of a weighing's spoonful, made again.
    Film,
}

impl JobKind {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Calibration,
        Self::Training,
        Self::Evaluation,
        Self::Investigation,
        Self::Repose,
        Self::Film,
    ];
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

/// What a job is about, and what it computes on.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Subject {
    /// Ids of its powders, in the order of the request, each once.
    #[serde(default)]
    pub powders: Vec<String>,
    /// The policy that it tests.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub policy: Option<String>,
    /// The angle of repose that it aims at, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repose_deg: Option<f64>,
    /// What it computes on; omitted for the processor.
    #[serde(default, skip_serializing_if = "Device::is_cpu")]
    pub device: Device,
}

/// Share of the work that has to be done before its pace says how long the rest takes: the first
/// steps are often unlike the others.
const SHARE_MIN: f64 = 0.05;

/// Time left at the pace so far, s: `done` of the work took `elapsed`, `left` of it remains. `None`
/// until enough is done.
pub fn seconds_left(done: f64, left: f64, elapsed: Duration) -> Option<f64> {
    let left = left.max(0.0);
    let enough = done > 0.0 && done >= SHARE_MIN * (done + left);
    enough.then(|| elapsed.as_secs_f64() * left / done)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_left_follows_the_pace_so_far() {
        assert_eq!(seconds_left(0.25, 0.75, Duration::from_secs(10)), Some(30.0));
        assert_eq!(seconds_left(0.0, 1.0, Duration::from_secs(10)), None);
        assert_eq!(seconds_left(0.04, 0.96, Duration::from_secs(10)), None, "a wild guess");
        assert_eq!(seconds_left(0.5, 0.0, Duration::from_secs(10)), Some(0.0));
    }
}
