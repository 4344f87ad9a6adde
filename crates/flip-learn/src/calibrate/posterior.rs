//! What a measured angle reveals about the nine parameters, and what it leaves open.
//!
//! Prior: uniform over the published box, or over the slice of it in which some parameters are
//! fixed. With m, s, n the measured mean, SD and number of repeats,
//! and f(theta) the mean angle of a simulated heap, which the emulator predicts as N(mu(theta),
//! sd(theta)^2):
//!
//! ```text
//! (m - f(theta)) / (s / sqrt(n)) ~ t_{n-1}          m = f(theta) exactly, for s = 0 or n = 1
//! p(theta, f | m, s, n)  ~  p(m | f, s, n) N(f; mu(theta), sd(theta)^2)
//! ```
//!
//! s is estimated from the repeats themselves, hence Student's t. Points of a space-filling pool,
//! each with its own draw of f, are weighted by the likelihood and resampled (sampling importance
//! resampling, Rubin 1988). For an exact measurement f is integrated out: the weight is N(m; mu,
//! sd^2).
//!
//! Other observables ([`Channel`]) multiply their likelihoods, with a value drawn for each point in
//! the same way as the angle.
//!
//! A parameter whose posterior equals its prior was not learned; pairs that stay correlated are
//! known only jointly.

use super::channel::{Channel, Knowledge};
use super::space::{Point, Space};
use flip_core::domain::observable::Observation;
use flip_core::domain::parameters::{COUNT, PARAMETERS, ParameterSet};
use flip_core::domain::powder::Flowability;
use flip_core::domain::seed::derive;
use flip_core::stats::latin_hypercube::latin_hypercube;
use flip_core::stats::normal::quantile;
use flip_core::stats::summary;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Number of points in the pool.
const POOL: usize = 20_000;
/// Seeds of the pool; no trial uses them.
const POINTS: u64 = u64::MAX - 2;
/// Pairs whose correlation is at least this are reported.
const TOGETHER: f64 = 0.2;

/// Draws from the posterior, with summaries.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Posterior {
    /// Draws, each the nine values in parameter order.
    pub draws: Vec<[f64; COUNT]>,
    /// The angle of each draw, degrees.
    pub repose_deg: Vec<f64>,
    /// Marginal posterior of each parameter.
    pub parameters: Vec<Marginal>,
    /// Pairs that are known only jointly.
    pub together: Vec<Pair>,
    /// Effective number of pool points behind the draws: (sum w)^2 / sum w^2. A small number means
    /// that draws repeat each other.
    pub effective: f64,
}

/// Marginal posterior of one parameter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Marginal {
    /// Its key.
    pub key: String,
    /// Posterior mean.
    pub mean: f64,
    /// 16 % and 84 % quantile.
    pub interval: [f64; 2],
    /// 1 - posterior variance / prior variance: 0 if nothing was learned, as of a fixed parameter.
    /// Negative if the posterior concentrates at both ends.
    pub learnt: f64,
    /// Whether none of the measurements depends on it.
    pub inert: bool,
}

/// Two parameters that are known only jointly.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pair {
    /// Their keys.
    pub keys: [String; 2],
    /// Correlation of their draws, -1 to 1.
    pub correlation: f64,
}

impl Posterior {
    /// Draws `count` points of the box given a measured angle and the other measurements.
    pub fn of(knowledge: Knowledge<'_>, measured: &Flowability, count: usize, seed: u64) -> Self {
        Prior::of(knowledge, seed).given(measured, count)
    }

    /// The same within a slice of the box.
    pub fn within(
        space: Space,
        knowledge: Knowledge<'_>,
        measured: &Flowability,
        count: usize,
        seed: u64,
    ) -> Self {
        Prior::within(space, knowledge, seed).given(measured, count)
    }
}

/// The prior: points of the box with the emulator's predictions. Reused for many measured angles,
/// so the emulator is evaluated once.
#[derive(Debug)]
pub struct Prior<'a> {
    space: Space,
    knowledge: Knowledge<'a>,
    points: Vec<Known>,
    rng: Pcg64,
}

/// A point of the prior.
#[derive(Debug, Clone, Copy)]
struct Known {
    set: ParameterSet,
    mean: f64,
    sd: f64,
    /// Standard normal number used to draw its angle.
    z: f64,
    /// Log likelihood of the measurements other than the angle.
    others: f64,
}

impl<'a> Prior<'a> {
    /// Builds the pool for this seed, in all of the box.
    pub fn of(knowledge: Knowledge<'a>, seed: u64) -> Self {
        Self::within(Space::default(), knowledge, seed)
    }

    /// Builds the pool for this seed, within a slice of the box.
    pub fn within(space: Space, knowledge: Knowledge<'a>, seed: u64) -> Self {
        let mut rng = Pcg64::seed_from_u64(derive(seed, &[POINTS]));
        let points: Vec<Point> = latin_hypercube(POOL, &mut rng);
        let pool: Vec<(usize, Point, f64)> = points
            .into_iter()
            .enumerate()
            .map(|(k, point)| (k, point, normal(rng.random())))
            .collect();
        let know = |(k, point, z): (usize, Point, f64)| {
            let set = space.parameters_at(&point);
            let at = knowledge.emulator.expect(&set).mean;
            let drawn = |c: usize| {
                normal(
                    (derive(seed, &[POINTS, k as u64, c as u64]) >> 11) as f64
                        / (1u64 << 53) as f64,
                )
            };
            let others = knowledge
                .channels
                .iter()
                .enumerate()
                .map(|(c, channel)| likelihood(channel, &set, drawn(c)));
            Known { set, mean: at.mean, sd: at.sd, z, others: others.sum() }
        };
        Self { space, knowledge, points: pool.into_par_iter().map(know).collect(), rng }
    }

    /// Of a fixed parameter nothing was learnt: its value was given.
    fn marginal(&self, k: usize, draws: &[[f64; COUNT]]) -> Marginal {
        let found = marginal(k, draws, &self.knowledge);
        if self.space.holds(k) { Marginal { learnt: 0.0, ..found } } else { found }
    }

    /// Draws `count` points given a measurement.
    pub fn given(&self, measured: &Flowability, count: usize) -> Posterior {
        let weighed: Vec<(f64, f64)> =
            self.points.iter().map(|point| point.weigh(measured)).collect();
        let largest = weighed.iter().map(|point| point.1).fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> = weighed.iter().map(|point| (point.1 - largest).exp()).collect();
        let (sum, squares) =
            weights.iter().fold((0.0, 0.0), |(sum, squares), w| (sum + w, squares + w * w));
        let drawn = resample(&weights, sum, count, self.rng.clone().random());
        let draws: Vec<[f64; COUNT]> = drawn.iter().map(|k| self.points[*k].set.values()).collect();
        Posterior {
            repose_deg: drawn.iter().map(|k| weighed[*k].0).collect(),
            parameters: (0..COUNT).map(|k| self.marginal(k, &draws)).collect(),
            together: together(&draws),
            effective: sum * sum / squares,
            draws,
        }
    }
}

/// Converts a uniform number to a standard normal one, kept finite.
fn normal(uniform: f64) -> f64 {
    quantile(uniform.clamp(1e-12, 1.0 - 1e-12))
}

/// Log likelihood of an observation at a set whose value is `z` standard deviations from its
/// prediction.
fn likelihood(channel: &Channel, set: &ParameterSet, z: f64) -> f64 {
    let Observation { mean, sd, n, .. } = channel.observation;
    let at = channel.expect(set);
    student(mean - channel.value(set, at.mean + z * at.sd), sd, n)
}

/// Log density of a mean of n with sample deviation sd that is `off` its expectation, up to a
/// constant. An impossible value has a likelihood close to zero.
fn student(off: f64, sd: f64, n: u32) -> f64 {
    let t = (off / (sd / f64::from(n).sqrt())).clamp(-1e6, 1e6);
    let freedom = f64::from(n - 1);
    -0.5 * (freedom + 1.0) * (t * t / freedom).ln_1p()
}

impl Known {
    /// Returns an angle for the point, and its log weight.
    fn weigh(&self, measured: &Flowability) -> (f64, f64) {
        let Flowability { repose_deg, sd_deg, n } = *measured;
        if sd_deg > 0.0 && n > 1 {
            let angle = self.mean + self.sd * self.z;
            return (angle, self.others + student(repose_deg - angle, sd_deg, n));
        }
        let sd = self.sd.max(1e-6);
        (repose_deg, self.others - 0.5 * ((repose_deg - self.mean) / sd).powi(2) - sd.ln())
    }
}

/// Systematic resampling: one uniform number, `count` equidistant positions in the cumulative
/// weights (Kitagawa 1996).
fn resample(weights: &[f64], sum: f64, count: usize, uniform: f64) -> Vec<usize> {
    let mut drawn = Vec::with_capacity(count);
    let (mut k, mut passed) = (0, weights[0]);
    for i in 0..count {
        let place = (i as f64 + uniform) / count as f64 * sum;
        while passed < place && k + 1 < weights.len() {
            k += 1;
            passed += weights[k];
        }
        drawn.push(k);
    }
    drawn
}

fn column(draws: &[[f64; COUNT]], k: usize) -> Vec<f64> {
    draws.iter().map(|draw| draw[k]).collect()
}

fn marginal(k: usize, draws: &[[f64; COUNT]], knowledge: &Knowledge<'_>) -> Marginal {
    let parameter = &PARAMETERS[k];
    let mut values = column(draws, k);
    values.sort_by(f64::total_cmp);
    let quantile =
        |share: f64| values[((share * values.len() as f64) as usize).min(values.len() - 1)];
    let variance = summary::sd(&values).unwrap_or(0.0).powi(2);
    Marginal {
        key: parameter.key.to_owned(),
        mean: summary::mean(&values).unwrap_or(parameter.default),
        interval: [quantile(0.16), quantile(0.84)],
        learnt: 1.0 - variance / ((parameter.upper - parameter.lower).powi(2) / 12.0),
        inert: is_inert(k, draws, knowledge),
    }
}

/// Whether moving the parameter from bound to bound leaves the inputs of every measured quantity
/// unchanged, at all draws.
fn is_inert(k: usize, draws: &[[f64; COUNT]], knowledge: &Knowledge<'_>) -> bool {
    let at = |draw: &[f64; COUNT], value: f64| {
        let mut values = *draw;
        values[k] = value;
        ParameterSet::new(values).expect("a bound is within bounds")
    };
    draws.iter().all(|draw| {
        let [low, high] = [PARAMETERS[k].lower, PARAMETERS[k].upper].map(|value| at(draw, value));
        knowledge.emulator.directions(&low) == knowledge.emulator.directions(&high)
            && knowledge.channels.iter().all(|channel| channel.sees_alike(&low, &high))
    })
}

fn together(draws: &[[f64; COUNT]]) -> Vec<Pair> {
    let columns: Vec<Vec<f64>> = (0..COUNT).map(|k| column(draws, k)).collect();
    let pairs = (0..COUNT).flat_map(|i| (i + 1..COUNT).map(move |j| (i, j)));
    let mut found: Vec<Pair> = pairs
        .map(|(i, j)| Pair {
            keys: [i, j].map(|k| PARAMETERS[k].key.to_owned()),
            correlation: correlation(&columns[i], &columns[j]),
        })
        .filter(|pair| pair.correlation.abs() >= TOGETHER)
        .collect();
    found.sort_by(|a, b| b.correlation.abs().total_cmp(&a.correlation.abs()));
    found
}

/// Pearson correlation; 0 if one of the two does not vary.
fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let (Some(ma), Some(mb), Some(sa), Some(sb)) =
        (summary::mean(a), summary::mean(b), summary::sd(a), summary::sd(b))
    else {
        return 0.0;
    };
    let covariance =
        a.iter().zip(b).map(|(x, y)| (x - ma) * (y - mb)).sum::<f64>() / (a.len() as f64 - 1.0);
    if sa * sb > 0.0 { covariance / (sa * sb) } else { 0.0 }
}
