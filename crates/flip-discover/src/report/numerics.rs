//! Whether simulated angles depend on how they are computed, as a document has it.

use serde::{Deserialize, Serialize};

/// Defects of the simulator, found without data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Numerics {
    /// The set whose heaps were poured.
    pub set: FitSet,
    /// How the angle depends on each setting of the computation.
    pub dependences: Vec<Dependence>,
}

/// A set of the fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FitSet {
    /// Powder id.
    pub powder: String,
    /// Parameter set id.
    pub set: String,
    /// Where the set comes from.
    pub source: String,
}

/// The varied setting of the computation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Varied {
    /// Longest wait for rest.
    SettlingTime,
    /// Substep of the solver.
    Substep,
    /// Grains in the heap.
    Particles,
}

/// How the angle depends on one setting of the computation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Dependence {
    /// The varied setting.
    pub varied: Varied,
    /// Degrees per decade of settling time, or per doubling of the others.
    pub slope_deg: f64,
    /// 99 % interval.
    pub ci99: [f64; 2],
    /// Whether it exceeds the bound: for the settling time, creep.
    pub is_defect: bool,
    /// Number of heaps simulated.
    pub runs: u32,
}
