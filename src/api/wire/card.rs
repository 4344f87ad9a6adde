//! Probing runs, and the card of a powder.

use super::{BenchKind, Day, Labels, Timestamp, Verdict, VialCheck};
use crate::app;
use flip_core::domain::powder_card;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Which powder to probe.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CharacterisationRequest {
    /// Powder id.
    pub powder: String,
    /// Fillings of the spoon, 1 to 9: full, half and quarter strokes in turn; default 3. A bench
    /// where a person fills the spoon makes one.
    pub spoonfuls: Option<u32>,
    /// Most that may fall altogether, mg, 1 to 1000; default one spoonful more than are made.
    pub limit_mg: Option<f64>,
    /// Policy id, which sets the range of the pitch; default as for a weighing.
    pub policy: Option<String>,
    /// Seed of the simulated bench; by default each run gets its own.
    pub seed: Option<u64>,
    /// Extended simulator version, `sv-…`; default the base.
    #[serde(default)]
    pub simulator: Option<String>,
    /// Conditions of the version on the simulated bench.
    #[serde(default)]
    #[schema(value_type = std::collections::BTreeMap<String, super::Condition>)]
    pub conditions: Day,
    /// Lot of the powder.
    #[serde(default)]
    pub lot: Option<String>,
    /// Label of the vial on the pan; it is discarded afterwards.
    #[serde(default)]
    pub vial: Option<String>,
    /// Name of the operator.
    #[serde(default)]
    pub operator: Option<String>,
    /// Whether a person must confirm that the vial is in (POST /v1/weighings/{id}/vial-ready),
    /// where the bench cannot exchange vials.
    #[serde(default)]
    pub vial_check: VialCheck,
    /// The bench reservation under which the request is made, `rs-…`, if any.
    #[serde(default)]
    pub reservation: Option<String>,
    /// What the caller writes on it, to find it again.
    #[serde(default)]
    pub labels: Labels,
}

request! { CharacterisationRequest => app::CharacterisationRequest {
    powder, spoonfuls, limit_mg, policy, seed, simulator, conditions, lot, vial, operator,
    vial_check, reservation, labels,
} }

/// The card of a powder, and what it is of.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct CardOfPowder {
    /// Powder id.
    pub powder: String,
    /// Only of this lot; absent for all, and unknown ones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lot: Option<String>,
    /// Of weighings on this bench, and imported spoonfuls; absent for every bench.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bench: Option<BenchKind>,
    /// Where its spoonfuls come from.
    pub lots: Vec<LotOnCard>,
    /// When the last weighing with a shake began, or the last spoonful was imported.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub last_at: Option<Timestamp>,
    /// What the newest investigation of its shakes said; absent if there was none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub judged: Option<JudgedSpoon>,
    /// The numbers.
    pub card: PowderCard,
}

answer! { app::CardOfPowder => CardOfPowder { powder, lot, bench, lots, last_at, card, judged,
} }

/// What an investigation said of a powder's shakes.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct JudgedSpoon {
    /// The investigation.
    pub investigation: String,
    /// Whether the simulated spoon is wrong, and whether the cause has a name.
    pub verdict: Verdict,
    /// In plain words.
    pub sentence: String,
    /// The version of the simulator made from it; absent if none was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub simulator: Option<String>,
}

answer! { app::JudgedSpoon => JudgedSpoon { investigation, verdict, sentence, simulator } }

/// Spoonfuls of a lot.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LotOnCard {
    /// Its name; absent if unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lot: Option<String>,
    /// Spoonfuls.
    pub spoonfuls: usize,
}

answer! { app::LotOnCard => LotOnCard { lot, spoonfuls } }

/// How a powder leaves a spoon. All intervals hold 90 %.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PowderCard {
    /// Spoonfuls that are known.
    pub spoonfuls: usize,
    /// Their readings after strokes.
    pub shakes: usize,
    /// Why the card has no numbers; absent if it has.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub missing: Option<String>,
    /// Pitch at which it begins to flow, deg: where the first 0.5 mg of a spoonful, or three SD of
    /// the balance, had fallen; 5 deg beyond the last pitch if nothing fell.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub onset_deg: Option<Estimate>,
    /// Spoonfuls of which nothing fell.
    pub never_flowed: usize,
    /// Increase of ln(mg + 0.3 mg) of a stroke with the pitch, from the onset on until half of the
    /// filling has fallen, 1/deg; absent if it flowed at one pitch only.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slope_per_deg: Option<Estimate>,
    /// SD of ln(mg + 0.3 mg) of a stroke from the onset on, at one pitch; absent without repeats.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scatter: Option<f64>,
    /// What stays in the spoon; absent if no spoonful was shaken to its end, or fillings are
    /// unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left: Option<Left>,
    /// Mass of a stroke over the pitch, from the longest stroke to the shortest. Readings
    /// after several strokes, and of a spoon that has released 85 % of its filling, are left out.
    pub curves: Vec<CardCurve>,
}

answer! { powder_card::PowderCard => PowderCard {
    spoonfuls, shakes, missing, onset_deg, never_flowed, slope_per_deg, scatter, left, curves,
} }

/// A mean with its interval of 90 %.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Estimate {
    /// Mean.
    pub mean: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

answer! { powder_card::Estimate => Estimate { mean, low, high } }

/// What stays in the spoon after eight full strokes or more at the steepest pitch.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Left {
    /// Spoonfuls that were shaken to their end.
    pub spoonfuls: usize,
    /// Mass, mg; below zero where more was filled in than is known.
    pub mass_mg: Estimate,
    /// As a share of the filling.
    pub share: Estimate,
}

answer! { powder_card::Left => Left { spoonfuls, mass_mg, share } }

/// Mass of a stroke over the pitch.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct CardCurve {
    /// Its strokes.
    pub stroke: StrokeClass,
    /// Their mean amplitude, mm.
    pub shake_mm: f64,
    /// By pitch, in ranges of 4 deg.
    pub cells: Vec<CardCell>,
}

answer! { powder_card::CardCurve => CardCurve { stroke, shake_mm, cells } }

/// Length of a stroke, by its share of the largest one made.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum StrokeClass {
    /// Above 0.71.
    Full,
    /// Above 0.35.
    Half,
    /// Above 0.18; gentler ones are in no curve.
    Quarter,
}

answer! { powder_card::StrokeClass => enum StrokeClass { Full, Half, Quarter } }

/// Strokes of one class in one range of pitch.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct CardCell {
    /// Mean pitch, deg.
    pub pitch_deg: f64,
    /// Readings.
    pub n: usize,
    /// Mean mass of a stroke, mg.
    pub mean_mg: f64,
    /// SD of the mass of a stroke, mg; absent for one reading.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sd_mg: Option<f64>,
    /// Interval of the mean, mg, with the spread pooled over the curve; absent without repeats.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub band_mg: Option<[f64; 2]>,
}

answer! { powder_card::CardCell => CardCell { pitch_deg, n, mean_mg, sd_mg, band_mg } }
