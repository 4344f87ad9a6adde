//! Jobs and events.

use super::{Answer, Labels, Timestamp, is_default};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A job.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Job {
    /// Id; a calibration, training, evaluation, investigation, film or measurement of the angle of
    /// repose has the id of its job.
    pub id: String,
    /// What it computes.
    pub kind: JobKind,
    /// What it is about.
    pub subject: Subject,
    /// Its state; one that no worker computes is queued.
    pub state: JobState,
    /// Its progress.
    pub progress: Progress,
    /// Time left at the pace of the present attempt, s; absent until the pace is known, from a
    /// twentieth of the work on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left_s: Option<f64>,
    /// Its place among the jobs that wait for the same slot, 1 being the next; absent unless it
    /// waits. Calibrations, evaluations and investigations take turns; trainings and measurements by
    /// camera have slots of their own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub place: Option<u32>,
    /// How long it is expected to take once it begins, s: the median of earlier jobs like it;
    /// absent unless it waits, and if there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expected_s: Option<f64>,
    /// The failed or cancelled job that it starts again.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub again_of: Option<String>,
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
    /// What callers wrote on it.
    #[serde(default, skip_serializing_if = "is_default")]
    pub labels: Labels,
}

answer! { flip_store::jobs::Job => Job {
    id, kind, subject, state, progress, left_s, place, expected_s, again_of, attempts, cancelling, created_at,
    started_at, finished_at, error, labels,
} }

/// How long jobs of one sort took on this machine: those that succeeded at the first attempt.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct JobTimes {
    /// Their kind.
    pub kind: JobKind,
    /// The search method, of calibrations.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub method: Option<String>,
    /// How many of them: the last fifty at most.
    pub n: u32,
    /// First quartile, s.
    pub lower_s: f64,
    /// Median, s.
    pub median_s: f64,
    /// Third quartile, s.
    pub upper_s: f64,
}

impl Answer for crate::app::JobTimes {
    type Wire = JobTimes;
    fn wire(self) -> JobTimes {
        let Self { sort, n, lower_s, median_s, upper_s } = self;
        JobTimes { kind: sort.kind.wire(), method: sort.method, n, lower_s, median_s, upper_s }
    }
}

/// A process that computes jobs.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Worker {
    /// Its id, new at each start.
    pub id: String,
    /// Its name: that of its machine, unless it was given one.
    pub name: String,
    /// The version of FLIP.
    pub version: String,
    /// The kinds of jobs that it takes.
    pub kinds: Vec<JobKind>,
    /// On how many threads it computes.
    pub threads: u32,
    /// Whether it answers requests, too.
    pub serves: bool,
    /// Its graphics card, on which it computes jobs that ask for one; absent if it has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub card: Option<String>,
    /// When it started.
    pub started_at: Timestamp,
    /// When it was last heard of.
    pub heard_at: Timestamp,
    /// When it ended in order; absent while it works, and if it was lost.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ended_at: Option<Timestamp>,
    /// Ids of the jobs that it computes or helps with.
    pub jobs: Vec<String>,
}

answer! { flip_store::workers::Worker => Worker {
    id, name, version, kinds, threads, serves, card, started_at, heard_at, ended_at, jobs,
} }

/// What a job is about, and what it computes on.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Subject {
    /// Ids of its powders, in the order of the request, each once.
    pub powders: Vec<String>,
    /// The policy that it tests.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub policy: Option<String>,
    /// The angle of repose that it aims at, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub repose_deg: Option<f64>,
    /// What it computes on; absent for the processor.
    #[serde(skip_serializing_if = "is_default")]
    pub device: Device,
}

answer! { flip_core::domain::job::Subject => Subject { powders, policy, repose_deg, device } }

/// What a job computes on.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Device {
    /// The processor.
    #[default]
    Cpu,
    /// A graphics card.
    Cuda,
}

answer! { flip_core::domain::device::Device => enum Device { Cpu, Cuda } }
request! { enum Device => flip_core::domain::device::Device { Cpu, Cuda } }

/// An event of a job or a weighing, or a choice of the current simulator.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Event {
    /// Position in the order of all events; the `id:` of a server-sent event.
    pub seq: i64,
    /// `job:<id>`, `weighing:<id>`, `simulator`, `bench` or `label`.
    pub topic: String,
    /// `state`, `progress`, `trial`, `episode` or `checkpoint_lost` of a job; `state` or `tick` of
    /// a weighing; `current` of the simulator; `latched` or `cleared` of the bench; `changed` of a label.
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
    /// The grains of a weighing's spoonful, made again.
    Film,
}

answer! { flip_core::domain::job::JobKind => enum JobKind {
    Calibration, Training, Evaluation, Investigation, Repose, Film,
} }
request! { enum JobKind => flip_core::domain::job::JobKind {
    Calibration, Training, Evaluation, Investigation, Repose, Film,
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
