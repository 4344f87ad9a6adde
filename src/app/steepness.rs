//! Whether the simulated heaps of a calibration are as steep as the measured one.

use super::comparison::mean_angle;
use crate::jobs::calibrate::CalibrationResult;
use flip_core::domain::powder::Flowability;
use serde::{Deserialize, Serialize};

/// The simulated heaps beside the measured one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Steepness {
    /// Mean verified angle of the sets, degrees.
    pub simulated_deg: f64,
    /// That minus the measured mean, degrees.
    pub difference_deg: f64,
    /// Expanded uncertainty of the difference (k = 2), degrees: the standard errors of both means.
    /// Absent if the spread of one of them is unknown: of a single heap, or of sets run once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub uncertainty_deg: Option<f64>,
    /// Whether the difference is within it; absent with it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub agrees: Option<bool>,
}

impl Steepness {
    /// Absent without sets.
    pub fn of(target: &Flowability, result: &CalibrationResult) -> Option<Self> {
        let (simulated_deg, simulated_error) = mean_angle(&result.sets);
        let simulated_deg = simulated_deg?;
        let difference_deg = simulated_deg - target.repose_deg;
        let measured_error = (target.n > 1).then(|| target.sd_deg / f64::from(target.n).sqrt());
        let uncertainty_deg = simulated_error.zip(measured_error).map(|(a, b)| 2.0 * a.hypot(b));
        let agrees = uncertainty_deg.map(|it| difference_deg.abs() <= it);
        Some(Self { simulated_deg, difference_deg, uncertainty_deg, agrees })
    }
}
