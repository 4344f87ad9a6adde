//! A policy's origin: everything needed to reproduce it.

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

/// Kind of controller in a policy, with its configuration besides weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
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
    /// A model of the mass a shake releases, identified while dosing.
    Dispenser {
        /// Its prior, before any reading.
        response: Response,
    },
    /// The prior work's PID rule.
    Pid {
        /// Its gains.
        gains: Pid,
    },
    /// Fuzzy rules on the missing mass and the last fall.
    Fuzzy {
        /// Their breakpoints and centroids.
        fuzzy: Fuzzy,
    },
    /// Fuzzy rules adapted to the number of steps and the target.
    Paced {
        /// The rules of an unhurried weighing, and their adaptation.
        paced: Paced,
    },
}

impl Kind {
    /// The kind's name in JSON: `learned`, `recurrent`, `fixed`, `schedule`, `dispenser`, `pid`,
    /// `fuzzy` or `paced`.
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

    /// Names and shapes of the tensors in the file of a policy of this kind, in the order of its
    /// flat weights.
    ///
    /// `layer<k>.weight` `[inputs, outputs]` and `layer<k>.bias` for a perceptron; a recurrent
    /// network has its branches and its LSTM before them.
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SetManifest {
    /// Its content address.
    pub id: String,
    /// Its nine values.
    pub parameters: ParameterSet,
}

/// A level of the curriculum.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LevelManifest {
    /// Powder id.
    pub powder: String,
    /// Angle of repose, degrees; determines the order of the levels.
    pub repose_deg: f64,
    /// Parameter sets that episodes on this level draw from.
    pub sets: Vec<SetManifest>,
    /// Episodes on this level.
    pub episodes: u32,
}

/// Why a curriculum moved to another level.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SwitchReason {
    /// The mean of the queued errors was small enough.
    Mean,
    /// Every queued error was small enough.
    Maximum,
    /// The level's episodes were used up.
    TimeOut,
    /// The training moved from the surrogate to the simulator and restarted at the first level.
    Simulator,
}

/// A move from one level to the next.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

/// A policy's origin. Stored inside the policy's file and alongside it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Kind of controller.
    #[serde(flatten)]
    pub kind: Kind,
    /// Steps, ending and pitch range that the policy was made for.
    pub rules: Rules,
    /// Name of the preset the training started from: `flip` or `paper`; empty if untrained.
    pub preset: String,
    /// Every setting of the training, as stored with its job; null if untrained.
    pub settings: serde_json::Value,
    /// Seed of the training.
    pub seed: u64,
    /// Version of the code.
    pub code_version: String,
    /// Version of the simulator.
    pub simulator_version: String,
    /// The levels it was trained on.
    pub levels: Vec<LevelManifest>,
    /// When the curriculum moved on.
    pub switches: Vec<Switch>,
    /// Episodes in the training.
    pub episodes: u32,
    /// Mean error of the last 20 episodes, mg; absent if untrained.
    pub final_error_mg: Option<f64>,
}

impl Manifest {
    /// The manifest of an untrained controller.
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
