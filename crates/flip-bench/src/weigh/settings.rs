//! Settings of the weighing loop.

use super::forecast::Forecast;
use super::result::Accuracy;
use flip_core::domain::vial::PanCheck;
use flip_core::domain::weighing::Probe;

/// Powders of a larger angle of repose must be agitated (USP <1174>).
pub(super) const AGITATED_DEG: f64 = 45.0;

/// Probability that a spoonful of a powder stops flowing while powder is left in it, by its angle
/// of repose.
///
/// The flow classes are those of USP <1174>: up to 40 deg no aid is needed, up to 45 deg it may hang
/// up, above it must be agitated. The probabilities are ours: far above that of a display that is
/// stuck, which silent shakes are taken for otherwise. `None`: not measured.
pub fn hangs(repose_deg: Option<f64>) -> f64 {
    match repose_deg {
        Some(deg) if deg > AGITATED_DEG => 0.3,
        Some(deg) if deg > 40.0 => 0.1,
        _ => 0.0,
    }
}

/// Settings of the weighing loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// How long the balance is watched before the first motion and for the final reading, s; 0: not
    /// at all, the last reading of the dose counts.
    pub stand_s: f64,
    /// Minimum time over which the display is averaged (after the tare, before the dose ends, at
    /// the end), s; 0: not at all, the tare is the zero and a single reading the result.
    pub rest_s: f64,
    /// Maximum time of the same, while its wander leaves the mean uncertain, s.
    pub rest_max_s: f64,
    /// Longest time from the tare to the last motion, s.
    pub seconds_max: f64,
    /// How long to wait for the display to change before the next shake, if it did not change at
    /// the last one, s; 0: no wait.
    pub life_s: f64,
    /// A spoon that releases nothing, and mass that appears without a shake, end the weighing; and
    /// what a stuck powder needs is tried before (`ladder.rs`).
    pub strict: bool,
    /// Probability that a spoonful of the powder stops flowing while powder is left in it
    /// ([`hangs`]).
    pub hangs: f64,
    /// Share of silent shakes in earlier spoonfuls of the powder while they flowed, if known.
    pub silent_share: Option<f64>,
    /// Pitch at which the powder began to flow in earlier spoonfuls, degrees, if known.
    pub onset_deg: Option<f64>,
    /// What a full spoon holds, mg, if known.
    pub spoon_mg: Option<f64>,
    /// Most fillings of the spoon for one dose, where the bench can fill it.
    pub spoonfuls_max: u32,
    /// Prior for the powder; `None`: the guard uses no forecast.
    pub forecast: Option<Forecast>,
    /// Known accuracy of the balance.
    pub accuracy: Accuracy,
    /// What the display must show before anything moves, if the balance is watched then.
    pub pan: PanCheck,
    /// Probe the powder instead of dosing it; the target of the order is the most that may fall.
    pub probe: Option<Probe>,
}

impl Settings {
    /// On a bench: watched for three seconds, averaged over ten to twenty, ten minutes at most, a
    /// display that changes within a minute, a powder about which nothing is known.
    pub const BENCH: Self = Self {
        stand_s: 3.0,
        rest_s: 10.0,
        rest_max_s: 20.0,
        seconds_max: 600.0,
        life_s: 60.0,
        strict: true,
        hangs: 0.0,
        silent_share: None,
        onset_deg: None,
        spoon_mg: None,
        spoonfuls_max: 3,
        forecast: Some(Forecast::GENERIC),
        accuracy: Accuracy { repeatability_mg: None, class_pct: 0.1 },
        pan: PanCheck::NONE,
        probe: None,
    };
    /// On a bench, for a target that may take several spoonfuls of `spoon_mg`: four times as many as
    /// full spoons hold it, as powder may miss the vial, and the time for each full one.
    pub fn for_target(target_mg: f64, spoon_mg: Option<f64>) -> Self {
        let full = spoon_mg.map_or(1.0, |spoon_mg| (target_mg / spoon_mg).ceil().max(1.0));
        // Casting saturates.
        let spoonfuls_max = Self::BENCH.spoonfuls_max.max(4 * full as u32);
        Self { spoonfuls_max, seconds_max: full * Self::BENCH.seconds_max, ..Self::BENCH }
    }

    /// As in a training episode: no watching, no forecast.
    pub const EPISODE: Self = Self {
        stand_s: 0.0,
        rest_s: 0.0,
        seconds_max: f64::INFINITY,
        life_s: 0.0,
        strict: false,
        spoonfuls_max: 1,
        forecast: None,
        ..Self::BENCH
    };
}
