//! The ledger: what is to be computed, who computes it, how far it is. The queue only delivers.

use crate::domain::job::{JobKind, JobState, Progress};
use crate::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};

/// A job as callers see it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Job {
    /// Id; a calibration, training or evaluation has the id of its job.
    pub id: String,
    /// What it computes.
    pub kind: JobKind,
    /// Where it stands.
    pub state: JobState,
    /// How far it is.
    pub progress: Progress,
    /// Times that a worker has begun or resumed it.
    pub attempts: u32,
    /// A cancellation was asked for and is not yet carried out.
    pub cancelling: bool,
    /// When it was asked for.
    pub created_at: Timestamp,
    /// When a worker first began it.
    pub started_at: Option<Timestamp>,
    /// When it ended.
    pub finished_at: Option<Timestamp>,
    /// Why it failed, or why its last attempt did.
    pub error: Option<String>,
}
