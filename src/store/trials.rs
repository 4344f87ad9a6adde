//! The trials of calibrations and the episodes of trainings: series that grow while their job runs.

use crate::domain::parameters::ParameterSet;
use serde::{Deserialize, Serialize};

/// Why a calibration simulated a heap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TrialPhase {
    /// To find candidates.
    Search,
    /// To check a candidate with a fresh seed.
    Verification,
}

/// One simulated heap of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Trial {
    /// Position in the calibration, from 0.
    pub index: u32,
    /// Why it was simulated.
    pub phase: TrialPhase,
    /// The nine values.
    pub parameters: ParameterSet,
    /// Seed of the simulation.
    pub seed: u64,
    /// Angle of repose by the tip formula, degrees; absent when the heap has none.
    pub tip_deg: Option<f64>,
    /// Slope of the fitted cone, degrees.
    pub cone_deg: Option<f64>,
    /// Creep of the resting heap, degrees per second.
    pub creep_deg_per_s: Option<f64>,
    /// Why the heap has no angle.
    pub refusal: Option<String>,
    /// Absolute difference to the target, degrees.
    pub error_deg: Option<f64>,
}

/// One simulated dose of a training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Episode {
    /// Position in the training, from 0.
    pub index: u32,
    /// Curriculum level, from 0.
    pub level: u32,
    /// Powder of the level.
    pub powder: String,
    /// Target mass, mg.
    pub target_mg: f64,
    /// Absolute difference between target and true mass at the end, mg.
    pub final_error_mg: f64,
    /// Sum of rewards.
    pub reward: f64,
    /// Steps taken.
    pub steps: u32,
    /// Entropy temperature after the episode.
    pub alpha: Option<f64>,
    /// Mean critic loss over the episode's updates.
    pub critic_loss: Option<f64>,
    /// Mean actor loss over the episode's updates.
    pub actor_loss: Option<f64>,
}
