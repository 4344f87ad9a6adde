//! Trainings and policies.

use super::{Day, Device, Job, Labels, Spoon, Timestamp, Under, is_default};
use crate::app;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Result of a training.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct TrainingResult {
    /// Policy id.
    pub policy: String,
    /// Episodes used.
    pub episodes: u32,
    /// Mean absolute error of the last 20 episodes, mg.
    pub final_error_mg: f64,
    /// The levels it trained on, in the order met, with the episodes on each.
    #[schema(value_type = Vec<Object>)]
    pub levels: Vec<serde_json::Value>,
    /// The graphics card that simulated; absent for the processor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub card: Option<String>,
}

answer! { app::TrainingResult => TrainingResult { policy, episodes, final_error_mg, levels, card } }

/// What to train. Everything has a default.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct TrainingRequest {
    /// Order of the levels.
    #[serde(default)]
    pub order: Order,
    /// Preset of settings.
    #[serde(default)]
    pub preset: Preset,
    /// Episodes, 1 to 20000; default the preset's: 4800 for `flip`, 4000 for `paper`.
    pub episodes: Option<u32>,
    /// Number of these run first on a fast model of the spoon instead of the simulator, 0 to all;
    /// default four fifths for `flip`, none for `paper`.
    pub surrogate_episodes: Option<u32>,
    /// Powders whose calibrated sets are the levels; default `sand`, `sugar`, `salt`. Not with the
    /// `paper` preset.
    pub powders: Option<Vec<String>>,
    /// Learnt policy of the same preset to continue from, e.g. to adapt it to a simulator version;
    /// default an untrained one. With it the default is 720 episodes, none of them on the
    /// surrogate.
    #[serde(default)]
    pub from: Option<String>,
    /// What simulates: the processor, or a graphics card of this process or of a worker. The same
    /// training on a card gives another policy: it plays 32 episodes a round instead of 4.
    #[serde(default)]
    pub device: Device,
    /// What computes the gradients of updates: libtorch, or FLIP's own code, whose bits are the same
    /// on every processor and which on a card makes the updates there. The policies differ. Default
    /// `libtorch` on the processor, `fused` on a card.
    #[serde(default)]
    pub gradients: Option<Gradients>,
    /// Seed; default 1.
    pub seed: Option<u64>,
    /// Extended simulator version, `sv-…`; default the base.
    #[serde(default)]
    pub simulator: Option<String>,
    /// Conditions held fixed in every episode; the others are drawn for each as seen in the
    /// version's campaign.
    #[serde(default)]
    #[schema(value_type = std::collections::BTreeMap<String, super::Condition>)]
    pub conditions: Day,
    /// Shake as the bench's arm was measured to shake (`flip bench calibrate-shake`); default as in
    /// the simulator. The surrogate ignores it.
    #[serde(default)]
    pub as_calibrated: bool,
    /// The spoon used for dosing; default FLIP's own, which holds about 40 mg. The surrogate
    /// ignores it.
    #[serde(default)]
    pub spoon: Option<Spoon>,
    /// What the caller writes on it, to find it again.
    #[serde(default)]
    pub labels: Labels,
}

request! { TrainingRequest => app::TrainingRequest {
    order, preset, episodes, surrogate_episodes, powders, from, device, gradients, seed, simulator,
    conditions, as_calibrated, spoon, labels,
} }

/// A training: its job, its levels, and its policy once it has succeeded.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Training {
    /// The job; the training has the same id.
    pub job: Job,
    /// Order of the levels.
    pub order: Order,
    /// Preset it started from.
    pub preset: Preset,
    /// Episodes it may use.
    pub episodes: u32,
    /// The levels.
    pub levels: Vec<TrainingLevel>,
    /// The extended simulator version and the conditions given; absent for the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub under: Option<Under>,
    /// What it simulates on; absent for the processor.
    #[serde(skip_serializing_if = "is_default")]
    pub device: Device,
    /// Every setting.
    #[schema(value_type = Object)]
    pub settings: serde_json::Value,
    /// Episodes, from 1, whose network is kept, in order: a film shows a dose with it. The last of a
    /// training that has succeeded is its policy's.
    pub kept_episodes: Vec<u32>,
    /// Result; absent until it has succeeded.
    pub result: Option<TrainingResult>,
}

answer! { app::Training => Training {
    job, order, preset, episodes, levels, under, device, settings, kept_episodes, result,
} }

/// One level of a training.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct TrainingLevel {
    /// Powder id, or `repose_<angle>` for a bare angle.
    pub powder: String,
    /// Angle of repose the sets are calibrated to, degrees.
    pub repose_deg: f64,
    /// Ids of the parameter sets.
    pub sets: Vec<String>,
}

answer! { app::TrainingLevel => TrainingLevel { powder, repose_deg, sets } }

/// One simulated dose of a training.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Episode {
    /// Position in the training, from 0.
    pub index: u32,
    /// Curriculum level, from 0.
    pub level: u32,
    /// Powder of the level.
    pub powder: String,
    /// Id of the parameter set it was simulated with.
    pub parameter_set: String,
    /// Target mass, mg.
    pub target_mg: f64,
    /// True mass in the vial at the end, mg.
    pub dispensed_mg: f64,
    /// Absolute difference between target and true mass at the end, mg.
    pub final_error_mg: f64,
    /// Sum of rewards.
    pub reward: f64,
    /// Steps taken.
    pub steps: u32,
    /// Entropy temperature; absent, like the losses, before the first update.
    pub alpha: Option<f64>,
    /// Mean critic loss over the updates that followed its round.
    pub critic_loss: Option<f64>,
    /// Mean actor loss over the updates that followed its round.
    pub actor_loss: Option<f64>,
}

answer! { flip_store::trials::Episode => Episode {
    index, level, powder, parameter_set, target_mg, dispensed_mg, final_error_mg, reward, steps,
    alpha, critic_loss, actor_loss,
} }

/// A trained policy. Never changes.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Policy {
    /// Content address: `p-` and 16 hexadecimal digits.
    pub id: String,
    /// `learned`, `recurrent`, `fixed`, `schedule`, `dispenser`, `pid`,
    /// `fuzzy` or `paced`.
    pub kind: String,
    /// The training that made it.
    pub training: Option<String>,
    /// Settings, seed, parameter sets, curriculum history, versions.
    #[schema(value_type = Object)]
    pub manifest: serde_json::Value,
    /// SHA-256 of the bytes, hexadecimal.
    pub sha256: String,
    /// Length of the bytes.
    pub size_bytes: u64,
    /// Mean absolute errors from evaluations, one entry for each powder weighed in any.
    pub evaluated: Vec<PolicyError>,
    /// When it was stored.
    pub created_at: Timestamp,
}

answer! { flip_store::policies::Policy => Policy {
    id, kind, training, manifest, sha256, size_bytes, evaluated, created_at,
} }

/// Evaluation results of a policy on one powder.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PolicyError {
    /// Powder id.
    pub powder: String,
    /// Mean absolute error over all evaluated weighings of the powder, mg.
    pub mae_mg: f64,
    /// Number of those weighings.
    pub n: u32,
}

answer! { flip_store::policies::PolicyError => PolicyError { powder, mae_mg, n } }

/// The defaults a training starts from.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// FLIP's own.
    #[default]
    Flip,
    /// The published robot's.
    Paper,
}

answer! { flip_learn::train::Preset => enum Preset { Flip, Paper } }
request! { enum Preset => flip_learn::train::Preset { Flip, Paper } }

/// How the powder of an episode is chosen.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// From the lowest angle of repose to the highest, advancing when good enough.
    #[default]
    Curriculum,
    /// From the highest angle of repose to the lowest, by the same rule.
    Reverse,
    /// A random level for each episode.
    Random,
    /// A random parameter set from the whole published box for each episode; levels are not used.
    DomainRandomisation,
}

answer! { flip_learn::train::Order => enum Order {
    Curriculum, Reverse, Random, DomainRandomisation,
} }
request! { enum Order => flip_learn::train::Order {
    Curriculum, Reverse, Random, DomainRandomisation,
} }

/// What computes the gradients of a training's updates.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Gradients {
    /// libtorch, whose bits depend on the processor.
    #[default]
    Libtorch,
    /// FLIP's own code, with the same bits on every processor and on a card.
    Fused,
}

request! { enum Gradients => flip_learn::train::Gradients { Libtorch, Fused } }
