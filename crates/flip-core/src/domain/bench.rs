//! The messages between a bench and its callers: actions out, readings back.

use super::rest::Rest;
use serde::{Deserialize, Serialize};

/// The devices behind a bench.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BenchKind {
    /// The simulator, called directly.
    Simulated,
    /// Emulated devices that speak their real protocols, with the simulator behind them.
    Emulated,
    /// Real devices.
    Devices,
}

impl BenchKind {
    /// Whether hardware could be left in an unsafe position when the process ends.
    pub fn has_devices(self) -> bool {
        self != Self::Simulated
    }

    /// Its name in JSON and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Simulated => "simulated",
            Self::Emulated => "emulated",
            Self::Devices => "devices",
        }
    }
}

/// Largest shake amplitude, mm.
pub const SHAKE_MM_MAX: f64 = 16.0;
/// An amplitude below this counts as no shake, mm (as on the published robot).
pub const SHAKE_MM_MIN: f64 = 0.9;
/// Largest change of the spoon's pitch in one step, degrees.
pub const INCLINE_CHANGE_DEG_MAX: f64 = 8.0;

/// Most strokes of one step.
pub const STROKES_MAX: u32 = 8;

/// What a policy proposes for one step: first incline, then shake.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Action {
    /// Change of the spoon's pitch, degrees; positive is tip down; -8 to 8.
    pub incline_change_deg: f64,
    /// Amplitude of one out-and-back shake along the spoon, mm; 0 to 16; below 0.9 there is no
    /// shake.
    pub shake_mm: f64,
    /// How often the shake is made before the balance is read; 1 to [`STROKES_MAX`].
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub strokes: u32,
}

fn one() -> u32 {
    1
}

fn is_one(strokes: &u32) -> bool {
    *strokes == 1
}

impl Default for Action {
    fn default() -> Self {
        Self::once(0.0, 0.0)
    }
}

impl Action {
    /// An incline, then one shake.
    pub const fn once(incline_change_deg: f64, shake_mm: f64) -> Self {
        Self { incline_change_deg, shake_mm, strokes: 1 }
    }

    /// Converts the two outputs of a policy in -1..=1: incline change first, then shake amplitude.
    pub fn from_unit(unit: [f64; 2]) -> Self {
        Self {
            incline_change_deg: unit[0].clamp(-1.0, 1.0) * INCLINE_CHANGE_DEG_MAX,
            shake_mm: (unit[1].clamp(-1.0, 1.0) + 1.0) / 2.0 * SHAKE_MM_MAX,
            strokes: 1,
        }
    }

    /// The inverse of [`Action::from_unit`].
    pub fn to_unit(&self) -> [f64; 2] {
        [self.incline_change_deg / INCLINE_CHANGE_DEG_MAX, 2.0 * self.shake_mm / SHAKE_MM_MAX - 1.0]
    }

    /// The executed amplitude: zero below [`SHAKE_MM_MIN`].
    pub fn executed_shake_mm(&self) -> f64 {
        if self.shake_mm < SHAKE_MM_MIN { 0.0 } else { self.shake_mm }
    }
}

/// One reading of the balance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// Net mass shown, mg; a multiple of the readability.
    pub mass_mg: f64,
    /// The balance's own stable flag.
    pub stable: bool,
}

/// One step of a weighing: the action and the balance reading after it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Tick {
    /// Step number; 0 is the reading after the tare, before any motion.
    pub step: u32,
    /// Bench time since the tare, seconds.
    pub t_s: f64,
    /// Pitch of the spoon after the step, degrees.
    pub pitch_deg: f64,
    /// The action as passed by the guard.
    pub action: Action,
    /// The settled balance reading.
    pub reading: Reading,
    /// Which filling of the spoon, from 1.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub spoonful: u32,
}

/// Range of the spoon's pitch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PitchLimits {
    /// Lowest pitch, degrees.
    pub lower_deg: f64,
    /// Highest pitch, degrees.
    pub upper_deg: f64,
}

impl PitchLimits {
    /// The published robot's limits.
    pub const PAPER: Self = Self { lower_deg: -10.0, upper_deg: 36.0 };
    /// FLIP's default: cohesive powders do not leave the spoon below 36 deg.
    pub const WIDE: Self = Self { lower_deg: -10.0, upper_deg: 50.0 };

    /// As far as an arm pitches: no upper limit of its own.
    pub const OPEN: Self = Self { lower_deg: -10.0, upper_deg: 90.0 };

    /// The intersection of two ranges; empty (upper below lower) if they do not overlap.
    #[must_use]
    pub fn within(self, other: Self) -> Self {
        Self {
            lower_deg: self.lower_deg.max(other.lower_deg),
            upper_deg: self.upper_deg.min(other.upper_deg),
        }
    }
}

/// The limits of an arm that holds a spoon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reach {
    /// Range of the pitch.
    pub pitch: PitchLimits,
    /// Largest amplitude of a shake, mm.
    pub shake_mm_max: f64,
}

impl Reach {
    /// No limits beyond those of an action.
    pub const FULL: Self = Self {
        pitch: PitchLimits { lower_deg: -90.0, upper_deg: 90.0 },
        shake_mm_max: SHAKE_MM_MAX,
    };

    /// The limits within this pitch range; `None` if dosing is impossible there: the spoon is never
    /// level, never tips down, or never shakes.
    pub fn of(&self, pitch: PitchLimits) -> Option<Self> {
        let pitch = pitch.within(self.pitch);
        let can_dose = pitch.lower_deg <= pitch.upper_deg
            && pitch.upper_deg > 0.0
            && self.shake_mm_max >= SHAKE_MM_MIN;
        can_dose.then_some(Self { pitch, ..*self })
    }
}

/// The tared mass.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Tare {
    /// Mass of the vial, mg; none if the balance does not report it.
    pub tare_mg: Option<f64>,
}

/// A balance reading at a point in time, with nothing moving.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    /// Bench time, s.
    pub t_s: f64,
    /// Displayed mass, mg.
    pub mass_mg: f64,
}

/// The result of watching a balance while nothing moved.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Standing {
    /// The last reading.
    pub reading: Reading,
    /// Whether every reading of the last part lay within one display step or the balance's noise:
    /// FLIP's own criterion, in addition to the balance's flag.
    pub still: bool,
    /// Slope of the readings, mg/min.
    pub drift_mg_min: f64,
    /// Standard deviation of the readings about that slope, mg.
    pub scatter_mg: f64,
    /// How long it was watched, s.
    pub seconds: f64,
    /// Statistics of the display at rest.
    pub rest: Rest,
}
