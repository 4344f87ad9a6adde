//! Where to simulate next.

use super::acquisition::{expected_improvement, probability_within};
use super::settings::Settings;
use super::space::{Point, Space};
use super::trial::Trial;
use flip_core::domain::parameters::COUNT;
use flip_core::stats::gaussian_process::evidence::Prior;
use flip_core::stats::gaussian_process::{GaussianProcess, Prediction};
use flip_core::stats::latin_hypercube::{distance, latin_hypercube};
use flip_core::stats::normal::cdf;
use rand::{Rng, RngExt};

/// Number of space-filling points at which the acquisition is compared.
const POOL: usize = 1000;
/// Number of further points around the best of them, for each of the [`REACHES`].
const AROUND: usize = 100;
/// Half-widths of the boxes around the best point so far, in sides of the cube.
const REACHES: [f64; 3] = [0.2, 0.05, 0.01];
/// Distance in the unit cube within which two sets count as similar; two random points are about
/// 1.2 apart.
const ALIKE: f64 = 0.5;

/// Beliefs from the trials so far: the angle over the whole box, and where a simulation is refused.
pub(super) struct Belief {
    angle: GaussianProcess<COUNT>,
    /// Regression on 1 (heap) and 0 (refused); none as long as nothing was refused.
    heaps: Option<GaussianProcess<COUNT>>,
    target_deg: f64,
}

impl Belief {
    /// Fits the beliefs to all trials of both phases. None as long as no trial has an angle.
    pub fn of(trials: &[Trial], target_deg: f64) -> Option<Self> {
        let points: Vec<Point> = trials.iter().map(|t| t.parameters.to_unit()).collect();
        let tips: Vec<Option<f64>> = trials.iter().map(|t| t.outcome.tip_deg()).collect();
        let (seen, angles): (Vec<Point>, Vec<f64>) =
            points.iter().zip(&tips).filter_map(|(p, tip)| Some((*p, (*tip)?))).unzip();
        let angle = GaussianProcess::fit(&seen, &angles, &Prior::default()).ok()?;
        let labels: Vec<f64> = tips.iter().map(|tip| f64::from(tip.is_some())).collect();
        let refused = labels.contains(&0.0);
        let heaps = refused
            .then(|| GaussianProcess::fit(&points, &labels, &Prior::default()).ok())
            .flatten();
        Some(Self { angle, heaps, target_deg })
    }

    /// Probability that the mean of `runs` fresh simulations of `point` is within `tolerance_deg`
    /// of the target.
    pub fn probability_within(&self, point: &Point, tolerance_deg: f64, runs: u32) -> f64 {
        let Prediction { mean, sd } = self.angle.predict(point);
        let noise_sd = self.angle.hyperparameters().noise_sd / f64::from(runs).sqrt();
        probability_within(
            Prediction { mean, sd: sd.hypot(noise_sd) },
            self.target_deg,
            tolerance_deg,
        )
    }

    /// Distance of the posterior mean from the target, degrees.
    pub fn expected_error_deg(&self, point: &Point) -> f64 {
        (self.angle.predict(point).mean - self.target_deg).abs()
    }

    /// Probability that `point` yields a heap: least-squares classification squashed by the normal
    /// distribution (Rasmussen and Williams 2006, section 6.5).
    fn probability_of_heap(&self, point: &Point) -> f64 {
        let Some(heaps) = &self.heaps else { return 1.0 };
        let at = heaps.predict(point);
        cdf((at.mean - 0.5) / at.sd.hypot(heaps.hyperparameters().noise_sd).max(1e-9))
    }

    /// Value of simulating `point` when `taken` are accepted or about to be simulated:
    ///
    /// ```text
    /// EI(point) * P(heap) * min over taken of (1 - exp(-(distance / ALIKE)^2))
    /// ```
    ///
    /// The last factor keeps the sets apart; a copy of an accepted set has no value.
    fn worth(&self, point: &Point, incumbent_deg: f64, taken: &[Point]) -> f64 {
        let gain = expected_improvement(self.angle.predict(point), self.target_deg, incumbent_deg);
        let nearest =
            taken.iter().map(|other| distance(point, other)).fold(f64::INFINITY, f64::min);
        gain * self.probability_of_heap(point) * (1.0 - (-(nearest / ALIKE).powi(2)).exp())
    }
}

/// Proposes the next `count` points to search, one after another, each as if those before it had
/// come out as expected (kriging believer). `taken` are the points of the sets verified so far.
///
/// The incumbent of the expected improvement is the least error so far, but never below the
/// tolerance: once a set within it is known, another one elsewhere is worth as much as the first.
pub(super) fn propose(
    mut belief: Belief,
    trials: &[Trial],
    mut taken: Vec<Point>,
    settings: &Settings,
    space: &Space,
    count: usize,
    rng: &mut impl Rng,
) -> Vec<Point> {
    let least = trials.iter().filter_map(|t| t.error_deg).fold(f64::INFINITY, f64::min);
    let incumbent = least.max(settings.tolerance_deg);
    (0..count)
        .map(|_| {
            let best = most_worth(&belief, space, incumbent, &taken, rng);
            belief.angle = belief.angle.believe(&best);
            taken.push(best);
            best
        })
        .collect()
}

/// The most valuable point in a random pool, then in shrinking boxes around the best so far. If all
/// values are zero to within rounding (a target far out of reach), the point expected nearest to
/// the target.
fn most_worth(
    belief: &Belief,
    space: &Space,
    incumbent_deg: f64,
    taken: &[Point],
    rng: &mut impl Rng,
) -> Point {
    let rated = |point: Point| {
        let point = space.project(point);
        let worth = belief.worth(&point, incumbent_deg, taken);
        (point, worth, -belief.expected_error_deg(&point))
    };
    let better = |a: &(Point, f64, f64), b: &(Point, f64, f64)| {
        a.1.total_cmp(&b.1).then(a.2.total_cmp(&b.2))
    };
    let pool = latin_hypercube(POOL, rng).into_iter().map(rated);
    let mut best = pool.max_by(better).expect("the pool is not empty");
    for reach in REACHES {
        let around: Vec<Point> = (0..AROUND).map(|_| nearby(&best.0, reach, rng)).collect();
        best = around
            .into_iter()
            .map(rated)
            .chain([best])
            .max_by(better)
            .expect("holds the best so far");
    }
    best.0
}

fn nearby(point: &Point, reach: f64, rng: &mut impl Rng) -> Point {
    point.map(|x| (x + reach * (2.0 * rng.random::<f64>() - 1.0)).clamp(0.0, 1.0))
}
