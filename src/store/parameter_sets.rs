//! Calibrated parameter sets.

use crate::domain::parameters::ParameterSet;
use crate::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};

/// A parameter set that a calibration kept: the simulated twin of a powder. Never changes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CalibratedSet {
    /// Content address: `ps-` and 16 hexadecimal digits.
    pub id: String,
    /// Powder id; absent for a calibration to a bare angle.
    pub powder: Option<String>,
    /// The calibration that found it first.
    pub calibration: String,
    /// The nine values.
    pub parameters: ParameterSet,
    /// Mean simulated angle of repose over its runs, degrees.
    pub repose_deg: f64,
    /// Standard deviation over its runs, degrees.
    pub repose_sd_deg: f64,
    /// Simulations behind the mean.
    pub runs: u32,
    /// Simulated minus measured angle, absolute, degrees.
    pub error_deg: f64,
    /// When it was stored.
    pub created_at: Timestamp,
}
