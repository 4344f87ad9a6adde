//! The published method, Algorithm 1 of arXiv:2506.03896.
//!
//! Bayesian optimisation of the error E = |AoR_real - AoR_sim| over the nine parameters, one
//! simulation per iteration, within shrinking bounds:
//!
//! ```text
//! E < accept            the set joins the solutions; over when there are as many as wanted
//! else k >= stagnation  the bounds become the range of the best tenth of the history, and k = 0
//! ```
//!
//! with k the iterations since the bounds last changed. It also ends when every side of the bounds
//! is below [`EXHAUSTED`] of its initial width, or when the budget is used up. Of all sets those
//! within the tolerance are retained, and of these the best, as many as wanted. The publication
//! does not describe its verification; here every retained set is verified with fresh seeds, which
//! does not change the selection.
//!
//! The publication names neither kernel nor acquisition. Here: a Gaussian process of E with the
//! Matern-5/2 kernel and one lengthscale per parameter, an initial Latin hypercube, and the
//! expected improvement on the least error, over a pool within the bounds.

use super::settings::Settings;
use super::space::{Point, Space};
use super::trial::{CalibratedSet, Phase, Planned, Trial};
use super::verify::verdict;
use flip_core::domain::parameters::COUNT;
use flip_core::domain::powder::Flowability;
use flip_core::domain::seed::derive;
use flip_core::stats::gaussian_process::evidence::Prior;
use flip_core::stats::gaussian_process::{GaussianProcess, Prediction};
use flip_core::stats::latin_hypercube::{latin_hypercube, maximin_latin_hypercube};
use flip_core::stats::normal::{cdf, pdf};
use rand::SeedableRng;
use rand_pcg::Pcg64;

/// The search space is exhausted when every side is below this share of its initial width. Our
/// choice; the publication gives no number.
const EXHAUSTED: f64 = 0.05;
/// Share of the history whose range becomes the new bounds.
const BEST: f64 = 0.1;
/// Number of points at which the expected improvement is compared.
const POOL: usize = 2000;

/// Plans the next simulations; empty when the calibration is over.
pub(super) fn plan(trials: &[Trial], settings: &Settings, space: &Space) -> Vec<Planned> {
    if trials.iter().any(|trial| trial.phase == Phase::Verification) {
        return Vec::new();
    }
    if let Some(state) = State::after(trials, settings) {
        return state.next(trials, settings, space).into_iter().collect();
    }
    let kept = kept(trials, settings).into_iter();
    let runs = kept.flat_map(|trial| {
        (1..=settings.verify_repeats).map(|repeat| Planned::verification(trial, repeat, settings))
    });
    runs.collect()
}

/// The retained sets, best first, each with its verification result.
pub(super) fn sets(
    trials: &[Trial],
    target: &Flowability,
    settings: &Settings,
) -> Vec<CalibratedSet> {
    let verified = |trial: &Trial| {
        let set = verdict(trial.index, trials, target, settings)?;
        Some(CalibratedSet { error_deg: trial.error_deg?, ..set })
    };
    kept(trials, settings).into_iter().filter_map(verified).collect()
}

/// The best search trials within the tolerance, as many as wanted, best first.
fn kept<'a>(trials: &'a [Trial], settings: &Settings) -> Vec<&'a Trial> {
    let mut kept: Vec<&Trial> = ranked(trials);
    kept.retain(|trial| trial.error_deg.is_some_and(|error| error <= settings.tolerance_deg));
    kept.truncate(settings.sets as usize);
    kept
}

/// Search trials that produced a heap, least error first.
fn ranked(trials: &[Trial]) -> Vec<&Trial> {
    let mut ranked: Vec<&Trial> = trials
        .iter()
        .filter(|trial| trial.phase == Phase::Search && trial.error_deg.is_some())
        .collect();
    ranked.sort_by(|a, b| {
        f64::total_cmp(&a.error_deg.unwrap_or(f64::MAX), &b.error_deg.unwrap_or(f64::MAX))
    });
    ranked
}

/// The state of the algorithm.
struct State {
    /// Lower and upper bound of each parameter in the unit cube.
    bounds: [[f64; 2]; COUNT],
}

impl State {
    /// The state after these trials; none when the search is over.
    fn after(trials: &[Trial], settings: &Settings) -> Option<Self> {
        let mut bounds = [[0.0, 1.0]; COUNT];
        let (mut k, mut solutions) = (0, 0);
        let searched = trials.iter().take_while(|trial| trial.phase == Phase::Search).count();
        for (n, trial) in trials[..searched].iter().enumerate() {
            k += 1;
            if trial.error_deg.is_some_and(|error| error < settings.accept_deg) {
                solutions += 1;
            } else if k >= settings.stagnation {
                bounds = range(&trials[..=n]);
                k = 0;
            }
        }
        let exhausted = bounds.iter().all(|[low, high]| high - low < EXHAUSTED);
        let over =
            exhausted || solutions >= settings.sets || searched >= settings.trials_max as usize;
        (!over).then_some(Self { bounds })
    }

    fn next(&self, trials: &[Trial], settings: &Settings, space: &Space) -> Option<Planned> {
        let index = trials.len() as u32;
        let initial = settings.initial.min(settings.trials_max) as usize;
        let point = match trials.get(..initial) {
            None => {
                let mut rng = Pcg64::seed_from_u64(derive(settings.seed, &[super::PROPOSALS]));
                *maximin_latin_hypercube(initial, 50, &mut rng).get(trials.len())?
            }
            Some(_) => self.most_promising(trials, settings, space),
        };
        Some(Planned::search(index, space.parameters_at(&point), settings.seed))
    }

    /// The point with the largest expected improvement within the bounds.
    fn most_promising(&self, trials: &[Trial], settings: &Settings, space: &Space) -> Point {
        let mut rng =
            Pcg64::seed_from_u64(derive(settings.seed, &[super::PROPOSALS, trials.len() as u64]));
        let within = |point: Point| {
            space.project(std::array::from_fn(|k| {
                self.bounds[k][0] + point[k] * (self.bounds[k][1] - self.bounds[k][0])
            }))
        };
        let pool: Vec<Point> = latin_hypercube(POOL, &mut rng).into_iter().map(within).collect();
        let seen = ranked(trials);
        let inputs: Vec<Point> = seen.iter().map(|trial| trial.parameters.to_unit()).collect();
        let errors: Vec<f64> = seen.iter().filter_map(|trial| trial.error_deg).collect();
        let Ok(error) = GaussianProcess::fit(&inputs, &errors, &Prior::default()) else {
            return pool[0];
        };
        let least = errors.first().copied().unwrap_or(0.0);
        let worth = |point: &Point| improvement(error.predict(point), least);
        let order = |a: &Point, b: &Point| worth(a).total_cmp(&worth(b));
        pool.into_iter().max_by(order).expect("the pool is not empty")
    }
}

/// E max(least - E, 0) for E ~ N(mean, sd): the expected improvement of Mockus (1975).
fn improvement(at: Prediction, least: f64) -> f64 {
    let gap = least - at.mean;
    if at.sd <= 0.0 {
        return gap.max(0.0);
    }
    (gap * cdf(gap / at.sd) + at.sd * pdf(gap / at.sd)).max(0.0)
}

/// The range of the best tenth of the search trials, at least two of them.
fn range(trials: &[Trial]) -> [[f64; 2]; COUNT] {
    let ranked = ranked(trials);
    let best = ((BEST * ranked.len() as f64).ceil() as usize).max(2).min(ranked.len());
    let points: Vec<Point> =
        ranked[..best].iter().map(|trial| trial.parameters.to_unit()).collect();
    std::array::from_fn(|k| {
        let sides = points.iter().map(|point| point[k]);
        [sides.clone().fold(1.0, f64::min), sides.fold(0.0, f64::max)]
    })
}
