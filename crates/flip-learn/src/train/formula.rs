//! A spoon that follows a formula: simulates the task in microseconds, for tests and benchmarks of
//! the learner.

use super::environment::{Filling, Spoon};
use flip_core::domain::bench::{Action, PitchLimits};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Fills [`FormulaSpoon`]s.
#[derive(Debug, Clone, Copy)]
pub struct Formula {
    /// Range of the pitch.
    pub pitch: PitchLimits,
}

/// A shake pours a random share of a dose that grows exponentially with the pitch and shrinks with
/// friction.
///
/// ```text
/// m = 0.08 mg/mm * amplitude * exp(0.09 (pitch - 12 friction)) * u,   u ~ U(0.7, 1.3)
/// ```
///
/// Not a real powder, but with the same difficulties: nothing comes at first, much comes late, and
/// no two shakes are alike. The log-linear rise with tilt matches salt taps on real spoons.
#[derive(Debug, Clone)]
pub struct FormulaSpoon {
    pitch: PitchLimits,
    friction: f64,
    pitch_deg: f64,
    vial_mg: f64,
    left_mg: f64,
    rng: Pcg64Mcg,
}

impl Filling for Formula {
    type Spoon = FormulaSpoon;
    fn fill(&self, set: &ParameterSet, seed: u64) -> FormulaSpoon {
        FormulaSpoon {
            pitch: self.pitch,
            friction: set.friction(),
            pitch_deg: 0.0,
            vial_mg: 0.0,
            left_mg: 37.0,
            rng: Pcg64Mcg::seed_from_u64(derive(seed, &[0])),
        }
    }
}

impl Spoon for FormulaSpoon {
    fn step(&mut self, action: Action) {
        self.pitch_deg = (self.pitch_deg + action.incline_change_deg)
            .clamp(self.pitch.lower_deg, self.pitch.upper_deg);
        let share = self.rng.random_range(0.7..1.3);
        let dose = 0.08
            * action.executed_shake_mm()
            * (0.09 * (self.pitch_deg - 12.0 * self.friction)).exp()
            * share;
        let dose = dose.min(self.left_mg);
        self.left_mg -= dose;
        self.vial_mg += dose;
    }
    fn pitch_deg(&self) -> f64 {
        self.pitch_deg
    }
    fn vial_mg(&self) -> f64 {
        self.vial_mg
    }
}
