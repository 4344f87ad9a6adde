//! From promising search trials to verified sets.

use super::propose::Belief;
use super::settings::Settings;
use super::space::Point;
use super::trial::{CalibratedSet, Phase, Trial};
use flip_core::domain::powder::Flowability;
use flip_core::stats::latin_hypercube::distance;
use flip_core::stats::summary;

/// A search trial becomes a candidate when the belief, fitted to all trials, gives it at least this
/// probability of passing its verification. Its own angle alone is not enough: one lucky seed does
/// not justify the runs, and one unlucky seed does not justify searching again.
const LIKELY: f64 = 0.6;

/// Search trials that are likely to pass their verification and have had none yet, oldest first.
pub(super) fn candidates<'a>(
    trials: &'a [Trial],
    belief: &Belief,
    settings: &Settings,
) -> Vec<&'a Trial> {
    let verified =
        |c: &Trial| trials.iter().any(|t| t.phase == Phase::Verification && t.candidate == c.index);
    let likely = |c: &Trial| {
        let point = c.parameters.to_unit();
        belief.probability_within(&point, settings.tolerance_deg, settings.verify_repeats) >= LIKELY
    };
    let search = trials.iter().filter(|t| t.phase == Phase::Search && t.error_deg.is_some());
    search.filter(|t| !verified(t) && likely(t)).collect()
}

/// Chooses up to `wanted` candidates to verify next, spread over the box, near the target rather
/// than at the tolerance: one after another, the one with the largest
///
/// ```text
/// distance to the nearest set taken * (1 - expected error / (2 tolerance))
/// ```
///
/// `taken` are the points of the sets verified before. The maximin idea is from Johnson, Moore and
/// Ylvisaker (1990).
pub(super) fn choose<'a>(
    mut candidates: Vec<&'a Trial>,
    mut taken: Vec<Point>,
    wanted: usize,
    belief: &Belief,
    settings: &Settings,
) -> Vec<&'a Trial> {
    let mut chosen = Vec::new();
    while chosen.len() < wanted && !candidates.is_empty() {
        let merit = |c: &&Trial| {
            let point = c.parameters.to_unit();
            // With nothing taken yet, all distances are equal.
            let nearest = taken.iter().map(|other| distance(&point, other)).fold(3.0, f64::min);
            nearest * (1.0 - belief.expected_error_deg(&point) / (2.0 * settings.tolerance_deg))
        };
        let order =
            |a: &usize, b: &usize| merit(&candidates[*a]).total_cmp(&merit(&candidates[*b]));
        let Some(best) = (0..candidates.len()).max_by(order) else { break };
        let candidate = candidates.remove(best);
        taken.push(candidate.parameters.to_unit());
        chosen.push(candidate);
    }
    chosen
}

/// The sets whose verification is complete, without a refusal, and within the tolerance on average.
pub(super) fn verified(
    trials: &[Trial],
    target: &Flowability,
    settings: &Settings,
) -> Vec<CalibratedSet> {
    let sets = candidates_of(trials)
        .into_iter()
        .filter_map(|candidate| verdict(candidate, trials, target, settings));
    sets.filter(|set| set.verified_error_deg <= settings.tolerance_deg).collect()
}

/// Verified candidates, by the index they have in their verification runs, in order.
pub(super) fn candidates_of(trials: &[Trial]) -> Vec<u32> {
    let mut indices: Vec<u32> = Vec::new();
    for trial in trials.iter().filter(|t| t.phase == Phase::Verification) {
        if !indices.contains(&trial.candidate) {
            indices.push(trial.candidate);
        }
    }
    indices.sort_unstable();
    indices
}

/// The verification result of a candidate, once complete.
pub(super) fn verdict(
    candidate: u32,
    trials: &[Trial],
    target: &Flowability,
    settings: &Settings,
) -> Option<CalibratedSet> {
    let runs: Vec<&Trial> = trials
        .iter()
        .filter(|t| t.phase == Phase::Verification && t.candidate == candidate)
        .collect();
    let tips: Vec<f64> = runs.iter().filter_map(|t| t.outcome.tip_deg()).collect();
    if tips.len() < settings.verify_repeats as usize {
        return None;
    }
    let repose_deg = summary::mean(&tips)?;
    let error_deg = (repose_deg - target.repose_deg).abs();
    Some(CalibratedSet {
        parameters: runs.first()?.parameters,
        repose_deg,
        repose_sd_deg: summary::sd(&tips),
        runs: tips.len() as u32,
        error_deg,
        verified_error_deg: error_deg,
    })
}
