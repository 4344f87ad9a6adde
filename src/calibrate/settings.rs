//! What a calibration may be told.

use crate::domain::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// Settings of one calibration; stored with the job and the result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = CalibrationSettings)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Parameter sets wanted, 1 to 100. Default 10 (the paper's).
    pub sets: u32,
    /// Largest accepted |AoR simulated - AoR measured|, degrees, 0.1 to 10. Default 1.5 (the paper's).
    pub tolerance_deg: f64,
    /// Most simulations, search and verification together, 1 to 500. Default 150 (the paper needed 52 to 150 a powder).
    pub trials_max: u32,
    /// Space-filling simulations before the first fit, 2 to 500. Default 6: on an emulator of 456 simulated heaps, five
    /// powders and eight seeds, ten sets took 46.0 simulations with 6, 46.7 with 4, 47.1 with 8 and 47.6 with 10.
    pub initial: u32,
    /// Simulations proposed together, 1 to 32; they can run in parallel. Fixed rather than the number of threads, so
    /// that the result does not depend on the machine. Default 4.
    pub batch: u32,
    /// Fresh simulations, with seeds the search has not seen, by which each candidate is verified, 1 to 50. Default 2.
    pub verify_repeats: u32,
    /// Seed of every random choice and, derived, of every simulation. Default 1.
    pub seed: u64,
    /// Grains in each simulated heap, 100 to 100 000; the caller hands it to the simulator. Default 2000.
    pub particles: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            sets: 10,
            tolerance_deg: 1.5,
            trials_max: 150,
            initial: 6,
            batch: 4,
            verify_repeats: 2,
            seed: 1,
            particles: 2000,
        }
    }
}

impl Settings {
    /// The settings if each is within its bounds.
    ///
    /// # Errors
    /// The first that is not, by name.
    pub fn checked(self) -> Result<Self, FieldError> {
        let count = |field, value: u32, lower: u32, upper: u32| match (lower..=upper).contains(&value) {
            true => Ok(()),
            false => Err(FieldError::new(field, format!("must be from {lower} to {upper}, got {value}"))),
        };
        count("sets", self.sets, 1, 100)?;
        bounded("tolerance_deg", self.tolerance_deg, 0.1, 10.0, "deg")?;
        count("trials_max", self.trials_max, 1, 500)?;
        count("initial", self.initial, 2, 500)?;
        count("batch", self.batch, 1, 32)?;
        count("verify_repeats", self.verify_repeats, 1, 50)?;
        count("particles", self.particles, 100, 100_000)?;
        Ok(self)
    }
}
