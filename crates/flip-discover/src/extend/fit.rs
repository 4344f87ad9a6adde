//! Fits an extension's amplitude so that simulated heaps move as the measured ones did, and checks
//! whether fresh heaps agree.
//!
//! ```text
//! shift(A) = mean over powders of (heaps at A f_p - heaps at the reference)
//! A_1 by the table of responses,  A_2 = A_1 e / shift(A_1),  A = e / b,   b = sum(A_k shift_k) / sum(A_k^2)
//! verified: the shift over fresh seeds is within the effect's 95 % interval widened by 2 standard errors, and of the effect's sign
//! ```
//!
//! Here e is the mean effect on the simulated powders, up to three that respond most. The line
//! through the origin is what an extension assumes of its amplitudes; over the few degrees of an
//! effect simulated responses are lines within their noise (`docs/simulated_responses.jsonl`).

use super::extension::{Extension, Fit, FitSet, Hook, OnPowder};
use crate::report::ParameterReport;
use flip_core::domain::conditions::Patch;
use flip_core::domain::seed::derive;
use flip_core::stats::summary::mean;

/// Most powders that are simulated.
const POWDERS: usize = 3;
/// Heaps of a powder for each repeat: three to fit (at the reference and two amplitudes) and two to
/// verify (at the reference and the fitted amplitude).
const STAGES: usize = 5;
/// SD of a heap's angle if one repeat gives no estimate, degrees.
const HEAP_SD_DEG: f64 = 1.5;
/// Bounds on the second amplitude relative to the first.
const STEP: [f64; 2] = [0.25, 4.0];
/// Normal deviate of a 95 % interval.
const DEVIATE: f64 = 1.96;

/// Stages that seeds are derived from. The amplitudes of the search share their seeds with its
/// reference: other seeds would only add noise.
const SEARCH: u64 = 1;
const VERIFICATION: u64 = 2;

/// A heap to simulate.
#[derive(Debug, Clone, PartialEq)]
pub struct FitHeap {
    /// Index of its powder among the sets.
    pub set: usize,
    /// What the extension changes about it.
    pub patch: Patch,
    /// Seed.
    pub seed: u64,
}

/// Finds an extension's amplitude and verifies it, in at most `budget` heaps. Returns `None` if the
/// budget is too small for one heap of each kind, no set stands for a responding powder, the
/// extension affects readings, or heaps have no angles.
///
/// `pour` returns the angles of a batch of heaps in the same order, degrees; `None` where a heap
/// has none. It must be pure.
pub fn fit(
    extension: &Extension,
    sets: &[FitSet],
    budget: u32,
    seed: u64,
    pour: impl Fn(&[FitHeap]) -> Vec<Option<f64>>,
) -> Option<(ParameterReport, Fit)> {
    if extension.hook == Hook::Reading {
        return None;
    }
    let mut stands: Vec<(usize, &OnPowder)> = extension
        .powders
        .iter()
        .filter(|on| on.factor > 0.0)
        .filter_map(|on| Some((sets.iter().position(|set| set.powder == on.powder)?, on)))
        .collect();
    stands.sort_by(|a, b| b.1.effect_deg.abs().total_cmp(&a.1.effect_deg.abs()));
    stands.truncate(POWDERS.min(budget as usize / STAGES));
    let repeats = budget as usize / (STAGES * stands.len().max(1));
    let effects: Vec<f64> = stands.iter().map(|stand| stand.1.effect_deg).collect();
    let effect = mean(&effects)?;
    let heaps = |amplitude: f64, stage: u64| -> Option<Vec<Vec<f64>>> {
        let of: Vec<(usize, usize)> =
            (0..stands.len()).flat_map(|k| (0..repeats).map(move |r| (k, r))).collect();
        let heap = |&(k, r): &(usize, usize)| {
            let (set, on) = stands[k];
            let patch = extension.patch(amplitude * on.factor);
            FitHeap { set, patch, seed: derive(seed, &[stage, k as u64, r as u64]) }
        };
        let angles = pour(&of.iter().map(heap).collect::<Vec<_>>());
        let angles = of.iter().zip(angles).filter_map(|(&(k, _), angle)| Some((k, angle?)));
        let angles: Vec<(usize, f64)> = angles.collect();
        let by_powder = (0..stands.len())
            .map(|k| angles.iter().filter(|angle| angle.0 == k).map(|angle| angle.1).collect());
        let by_powder: Vec<Vec<f64>> = by_powder.collect();
        by_powder.iter().all(|angles| !angles.is_empty()).then_some(by_powder)
    };
    let reference = heaps(0.0, SEARCH)?;
    let first = extension.amplitude.value;
    let at_first = heaps(first, SEARCH)?;
    let second = first * (effect / shift(&at_first, &reference)?).clamp(STEP[0], STEP[1]);
    let at_second = heaps(second, SEARCH)?;
    let shifts = [shift(&at_first, &reference)?, shift(&at_second, &reference)?];
    let slope = (first * shifts[0] + second * shifts[1]) / (first * first + second * second);
    // Heaps that do not move in the direction of the effect say nothing about the amplitude; the
    // verification will show it.
    let is_responding = slope * effect * first > 0.0;
    let value = if is_responding { effect / slope } else { first };
    let fresh = heaps(0.0, VERIFICATION)?;
    let verifying = heaps(value, VERIFICATION)?;
    let variance = variance(&[&reference, &at_first, &at_second, &fresh, &verifying]);
    let error = |a: &[Vec<f64>], b: &[Vec<f64>]| {
        let of = |angles: &[Vec<f64>]| {
            angles.iter().map(|angles| variance / angles.len() as f64).sum::<f64>()
        };
        (of(a) + of(b)).sqrt() / stands.len() as f64
    };
    let errors = [error(&at_first, &reference), error(&at_second, &reference)];
    let (found, error_deg) = (shift(&verifying, &fresh)?, error(&verifying, &fresh));
    // The interval covers all powders; it scales with the mean of the simulated ones.
    let mut interval = extension.effect_ci95.map(|end| end * effect / extension.effect_deg);
    interval.sort_by(f64::total_cmp);
    let accepted = [interval[0] - 2.0 * error_deg, interval[1] + 2.0 * error_deg];
    let verified = (accepted[0]..=accepted[1]).contains(&found) && found * effect > 0.0;
    // Independent errors: that of the effect and that of the slope.
    let of_effect = (interval[1] - interval[0]) / (2.0 * DEVIATE) / effect;
    let of_slope =
        (first * errors[0]).hypot(second * errors[1]) / (first * first + second * second) / slope;
    let half = DEVIATE * of_effect.hypot(of_slope) * value.abs();
    let floor = if matches!(extension.hook, Hook::Extension(_)) { 0.0 } else { f64::NEG_INFINITY };
    let ci95 = if is_responding {
        [(value - half).max(floor), value + half]
    } else {
        extension.amplitude.ci95
    };
    let fit = Fit {
        sets: stands.iter().map(|stand| sets[stand.0].clone()).collect(),
        runs: (STAGES * stands.len() * repeats) as u32,
        shifts: vec![[first, shifts[0], errors[0]], [second, shifts[1], errors[1]]],
        verification: [found, error_deg],
        accepted,
        verified,
    };
    Some((ParameterReport { value, ci95, ..extension.amplitude.clone() }, fit))
}

/// Mean over powders of the difference of their means, degrees.
fn shift(at: &[Vec<f64>], reference: &[Vec<f64>]) -> Option<f64> {
    let of = |(at, reference): (&Vec<f64>, &Vec<f64>)| Some(mean(at)? - mean(reference)?);
    mean(&at.iter().zip(reference).map(of).collect::<Option<Vec<f64>>>()?)
}

/// Variance of a heap's angle, pooled over powders and amplitudes.
fn variance(stages: &[&Vec<Vec<f64>>]) -> f64 {
    let (mut squares, mut freedom) = (0.0, 0);
    for angles in stages.iter().flat_map(|stage| stage.iter()) {
        let middle = mean(angles).unwrap_or(0.0);
        squares += angles.iter().map(|angle| (angle - middle).powi(2)).sum::<f64>();
        freedom += angles.len() - 1;
    }
    if freedom > 0 { squares / freedom as f64 } else { HEAP_SD_DEG * HEAP_SD_DEG }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::extend::extension::Form;
    use flip_core::stats::normal;
    use std::cell::Cell;

    fn extension(effect_deg: f64) -> Extension {
        let on = |powder: &str, share: f64, factor: f64| OnPowder {
            powder: powder.into(),
            effect_deg: share * effect_deg,
            factor,
        };
        Extension {
            mechanism: "humidity".into(),
            hook: Hook::Extension("humidity".into()),
            form: Form::Named("h".into()),
            through: Vec::new(),
            strength: [0.0, 1.0],
            effect_deg,
            effect_ci95: [0.6 * effect_deg, 1.4 * effect_deg],
            amplitude: ParameterReport {
                name: "humidity".into(),
                value: 0.1,
                ci95: [0.05, 0.15],
                unit: "1".into(),
            },
            powders: vec![on("sand", 0.5, 0.5), on("salt", 1.5, 1.5), on("flour", 0.0, 0.0)],
            fit: None,
        }
    }

    fn sets() -> Vec<FitSet> {
        let set = |powder: &str| FitSet {
            powder: powder.into(),
            set: "ps-0".into(),
            source: "its calibration".into(),
        };
        ["flour", "salt", "sand"].map(set).to_vec()
    }

    /// 20 deg per unit amplitude, heaps that scatter by 0.5 deg.
    fn heaps(slope: f64) -> impl Fn(&[FitHeap]) -> Vec<Option<f64>> {
        let heap = move |FitHeap { set, patch, seed }: &FitHeap| {
            let noise = 0.5 * normal::quantile((seed % 9973) as f64 / 9973.0 * 0.98 + 0.01);
            let amplitude = patch.amplitudes.get("humidity").copied().unwrap_or(0.0);
            Some(30.0 + *set as f64 + slope * amplitude + noise)
        };
        move |all| all.iter().map(heap).collect()
    }

    #[test]
    fn the_amplitude_is_the_one_whose_heaps_move_as_far_and_fresh_heaps_agree() {
        let count = Cell::new(0);
        let counted = |all: &[FitHeap]| {
            count.set(count.get() + all.len() as u32);
            heaps(20.0)(all)
        };
        let (amplitude, fit) = super::fit(&extension(3.0), &sets(), 55, 1, counted).unwrap();
        // 3 deg at 20 deg per unit amplitude, via a first guess of 0.1 that moves by 2 deg.
        assert!((amplitude.value - 0.15).abs() < 0.03, "{amplitude:?}");
        assert!(
            amplitude.ci95[0] < 0.15 && amplitude.ci95[1] > 0.15 && amplitude.ci95[0] > 0.0,
            "{amplitude:?}"
        );
        assert!(fit.verified && (fit.verification[0] - 3.0).abs() < 1.0, "{fit:?}");
        // Five heaps of two powders each: 50 of 55; flour does not respond and has none.
        assert_eq!((fit.runs, count.into_inner()), (50, 50));
        assert_eq!(
            fit.sets.iter().map(|it| it.powder.as_str()).collect::<Vec<_>>(),
            ["salt", "sand"]
        );
    }

    #[test]
    fn heaps_that_do_not_move_or_the_other_way_verify_nothing() {
        for slope in [0.0, -20.0] {
            let (amplitude, fit) =
                super::fit(&extension(3.0), &sets(), 60, 1, heaps(slope)).unwrap();
            assert!(!fit.verified, "{slope}: {fit:?}");
            assert!(
                amplitude.value.is_finite() && amplitude.ci95.iter().all(|end| end.is_finite()),
                "{amplitude:?}"
            );
        }
    }

    #[test]
    fn the_budget_is_never_passed_and_the_same_seed_finds_the_same() {
        for budget in 0..40 {
            match super::fit(&extension(3.0), &sets(), budget, 1, heaps(20.0)) {
                Some((_, fit)) => {
                    assert!(fit.runs <= budget && budget >= 5, "{budget}: {}", fit.runs)
                }
                None => assert!(budget < 5, "{budget}"),
            }
        }
        let found = |seed| super::fit(&extension(3.0), &sets(), 30, seed, heaps(20.0));
        assert_eq!(found(1), found(1));
        assert_ne!(found(1), found(2));
        assert!(super::fit(&extension(3.0), &sets()[..1], 60, 1, heaps(20.0)).is_none());
        assert!(super::fit(&extension(3.0), &sets(), 60, 1, |all| vec![None; all.len()]).is_none());
    }
}
