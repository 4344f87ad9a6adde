//! One emulator of the angle of repose for all powders, learned from all heaps of a design.
//!
//! A heap depends on [`DIRECTIONS`] numbers (`sim/directions.rs`), into which the nine parameters
//! fold. Over these
//!
//! ```text
//! angle of one reading = f(x) + e,   f ~ GP,   e ~ N(0, v(x))      ln v ~ GP
//! ```
//!
//! Each heap of the design is read several times. The readings of one heap are nearly as
//! independent as those of separate heaps, so their variance s^2 estimates v, and their mean has
//! the variance v (1 / readings + [`COMMON`]): for k = readings - 1
//! ```text
//! ln s^2 = ln v + ln(chi^2_k / k),     E ln(chi^2_k / k) = psi(k / 2) - ln(k / 2)
//! ```
//!
//! The design starts space-filling in the box of the nine parameters and continues, round by round,
//! where f is least certain. It is a pure function of the earlier runs, so an interrupted build
//! resumes and ends with the same bytes.

use super::space::{self, Point};
use super::trial::{Heap, Outcome, Planned, Pour, Trial};
use super::{Error, Simulate, in_order};
use flip_core::domain::job::Progress;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_core::stats::gaussian_process::evidence::{Fit, Prior};
use flip_core::stats::gaussian_process::{GaussianProcess, Prediction};
use flip_core::stats::latin_hypercube::{latin_hypercube, maximin_latin_hypercube};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use statrs::function::gamma::digamma;
use std::ops::ControlFlow;

/// Number of inputs a heap depends on.
pub const DIRECTIONS: usize = 5;
/// Maps a parameter set to these numbers, each 0 to 1.
pub type Directions = fn(&ParameterSet) -> [f64; DIRECTIONS];

/// The heaps an emulator is built from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Design {
    /// Total number of heaps.
    pub runs: u32,
    /// Heaps in the initial space-filling design.
    pub initial: u32,
    /// Heaps in each further round.
    pub round: u32,
    /// Readings of each heap, at least 2.
    pub readings: u32,
    /// Grains in each heap.
    pub particles: u32,
    /// Seed for every choice and heap.
    pub seed: u64,
}

impl Design {
    /// The production design for heaps of this many grains.
    pub fn with_particles(particles: u32) -> Self {
        Self { runs: 240, initial: 64, round: 22, readings: 4, particles, seed: 1 }
    }

    /// As many heaps in one round, for a graphics card, on which all of them take little longer than
    /// one. None of them is where the others left the most doubt, which costs nothing that 277 heaps
    /// could show (`cargo experiment emulator_rounds`).
    pub fn at_once(particles: u32) -> Self {
        let usual = Self::with_particles(particles);
        Self { initial: usual.runs, ..usual }
    }

    /// Content address of the design for this version of a simulator.
    pub fn id(&self, simulator: &str) -> String {
        let text = serde_json::to_string(&(simulator, self)).expect("numbers and text");
        format!("em-{}", &sha256(text.as_bytes())[..16])
    }
}

fn sha256(bytes: &[u8]) -> String {
    hex::encode(Sha256::digest(bytes))
}

/// Number of candidate points for the least certain ones.
const POOL: usize = 800;
/// Angles that powders have and calibrations request, degrees. Half of the box is steeper; points
/// far outside are not worth a heap.
pub(super) const ASKED: [f64; 2] = [20.0, 52.0];
/// Weight of the uncertainty about an angle outside this range.
const ELSEWHERE: f64 = 0.2;
/// Share of the variance of a reading that the readings of one heap have in common: the variance of
/// the mean of r readings is v (1/r + COMMON). Measured with ten sets at 29 deg, eight heaps of 16
/// readings each.
const COMMON: f64 = 0.09;

/// Builds an emulator.
///
/// | argument | meaning |
/// |----------|---------|
/// | `history` | heaps of an interrupted build of the same design, in order; replayed, never simulated again |
/// | `simulate` | pours heaps |
/// | `on_run` | called with every new heap (not the replayed ones) in order of its index; `Break` stops |
///
/// # Errors
/// [`Error`]
///
/// # Panics
/// As [`calibrate`](super::calibrate).
pub fn build(
    design: &Design,
    directions: Directions,
    history: &[Trial],
    simulate: impl Simulate<Pour, Heap>,
    mut on_run: impl FnMut(&Trial, &Progress) -> ControlFlow<()>,
) -> Result<Emulator, Error> {
    let mut runs: Vec<Trial> = Vec::new();
    while runs.len() < design.runs as usize {
        let round = plan(design, directions, &runs);
        let known = super::replay(&round, &mut runs, history, None)?;
        let new = &round[known..];
        let pours: Vec<Pour> = new.iter().map(|p| p.pour(design.particles)).collect();
        in_order(&simulate, &pours, |k, heap| {
            let run = new[k].clone().concluded(runs.len() as u32, Outcome::of(heap), None);
            runs.push(run.clone());
            let fraction = runs.len() as f64 / f64::from(design.runs);
            let message = format!("emulator, heap {} of {}", runs.len(), design.runs);
            on_run(&run, &Progress { fraction, message })
        })?;
    }
    Emulator::of(&runs, directions).ok_or(Error::NoHeap)
}

fn plan(design: &Design, directions: Directions, runs: &[Trial]) -> Vec<Planned> {
    let first = runs.len() as u32;
    let mut rng = Pcg64::seed_from_u64(derive(design.seed, &[super::PROPOSALS, u64::from(first)]));
    let points = match Emulator::of(runs, directions).filter(|_| first >= design.initial) {
        None => {
            let wanted = design.initial.saturating_sub(first).max(1).min(design.runs - first);
            maximin_latin_hypercube(wanted as usize, 20, &mut rng)
        }
        Some(emulator) => emulator.least_certain(
            design.round.min(design.runs - first) as usize,
            latin_hypercube(POOL, &mut rng),
        ),
    };
    let planned = (first..).zip(points);
    planned
        .map(|(k, point)| {
            Planned::search(k, space::parameters_at(&point), design.seed).read(design.readings)
        })
        .collect()
}

/// The angle of repose over the whole box.
#[derive(Debug, Clone)]
pub struct Emulator {
    angle: GaussianProcess<DIRECTIONS>,
    /// ln of the variance of one reading.
    spread: GaussianProcess<DIRECTIONS>,
    /// Variance of one reading in which the noise of `angle` is expressed, degrees squared.
    unit: f64,
    directions: Directions,
    hash: String,
    runs: u32,
}

/// The emulator's prediction of an angle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Mean over seeds, degrees, with its uncertainty.
    pub mean: Prediction,
    /// Standard deviation of one reading around that mean, degrees.
    pub seed_sd_deg: f64,
}

impl Emulator {
    /// Builds the emulator from simulated heaps; none if none of them has an angle.
    pub fn of(runs: &[Trial], directions: Directions) -> Option<Self> {
        let heaps: Vec<([f64; DIRECTIONS], f64, f64, u32)> = runs
            .iter()
            .filter_map(|run| match &run.outcome {
                Outcome::Heap(heap) => Some((
                    directions(&run.parameters),
                    heap.tip_deg,
                    heap.tip_sd_deg.unwrap_or(0.0),
                    run.readings,
                )),
                Outcome::Refused(_) => None,
            })
            .collect();
        let inputs: Vec<_> = heaps.iter().map(|heap| heap.0).collect();
        // If all readings of a heap were equal to within rounding, the logarithm would diverge.
        let logs: Vec<f64> = heaps
            .iter()
            .map(|(_, _, sd, readings)| 2.0 * sd.max(1e-3).ln() - log_bias(readings.max(&2) - 1))
            .collect();
        let smooth = Prior { lengthscale: (3.0, 0.5), signal_sd: (0.5, 0.5), noise_sd: (0.9, 0.3) };
        let spread = fitted(&inputs, &logs, &vec![1.0; inputs.len()], &smooth)?;
        let variance = |x: &[f64; DIRECTIONS]| spread.mean(x).exp();
        let unit = inputs.iter().map(variance).sum::<f64>() / inputs.len().max(1) as f64;
        let noise: Vec<f64> =
            heaps.iter().map(|(x, _, _, readings)| variance(x) / unit * share(*readings)).collect();
        let tips: Vec<f64> = heaps.iter().map(|heap| heap.1).collect();
        let angle = fitted(&inputs, &tips, &noise, &Prior::default())?;
        let hash = sha256(serde_json::to_string(runs).expect("numbers and text").as_bytes());
        Some(Self { angle, spread, unit, directions, hash, runs: runs.len() as u32 })
    }

    /// SHA-256 of the heaps it was built from.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// Number of heaps it was built from.
    pub fn runs(&self) -> u32 {
        self.runs
    }

    /// The numbers that a set reduces to.
    pub fn directions(&self, set: &ParameterSet) -> [f64; DIRECTIONS] {
        (self.directions)(set)
    }

    /// Predicts the angle of a set.
    pub fn expect(&self, set: &ParameterSet) -> Expected {
        let x = self.directions(set);
        Expected { mean: self.angle.predict(&x), seed_sd_deg: self.variance(&x).sqrt() }
    }

    /// Predicts only the mean, which costs a hundredth.
    pub fn mean_deg(&self, set: &ParameterSet) -> f64 {
        self.angle.mean(&self.directions(set))
    }

    fn variance(&self, x: &[f64; DIRECTIONS]) -> f64 {
        self.spread.mean(x).exp()
    }

    /// Returns the emulator with more heaps, used for its angle only.
    pub fn with(&self, trials: &[Trial]) -> Self {
        let seen = trials.iter().filter_map(|trial| {
            let x = self.directions(&trial.parameters);
            Some((
                x,
                trial.outcome.tip_deg()?,
                self.variance(&x) / self.unit * share(trial.readings),
            ))
        });
        let seen: Vec<_> = seen.collect();
        if seen.is_empty() {
            self.clone()
        } else {
            Self { angle: self.angle.observe(&seen), ..self.clone() }
        }
    }

    /// Selects the points of `pool` at which the angle is least certain, one after another, each as
    /// if those before it had been observed.
    fn least_certain(&self, count: usize, pool: Vec<Point>) -> Vec<Point> {
        let numbers: Vec<_> =
            pool.iter().map(|point| self.directions(&space::parameters_at(point))).collect();
        let mut angle = self.angle.clone();
        let mut chosen = Vec::new();
        for _ in 0..count {
            let doubt = |at: Prediction| match (ASKED[0]..=ASKED[1]).contains(&at.mean) {
                true => at.sd,
                false => ELSEWHERE * at.sd,
            };
            let doubts: Vec<f64> = numbers.par_iter().map(|x| doubt(angle.predict(x))).collect();
            let order = |a: &usize, b: &usize| doubts[*a].total_cmp(&doubts[*b]);
            let Some(best) = (0..pool.len()).max_by(order) else { break };
            angle = angle.believe(&numbers[best]);
            chosen.push(pool[best]);
        }
        chosen
    }
}

/// A fit with its searches side by side: where a card pours the heaps, one after another
/// they were half of the time.
fn fitted(
    inputs: &[[f64; DIRECTIONS]],
    outputs: &[f64],
    noise: &[f64],
    prior: &Prior,
) -> Option<GaussianProcess<DIRECTIONS>> {
    let fit = Fit::new(inputs, outputs, noise, prior).ok()?;
    let ends: Vec<_> = fit.starts().into_par_iter().map(|start| fit.end(start)).collect();
    fit.best(ends).ok()
}

/// Variance of the mean of a heap's readings over that of one reading.
pub(super) fn share(readings: u32) -> f64 {
    1.0 / f64::from(readings) + COMMON
}

/// E ln(chi^2_k / k) = psi(k / 2) - ln(k / 2).
fn log_bias(k: u32) -> f64 {
    let half = f64::from(k) / 2.0;
    digamma(half) - half.ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_of_the_logarithm_of_a_chi_square_is_known() {
        // psi(1/2) = -1.963510, psi(1) = -0.577216, psi(3/2) = 0.036490, psi(5) = 1.506118.
        for (k, psi) in [(1u32, -1.963_510), (2, -0.577_216), (3, 0.036_490), (10, 1.506_118)] {
            assert!((log_bias(k) - (psi - (f64::from(k) / 2.0).ln())).abs() < 1e-5, "{k}");
        }
    }
}
