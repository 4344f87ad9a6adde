//! Reads sets off the shared emulator and verifies them.
//!
//! 1. The points with the least expected error in a space-filling pool of the box form the
//!    *accepted region* ([`REGION`] of them).
//! 2. As many points as sets are missing are taken from it, each as far as possible from those
//!    before it, so that the sets differ.
//! 3. A point that the emulator is unsure of is first simulated once, as a *search* trial: one heap
//!    shows whether ten are worth it ([`Settings::tried_first`]).
//! 4. The points are verified with fresh seeds. The emulator learns from every run; a point that
//!    misses is replaced.
//!
//! Sets may be verified with heaps of a different size from the emulator's
//! ([`Settings::verify_particles`]). In that case the first [`PILOTS`] are verified before the
//! others: the difference between their heaps and the emulator's prediction is the shift between
//! the sizes ([`size_shift`]). From then on, both the target and the observations are passed to the
//! emulator less that shift.
//!
//! For a target outside the emulator's reach, the nearest point is verified instead, and the
//! limiting parameter is reported.

use super::acquisition::probability_within;
use super::channel::Knowledge;
use super::emulator::{Emulator, share};
use super::settings::Settings;
use super::space::{Point, Space};
use super::trial::{Outcome, Phase, Planned, Shortfall, Trial};
use super::verify::{candidates_of, verdict, verified};
use flip_core::domain::parameters::{COUNT, PARAMETERS, ParameterSet};
use flip_core::domain::powder::Flowability;
use flip_core::domain::seed::derive;
use flip_core::stats::gaussian_process::Prediction;
use flip_core::stats::latin_hypercube::{distance, latin_hypercube};
use flip_core::stats::summary;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use rayon::prelude::*;

/// Number of points in the pool.
const POOL: usize = 12_000;
/// Points in the accepted region, per set wanted.
const REGION: usize = 20;
/// Number of points preselected by the emulator's mean, for each point of the accepted region.
const CLOSE: usize = 8;
/// Seeds of the pool; no trial uses them.
const POINTS: u64 = u64::MAX - 1;
/// Below this probability of passing, a point is simulated before it is verified.
const SURE: f64 = 0.95;
/// Number of sets verified before the shift between two heap sizes is known.
const PILOTS: usize = 2;
/// Steps of the descent to the nearest angle.
const WALK: usize = 60;

/// Plans the next simulations; empty when the calibration is over.
pub(super) fn plan(
    trials: &[Trial],
    target: &Flowability,
    settings: &Settings,
    space: &Space,
    knowledge: &Knowledge<'_>,
) -> Vec<Planned> {
    let left = (settings.trials_max as usize).saturating_sub(trials.len());
    let sets = verified(trials, target, settings);
    let wanted = (settings.sets as usize).saturating_sub(sets.len());
    let shift = size_shift(trials, settings, knowledge.emulator);
    let unknown = settings.verify_particles.is_some() && shift.is_none();
    let affordable = wanted.min(left / settings.verify_repeats as usize).min(if unknown {
        PILOTS
    } else {
        usize::MAX
    });
    if affordable == 0 {
        return Vec::new();
    }
    let target = &in_emulator_heaps(target, shift);
    let emulator = grown(trials, settings, knowledge.emulator);
    let next = trials.iter().map(|trial| trial.candidate + 1).max().unwrap_or(0);
    let verification = |points: &[ParameterSet]| {
        let runs = (next..).zip(points).flat_map(|(candidate, set)| {
            (1..=settings.verify_repeats)
                .map(move |repeat| Planned::fresh(candidate, *set, repeat, settings))
        });
        runs.collect()
    };
    let pool = pool(settings.seed, space);
    if let Some(nearest) = beyond_reach(&emulator, target, settings, space, &pool) {
        // Verify only once: the verification is the answer. Pilots were verified before this was
        // known.
        let pilots = if settings.verify_particles.is_some() { PILOTS } else { 0 };
        return if candidates_of(trials).len() <= pilots {
            verification(&[nearest])
        } else {
            Vec::new()
        };
    }
    let region = region(&Knowledge { emulator: &emulator, ..*knowledge }, target, settings, pool);
    let of = |phase: Phase| {
        trials.iter().filter(move |t| t.phase == phase).map(|t| t.parameters.to_unit())
    };
    let (searched, verified): (Vec<Point>, Vec<Point>) =
        (of(Phase::Search).collect(), of(Phase::Verification).collect());
    let taken: Vec<Point> = sets.iter().map(|set| set.parameters.to_unit()).collect();
    let chosen = spread(region, taken, &verified, affordable);
    let doubtful = chosen
        .iter()
        .filter(|rated| rated.passes < SURE && !searched.contains(&rated.set.to_unit()));
    let heaps = (settings.tried_first as usize).saturating_sub(searched.len()).min(left);
    let doubtful: Vec<Planned> = (next..)
        .zip(doubtful.take(heaps))
        .map(|(candidate, rated)| {
            Planned::search(candidate, rated.set, settings.seed).read(settings.readings)
        })
        .collect();
    if !doubtful.is_empty() {
        return doubtful;
    }
    verification(&chosen.iter().map(|rated| rated.set).collect::<Vec<_>>())
}

/// Explains why a calibration ends with fewer sets than wanted.
pub(super) fn shortfall(
    trials: &[Trial],
    target: &Flowability,
    settings: &Settings,
    space: &Space,
    emulator: &Emulator,
) -> Option<Shortfall> {
    let shift = size_shift(trials, settings, emulator);
    let aim = in_emulator_heaps(target, shift);
    let emulator = grown(trials, settings, emulator);
    match beyond_reach(&emulator, &aim, settings, space, &pool(settings.seed, space)) {
        Some(nearest) => {
            let verdicts = candidates_of(trials)
                .into_iter()
                .filter_map(|k| verdict(k, trials, target, settings));
            let measured =
                verdicts.min_by(|a, b| a.verified_error_deg.total_cmp(&b.verified_error_deg));
            let expected = emulator.mean_deg(&nearest) + shift.unwrap_or(0.0);
            Some(Shortfall {
                nearest_repose_deg: measured.map_or(expected, |set| set.repose_deg),
                limiting_parameter: limiting(&emulator, &nearest, &aim, space).map(str::to_owned),
            })
        }
        None => super::nearest(trials)
            .map(|nearest_repose_deg| Shortfall { nearest_repose_deg, limiting_parameter: None }),
    }
}

/// Angle of the verification heaps minus that of heaps of the emulator's size, degrees: the mean
/// over the verified runs of the difference from the emulator's prediction before it has seen any
/// of them. None if the sizes are equal, or nothing has been verified yet.
pub(super) fn size_shift(
    trials: &[Trial],
    settings: &Settings,
    emulator: &Emulator,
) -> Option<f64> {
    settings.verify_particles?;
    let verified = trials.iter().filter(|trial| trial.phase == Phase::Verification);
    let shifts: Vec<f64> = verified
        .filter_map(|t| Some(t.outcome.tip_deg()? - emulator.mean_deg(&t.parameters)))
        .collect();
    summary::mean(&shifts)
}

/// Converts a target to heaps of the emulator's size.
pub fn in_emulator_heaps(target: &Flowability, shift: Option<f64>) -> Flowability {
    Flowability { repose_deg: target.repose_deg - shift.unwrap_or(0.0), ..*target }
}

/// The emulator extended by the simulations so far, all converted to heaps of the emulator's size.
fn grown(trials: &[Trial], settings: &Settings, emulator: &Emulator) -> Emulator {
    let shift = size_shift(trials, settings, emulator).unwrap_or(0.0);
    let moved = trials.iter().cloned().map(|mut trial| {
        if let (Phase::Verification, Outcome::Heap(heap)) = (trial.phase, &mut trial.outcome) {
            heap.tip_deg -= shift;
        }
        trial
    });
    emulator.with(&moved.collect::<Vec<_>>())
}

fn pool(seed: u64, space: &Space) -> Vec<ParameterSet> {
    let mut rng = Pcg64::seed_from_u64(derive(seed, &[POINTS]));
    latin_hypercube(POOL, &mut rng).iter().map(|point| space.parameters_at(point)).collect()
}

/// A point and the emulator's prediction for it.
#[derive(Debug, Clone, Copy)]
struct Rated {
    set: ParameterSet,
    /// E |f - t| in tolerances, plus the contribution of other observables.
    misfit: f64,
    /// Probability that its verification is within the tolerance.
    passes: f64,
}

/// The points with the least expected error, best first. Other measurements count in addition to
/// the angle.
fn region(
    knowledge: &Knowledge<'_>,
    target: &Flowability,
    settings: &Settings,
    pool: Vec<ParameterSet>,
) -> Vec<Rated> {
    let emulator = knowledge.emulator;
    let misfit = |set: &ParameterSet, error_deg: f64| {
        let others: f64 = knowledge.channels.iter().map(|channel| channel.misfit(set)).sum();
        error_deg / settings.tolerance_deg + others
    };
    let verification = share(settings.readings) / f64::from(settings.verify_repeats);
    let rate = |set: ParameterSet| {
        let expected = emulator.expect(&set);
        let Prediction { mean, sd } = expected.mean;
        let verified =
            Prediction { mean, sd: sd.hypot(expected.seed_sd_deg * verification.sqrt()) };
        let passes = probability_within(verified, target.repose_deg, settings.tolerance_deg);
        Rated { set, misfit: misfit(&set, (mean - target.repose_deg).hypot(sd)), passes }
    };
    // The uncertainty is computed only for points that the mean does not rule out.
    let mut near: Vec<(f64, ParameterSet)> = pool
        .into_par_iter()
        .map(|set| (misfit(&set, (emulator.mean_deg(&set) - target.repose_deg).abs()), set))
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    near.truncate(CLOSE * REGION * settings.sets as usize);
    let mut rated: Vec<Rated> = near.into_par_iter().map(|(_, set)| rate(set)).collect();
    rated.sort_by(|a, b| a.misfit.total_cmp(&b.misfit));
    rated.truncate(REGION * settings.sets as usize);
    rated
}

/// Selects `count` of the points, each the farthest from those taken before it; skips those already
/// verified.
///
/// The maximin idea is from Johnson, Moore and Ylvisaker (1990).
fn spread(
    mut region: Vec<Rated>,
    mut taken: Vec<Point>,
    verified: &[Point],
    count: usize,
) -> Vec<Rated> {
    region.retain(|rated| !verified.contains(&rated.set.to_unit()));
    let mut chosen = Vec::new();
    while chosen.len() < count && !region.is_empty() {
        let gap = |rated: &Rated| {
            let at = rated.set.to_unit();
            taken.iter().map(|other| distance(&at, other)).fold(f64::INFINITY, f64::min)
        };
        // With nothing taken yet, all gaps are equal, and the first point, with the least error,
        // wins.
        let best =
            (0..region.len()).rev().max_by(|a, b| gap(&region[*a]).total_cmp(&gap(&region[*b])));
        let rated = region.remove(best.expect("the region is not empty"));
        taken.push(rated.set.to_unit());
        chosen.push(rated);
    }
    chosen
}

/// The set whose angle is probably nearest to a target that no set reaches within the tolerance;
/// none for a target within reach.
fn beyond_reach(
    emulator: &Emulator,
    target: &Flowability,
    settings: &Settings,
    space: &Space,
    pool: &[ParameterSet],
) -> Option<ParameterSet> {
    let miss = |set: &ParameterSet| (emulator.mean_deg(set) - target.repose_deg).abs();
    let start = pool.par_iter().map(|set| (miss(set), *set)).min_by(|a, b| a.0.total_cmp(&b.0))?;
    if start.0 <= settings.tolerance_deg {
        return None;
    }
    // Coordinate descent with halving steps: the angle is smooth and mostly monotone in each
    // parameter.
    let (mut least, mut at) = (start.0, start.1.to_unit());
    let mut step = 0.5;
    for _ in 0..WALK {
        let before = least;
        for j in (0..COUNT).filter(|j| !space.holds(*j)) {
            for sign in [-1.0, 1.0] {
                let mut moved = at;
                moved[j] = (moved[j] + sign * step).clamp(0.0, 1.0);
                let there = miss(&space.parameters_at(&moved));
                if there < least {
                    (least, at) = (there, moved);
                }
            }
        }
        if least <= settings.tolerance_deg {
            return None;
        }
        if before == least {
            step *= 0.5;
        }
        if step < 1e-3 {
            break;
        }
    }
    Some(space.parameters_at(&at))
}

/// The parameter at a bound of the box that would bring the angle of `set` nearest to the target if
/// the bound were relaxed: the one with the steepest slope into its bound, from a difference over a
/// twentieth of its range.
fn limiting(
    emulator: &Emulator,
    set: &ParameterSet,
    target: &Flowability,
    space: &Space,
) -> Option<&'static str> {
    let at = set.to_unit();
    let here = emulator.mean_deg(set);
    let towards = (target.repose_deg - here).signum();
    let slope = |k: usize| {
        let at_bound = (at[k] < 0.02 || at[k] > 0.98) && !space.holds(k);
        let mut inward = at;
        inward[k] += if at[k] < 0.5 { 0.05 } else { -0.05 };
        let gained = towards * (here - emulator.mean_deg(&space.parameters_at(&inward)));
        if at_bound { gained } else { 0.0 }
    };
    let steepest = (0..COUNT).map(|k| (slope(k), k)).max_by(|a, b| a.0.total_cmp(&b.0))?;
    (steepest.0 > 0.0).then_some(PARAMETERS[steepest.1].key)
}
