//! A weighing: what was asked, and how it ended.

use super::conditions::{Patch, Under};
use serde::{Deserialize, Serialize};

/// What a checked request asks for, all masses in mg.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WeighRequest {
    /// Powder id.
    pub powder: String,
    /// Target mass, mg.
    pub target_mg: f64,
    /// Accepted shortfall, mg, >= 0.
    pub tolerance_lower_mg: f64,
    /// Accepted excess, mg, >= 0.
    pub tolerance_upper_mg: f64,
    /// Policy id; resolved before the intent is stored.
    pub policy: String,
    /// Seed of the simulated bench.
    pub seed: u64,
    /// The extended version of the simulator on the bench, and its conditions; none of the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub under: Option<Under>,
    /// What the conditions change about the powder.
    #[serde(default, skip_serializing_if = "Patch::is_none")]
    pub patch: Patch,
}

/// How a weighing ended. Names are the API's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Within tolerance.
    Within,
    /// Short of the target beyond tolerance; every step is spent.
    Under,
    /// Above the target beyond tolerance. Powder cannot be taken back.
    Over,
    /// Stopped on request.
    Stopped,
    /// A device failed or the guard refused to go on.
    Aborted,
    /// The process ended during the weighing: a person must look.
    Unknown,
}

/// Where a weighing stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum WeighingState {
    /// Accepted and stored; waits for the bench.
    Planned,
    /// The bench is about to move.
    Armed,
    /// Powder may be falling.
    Dosing,
    /// Ended with an outcome.
    Done,
    /// Ended by a stop, a fault or the guard.
    Aborted,
    /// The process ended while it ran; nothing resumes by itself.
    Unknown,
}
