//! Jobs and events.

use super::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A job.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Job {
    /// Id; a calibration, training, evaluation, investigation or measurement of the angle of repose
    /// has the id of its job.
    pub id: String,
    /// What it computes.
    pub kind: JobKind,
    /// Its state.
    pub state: JobState,
    /// Its progress.
    pub progress: Progress,
    /// How often a worker has started or resumed it.
    pub attempts: u32,
    /// A cancellation was requested and has not been carried out yet.
    pub cancelling: bool,
    /// When it was created.
    pub created_at: Timestamp,
    /// When a worker first started it.
    pub started_at: Option<Timestamp>,
    /// When it ended.
    pub finished_at: Option<Timestamp>,
    /// Why it failed, or why its last attempt did.
    pub error: Option<String>,
}

answer! { flip_store::jobs::Job => Job {
    id, kind, state, progress, attempts, cancelling, created_at, started_at, finished_at, error,
} }

/// An event of a job or a weighing, or a choice of the current simulator.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Event {
    /// Position in the order of all events; the `id:` of a server-sent event.
    pub seq: i64,
    /// `job:<id>`, `weighing:<id>`, `simulator` or `bench`.
    pub topic: String,
    /// `state`, `progress`, `trial`, `episode` or `checkpoint_lost` of a job; `state` or `tick` of
    /// a weighing; `current` of the simulator; `latched` or `cleared` of the bench.
    pub kind: String,
    /// Contents; the fields depend on the kind.
    #[schema(value_type = Object)]
    pub data: serde_json::Value,
    /// When.
    pub at: Timestamp,
}

answer! { flip_store::events::Event => Event { seq, topic, kind, data, at } }

/// Kind of job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
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

answer! { flip_core::domain::job::JobKind => enum JobKind {
    Calibration, Training, Evaluation, Investigation, Repose,
} }
request! { enum JobKind => flip_core::domain::job::JobKind {
    Calibration, Training, Evaluation, Investigation, Repose,
} }

/// State of a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
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

answer! { flip_core::domain::job::JobState => enum JobState {
    Queued, Running, Succeeded, Failed, Cancelled,
} }
request! { enum JobState => flip_core::domain::job::JobState {
    Queued, Running, Succeeded, Failed, Cancelled,
} }

/// Progress of a job.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Progress {
    /// 0 to 1.
    pub fraction: f64,
    /// Current activity in readable form, e.g. `trial 12, 4 of 10 sets`.
    pub message: String,
}

answer! { flip_core::domain::job::Progress => Progress { fraction, message } }
