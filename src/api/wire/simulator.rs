//! Versions of the simulator, and conditions.

use super::{MotionLimits, Timestamp, is_default};
use crate::app;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// What is on the spoon, and mechanisms added to the simulator.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Conditions {
    /// Grains on the spoon. Their mass is the powder's, so twice the grains is twice the powder.
    pub particles: u32,
    /// Mechanisms missing from the base simulator, with their amplitudes.
    #[serde(default)]
    pub extensions: Extensions,
    /// Limits of a shake as executed by the bench's arm; absent: those of the simulator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shake: Option<MotionLimits>,
    /// The spoon; absent: FLIP's own.
    #[serde(default, skip_serializing_if = "is_default")]
    pub spoon: Spoon,
    /// Substep of the solver, us; absent: the usual 80.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub substep_us: Option<u32>,
}

answer! { app::Conditions => Conditions { particles, extensions, shake, spoon, substep_us } }

/// Rows whose angles are to be predicted.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PredictionRequest {
    /// The rows as CSV text, in the format of investigations; `repose_deg` is optional and ignored.
    pub measurements_csv: String,
}

request! { PredictionRequest => app::PredictionRequest { measurements_csv } }

/// The version used where none is named.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct CurrentSimulator {
    /// `base`, or a version, `sv-…`.
    pub simulator: String,
    /// Name of the base, as used by versions that extend it.
    pub base: String,
    /// When it was chosen; absent if none was ever chosen and the base is current.
    pub chosen_at: Option<Timestamp>,
    /// Why it was chosen, if anyone said so.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// The previously current version, which can be chosen again; absent if none was ever chosen.
    pub before: Option<String>,
}

answer! { app::CurrentSimulator => CurrentSimulator { simulator, base, chosen_at, reason, before } }

/// Version to use from now on where none is named.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ChosenSimulator {
    /// `base`, or a version, `sv-…`.
    pub simulator: String,
    /// Why, for the record: 1 to 500 characters.
    #[serde(default)]
    pub reason: Option<String>,
}

request! { ChosenSimulator => app::ChosenSimulator { simulator, reason } }

/// A version of the simulator: its base, its extensions, and their origin. Never changes.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct SimulatorVersion {
    /// `sv-` and 16 hexadecimal digits of the SHA-256 of its inputs: campaign, settings and base.
    pub id: String,
    /// The version that it extends.
    pub base: String,
    /// The investigation that made it.
    pub investigation: String,
    /// Causes with fitted parameters, their benefit on held-out days, and whether simulations
    /// confirmed it.
    #[schema(value_type = Object)]
    pub body: serde_json::Value,
    /// When it was stored.
    pub created_at: Timestamp,
}

answer! { flip_store::simulators::SimulatorVersion => SimulatorVersion {
    id, base, investigation, body, created_at,
} }

/// Amplitudes of the mechanisms; all zero is the base simulator, bit for bit.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Extensions {
    /// Freedom of grains to rotate: 0 none, 1 as for solid spheres.
    #[serde(skip_serializing_if = "is_default")]
    pub rotation: f64,
    /// Rolling friction: largest rolling torque over normal force and radius. Acts only on grains
    /// that rotate.
    #[serde(skip_serializing_if = "is_default")]
    pub rolling_friction: f64,
    /// Standard deviation of the logarithm of the radii.
    #[serde(skip_serializing_if = "is_default")]
    pub size_spread: f64,
    /// Bond number gained by an ageing contact; half of it is reached after 0.1 s.
    #[serde(skip_serializing_if = "is_default")]
    pub consolidation: f64,
    /// Water in the powder: 0 dry, 1 bridges of bond number 2 that reach 0.1 d.
    #[serde(skip_serializing_if = "is_default")]
    pub humidity: f64,
    /// Bond number of grains to the spoon, in addition to the effect of `adhesion`.
    #[serde(skip_serializing_if = "is_default")]
    pub spoon_adhesion: f64,
    /// Share of the grains that stay on the spoon once they touch it.
    #[serde(skip_serializing_if = "is_default")]
    pub hold_up: f64,
    /// Peak acceleration of a vertical vibration of the base or the spoon, in g.
    #[serde(skip_serializing_if = "is_default")]
    pub vibration_g: f64,
    /// Bond number of grains to walls due to charge, at contact.
    #[serde(skip_serializing_if = "is_default")]
    pub charge: f64,
    /// Viscosity of the air relative to 20 deg C; 1 is air, 0 is vacuum.
    #[serde(skip_serializing_if = "is_default")]
    pub air: f64,
}

answer! { flip_sim::mechanisms::Extensions => Extensions {
    rotation, rolling_friction, size_spread, consolidation, humidity, spoon_adhesion, hold_up,
    vibration_g, charge, air,
} }

/// A recorded condition: a number in the unit given by the suffix of its name, or a name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(untagged)]
pub enum Condition {
    /// A number, for example `relative_humidity_pct`.
    Number(f64),
    /// A name, for example `batch`.
    Name(String),
}

answer! { flip_core::domain::conditions::Condition => enum Condition { Number(it), Name(it) } }
request! { enum Condition => flip_core::domain::conditions::Condition { Number(it), Name(it) } }

/// Conditions by column name of the campaign, e.g. `relative_humidity_pct`.
pub type Day = BTreeMap<String, Condition>;

/// An extended simulator version, and the conditions it simulates.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Under {
    /// Version, `sv-…`.
    pub simulator: String,
    /// The conditions given. A calibration without any runs at the version's reference; a training
    /// draws those left out.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[schema(value_type = std::collections::BTreeMap<String, Condition>)]
    pub conditions: Day,
}

answer! { flip_core::domain::conditions::Under => Under { simulator, conditions } }

/// Changes that conditions make to a simulated powder and its experiments. None by default: the
/// base simulator, bit for bit.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Patch {
    /// Amplitudes of mechanisms not in the base simulator, by name.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub amplitudes: BTreeMap<String, f64>,
    /// Offsets of the powder's parameters, by key.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub parameters: BTreeMap<String, f64>,
    /// Offsets of the heap experiment's settings, by name; not applied to a spoon.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub heap: BTreeMap<String, f64>,
}

answer! { flip_core::domain::conditions::Patch => Patch { amplitudes, parameters, heap } }

/// Who fills the spoon.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FilledBy {
    /// The arm, from the powder's container, if it reports that it can.
    #[default]
    Arm,
    /// A person or a station, before each dose.
    Hand,
}

answer! { flip_core::domain::spoon::FilledBy => enum FilledBy { Arm, Hand } }
request! { enum FilledBy => flip_core::domain::spoon::FilledBy { Arm, Hand } }

/// A spoon. Omitted values are those of FLIP's own spoon, which holds about 40 mg.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Spoon {
    /// Mass of one filling, mg, 1 to 100000; if omitted, the capacity of a bowl of these dimensions
    /// for the simulated powder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub capacity_mg: Option<f64>,
    /// Inner length of the bowl, mm, 2 to 60; requires `width_mm` and `depth_mm`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub length_mm: Option<f64>,
    /// Inner width of the bowl, mm, 2 to 60.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub width_mm: Option<f64>,
    /// Depth of the bowl, mm, 0.5 to 30.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth_mm: Option<f64>,
    /// Who fills it. Default the arm.
    #[serde(skip_serializing_if = "is_default")]
    pub filled_by: FilledBy,
}

answer! { flip_core::domain::spoon::Spoon => Spoon {
    capacity_mg, length_mm, width_mm, depth_mm, filled_by,
} }
request! { Spoon => flip_core::domain::spoon::Spoon {
    capacity_mg, length_mm, width_mm, depth_mm, filled_by,
} }
