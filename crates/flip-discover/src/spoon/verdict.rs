//! What may be claimed of a powder's spoonfuls, by the rules for angles.

use super::causes::SpoonCause;
use super::evidence::{Point, Weighed, amplitude};
use crate::judge::claim::Proposal;
use crate::report::spoon::{FamilyShare, SpoonCauseReport};
use crate::thresholds::{CERTAIN, CLAIM, LOOK_ALIKE, WORTH_TELLING};
use nalgebra::DVector;

/// Causes and one that is not in the catalogue, by their probability.
#[derive(Debug, Clone)]
pub(super) struct Judged {
    /// Most probable first.
    pub causes: Vec<SpoonCauseReport>,
    pub unknown: f64,
    pub proposal: Proposal,
    pub alike: Vec<SpoonCause>,
}

impl Judged {
    /// Judges what was weighed.
    pub fn of(weighed: &Weighed) -> Self {
        let known = weighed.causes();
        let logs: Vec<f64> = known.iter().map(|cause| weighed.log_evidence(*cause)).collect();
        let largest = logs.iter().copied().fold(weighed.log_unknown, f64::max);
        let odds = |log: f64| (log - largest).exp();
        let sum = logs.iter().copied().map(odds).sum::<f64>() + odds(weighed.log_unknown);
        let mut causes: Vec<SpoonCauseReport> = known
            .iter()
            .zip(&logs)
            .map(|(cause, log)| told(weighed, *cause, odds(*log) / sum, *log))
            .collect();
        causes.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        let unknown = odds(weighed.log_unknown) / sum;
        let alike = causes.first().map_or(vec![], |first| look_alikes(weighed, first.cause));
        let proposal =
            proposal(causes.first().map(|it| it.probability), unknown, !alike.is_empty());
        Self { causes, unknown, proposal, alike }
    }

    /// Two or three causes that cannot be told apart: of one family, if it is as probable as a cause
    /// that is claimed.
    pub fn candidates(&self) -> Vec<SpoonCause> {
        let named = self.families().into_iter().next().filter(|it| it.probability >= CLAIM);
        let is_of_it = |family: &str| named.as_ref().is_none_or(|named| named.family == family);
        let of_it: Vec<_> = self.causes.iter().filter(|it| is_of_it(&it.family)).collect();
        let probable = of_it.iter().filter(|it| it.probability >= WORTH_TELLING);
        let mut all: Vec<SpoonCause> = probable.map(|it| it.cause).collect();
        if all.len() < 2 {
            let alike = self.alike.iter().copied().filter(|it| is_of_it(it.name().1));
            let others = alike.chain(of_it.iter().map(|it| it.cause));
            let first = self.causes.first().map(|it| it.cause);
            all = first.into_iter().collect();
            all.extend(others.filter(|cause| Some(*cause) != first).take(1));
        }
        all.truncate(3);
        all
    }

    /// Probability of each family, most probable first.
    pub fn families(&self) -> Vec<FamilyShare> {
        let mut all: Vec<FamilyShare> = Vec::new();
        for cause in &self.causes {
            match all.iter_mut().find(|it| it.family == cause.family) {
                Some(it) => it.probability += cause.probability,
                None => all.push(FamilyShare {
                    family: cause.family.clone(),
                    probability: cause.probability,
                }),
            }
        }
        all.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        all
    }
}

/// What the evidence proposes where something is wrong.
fn proposal(first: Option<f64>, unknown: f64, has_look_alike: bool) -> Proposal {
    match first {
        _ if unknown >= CLAIM => Proposal::Unexplained,
        Some(first) if first >= if has_look_alike { CERTAIN } else { CLAIM } => Proposal::Cause,
        None => Proposal::Unexplained,
        Some(_) => Proposal::Ambiguous,
    }
}

/// Causes that change the summaries in nearly the same proportions.
fn look_alikes(weighed: &Weighed, cause: SpoonCause) -> Vec<SpoonCause> {
    let Some(own) = shift(weighed, cause) else { return Vec::new() };
    let others = weighed.causes().into_iter().filter(|other| *other != cause);
    let is_alike = |other: &SpoonCause| {
        shift(weighed, *other).is_some_and(|other| cosine(&own, &other) >= LOOK_ALIKE)
    };
    others.filter(is_alike).collect()
}

/// What a cause changes at its most probable amplitude.
fn shift(weighed: &Weighed, cause: SpoonCause) -> Option<DVector<f64>> {
    best(weighed, cause).map(|point| point.shift.clone())
}

/// The most probable amplitude and set of a cause.
pub(super) fn best(weighed: &Weighed, cause: SpoonCause) -> Option<&Point> {
    weighed.of(cause).max_by(|a, b| a.log_likelihood.total_cmp(&b.log_likelihood))
}

fn cosine(a: &DVector<f64>, b: &DVector<f64>) -> f64 {
    let scale = a.norm() * b.norm();
    if scale > 0.0 { a.dot(b) / scale } else { 0.0 }
}

fn told(weighed: &Weighed, cause: SpoonCause, probability: f64, log: f64) -> SpoonCauseReport {
    let points: Vec<&Point> = weighed.of(cause).collect();
    let by = |value: &dyn Fn(&Point) -> f64| {
        interval(points.iter().map(|it| (it.log_likelihood, value(it))).collect())
    };
    let (amplitude, amplitude_ci95) = by(&|point| amplitude(cause, point.u));
    let (effect_mg, effect_ci95_mg) = by(&|point| effect_mg(weighed, point));
    SpoonCauseReport {
        cause,
        family: cause.name().1.to_owned(),
        probability,
        log10_evidence: (log - weighed.log_plain()) / std::f64::consts::LN_10,
        amplitude,
        amplitude_ci95,
        effect_mg,
        effect_ci95_mg,
        angle_deg: best(weighed, cause).and_then(|point| point.angle_deg),
        experiment: cause.experiment().to_owned(),
    }
}

/// What a point changes in a spoonful, mg.
fn effect_mg(weighed: &Weighed, point: &Point) -> f64 {
    let plain = &weighed.plain[weighed.place(point.set)].totals_mg;
    let differences = point.totals_mg.iter().zip(plain).map(|(after, before)| after - before);
    differences.sum::<f64>() / plain.len().max(1) as f64
}

/// Mean and 95 % interval of values by the logs of their weights.
fn interval(mut of: Vec<(f64, f64)>) -> (f64, [f64; 2]) {
    of.sort_by(|a, b| a.1.total_cmp(&b.1));
    let mean = super::held_out::averaged(&of);
    let largest = of.iter().map(|it| it.0).fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = of.iter().map(|it| (it.0 - largest).exp()).collect();
    let sum: f64 = weights.iter().sum();
    let at = |share: f64| {
        let mut below = 0.0;
        let reached = weights.iter().position(|weight| {
            below += weight / sum;
            below >= share
        });
        of[reached.unwrap_or(of.len() - 1)].1
    };
    (mean, [at(0.025), at(0.975)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cause_is_proposed_by_the_rules_for_angles() {
        let of = |first, unknown, alike| proposal(Some(first), unknown, alike);
        assert_eq!(
            [of(0.79, 0.1, false), of(0.8, 0.1, false)],
            [Proposal::Ambiguous, Proposal::Cause]
        );
        assert_eq!(
            [of(0.94, 0.0, true), of(0.95, 0.0, true)],
            [Proposal::Ambiguous, Proposal::Cause]
        );
        assert_eq!(of(0.1, 0.85, false), Proposal::Unexplained);
    }

    #[test]
    fn an_interval_holds_the_weight_between_its_ends() {
        let even = (0..100).map(|k| (0.0, f64::from(k))).collect();
        let (mean, ci95) = interval(even);
        assert!((mean - 49.5).abs() < 1e-9 && ci95 == [2.0, 97.0], "{mean} {ci95:?}");
        assert_eq!(interval(vec![(0.0, 1.0), (-900.0, 5.0)]), (1.0, [1.0, 1.0]));
    }
}
