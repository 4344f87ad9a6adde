//! What the experiments read of the document of `flip calibrate --json`.

use flip_core::domain::parameters::ParameterSet;
use serde::Deserialize;

/// The document.
#[derive(Deserialize)]
pub struct Calibrated {
    pub powders: Vec<Powder>,
}

#[derive(Deserialize)]
pub struct Powder {
    /// Empty where an angle was calibrated, not a powder.
    pub powder: String,
    pub target_deg: f64,
    pub sets: Vec<Set>,
}

#[derive(Deserialize)]
pub struct Set {
    pub parameters: ParameterSet,
}
