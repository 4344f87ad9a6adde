//! Where a policy came from: everything needed to make it again.

use super::controller::{Schedule, ScheduledStep};
use super::episode::Rules;
use super::fuzzy::Fuzzy;
use super::observation::Encoding;
use super::paced::Paced;
use super::pid::Pid;
use super::recurrent;
use super::response::Response;
use flip_core::domain::parameters::ParameterSet;
use serde::{Deserialize, Serialize};

/// What kind of controller a policy holds, and what it needs besides weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[schema(as = PolicyKind)]
pub enum Kind {
    /// A network; its weights are the file's tensors.
    Learned {
        /// How observations become inputs.
        encoding: Encoding,
        /// Sizes of the layers from the inputs to the outputs.
        widths: Vec<usize>,
    },
    /// The recurrent network of the prior work; its weights are the file's tensors.
    Recurrent {
        /// How observations become inputs.
        encoding: Encoding,
        /// Units of each branch and of the LSTM.
        hidden: usize,
    },
    /// One pitch and one shake.
    Fixed {
        /// The pitch and the shake.
        step: ScheduledStep,
    },
    /// A list of pitches and shakes.
    Schedule {
        /// The list.
        schedule: Schedule,
    },
    /// A model of what a shake lets fall, identified while it doses.
    Dispenser {
        /// What it expects before it has seen anything.
        response: Response,
    },
    /// The prior work's PID rule.
    Pid {
        /// Its gains.
        gains: Pid,
    },
    /// Fuzzy rules on what is missing and what fell.
    Fuzzy {
        /// Their breakpoints and centroids.
        fuzzy: Fuzzy,
    },
    /// Fuzzy rules that suit the steps and the target.
    Paced {
        /// The rules of a weighing that has time, and how others differ.
        paced: Paced,
    },
}

impl Kind {
    /// The kind's name in JSON: `learned`, `recurrent`, `fixed`, `schedule`, `dispenser`, `pid`, `fuzzy` or `paced`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Learned { .. } => "learned",
            Self::Recurrent { .. } => "recurrent",
            Self::Fixed { .. } => "fixed",
            Self::Schedule { .. } => "schedule",
            Self::Dispenser { .. } => "dispenser",
            Self::Pid { .. } => "pid",
            Self::Fuzzy { .. } => "fuzzy",
            Self::Paced { .. } => "paced",
        }
    }

    /// Names and shapes of the tensors that a policy of this kind has in its file, in the order of its flat weights.
    ///
    /// `layer<k>.weight` `[inputs, outputs]` and `layer<k>.bias` for a perceptron; a recurrent network has its branches and its LSTM
    /// before them.
    pub fn tensors(&self) -> Vec<(String, Vec<usize>)> {
        match self {
            Self::Learned { widths, .. } => recurrent::layers(widths),
            Self::Recurrent { encoding, hidden } => recurrent::tensors(encoding.width(), *hidden),
            Self::Fixed { .. }
            | Self::Schedule { .. }
            | Self::Dispenser { .. }
            | Self::Pid { .. }
            | Self::Fuzzy { .. }
            | Self::Paced { .. } => Vec::new(),
        }
    }
}

/// A parameter set that a policy trained on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct SetManifest {
    /// Its content address.
    pub id: String,
    /// Its nine values.
    pub parameters: ParameterSet,
}

/// A level of the curriculum.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct LevelManifest {
    /// Powder id.
    pub powder: String,
    /// Angle of repose, degrees: what the levels are ordered by.
    pub repose_deg: f64,
    /// Parameter sets that episodes on this level draw from.
    pub sets: Vec<SetManifest>,
    /// Episodes on this level.
    pub episodes: u32,
}

/// Why a curriculum moved on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum SwitchReason {
    /// The mean of the queued errors was small enough.
    Mean,
    /// Every queued error was small enough.
    Maximum,
    /// The level's episodes were spent.
    TimeOut,
    /// The training went over from the surrogate to the simulator, and begins with the first level again.
    Simulator,
}

/// A move from one level to the next.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Switch {
    /// Episodes before the move, over the whole training.
    pub episode: u32,
    /// Level left, from 0.
    pub from: u32,
    /// Level entered.
    pub to: u32,
    /// Why.
    pub reason: SwitchReason,
}

/// Where a policy came from. Stored inside the policy's file and beside it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = PolicyManifest)]
pub struct Manifest {
    /// What it is.
    #[serde(flatten)]
    pub kind: Kind,
    /// Steps, ending and pitch range that it was made for.
    pub rules: Rules,
    /// Name of the settings it started from: `flip` or `paper`; empty for one that did not train.
    pub preset: String,
    /// Every setting of the training, as stored with its job; null for one that did not train.
    pub settings: serde_json::Value,
    /// Seed of the training.
    pub seed: u64,
    /// Version of the code.
    pub code_version: String,
    /// Version of the simulator.
    pub simulator_version: String,
    /// What it trained on.
    pub levels: Vec<LevelManifest>,
    /// When the curriculum moved on.
    pub switches: Vec<Switch>,
    /// Episodes in the training.
    pub episodes: u32,
    /// Mean error of the last 20 episodes, mg; absent for one that did not train.
    pub final_error_mg: Option<f64>,
}

impl Manifest {
    /// The manifest of a controller that did not train.
    pub fn of_untrained(kind: Kind, rules: Rules, seed: u64) -> Self {
        Self {
            kind,
            rules,
            preset: String::new(),
            settings: serde_json::Value::Null,
            seed,
            code_version: env!("CARGO_PKG_VERSION").to_owned(),
            simulator_version: String::new(),
            levels: Vec::new(),
            switches: Vec::new(),
            episodes: 0,
            final_error_mg: None,
        }
    }
}
