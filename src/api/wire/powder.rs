//! Powders and what was measured of them.

use super::{CalibratedSet, NamedPowder, Timestamp, is_default};
use crate::app;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A measurement to register, in exactly one of three forms.
///
/// `repose_deg` with `sd_deg` and `n`, or alone as a single value; the angles of all repeats in
/// `repeats_deg`; or the heaps themselves, `heights_mm` with `base_diameters_mm`.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewMeasurement {
    /// How it was measured.
    pub method: Method,
    /// Mean angle of repose, 5 to 85 degrees.
    pub repose_deg: Option<f64>,
    /// Standard deviation over the repeats, 0 to 45 degrees; left out for a single value, whose
    /// spread is unknown.
    pub sd_deg: Option<f64>,
    /// Number of repeats, 1 to 10000; 1 if neither it nor `sd_deg` is given.
    pub n: Option<u32>,
    /// Angle of repose of each of 1 to 10000 repeats, 5 to 85 degrees; mean, sample SD (0 for a
    /// single one) and number are computed.
    pub repeats_deg: Option<Vec<f64>>,
    /// Height of each of 1 to 10000 heaps above the base it covers, mm. The angle of each is atan(2
    /// h / d), 5 to 85 degrees.
    pub heights_mm: Option<Vec<f64>>,
    /// Diameter of the base, 5 to 500 mm: one for each height, or one for all.
    pub base_diameters_mm: Option<Vec<f64>>,
    /// Height of the funnel's tip above the base, 0.1 to 3000 mm; a heap higher than this is
    /// refused.
    pub funnel_height_mm: Option<f64>,
    /// Where the numbers come from; up to 500 characters.
    pub source: Option<String>,
    /// On which day it was made, as `2026-02-03`.
    pub measured_on: Option<String>,
}

request! { NewMeasurement => app::NewMeasurement {
    method, repose_deg, sd_deg, n, repeats_deg, heights_mm, base_diameters_mm, funnel_height_mm,
    source, measured_on,
} }

/// A measurement to register, other than the angle of repose.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewObservation {
    /// What was measured, with the settings of the experiment.
    pub observable: Observable,
    /// Mean over the repeats, in the observable's unit: s, mg, deg or mm.
    pub mean: f64,
    /// Standard deviation over the repeats, above 0.
    pub sd: f64,
    /// Number of repeats, 2 to 10000.
    pub n: u32,
    /// Where the numbers come from; up to 500 characters.
    pub source: Option<String>,
    /// On which day it was made, as `2026-02-03`.
    pub measured_on: Option<String>,
}

request! { NewObservation => app::NewObservation { observable, mean, sd, n, source, measured_on } }

/// Result of importing a file of measurements.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Imported {
    /// Ids of the powders registered because the file names them.
    pub powders: Vec<String>,
    /// Powders given by name in the file, with the ids made or found for them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub named: Vec<NamedPowder>,
    /// The measurements, in the order of the file.
    pub measurements: Vec<Measurement>,
    /// The observations other than the angle, in the order of the file.
    pub observations: Vec<PowderObservation>,
    /// Entries of the file that were stored already, with the same powder, values and source, and
    /// were skipped.
    #[serde(default, skip_serializing_if = "is_default")]
    pub already_stored: usize,
}

answer! { app::Imported => Imported { powders, named, measurements, observations, already_stored } }

/// A powder to register.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewPowder {
    /// A lower-case letter, then up to 63 of a-z, 0-9 and _; made from the name if omitted or
    /// empty: `Lactose 200M` is `lactose_200m`, and `lactose_200m_2` if another powder has that id.
    #[serde(default)]
    pub id: String,
    /// Name for people, 1 to 100 characters.
    pub name: String,
    /// Whether it dissolves in water that it takes up from humid air, if known: an investigation
    /// then does not blame deliquescence for what a powder that does not dissolve does.
    #[serde(default)]
    pub soluble: Option<bool>,
    /// Its first measurement, registered with it or not at all.
    #[serde(default)]
    pub measurement: Option<NewMeasurement>,
}

request! { NewPowder => app::NewPowder { id, name, soluble, measurement } }

/// A powder with all data on it.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PowderDetail {
    /// The powder.
    pub powder: Powder,
    /// Its measurements, oldest first.
    pub measurements: Vec<Measurement>,
    /// Other measurements: the newest observation of each observable.
    pub observations: Vec<Observation>,
    /// Its calibrated sets, oldest first.
    pub sets: Vec<CalibratedSet>,
}

answer! { app::PowderDetail => PowderDetail { powder, measurements, observations, sets } }

/// One registered observation of a powder.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PowderObservation {
    /// Id.
    pub id: String,
    /// Powder id.
    pub powder: String,
    /// What was measured, with the settings of the experiment.
    pub observable: Observable,
    /// Mean over the repeats, in the observable's unit.
    pub mean: f64,
    /// Standard deviation over the repeats.
    pub sd: f64,
    /// Number of repeats.
    pub n: u32,
    /// Where the numbers come from.
    pub source: String,
    /// On which day it was made, as `2026-02-03`; absent if nobody said.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measured_on: Option<String>,
    /// When it was registered.
    pub created_at: Timestamp,
    /// Why it no longer counts; absent if it does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub withdrawn: Option<Withdrawn>,
}

answer! { flip_store::observations::PowderObservation => PowderObservation {
    id, powder, observable, mean, sd, n, source, measured_on, created_at, withdrawn,
} }

/// Why a measurement no longer counts.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Withdrawn {
    /// When it was withdrawn.
    pub at: Timestamp,
    /// By whom, if known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
    /// The reason given.
    pub reason: String,
    /// Id of the corrected measurement that took its place.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub replaced_by: Option<String>,
}

answer! { app::Withdrawn => Withdrawn { at, by, reason, replaced_by } }

/// Why a measurement is to be withdrawn.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WithdrawalRequest {
    /// The reason, 1 to 500 characters.
    pub reason: String,
}

request! { WithdrawalRequest => app::WithdrawalRequest { reason } }

/// What a measurement should have been, and why it was wrong.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CorrectMeasurement {
    /// The reason, 1 to 500 characters.
    pub reason: String,
    /// The corrected measurement, in full.
    pub corrected: NewMeasurement,
}

request! { CorrectMeasurement => app::Correction::<app::NewMeasurement> { reason, corrected } }

/// What an observation should have been, and why it was wrong.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CorrectObservation {
    /// The reason, 1 to 500 characters.
    pub reason: String,
    /// The corrected observation, in full.
    pub corrected: NewObservation,
}

request! { CorrectObservation => app::Correction::<app::NewObservation> { reason, corrected } }

/// A real powder.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Powder {
    /// Short name in lower case, e.g. `sodium_bicarbonate`.
    pub id: String,
    /// Display name.
    pub name: String,
    /// The flowability that calibrations target: the latest automated measurement, else the latest
    /// manual one.
    pub flowability: Option<Flowability>,
    /// Whether it dissolves in water that it takes up from humid air; absent where nobody said.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub soluble: Option<bool>,
    /// When it was registered.
    pub created_at: Timestamp,
}

answer! { flip_store::powders::Powder => Powder { id, name, flowability, soluble, created_at } }

/// One measurement of a powder's flowability.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Measurement {
    /// Id.
    pub id: String,
    /// Powder id.
    pub powder: String,
    /// How it was measured.
    pub method: Method,
    /// Mean angle of repose, degrees.
    pub repose_deg: f64,
    /// Standard deviation over the repeats, degrees.
    pub sd_deg: f64,
    /// A single value has no known spread: `sd_deg` is 0 then, and carries no information.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub sd_unknown: bool,
    /// Number of repeats.
    pub n: u32,
    /// Where the numbers come from.
    pub source: String,
    /// On which day it was made, as `2026-02-03`; absent if nobody said.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measured_on: Option<String>,
    /// When it was registered.
    pub created_at: Timestamp,
    /// Why it no longer counts; absent if it does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub withdrawn: Option<Withdrawn>,
}

answer! { flip_store::powders::Measurement => Measurement {
    id, powder, method, repose_deg, sd_deg, sd_unknown, n, source, measured_on, created_at, withdrawn,
} }

/// How an angle of repose was measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// By camera: funnel tip and pile apex located in depth images.
    Automated,
    /// By hand, per ISO 8398.
    Manual,
}

answer! { flip_core::domain::powder::Method => enum Method { Automated, Manual } }
request! { enum Method => flip_core::domain::powder::Method { Automated, Manual } }

/// A measured angle of repose: the mean of `n` repeats and their standard deviation.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Flowability {
    /// Mean angle of repose, degrees.
    pub repose_deg: f64,
    /// Standard deviation over the repeats, degrees.
    pub sd_deg: f64,
    /// Number of repeats.
    pub n: u32,
}

answer! { flip_core::domain::powder::Flowability => Flowability { repose_deg, sd_deg, n } }

/// A quantity measured in an experiment, with the experiment's settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Observable {
    /// Time for a mass to run out of a flat-bottomed cup through a round hole, s. A Hall flow meter
    /// uses 50 g, 2.54 mm (ASTM B213).
    #[schema(title = "FlowTime")]
    FlowTime {
        /// Mass that runs out, 0.01 to 1000 g.
        mass_g: f64,
        /// Diameter of the hole, 1.5 to 4 mm.
        orifice_mm: f64,
    },
    /// Mass that falls from a full spoon in one shake, mg.
    #[schema(title = "ShakeMass")]
    ShakeMass {
        /// Pitch of the spoon, tip down, 0 to 50 deg.
        pitch_deg: f64,
        /// Amplitude of the shake along the spoon, 0.9 to 16 mm.
        shake_mm: f64,
    },
    /// Slope of the powder left in a flat-bottomed cup after draining through a hole in the middle,
    /// deg.
    #[schema(title = "DrainedAngle")]
    DrainedAngle {},
    /// Height of a heap that covers a round base to its rim, mm.
    #[schema(title = "PileHeight")]
    PileHeight {
        /// Diameter of the base, 5 to 500 mm.
        base_diameter_mm: f64,
        /// Distance from the funnel's tip down to the apex of the finished heap, mm; 0.05 to 0.5
        /// base diameters.
        fall_mm: f64,
    },
}

answer! { flip_core::domain::observable::Observable => enum Observable {
    FlowTime { mass_g, orifice_mm }, ShakeMass { pitch_deg, shake_mm }, DrainedAngle {}, PileHeight
    { base_diameter_mm, fall_mm },
} }
request! { enum Observable => flip_core::domain::observable::Observable {
    FlowTime { mass_g, orifice_mm }, ShakeMass { pitch_deg, shake_mm }, DrainedAngle {}, PileHeight
    { base_diameter_mm, fall_mm },
} }

/// A measured quantity: the mean of `n` repeats and their standard deviation, in the quantity's
/// unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Observation {
    /// What was measured.
    pub observable: Observable,
    /// Mean over the repeats, in the observable's unit.
    pub mean: f64,
    /// Standard deviation over the repeats, above 0.
    pub sd: f64,
    /// Number of repeats, 2 to 10000: a single one has no spread.
    pub n: u32,
}

answer! { flip_core::domain::observable::Observation => Observation { observable, mean, sd, n } }
request! { Observation => flip_core::domain::observable::Observation { observable, mean, sd, n } }
