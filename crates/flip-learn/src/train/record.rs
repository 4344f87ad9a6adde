//! What a training is given, what it reports, and what it gives: all that others need to know of one, without libtorch.

use flip_core::domain::FieldError;
use flip_core::domain::parameters::ParameterSet;
use flip_policy::{Actor, Episode, LevelManifest, Manifest};
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

/// A level of the curriculum: a powder and its simulated twins.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = TrainingLevel)]
pub struct Level {
    /// Powder id.
    pub powder: String,
    /// Angle of repose, degrees.
    pub repose_deg: f64,
    /// Its parameter sets; an episode draws one. The paper has 7 per level.
    pub sets: Vec<ParameterSet>,
}

/// The powder of an episode whose parameter set is drawn from the whole box.
pub const RANDOMISED: &str = "randomised";

/// What a training reports while it runs.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// An episode was played and learned from.
    Episode(Box<EpisodeRecord>),
    /// Everything needed to go on from here. After a crash the episodes since the last checkpoint come again, the same
    /// in every bit: they can be told by their index.
    Checkpoint(Vec<u8>),
}

/// One episode, for curves and tables.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct EpisodeRecord {
    /// From 0.
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
    /// How it ended.
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
    /// What it trained on, in the order it was met.
    pub levels: Vec<LevelManifest>,
}

/// Says whether a training goes on; asked before every episode, from any thread.
pub type Flow<'a> = dyn Fn() -> ControlFlow<()> + Sync + 'a;

/// Why there is no policy.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrainError {
    /// Settings or levels that no training can run with.
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
    /// Built without libtorch.
    #[error(
        "this build of FLIP does not train: it was built without the feature `learn`; train with one that has it, and carry the policy over"
    )]
    Unavailable,
    /// The caller asked for it.
    #[error("the training was stopped")]
    Stopped {
        /// To go on from here.
        checkpoint: Vec<u8>,
    },
}

/// Where a training begins.
#[derive(Debug, Clone, Copy)]
pub enum Start<'a> {
    /// With a policy that cannot do anything.
    Nothing,
    /// With this one; the settings' [`FineTuning`](super::FineTuning) says how.
    Policy(&'a Actor),
    /// Where it was interrupted.
    Checkpoint(&'a [u8]),
}

/// What one update saw.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Losses {
    /// Of both critics.
    pub critic: f64,
    /// Of the actor.
    pub actor: f64,
    /// Entropy of the policy, nats.
    pub entropy: f64,
    /// Temperature before the update.
    pub alpha: f64,
}
