//! Tuning of the open-loop rival: the best schedule of pitches and shakes for the training powders.

use super::environment::{Filling, Spoon};
use super::record::Level;
use super::spoons::Spoons;
use flip_core::domain::bench::{Action, SHAKE_MM_MAX};
use flip_core::domain::conditions::Patch;
use flip_core::domain::seed::derive;
use flip_policy::{Controller, Episode, ON_TARGET_MG, Observation, Rules, Schedule, ScheduledStep};
use flip_sim::balance;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How a schedule is searched for; stored with the result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tuning {
    /// Seed of the search.
    pub seed: u64,
    /// Schedules drawn initially; half as many are then drawn around the best of them. Default 64.
    pub candidates: u32,
    /// Spoons per powder in the first round. Default 1.
    pub spoons: u32,
    /// Weight in the search of errors of more than 1 mg above the target. Default 1.
    pub overdose_factor: f64,
    /// Targets a schedule has to serve, mg. Default 5 to 15 in steps of 2.5.
    pub targets_mg: Vec<f64>,
    /// Steps, ending and pitch range.
    pub rules: Rules,
    /// The balance.
    pub balance: balance::Settings,
}

impl Tuning {
    /// The default search.
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            candidates: 64,
            spoons: 1,
            overdose_factor: 1.0,
            targets_mg: vec![5.0, 7.5, 10.0, 12.5, 15.0],
            rules: Rules::FLIP,
            balance: balance::Settings::default(),
        }
    }

    /// The same with every error weighted once.
    pub(super) fn plain(&self) -> Self {
        Self { overdose_factor: 1.0, ..self.clone() }
    }
}

/// A schedule and its search result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tuned {
    /// The schedule.
    pub schedule: Schedule,
    /// Mean absolute error over powders, spoons and targets of its last round, mg. It was selected
    /// for a small value: expect more on other spoons.
    pub mae_mg: f64,
    /// Schedules poured, counted once per round.
    pub pours: u32,
}

/// Number of steps of a tuned schedule.
const STEPS: usize = 10;

/// A schedule whose pitch and shake go linearly from a first to a last value.
fn ramp(first: ScheduledStep, last: ScheduledStep) -> Schedule {
    let steps = (0..STEPS).map(|k| {
        let w = k as f64 / (STEPS - 1) as f64;
        let round = |x: f64| (x * 10.0).round() / 10.0;
        ScheduledStep {
            pitch_deg: round(first.pitch_deg + w * (last.pitch_deg - first.pitch_deg)),
            shake_mm: round(first.shake_mm + w * (last.shake_mm - first.shake_mm)),
        }
    });
    Schedule { steps: steps.collect() }
}

/// Searches for the schedule with the smallest mean absolute error on these powders.
///
/// Random ramps and successive halving (Jamieson and Talwalkar 2016), then once more around the
/// best of them. The pours of an open-loop schedule do not depend on the target, so one pour serves
/// all targets.
///
/// # Panics
/// Without powders, parameter sets, targets or candidates.
pub fn tune<F: Filling>(filling: &F, levels: &[Level], tuning: &Tuning) -> Tuned {
    let pitch_max_deg = tuning.rules.pitch.upper_deg;
    let draw = |rng: &mut Pcg64Mcg| {
        let mut step = || ScheduledStep {
            pitch_deg: rng.random_range(0.0..pitch_max_deg),
            shake_mm: rng.random_range(1.0..SHAKE_MM_MAX),
        };
        [step(), step()]
    };
    let aside = |ends: &Ends, rng: &mut Pcg64Mcg| {
        ends.map(|from| ScheduledStep {
            pitch_deg: (from.pitch_deg + rng.random_range(-6.0..6.0)).clamp(0.0, pitch_max_deg),
            shake_mm: (from.shake_mm + rng.random_range(-2.5..2.5)).clamp(1.0, SHAKE_MM_MAX),
        })
    };
    let score = |[first, last]: &Ends, spoons: &Spoons<&F>, doses| {
        score(&ramp(*first, *last), levels, tuning, spoons, doses)
    };
    let (best, spoons) = search(filling, levels, tuning, KEPT, draw, aside, score);
    let (mae_mg, [first, last]) = best[0];
    Tuned { schedule: ramp(first, last), mae_mg, pours: spoons * levels.len() as u32 }
}

/// The two ends of a ramp.
type Ends = [ScheduledStep; 2];
/// Number of candidates returned by a search.
pub(super) const KEPT: usize = 4;

/// Successive halving among candidates drawn at random, then once more among the best of them and
/// variants: half as many as were drawn. Returns the `kept` best, best first, and the number of
/// spoons of each powder that were poured.
///
/// # Panics
/// Without powders, parameter sets or candidates.
pub(super) fn search<F: Filling, C: Send + Sync>(
    filling: &F,
    levels: &[Level],
    tuning: &Tuning,
    kept: usize,
    draw: impl Fn(&mut Pcg64Mcg) -> C,
    aside: impl Fn(&C, &mut Pcg64Mcg) -> C,
    score: impl Fn(&C, &Spoons<&F>, u32) -> f64 + Sync,
) -> (Vec<(f64, C)>, u32) {
    assert!(
        !levels.is_empty() && levels.iter().all(|l| !l.sets.is_empty()) && tuning.candidates > 0
    );
    let spoons = Spoons::new(filling, derive(tuning.seed, &[1]));
    let mut rng = Pcg64Mcg::seed_from_u64(derive(tuning.seed, &[2]));
    let score = |candidate: &C, doses| score(candidate, &spoons, doses);
    let drawn = (0..tuning.candidates).map(|_| draw(&mut rng)).collect();
    let (best, first_spoons) = halve(drawn, tuning.spoons, kept, score);
    let around: Vec<C> = (best.len()..tuning.candidates.div_ceil(2) as usize)
        .map(|k| aside(&best[k % best.len()].1, &mut rng))
        .collect();
    let field = best.into_iter().map(|(_, candidate)| candidate).chain(around).collect();
    let (best, second_spoons) = halve(field, tuning.spoons, kept, score);
    (best, first_spoons + second_spoons)
}

/// Successive halving: each round scores every remaining candidate on twice as many spoons of each
/// powder and keeps the better quarter, until `kept` are left. Returns those with their scores,
/// best first, and the number of spoons of each powder that were poured.
pub(super) fn halve<C: Send + Sync>(
    mut field: Vec<C>,
    mut spoons: u32,
    kept: usize,
    score: impl Fn(&C, u32) -> f64 + Sync,
) -> (Vec<(f64, C)>, u32) {
    let mut poured = 0;
    loop {
        let mut scored: Vec<(f64, C)> =
            field.into_par_iter().map(|c| (score(&c, spoons), c)).collect();
        poured += scored.len() as u32 * spoons;
        // A stable sort: among equals, the first drawn wins.
        scored.sort_by(|a, b| a.0.total_cmp(&b.0));
        if scored.len() <= kept {
            return (scored, poured);
        }
        scored.truncate(scored.len().div_ceil(4).max(kept));
        field = scored.into_iter().map(|(_, candidate)| candidate).collect();
        spoons *= 2;
    }
}

/// Mean absolute error of a schedule on `doses` spoons of each powder, filled with a seed not used
/// in the search, mg.
pub fn assess<F: Filling>(
    filling: &F,
    levels: &[Level],
    tuning: &Tuning,
    schedule: &Schedule,
    doses: u32,
    seed: u64,
) -> f64 {
    score(schedule, levels, &tuning.plain(), &Spoons::new(filling, derive(seed, &[4])), doses)
}

/// Mean absolute error of a schedule over powders, spoons and targets, mg.
fn score<F: Filling>(
    schedule: &Schedule,
    levels: &[Level],
    tuning: &Tuning,
    spoons: &Spoons<&F>,
    doses: u32,
) -> f64 {
    let controller = Controller::Schedule(schedule.clone());
    mean_error_mg(levels, tuning.seed, spoons, doses, |spoon, seed| {
        errors_mg(&controller, spoon, tuning, &tuning.targets_mg, 0.0, seed)
    })
}

/// Mean of the errors `pour` makes with a spoon and a seed, over `doses` spoons of each powder, mg.
pub(super) fn mean_error_mg<F: Filling>(
    levels: &[Level],
    seed: u64,
    spoons: &Spoons<&F>,
    doses: u32,
    pour: impl Fn(F::Spoon, u64) -> Vec<f64> + Sync,
) -> f64 {
    let pours: Vec<(&Level, u32)> =
        levels.iter().flat_map(|level| (0..doses).map(move |dose| (level, dose))).collect();
    // `collect` keeps the order, so the sum is the same at any thread count.
    let errors: Vec<f64> = pours
        .into_par_iter()
        .flat_map_iter(|(level, dose)| {
            let set = &level.sets[dose as usize % level.sets.len()];
            let spoon = spoons.take(set, dose / level.sets.len() as u32, &Patch::default());
            pour(spoon, derive(seed, &[3, dose.into()]))
        })
        .collect();
    errors.iter().sum::<f64>() / errors.len() as f64
}

/// Weighted true errors at each target when this controller, given the target `shown_mg`, pours one
/// spoon.
pub(super) fn errors_mg(
    controller: &Controller,
    mut spoon: impl Spoon,
    tuning: &Tuning,
    targets_mg: &[f64],
    shown_mg: f64,
    seed: u64,
) -> Vec<f64> {
    let mut dosing = controller.begin(&tuning.rules, tuning.balance.readability_mg);
    let mut waiting = targets_mg.to_vec();
    let mut errors = Vec::new();
    let mut reading_mg = 0.0;
    for steps in 1..=tuning.rules.steps_max {
        let before_mg = spoon.vial_mg();
        let seen = Observation { reading_mg, target_mg: shown_mg, pitch_deg: spoon.pitch_deg() };
        let action: Action = dosing.propose(&seen);
        spoon.step(action);
        reading_mg = tuning.balance.read(before_mg, spoon.vial_mg(), seed, steps.into()).mass_mg;
        waiting.retain(|&target_mg| {
            let seen = Observation { reading_mg, target_mg, pitch_deg: spoon.pitch_deg() };
            let goes_on =
                tuning.rules.after(steps, &seen, tuning.balance.readability_mg) == Episode::Running;
            if !goes_on {
                let missing_mg = target_mg - spoon.vial_mg();
                let factor = if missing_mg < -ON_TARGET_MG { tuning.overdose_factor } else { 1.0 };
                errors.push(factor * missing_mg.abs());
            }
            goes_on
        });
        if waiting.is_empty() {
            break;
        }
    }
    errors
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::formula::Formula;
    use flip_core::domain::bench::PitchLimits;
    use flip_core::domain::parameters::ParameterSet;

    fn levels() -> Vec<Level> {
        let level = |powder: &str, friction| Level {
            powder: powder.into(),
            repose_deg: 30.0,
            sets: vec![ParameterSet::default().with("friction", friction).unwrap()],
        };
        vec![level("easy", 0.3), level("hard", 0.6)]
    }

    #[test]
    fn a_tuned_schedule_beats_the_fixed_action_on_other_spoons() {
        let formula = Formula { pitch: PitchLimits::WIDE };
        let tuning = Tuning::new(1);
        let tuned = tune(&formula, &levels(), &tuning);
        let fixed = Schedule { steps: vec![ScheduledStep::FIXED] };
        let on_others = |schedule| assess(&formula, &levels(), &tuning, schedule, 20, 99);
        let (ours, theirs) = (on_others(&tuned.schedule), on_others(&fixed));
        assert!(ours < theirs, "tuned {ours}, fixed {theirs}");
        assert_eq!(
            tune(&formula, &levels(), &tuning),
            tuned,
            "the same seed finds the same schedule"
        );
    }

    #[test]
    fn every_target_gets_exactly_one_error_even_when_nothing_pours() {
        let tuning = Tuning::new(1);
        let formula = Formula { pitch: PitchLimits::WIDE };
        let still = Controller::Fixed(ScheduledStep { pitch_deg: 0.0, shake_mm: 0.0 });
        let spoon = formula.fill(&ParameterSet::default(), 1);
        assert_eq!(
            errors_mg(&still, spoon, &tuning, &tuning.targets_mg, 0.0, 1),
            tuning.targets_mg
        );
    }
}
