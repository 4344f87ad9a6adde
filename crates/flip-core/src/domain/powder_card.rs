//! The card of a powder: how it leaves a spoon, from all shakes that are known of it
//! ([`card`](crate::card) makes it). All intervals hold 90 %.

use serde::{Deserialize, Serialize};

/// A mean with its interval of 90 %.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Mean.
    pub mean: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

/// Length of a stroke, by its share of the largest one made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StrokeClass {
    /// Above 0.71.
    Full,
    /// Above 0.35.
    Half,
    /// Above 0.18; gentler ones are in no curve.
    Quarter,
}

/// Strokes of one class in one range of pitch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CardCell {
    /// Mean pitch, deg.
    pub pitch_deg: f64,
    /// Readings.
    pub n: usize,
    /// Mean mass of a stroke, mg.
    pub mean_mg: f64,
    /// SD of the mass of a stroke, mg; `None` for one reading.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sd_mg: Option<f64>,
    /// Interval of the mean, mg; `None` if no cell of the curve has two readings.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub band_mg: Option<[f64; 2]>,
}

/// Mass of a stroke over the pitch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CardCurve {
    /// Its strokes.
    pub stroke: StrokeClass,
    /// Their mean amplitude, mm.
    pub shake_mm: f64,
    /// By pitch.
    pub cells: Vec<CardCell>,
}

/// What stays in the spoon.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Left {
    /// Spoonfuls that were shaken to their end.
    pub spoonfuls: usize,
    /// Mass, mg; below zero where more was filled in than is known.
    pub mass_mg: Estimate,
    /// As a share of the filling.
    pub share: Estimate,
}

/// How a powder leaves a spoon.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct PowderCard {
    /// Spoonfuls that are known.
    pub spoonfuls: usize,
    /// Their readings after strokes.
    pub shakes: usize,
    /// Why the card has no numbers; `None` if it has.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub missing: Option<String>,
    /// Pitch at which it begins to flow, deg.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub onset_deg: Option<Estimate>,
    /// Spoonfuls of which nothing fell.
    #[serde(default)]
    pub never_flowed: usize,
    /// Increase of the logarithm of the mass with the pitch, 1/deg; `None` if it flowed at one pitch
    /// only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slope_per_deg: Option<Estimate>,
    /// SD of the logarithm of the mass of a stroke; `None` without repeats.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scatter: Option<f64>,
    /// What stays; `None` if no spoonful was shaken to its end, or fillings are unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left: Option<Left>,
    /// From the longest stroke to the shortest.
    #[serde(default)]
    pub curves: Vec<CardCurve>,
}
