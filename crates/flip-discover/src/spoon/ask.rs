//! What is asked of the simulator: spoonfuls made again, and heaps.

pub use crate::report::spoon::Change;
use flip_core::domain::conditions::Patch;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::powder::Flowability;
use serde::{Deserialize, Serialize};

/// A spoonful to make again.
#[derive(Debug, Clone, PartialEq)]
pub struct SpoonReplay {
    /// The powder.
    pub set: ParameterSet,
    /// Which of the spoonfuls: its steps, and what the spoon held, are to be made.
    pub spoonful: usize,
    /// What is changed.
    pub change: Change,
    /// Seed.
    pub seed: u64,
}

/// A heap to pour.
#[derive(Debug, Clone, PartialEq)]
pub struct SpoonHeap {
    /// The powder.
    pub set: ParameterSet,
    /// What is changed about it.
    pub patch: Patch,
    /// Seed.
    pub seed: u64,
}

/// The simulator, wherever it computes. Answers are in the order of what was asked and depend on
/// that alone; `None` where an experiment has no result.
pub trait Simulator {
    /// Mass that falls into the vial at each step, mg.
    fn pour(&self, replays: &[SpoonReplay]) -> Vec<Option<Vec<f64>>>;
    /// Angles of repose, degrees.
    fn heaps(&self, heaps: &[SpoonHeap]) -> Vec<Option<f64>>;
}

/// What calibration says of a powder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Calibrated {
    /// Powder, by id.
    pub powder: String,
    /// Sets that pile alike, each as probable as the others.
    pub sets: Vec<ParameterSet>,
    /// The measured angle, which every cause has to keep; `None`: spoonfuls alone decide.
    pub angle: Option<Flowability>,
}
