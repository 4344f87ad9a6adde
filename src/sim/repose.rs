//! The heap experiment: parameter set and seed in, angle of repose out.

use crate::domain::parameters::ParameterSet;
use serde::{Deserialize, Serialize};

/// Settings of the heap experiment; stored with every result.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = ReposeSettings)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Grains poured.
    pub particles: u32,
}

impl Default for Settings {
    fn default() -> Self {
        Self { particles: 2000 }
    }
}

/// One simulated heap.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Repose {
    /// atan(2 h / d_base) from the apex, degrees.
    pub tip_deg: f64,
    /// Slope of a cone fitted between 20 % and 80 % of the height, degrees.
    pub cone_deg: f64,
    /// Change of the cone angle over the last 0.2 s, degrees per second.
    pub creep_deg_per_s: f64,
}

/// Why a heap has no angle.
#[derive(Debug, Clone, PartialEq, thiserror::Error, Serialize, Deserialize)]
pub enum Refusal {
    /// The base is not covered.
    #[error("the pile covers {covered} of {sectors} sectors of the base rim: pour more particles or use a smaller base")]
    BaseNotCovered {
        /// Sectors of the rim that hold a grain.
        covered: u32,
        /// All sectors.
        sectors: u32,
    },
    /// The simulation left the range where its numbers mean anything.
    #[error("the simulation diverged at {at_s} s: {cause}")]
    Diverged {
        /// Simulated time, s.
        at_s: f64,
        /// What was seen.
        cause: String,
    },
}

/// Pour, wait until the heap rests, measure. Same inputs, same bytes.
///
/// # Errors
/// [`Refusal`] when the heap has no angle.
pub fn repose(set: &ParameterSet, _settings: &Settings, seed: u64) -> Result<Repose, Refusal> {
    // Placeholder until the kernel lands: a smooth map with noise, so that the rest can be built against it.
    let noise = (crate::domain::seed::derive(seed, &[1]) >> 11) as f64 / (1u64 << 53) as f64 - 0.5;
    let tip = 20.0 + 18.0 * set.friction() + 8.0 * set.cohesion() / set.gravity_scale() + 3.0 * noise;
    Ok(Repose { tip_deg: tip, cone_deg: tip - 2.0, creep_deg_per_s: 0.0 })
}
