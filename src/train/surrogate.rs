//! A spoon in microseconds: what simulated ones were seen to do. Our own trainings begin on it.
//!
//! The model is the dispenser's ([`crate::policy::Response`]): a mass that is loose, and the share of it that a shake takes. Which spoonful it is
//! follows from the powder and from chance,
//!
//! ```text
//! (onset, ln slope, ln stroke) = B (1, d1 .. d5) + N(0, C)
//! ```
//!
//! with d the five numbers that the powder's parameter set folds into ([`crate::sim::directions`]). B, C and the model's other numbers are fitted to
//! courses of simulated spoons over the whole published box:
//!
//! ```text
//! cargo run --release --example shake_response -- box:300 1 1 -10 > box.csv
//! benches/dispenser/fit.py box.csv --by-directions
//! ```

use super::environment::{Filling, Spoon, Step};
use crate::domain::bench::{Action, PitchLimits};
use crate::domain::parameters::ParameterSet;
use crate::domain::seed::derive;
use crate::policy::{Response, Spoonful, normal};
use crate::sim::{DIRECTIONS, directions};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;

/// Fills [`SurrogateSpoon`]s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surrogate {
    /// Range of the pitch.
    pub pitch: PitchLimits,
    /// How much spoonfuls of one powder differ: 1 as simulated ones do, 0 not at all.
    pub spread: f64,
    /// Added to the means of onset, ln slope and ln stroke of every powder.
    pub shift: [f64; 3],
}

/// B: of the onset in degrees, of ln slope in mg/deg and of ln stroke in mm, each a constant and a number for each direction.
const BY_DIRECTIONS: [[f64; 1 + DIRECTIONS]; 3] = [
    [-2.942, 37.38, -1.234, -1.348, 3.49, -24.916],
    [-0.148, 0.008, 0.942, -0.924, 0.071, 0.343],
    [7.247, 1.469, -3.435, -0.92, -0.333, -0.117],
];

/// What is left to chance, and what all spoonfuls share; the means are those of [`BY_DIRECTIONS`].
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

/// A spoonful at work.
#[derive(Debug, Clone, PartialEq)]
pub struct SurrogateSpoon {
    pitch: PitchLimits,
    spoonful: Spoonful,
    seed: u64,
    pitch_deg: f64,
    vial_mg: f64,
}

impl Surrogate {
    /// Spoonfuls as simulated ones are.
    pub fn new(pitch: PitchLimits) -> Self {
        Self { pitch, spread: 1.0, shift: [0.0; 3] }
    }

    /// The shift with which the surrogate does most nearly what spoons of these powders did: the most likely mean when spoonfuls scatter about it as they
    /// do about the unshifted one.
    ///
    /// ```text
    /// E   w(c, j) ~ prod over the shaken steps of course c of t_4(sqrt(mass); sqrt(mean of spoonful j), sd)
    /// M   shift += mean over c of sum over j of w(c, j) (spoonful j - mean)
    /// ```
    ///
    /// Expectation maximisation (Dempster, Laird and Rubin 1977) over [`GUESSES`] spoonfuls; the likelihood is that of `benches/dispenser/fit.py`. Without
    /// courses, or where they show nothing, it stays what it is.
    pub fn shift_to(&self, courses: &[(ParameterSet, &[Step])]) -> [f64; 3] {
        let centred = Response { onset_deg: [0.0, RESPONSE.onset_deg[1]], ..RESPONSE };
        let mut rng = Pcg64Mcg::seed_from_u64(derive(0, &[]));
        let deviations: Vec<[f64; 3]> = (0..GUESSES)
            .map(|_| parts(&centred.spoonful(std::array::from_fn(|_| self.spread * f64::from(normal(&mut rng))))))
            .collect();
        let mut shift = self.shift;
        for _ in 0..ROUNDS {
            let means: Vec<[f64; 3]> = courses
                .par_iter()
                .map(|(set, steps)| {
                    let mean = Self { shift, ..*self }.means(set);
                    let logs: Vec<f64> =
                        deviations.iter().map(|by| log_likelihood(&of_parts(plus(mean, *by)), steps)).collect();
                    weighted(&logs, &deviations)
                })
                .collect();
            for mean in &means {
                shift = plus(shift, mean.map(|it| it / means.len() as f64));
            }
        }
        shift
    }

    /// Means of onset, ln slope and ln stroke of a powder.
    fn means(&self, set: &ParameterSet) -> [f64; 3] {
        let d = directions(set);
        plus(self.shift, BY_DIRECTIONS.map(|row| row[0] + row[1..].iter().zip(d).map(|(b, d)| b * d).sum::<f64>()))
    }

    /// What a spoonful of this powder does, as chance will have it.
    fn spoonful(&self, set: &ParameterSet, seed: u64) -> Spoonful {
        let [onset, slope, stroke] = self.means(set);
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

/// Spoonfuls that stand for all when the surrogate is shifted.
const GUESSES: usize = 256;
/// Rounds of expectation maximisation.
const ROUNDS: usize = 60;
/// Keeps the root of no mass away from nothing, mg.
const DUST_MG: f64 = 0.005;

/// Onset in degrees, ln slope and ln stroke.
fn parts(spoonful: &Spoonful) -> [f64; 3] {
    [spoonful.onset_deg, libm::log(spoonful.slope_mg_deg), libm::log(spoonful.stroke_mm)]
}

fn of_parts([onset_deg, slope, stroke]: [f64; 3]) -> Spoonful {
    Spoonful { onset_deg, slope_mg_deg: libm::exp(slope), stroke_mm: libm::exp(stroke) }
}

fn plus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| a[k] + b[k])
}

/// Of a course, if this was the spoonful; up to a constant.
fn log_likelihood(spoonful: &Spoonful, steps: &[Step]) -> f64 {
    let mut before_mg = 0.0;
    let mut sum = 0.0;
    for step in steps {
        let after_mg = f64::from(step.next_true_mg);
        let shake_mm = Action::from_unit(step.action.map(f64::from)).executed_shake_mm();
        if shake_mm > 0.0 {
            let mean = spoonful.mean_mg(&RESPONSE, step.next_pitch_deg.into(), shake_mm, before_mg) + DUST_MG;
            let sd = (RESPONSE.floor.powi(2) + RESPONSE.scatter.powi(2) * mean).sqrt();
            let z = ((after_mg - before_mg).max(0.0).sqrt() - mean.sqrt()) / sd;
            sum -= 2.5 * libm::log1p(z * z / 4.0) + libm::log(sd);
        }
        before_mg = after_mg;
    }
    sum
}

/// Mean with weights that are known by their logarithms.
fn weighted(logs: &[f64], of: &[[f64; 3]]) -> [f64; 3] {
    let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = logs.iter().map(|log| libm::exp(log - largest)).collect();
    let all: f64 = weights.iter().sum();
    let of = weights.iter().zip(of);
    of.fold([0.0; 3], |sum, (weight, it)| plus(sum, it.map(|x| x * weight / all)))
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
        self.pitch_deg = (self.pitch_deg + action.incline_change_deg).clamp(self.pitch.lower_deg, self.pitch.upper_deg);
        let mean = self.spoonful.mean_mg(&RESPONSE, self.pitch_deg, action.executed_shake_mm(), self.vial_mg);
        if mean <= 0.0 {
            return;
        }
        // Grains in slightly other motion end elsewhere: what chance gives depends on all that was done, as in the simulator.
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
    use super::super::environment::play;
    use super::*;
    use crate::stats::summary::{mean, sd};

    const SURROGATE: Surrogate = Surrogate { pitch: PitchLimits::WIDE, spread: 1.0, shift: [0.0; 3] };
    const SHAKE: Action = Action { incline_change_deg: 8.0, shake_mm: 8.0 };

    /// Mass of one dose after four shakes, each 8 deg higher, for many spoonfuls.
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
    fn a_shift_that_was_hidden_in_spoons_is_found() {
        let hidden = [8.0, -0.5, 0.6];
        let shifted = Surrogate { shift: hidden, ..SURROGATE };
        let sets = [0.3, 0.5, 0.7].map(|friction| ParameterSet::default().with("friction", friction).unwrap());
        let rules = crate::policy::Rules { steps_max: 16, ..crate::policy::Rules::PAPER };
        let balance = crate::sim::balance::Settings::default();
        let poured: Vec<(ParameterSet, Vec<Step>)> = (0..240u64)
            .map(|k| {
                let mut spoon = shifted.fill(&sets[k as usize % 3], k);
                let mut rng = Pcg64Mcg::seed_from_u64(derive(k, &[1]));
                let mut shake = || (0.5 + 0.5 * normal(&mut rng)).clamp(-1.0, 1.0);
                let steps = play(&mut spoon, &rules, &balance, 15.0, k, |_| [0.3 + 0.5 * shake(), shake()]).steps;
                (sets[k as usize % 3], steps)
            })
            .collect();
        let courses: Vec<_> = poured.iter().map(|(set, steps)| (*set, steps.as_slice())).collect();
        let found = SURROGATE.shift_to(&courses);
        // A shake much smaller than the stroke takes slope * (amplitude / stroke)^bend of each degree: slope and stroke are known together.
        let known = |shift: [f64; 3]| [shift[0], shift[1] - RESPONSE.bend * shift[2]];
        let [slope, stroke] = [RESPONSE.ln_slope_mg_deg[1], RESPONSE.bend * RESPONSE.ln_stroke_mm[1]];
        let together = (slope.powi(2) + stroke.powi(2) - 2.0 * RESPONSE.correlations[2] * slope * stroke).sqrt();
        // What 240 spoons can say: three times their own scatter over the root of their number.
        for (k, scatter) in [RESPONSE.onset_deg[1], together].into_iter().enumerate() {
            let (found, hidden) = (known(found)[k], known(hidden)[k]);
            let error = 3.0 * scatter / (courses.len() as f64).sqrt();
            assert!((found - hidden).abs() < error, "{k}: {found}, hidden {hidden}");
        }
        assert!(found[0] > 3.0, "{found:?}");
        assert_eq!(SURROGATE.shift_to(&[]), [0.0; 3]);
    }

    #[test]
    fn without_a_shake_nothing_falls() {
        let mut spoon = SURROGATE.fill(&ParameterSet::default(), 1);
        (0..8).for_each(|_| spoon.step(Action { incline_change_deg: 8.0, shake_mm: 0.0 }));
        assert_eq!(spoon.vial_mg(), 0.0);
    }
}
