//! The parts of the `flip calibrate --json` document that the experiments read.

use flip_core::domain::parameters::ParameterSet;
use serde::Deserialize;

/// The document.
#[derive(Deserialize)]
pub struct Calibrated {
    pub powders: Vec<Powder>,
}

#[derive(Deserialize)]
pub struct Powder {
    /// Empty if an angle was calibrated, not a powder.
    pub powder: String,
    pub target_deg: f64,
    pub sets: Vec<Set>,
}

#[derive(Deserialize)]
pub struct Set {
    pub parameters: ParameterSet,
}
