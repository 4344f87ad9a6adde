//! The inputs, reports and results of a training: everything that needs no libtorch.

use flip_core::domain::FieldError;
use flip_core::domain::parameters::ParameterSet;
use flip_policy::{Actor, Episode, LevelManifest, Manifest};
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

pub use flip_core::learner::Losses;

/// A level of the curriculum: a powder and its simulated twins.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Level {
    /// Powder id.
    pub powder: String,
    /// Angle of repose, degrees.
    pub repose_deg: f64,
    /// Its parameter sets; an episode draws one. The paper has 7 per level.
    pub sets: Vec<ParameterSet>,
}

/// Name of the powder in an episode with a parameter set from the whole box.
pub const RANDOMISED: &str = "randomised";

/// Episodes, from 1, whose network is kept, to show what the training had learned by then. That of
/// the last episode is the policy.
pub const KEPT: [u32; 4] = [1, 10, 100, 1000];

/// Events reported by a running training.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// An episode was played and learned from.
    Episode(Box<EpisodeRecord>),
    /// The network that played an episode of [`KEPT`], before anything was learned from it.
    Kept {
        /// Number of the episode, from 1.
        episode: u32,
        /// The network as a policy's bytes.
        policy: Vec<u8>,
    },
    /// Everything needed to resume from here. After a crash the episodes since the last checkpoint
    /// are repeated, bit for bit; their index identifies them.
    Checkpoint(Vec<u8>),
}

/// One episode, for curves and tables.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodeRecord {
    /// Index, from 0.
    pub index: u32,
    /// Level, from 0.
    pub level: u32,
    /// Powder id.
    pub powder: String,
    /// Id of the parameter set.
    pub parameter_set: String,
    /// Target, mg.
    pub target_mg: f64,
    /// True mass in the vial at the end, mg.
    pub dispensed_mg: f64,
    /// Absolute true error at the end, mg.
    pub final_error_mg: f64,
    /// Sum of the published rewards.
    pub reward: f64,
    /// Steps.
    pub steps: u32,
    /// Final state of the episode.
    pub ending: Episode,
    /// Mean over the updates that followed its round; absent before the first update.
    pub losses: Option<Losses>,
}

/// A finished training.
#[derive(Debug, Clone, PartialEq)]
pub struct Trained {
    /// The policy's bytes.
    pub artifact: Vec<u8>,
    /// The manifest inside them.
    pub manifest: Manifest,
    /// Episodes played.
    pub episodes: u32,
    /// Mean absolute error of the last 20 episodes, mg: still exploring.
    pub final_error_mg: f64,
    /// The levels it was trained on, in that order.
    pub levels: Vec<LevelManifest>,
}

/// Whether a training continues; called before every episode, from any thread.
pub type Flow<'a> = dyn Fn() -> ControlFlow<()> + Sync + 'a;

/// Why a training has no result.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrainError {
    /// Invalid settings or levels.
    #[error(transparent)]
    Invalid(#[from] FieldError),
    /// A checkpoint that cannot be resumed.
    #[error("the checkpoint cannot be resumed: {0}")]
    Checkpoint(String),
    /// The weights are no longer finite.
    #[error(
        "the training diverged after {episodes} episodes: a weight is not a finite number; lower the learning rate"
    )]
    Diverged {
        /// Episodes played.
        episodes: u32,
    },
    /// What computes the simulated doses failed, such as a graphics card.
    #[error("{cause}")]
    Device {
        /// What it said.
        cause: String,
        /// Checkpoint to resume from, on any device; none if nothing had begun.
        checkpoint: Option<Vec<u8>>,
    },
    /// Built without libtorch.
    #[error(
        "this build of FLIP does not train: it was built without the feature `learn`; train with one that has it, and carry the policy over"
    )]
    Unavailable,
    /// The caller requested a stop.
    #[error("the training was stopped")]
    Stopped {
        /// Checkpoint to resume from.
        checkpoint: Vec<u8>,
    },
}

/// The starting point of a training.
#[derive(Debug, Clone, Copy)]
pub enum Start<'a> {
    /// An untrained policy.
    Nothing,
    /// This policy, as configured by the settings' [`FineTuning`](super::FineTuning).
    Policy(&'a Actor),
    /// A checkpoint of an interrupted training.
    Checkpoint(&'a [u8]),
}
