//! A spoon in microseconds, for tests that dose thousands of times.

use super::spoon::{Pour, Spoon};
use flip_core::domain::bench::Action;
use flip_core::domain::seed::derive;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Amplitude to which [`Flow::level_mg`] refers, mm.
const REFERENCE_MM: f64 = 8.0;

/// How powder flows from a spoon.
///
/// ```text
/// mean = m0 exp(p / e) (A / 8)^n / (1 + exp(-(p - p0) / w))
/// mass = min(mean exp(s z - s^2 / 2), held)        s^2 = ln(1 + CV^2),  z ~ N(0, 1)
/// ```
///
/// | symbol | field | unit |
/// |---|---|---|
/// | p, A | pitch, executed amplitude | deg, mm |
/// | m0, e, n | `level_mg`, `e_fold_deg`, `power` | mg, deg, 1 |
/// | p0, w | `onset_deg`, `onset_width_deg` | deg |
/// | CV | `variation` | 1 |
///
/// Source: the defaults m0 and e are those of table salt from a tapped tube, ln(mg per tap) =
/// -1.22 + 0.0458 deg from 0 to 60 deg with a CV from 0.4 to 0.8 (the weighing notes, real data).
/// Differs: a tap has no amplitude; the exponent of the amplitude is a guess.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flow {
    /// Mean mass of a shake of 8 mm at level, far above the onset, mg. Default 0.295.
    pub level_mg: f64,
    /// Pitch over which the mean grows e-fold, deg. Default 21.8.
    pub e_fold_deg: f64,
    /// Exponent of the amplitude. Default 1.5.
    pub power: f64,
    /// Pitch from which powder leaves, deg. Default 5.
    pub onset_deg: f64,
    /// Width of the onset, deg. Default 2.
    pub onset_width_deg: f64,
    /// Coefficient of variation of one shake. Default 0.5.
    pub variation: f64,
    /// Mass of a full spoon, mg. Default 40.
    pub capacity_mg: f64,
}

impl Default for Flow {
    fn default() -> Self {
        Self {
            level_mg: 0.295,
            e_fold_deg: 21.8,
            power: 1.5,
            onset_deg: 5.0,
            onset_width_deg: 2.0,
            variation: 0.5,
            capacity_mg: 40.0,
        }
    }
}

impl Flow {
    /// Mean mass of one shake, mg.
    pub fn mean_mg(&self, pitch_deg: f64, shake_mm: f64) -> f64 {
        if shake_mm <= 0.0 {
            return 0.0;
        }
        let open = 1.0 / (1.0 + libm::exp(-(pitch_deg - self.onset_deg) / self.onset_width_deg));
        self.level_mg
            * libm::exp(pitch_deg / self.e_fold_deg)
            * libm::pow(shake_mm / REFERENCE_MM, self.power)
            * open
    }
}

/// A spoon that follows a [`Flow`]. Empty until it is filled; the same seed and motions yield the
/// same masses.
#[derive(Debug, Clone, PartialEq)]
pub struct FormulaSpoon {
    flow: Flow,
    seed: u64,
    shakes: u64,
    pitch_deg: f64,
    held_mg: f64,
    kept_mg: f64,
}

impl FormulaSpoon {
    /// An empty spoon for this powder.
    pub fn new(flow: Flow, seed: u64) -> Self {
        Self { flow, seed, shakes: 0, pitch_deg: 0.0, held_mg: 0.0, kept_mg: 0.0 }
    }

    /// A log-normal factor of mean 1, cut at 3 sd so that a test can rely on it.
    fn scatter(&self) -> f64 {
        let mut rng = Pcg64Mcg::seed_from_u64(derive(self.seed, &[self.shakes]));
        let spread = libm::log(1.0 + self.flow.variation * self.flow.variation).sqrt();
        let (u, v): (f64, f64) = (rng.random(), rng.random());
        let normal = (-2.0 * libm::log(1.0 - u)).sqrt() * libm::cos(std::f64::consts::TAU * v);
        libm::exp(spread * normal.clamp(-3.0, 3.0) - spread * spread / 2.0)
    }
}

impl Spoon for FormulaSpoon {
    fn step(&mut self, action: Action) -> Pour {
        self.pitch_deg += action.incline_change_deg;
        let mean = self.flow.mean_mg(self.pitch_deg, action.shake_mm);
        if mean <= 0.0 {
            return Pour::default();
        }
        self.shakes += 1;
        let mass_mg = (mean * self.scatter()).min(self.held_mg);
        self.held_mg -= mass_mg;
        Pour { mass_mg }
    }

    fn keep(&mut self, mass_mg: f64) {
        self.kept_mg += mass_mg;
    }

    fn refill(&mut self) {
        (self.held_mg, self.kept_mg) = (self.flow.capacity_mg, 0.0);
    }

    fn empty(&mut self) {
        (self.held_mg, self.kept_mg) = (0.0, 0.0);
    }

    fn pitch_deg(&self) -> f64 {
        self.pitch_deg
    }

    fn held_mg(&self) -> f64 {
        self.held_mg + self.kept_mg
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_grows_e_fold_with_pitch_and_as_a_power_of_the_amplitude() {
        let flow = Flow { onset_deg: -100.0, ..Flow::default() };
        assert!(
            (flow.mean_mg(21.8, 8.0) / flow.mean_mg(0.0, 8.0) - std::f64::consts::E).abs() < 1e-9
        );
        assert!((flow.mean_mg(30.0, 16.0) / flow.mean_mg(30.0, 8.0) - 2f64.powf(1.5)).abs() < 1e-9);
        let late = Flow { onset_deg: 30.0, ..Flow::default() };
        assert!(late.mean_mg(20.0, 8.0) < 0.01 * late.mean_mg(40.0, 8.0));
    }

    #[test]
    fn shakes_scatter_as_asked_for_around_their_mean() {
        let flow = Flow { capacity_mg: 1e9, ..Flow::default() };
        let mut spoon = FormulaSpoon::new(flow, 3);
        spoon.refill();
        spoon.step(Action::once(40.0, 0.0));
        let shake = Action::once(0.0, 8.0);
        let masses: Vec<f64> = (0..4000).map(|_| spoon.step(shake).mass_mg).collect();
        let mean = masses.iter().sum::<f64>() / 4000.0;
        let sd = (masses.iter().map(|mass| (mass - mean).powi(2)).sum::<f64>() / 4000.0).sqrt();
        // The mean of 4000 has an error of 0.8 %; the cut at 3 sd takes a little of the spread.
        assert!((mean / flow.mean_mg(40.0, 8.0) - 1.0).abs() < 0.03, "{mean}");
        assert!((sd / mean - 0.5).abs() < 0.05, "{sd}");
    }

    #[test]
    fn no_more_falls_than_is_held_and_the_same_seed_gives_the_same() {
        let course = |seed| {
            let mut spoon = FormulaSpoon::new(Flow::default(), seed);
            spoon.refill();
            let poured: f64 = (0..60).map(|_| spoon.step(Action::once(0.8, 16.0)).mass_mg).sum();
            (poured, spoon.held_mg())
        };
        assert!((course(1).0 - 40.0).abs() < 1e-9 && course(1).1.abs() < 1e-9);
        assert_eq!(course(2), course(2));
    }
}
