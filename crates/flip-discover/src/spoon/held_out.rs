//! What the causes are worth: masses of spoonfuls that were left out of the whole search.
//!
//! Sessions are left out in turn, or weighings where fewer than four sessions were recorded.
//! Everything is weighed again without them: which cause, how strong, which set. Three predictions
//! of the same spoonfuls are compared: by the calibrated sets alone, by every cause as far as it is
//! probable beside none, and by a sham: the same catalogue, each of whose causes changes nothing.

use super::causes::AMPLITUDES;
use super::evidence::{Weighed, weigh};
use super::field::{Field, Node};
use super::readings::day;
use super::summaries::total;
use crate::report::spoon::SpoonGain;
use crate::thresholds::HELD_OUT_SESSIONS_MIN;
use flip_core::domain::powder::Flowability;
use flip_core::stats::summary::{bootstrap_mean_interval, mean};

/// Resamples of the interval.
const RESAMPLES: usize = 4000;

/// Absolute errors of one left-out spoonful, mg: before, after, with the sham.
struct Missed {
    group: usize,
    errors_mg: [f64; 3],
}

/// The gain on left-out spoonfuls; `None` where there are too few to leave any out.
pub(super) fn gain(
    field: &Field<'_>,
    used: &[usize],
    angle: Option<Flowability>,
    seed: u64,
) -> Option<SpoonGain> {
    let (groups, by) = groups(field);
    let count = groups.iter().max()? + 1;
    if count < HELD_OUT_SESSIONS_MIN {
        return None;
    }
    let sham = sham(field);
    let mut missed = Vec::new();
    for group in 0..count {
        let keep: Vec<usize> = (0..groups.len()).filter(|&j| groups[j] != group).collect();
        let of = |nodes: &[Node]| weigh(field, nodes, used, &keep, angle);
        let (real, sham) = (of(&field.nodes)?, of(&sham)?);
        for j in (0..groups.len()).filter(|&j| groups[j] == group) {
            let weighed = total(&field.measured[j]);
            let predicted = [real.plain_mg(j), real.predicted_mg(j), sham.predicted_mg(j)];
            missed.push(Missed { group, errors_mg: predicted.map(|mg| (mg - weighed).abs()) });
        }
    }
    Some(concluded(&missed, count, by, seed))
}

fn concluded(missed: &[Missed], groups: usize, by: &'static str, seed: u64) -> SpoonGain {
    let error = |which: usize| {
        mean(&missed.iter().map(|it| it.errors_mg[which]).collect::<Vec<_>>()).unwrap_or(0.0)
    };
    let of_group = |group: usize| {
        let own = missed.iter().filter(|it| it.group == group);
        mean(&own.map(|it| it.errors_mg[0] - it.errors_mg[1]).collect::<Vec<_>>()).unwrap_or(0.0)
    };
    let differences: Vec<f64> = (0..groups).map(of_group).collect();
    let ci95 = bootstrap_mean_interval(&differences, 0.95, RESAMPLES, seed).unwrap_or([0.0; 2]);
    let [before, after, sham] = [error(0), error(1), error(2)];
    SpoonGain {
        by: by.to_owned(),
        spoonfuls: missed.len() as u32,
        error_before_mg: before,
        error_after_mg: after,
        error_sham_mg: sham,
        gain_ci95_mg: ci95,
        accepted: ci95[0] > 0.0 && after < sham,
    }
}

/// The group of each spoonful, and what groups are.
fn groups(field: &Field<'_>) -> (Vec<usize>, &'static str) {
    let of = |name: &dyn Fn(usize) -> String| {
        let mut known: Vec<String> = Vec::new();
        let each = (0..field.spoonfuls.len()).map(|j| {
            let name = name(j);
            known.iter().position(|other| *other == name).unwrap_or_else(|| {
                known.push(name);
                known.len() - 1
            })
        });
        each.collect::<Vec<usize>>()
    };
    let days = of(&|j| day(field.spoonfuls[j].1).to_owned());
    match days.iter().max().is_some_and(|last| last + 1 >= HELD_OUT_SESSIONS_MIN) {
        true => (days, "session"),
        false => (of(&|j| field.spoonfuls[j].1.weighing.clone()), "weighing"),
    }
}

/// The catalogue with replays of which nothing was changed.
fn sham(field: &Field<'_>) -> Vec<Node> {
    let plain = |(k, node): (usize, &Node)| {
        let own: Vec<_> = field.base.iter().filter(|it| it.set == node.set).collect();
        // Neighbouring nodes of a set are AMPLITUDES apart or next to each other: no two alike.
        let take = |r: usize| own[(k + r * AMPLITUDES) % own.len()].fell.clone();
        let replays = (0..node.replays.len()).map(take).collect();
        Node {
            replays,
            angle_deg: field.angles_deg.get(node.set).copied().flatten(),
            ..node.clone()
        }
    };
    field.nodes.iter().enumerate().map(plain).collect()
}

impl Weighed {
    /// Mass of a spoonful by the calibrated sets, each as probable as it explains the rest, mg.
    pub fn plain_mg(&self, spoonful: usize) -> f64 {
        let of = self.plain.iter().map(|it| (it.log_likelihood, it.totals_mg[spoonful]));
        averaged(&of.collect::<Vec<_>>())
    }

    /// The same by every cause and by none, which are equally probable at first, mg.
    pub fn predicted_mg(&self, spoonful: usize) -> f64 {
        let share = |count: usize| -(count.max(1) as f64).ln();
        let none = self
            .plain
            .iter()
            .map(|it| (it.log_likelihood + share(self.plain.len()), it.totals_mg[spoonful]));
        let causes = self.causes();
        let some = causes.iter().flat_map(|cause| {
            let own: Vec<_> = self.of(*cause).collect();
            let prior = share(causes.len()) + share(own.len());
            own.into_iter().map(move |it| (it.log_likelihood + prior, it.totals_mg[spoonful]))
        });
        averaged(&none.chain(some).collect::<Vec<_>>())
    }
}

/// Mean of values by the log of their weights.
pub(super) fn averaged(of: &[(f64, f64)]) -> f64 {
    let largest = of.iter().map(|it| it.0).fold(f64::NEG_INFINITY, f64::max);
    let weights = of.iter().map(|it| (it.0 - largest).exp());
    let sum: f64 = weights.clone().sum();
    weights.zip(of).map(|(weight, it)| weight * it.1).sum::<f64>() / sum
}
