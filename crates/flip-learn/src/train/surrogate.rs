//! A microsecond model of the spoon, fitted to simulated ones. Our own trainings start on it.
//!
//! The model is the dispenser's ([`flip_policy::Response`]): a loose mass, and the share of it
//! that a shake releases. The spoonful depends on the powder and on chance,
//!
//! ```text
//! (onset, ln slope, ln stroke) = B (1, d1 .. d5) + N(0, C)
//! ```
//!
//! with d the five numbers that the powder's parameter set reduces to ([`flip_sim::directions`]).
//! B, C and the model's other numbers are fitted to courses of simulated spoons over the whole
//! published box:
//!
//! ```text
//! cargo experiment shake_response -- box:300 1 1 -10 > box.csv
//! benches/dispenser/fit.py box.csv --by-directions
//! ```

use super::environment::{Filling, Spoon};
use flip_core::domain::bench::{Action, PitchLimits};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_policy::{Response, Spoonful, normal};
use flip_sim::{DIRECTIONS, directions};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

/// Fills [`SurrogateSpoon`]s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surrogate {
    /// Range of the pitch.
    pub pitch: PitchLimits,
    /// Spread between spoonfuls of one powder: 1 as in the simulator, 0 for none.
    pub spread: f64,
}

/// B: rows for the onset in degrees, ln slope in mg/deg and ln stroke in mm, each with a constant
/// and a coefficient for each direction.
const BY_DIRECTIONS: [[f64; 1 + DIRECTIONS]; 3] = [
    [-2.942, 37.38, -1.234, -1.348, 3.49, -24.916],
    [-0.148, 0.008, 0.942, -0.924, 0.071, 0.343],
    [7.247, 1.469, -3.435, -0.92, -0.333, -0.117],
];

/// The random part, and the parameters shared by all spoonfuls; the means are those of
/// [`BY_DIRECTIONS`].
const RESPONSE: Response = Response {
    onset_deg: [0.0, 21.92],
    ln_slope_mg_deg: [0.0, 1.07],
    ln_stroke_mm: [0.0, 1.09],
    correlations: [0.59, 0.83, 0.55],
    bend: 0.41,
    reach_deg: 5.6,
    width_deg: 0.02,
    floor: 0.076,
    scatter: 0.37,
    caution: 1.0,
    held_mg: 40.0,
    overdose_factor: 1.0,
};

/// A spoonful in use.
#[derive(Debug, Clone, PartialEq)]
pub struct SurrogateSpoon {
    pitch: PitchLimits,
    spoonful: Spoonful,
    seed: u64,
    pitch_deg: f64,
    vial_mg: f64,
}

impl Surrogate {
    /// Creates spoonfuls with the simulator's spread.
    pub fn new(pitch: PitchLimits) -> Self {
        Self { pitch, spread: 1.0 }
    }

    /// Means of onset, ln slope and ln stroke for a powder.
    fn means(set: &ParameterSet) -> [f64; 3] {
        let d = directions(set);
        BY_DIRECTIONS.map(|row| row[0] + row[1..].iter().zip(d).map(|(b, d)| b * d).sum::<f64>())
    }

    /// Draws a spoonful of this powder.
    fn spoonful(&self, set: &ParameterSet, seed: u64) -> Spoonful {
        let [onset, slope, stroke] = Self::means(set);
        let response = Response {
            onset_deg: [onset, RESPONSE.onset_deg[1]],
            ln_slope_mg_deg: [slope, RESPONSE.ln_slope_mg_deg[1]],
            ln_stroke_mm: [stroke, RESPONSE.ln_stroke_mm[1]],
            ..RESPONSE
        };
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        response.spoonful(std::array::from_fn(|_| self.spread * f64::from(normal(&mut rng))))
    }
}

impl Filling for Surrogate {
    type Spoon = SurrogateSpoon;
    fn fill(&self, set: &ParameterSet, seed: u64) -> SurrogateSpoon {
        SurrogateSpoon {
            pitch: self.pitch,
            spoonful: self.spoonful(set, derive(seed, &[0])),
            seed: derive(seed, &[1]),
            pitch_deg: 0.0,
            vial_mg: 0.0,
        }
    }
}

impl Spoon for SurrogateSpoon {
    fn step(&mut self, action: Action) {
        self.pitch_deg = (self.pitch_deg + action.incline_change_deg)
            .clamp(self.pitch.lower_deg, self.pitch.upper_deg);
        let mean = self.spoonful.mean_mg(
            &RESPONSE,
            self.pitch_deg,
            action.executed_shake_mm(),
            self.vial_mg,
        );
        if mean <= 0.0 {
            return;
        }
        // Grains that move slightly differently end elsewhere: the random draw depends on the whole
        // history, as in the simulator.
        self.seed = derive(self.seed, &[self.pitch_deg.to_bits(), action.shake_mm.to_bits()]);
        let z = normal(&mut Pcg64Mcg::seed_from_u64(self.seed));
        self.vial_mg = (self.vial_mg + RESPONSE.draw(mean, z.into())).min(RESPONSE.held_mg);
    }
    fn pitch_deg(&self) -> f64 {
        self.pitch_deg
    }
    fn vial_mg(&self) -> f64 {
        self.vial_mg
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_core::stats::summary::{mean, sd};

    const SURROGATE: Surrogate = Surrogate { pitch: PitchLimits::WIDE, spread: 1.0 };
    const SHAKE: Action = Action::once(8.0, 8.0);

    /// Masses of one dose after four shakes, each 8 deg higher, for many spoonfuls.
    fn masses(set: &ParameterSet) -> Vec<f64> {
        (0..400)
            .map(|seed| {
                let mut spoon = SURROGATE.fill(set, seed);
                (0..4).for_each(|_| spoon.step(SHAKE));
                spoon.vial_mg()
            })
            .collect()
    }

    #[test]
    fn friction_holds_powder_back_and_spoonfuls_differ() {
        let of = |friction| masses(&ParameterSet::default().with("friction", friction).unwrap());
        let (easy, hard) = (of(0.2), of(0.8));
        let error = (sd(&easy).unwrap().powi(2) + sd(&hard).unwrap().powi(2)).sqrt() / 20.0;
        assert!(mean(&easy).unwrap() > mean(&hard).unwrap() + 3.0 * error);
        assert!(easy.iter().chain(&hard).all(|mg| (0.0..=RESPONSE.held_mg).contains(mg)));
        assert!(sd(&easy).unwrap() > 1.0);
    }

    #[test]
    fn the_same_motions_give_the_same_mass_and_others_another() {
        let set = ParameterSet::default();
        let pour = |actions: &[Action]| {
            let mut spoon = SURROGATE.fill(&set, 7);
            actions.iter().for_each(|action| spoon.step(*action));
            (spoon.pitch_deg(), spoon.vial_mg())
        };
        assert_eq!(pour(&[SHAKE; 6]), pour(&[SHAKE; 6]));
        assert_eq!(pour(&[SHAKE; 9]).0, PitchLimits::WIDE.upper_deg);
        let gently = Action { shake_mm: 7.999, ..SHAKE };
        let (a, b) = (pour(&[SHAKE; 6]).1, pour(&[gently, SHAKE, SHAKE, SHAKE, SHAKE, SHAKE]).1);
        assert!((a - b).abs() > 1e-3, "{a} {b}");
    }

    #[test]
    fn without_a_shake_nothing_falls() {
        let mut spoon = SURROGATE.fill(&ParameterSet::default(), 1);
        (0..8).for_each(|_| spoon.step(Action::once(8.0, 0.0)));
        assert_eq!(spoon.vial_mg(), 0.0);
    }
}
