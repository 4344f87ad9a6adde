//! Actions and their log-probabilities from the actor's outputs, and the way back.
//!
//! The formulas are those of [`crate::train::sac::squash`].
#![allow(clippy::inline_always)] // See `lanes`.

use super::curves::{exp, softplus, tanh};
use super::lanes::{Lanes, Path, Task, put, take, vectors};
use flip_policy::{LOG_STD_MAX, LOG_STD_MIN, OUTPUTS};

/// Squashed actions of a batch, by action and then by row.
#[derive(Debug, Default)]
pub(super) struct Squashed {
    /// Means, logarithms of the standard deviations, and noise: `[3, rows]` for each action.
    inputs: [Vec<f32>; OUTPUTS],
    /// Actions, `[rows]` each.
    pub action: [Vec<f32>; OUTPUTS],
    /// Standard deviation times noise.
    spread: [Vec<f32>; OUTPUTS],
    /// Log-probability of each row's actions, `[rows]`.
    pub log_prob: Vec<f32>,
}

impl Squashed {
    /// Squashes the actor's outputs `[rows, 4]` with noise `[rows, 2]`.
    pub(super) fn compute(&mut self, path: Path, head: &[f32], noise: &[f32]) {
        let rows = noise.len() / OUTPUTS;
        self.log_prob.clear();
        self.log_prob.resize(rows, 0.0);
        for k in 0..OUTPUTS {
            let inputs = &mut self.inputs[k];
            inputs.clear();
            inputs.extend(head.chunks_exact(2 * OUTPUTS).map(|row| row[k]));
            inputs.extend(head.chunks_exact(2 * OUTPUTS).map(|row| row[OUTPUTS + k]));
            inputs.extend(noise.chunks_exact(OUTPUTS).map(|row| row[k]));
            self.action[k].resize(rows, 0.0);
            self.spread[k].resize(rows, 0.0);
            path.run(One {
                inputs,
                action: &mut self.action[k],
                spread: &mut self.spread[k],
                log_prob: &mut self.log_prob,
            });
        }
    }

    /// Gradient of `sum (weight log pi + f(a))` for the actor's outputs `[rows, 4]`, from that of
    /// `f` for the actions `[rows, 2]`.
    ///
    /// ```text
    /// d/du = 2 weight a + df/da (1 - a^2)       since d log pi / du = 2 tanh u
    /// d/d mean = d/du,   d/d log_std = d/du std noise - weight, or 0 where log_std is clamped
    /// ```
    pub(super) fn backward(&self, weight: f32, actions: &[f32], into: &mut [f32]) {
        for (row, out) in into.chunks_exact_mut(2 * OUTPUTS).enumerate() {
            for k in 0..OUTPUTS {
                let a = self.action[k][row];
                let du = 2.0 * weight * a + actions[row * OUTPUTS + k] * (1.0 - a * a);
                let log_std = self.inputs[k][self.log_prob.len() + row];
                out[k] = du;
                out[OUTPUTS + k] = match (LOG_STD_MIN..=LOG_STD_MAX).contains(&log_std) {
                    true => du * self.spread[k][row] - weight,
                    false => 0.0,
                };
            }
        }
    }
}

/// One action of every row.
struct One<'a> {
    inputs: &'a [f32],
    action: &'a mut [f32],
    spread: &'a mut [f32],
    log_prob: &'a mut [f32],
}

impl Task for One<'_> {
    #[inline(always)]
    fn with<L: Lanes>(self) {
        const HALF_LN_TAU: f32 = 0.918_938_5;
        let rows = self.log_prob.len();
        let (two, ln2) = (L::splat(2.0), L::splat(std::f32::consts::LN_2));
        for (at, count) in vectors(rows) {
            let mean: L = take(self.inputs, at, count);
            let log_std: L = take(self.inputs, rows + at, count);
            let noise: L = take(self.inputs, 2 * rows + at, count);
            // In this order NaN stays NaN.
            let log_std = L::splat(LOG_STD_MAX).min(L::splat(LOG_STD_MIN).max(log_std));
            let spread = exp(log_std).times(noise);
            let u = mean.plus(spread);
            let gauss = noise.times(noise).times(L::splat(-0.5)).minus(log_std);
            let gauss = gauss.minus(L::splat(HALF_LN_TAU));
            let slope = ln2.minus(u).minus(softplus(u.times(L::splat(-2.0)))).times(two);
            let before: L = take(self.log_prob, at, count);
            put(tanh(u), self.action, at, count);
            put(spread, self.spread, at, count);
            put(before.plus(gauss.minus(slope)), self.log_prob, at, count);
        }
    }
}
