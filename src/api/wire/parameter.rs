//! Parameters of a simulated powder, and the sets that calibrations found.

use super::{Answer, Timestamp};
use flip_core::domain::parameters::ParameterSet;
use serde::Serialize;
use utoipa::ToSchema;

/// A parameter set kept by a calibration: the simulated twin of a powder. Never changes.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct CalibratedSet {
    /// Content address: `ps-` and 16 hexadecimal digits.
    pub id: String,
    /// Powder id; absent for a calibration to a bare angle.
    pub powder: Option<String>,
    /// The calibration that produced it.
    pub calibration: String,
    /// The nine values.
    pub parameters: ParameterSetValues,
    /// Mean simulated angle of repose over its runs, degrees.
    pub repose_deg: f64,
    /// Standard deviation over its runs, degrees; absent for a single run.
    pub repose_sd_deg: Option<f64>,
    /// Number of simulations behind the mean.
    pub runs: u32,
    /// Simulated minus measured angle, absolute, degrees.
    pub error_deg: f64,
    /// The extended version of the simulator at whose reference conditions it piles at this angle;
    /// absent for the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub simulator: Option<String>,
    /// When it was stored.
    pub created_at: Timestamp,
}

answer! { flip_store::parameter_sets::CalibratedSet => CalibratedSet {
    id, powder, calibration, parameters, repose_deg, repose_sd_deg, runs, error_deg, simulator,
    created_at,
} }

/// One of the nine parameters: key, unit, published bounds, default and what it does in FLIP's
/// simulator.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Parameter {
    /// Key in JSON, in the database and (with dashes) on the command line.
    pub key: &'static str,
    /// Unit of the value; empty if it has none.
    pub unit: &'static str,
    /// Lower published bound, inclusive.
    pub lower: f64,
    /// Upper published bound, inclusive.
    pub upper: f64,
    /// Default value.
    pub default: f64,
    /// Its effect, in one sentence; `sim/mod.rs` has the equation.
    pub meaning: &'static str,
}

answer! { flip_core::domain::parameters::Parameter => Parameter {
    key, unit, lower, upper, default, meaning,
} }

/// The simulated twin of a powder: one value for each of the nine parameters, each within its
/// published bounds.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ParameterSetValues {
    /// Grain diameter, mm.
    pub particle_diameter_mm: f64,
    pub adhesion: f64,
    pub particle_adhesion_scale: f64,
    pub adhesion_offset_scale: f64,
    pub friction: f64,
    pub gravity_scale: f64,
    /// 1/s.
    pub damping: f64,
    pub cohesion: f64,
    /// Micrograms.
    pub particle_mass_ug: f64,
}

impl Answer for ParameterSet {
    type Wire = ParameterSetValues;
    fn wire(self) -> ParameterSetValues {
        let [
            particle_diameter_mm,
            adhesion,
            particle_adhesion_scale,
            adhesion_offset_scale,
            friction,
            gravity_scale,
            damping,
            cohesion,
            particle_mass_ug,
        ] = self.values();
        ParameterSetValues {
            particle_diameter_mm,
            adhesion,
            particle_adhesion_scale,
            adhesion_offset_scale,
            friction,
            gravity_scale,
            damping,
            cohesion,
            particle_mass_ug,
        }
    }
}
