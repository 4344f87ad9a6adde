//! Tuning the open-loop rival: the best schedule of pitches and shakes for the training powders.

use super::environment::{Filling, Spoon};
use super::spoons::Spoons;
use super::training::Level;
use crate::domain::bench::{Action, SHAKE_MM_MAX};
use crate::domain::seed::derive;
use crate::policy::{Controller, Episode, Observation, Rules, Schedule, ScheduledStep};
use crate::sim::balance;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How a schedule is searched; stored with the result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = TuningSettings)]
#[serde(deny_unknown_fields)]
pub struct Tuning {
    /// Seed of the search.
    pub seed: u64,
    /// Schedules tried at first. Default 64; each round keeps the better quarter and pours twice as often.
    pub candidates: u32,
    /// Spoons per powder in the first round. Default 1.
    pub spoons: u32,
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
            targets_mg: vec![5.0, 7.5, 10.0, 12.5, 15.0],
            rules: Rules::FLIP,
            balance: balance::Settings::default(),
        }
    }
}

/// A schedule and how it did in the search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Tuned {
    /// The schedule.
    pub schedule: Schedule,
    /// Mean absolute error over powders, spoons and targets of its last round, mg. It was chosen for being small: expect more on
    /// other spoons.
    pub mae_mg: f64,
    /// Schedules poured, counting a schedule again in each round.
    pub pours: u32,
}

/// Steps of a tuned schedule.
const STEPS: usize = 10;

/// Pitch and shake that go linearly from a first to a last value.
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

/// Search the schedule with the smallest mean absolute error on these powders.
///
/// Random ramps, then successive halving (Jamieson and Talwalkar 2016): each round pours every remaining schedule over more spoons and
/// keeps the better quarter. What an open-loop schedule pours does not depend on the target, so one pour serves all targets.
///
/// # Panics
/// Without powders, parameter sets, targets or candidates.
pub fn tune<F: Filling>(filling: &F, levels: &[Level], tuning: &Tuning) -> Tuned {
    assert!(!levels.is_empty() && levels.iter().all(|l| !l.sets.is_empty()) && tuning.candidates > 0);
    let spoons = Spoons::new(filling, derive(tuning.seed, &[1]));
    let mut rng = Pcg64Mcg::seed_from_u64(derive(tuning.seed, &[2]));
    let mut field: Vec<Schedule> = (0..tuning.candidates)
        .map(|_| {
            let mut step = || ScheduledStep {
                pitch_deg: rng.random_range(0.0..tuning.rules.pitch.upper_deg),
                shake_mm: rng.random_range(1.0..SHAKE_MM_MAX),
            };
            ramp(step(), step())
        })
        .collect();
    let (mut doses, mut pours) = (tuning.spoons, 0);
    loop {
        let mut scored: Vec<(f64, Schedule)> = field
            .into_par_iter()
            .map(|schedule| (score(&schedule, levels, tuning, &spoons, doses), schedule))
            .collect();
        pours += scored.len() as u32 * doses * levels.len() as u32;
        // A stable sort: of equals the first drawn wins.
        scored.sort_by(|a, b| a.0.total_cmp(&b.0));
        if scored.len() == 1 {
            let (mae_mg, schedule) = scored.remove(0);
            return Tuned { schedule, mae_mg, pours };
        }
        scored.truncate(scored.len().div_ceil(4));
        field = scored.into_iter().map(|(_, schedule)| schedule).collect();
        doses *= 2;
    }
}

/// Mean absolute error of a schedule over powders, spoons and targets, mg.
fn score<F: Filling>(schedule: &Schedule, levels: &[Level], tuning: &Tuning, spoons: &Spoons<F>, doses: u32) -> f64 {
    let mut errors = Vec::new();
    for level in levels {
        for dose in 0..doses {
            let set = &level.sets[dose as usize % level.sets.len()];
            let spoon = spoons.take(set, dose / level.sets.len() as u32);
            errors.extend(errors_mg(schedule, spoon, tuning, derive(tuning.seed, &[3, dose.into()])));
        }
    }
    errors.iter().sum::<f64>() / errors.len() as f64
}

/// The absolute true error at each target when one spoon is poured by this schedule.
fn errors_mg(schedule: &Schedule, mut spoon: impl Spoon, tuning: &Tuning, seed: u64) -> Vec<f64> {
    let controller = Controller::Schedule(schedule.clone());
    let mut waiting = tuning.targets_mg.clone();
    let mut errors = Vec::new();
    let mut reading_mg = 0.0;
    for steps in 1..=tuning.rules.steps_max {
        let before_mg = spoon.vial_mg();
        let seen = Observation { reading_mg, target_mg: 0.0, pitch_deg: spoon.pitch_deg() };
        let action: Action = controller.propose(steps - 1, &seen);
        spoon.step(action);
        reading_mg = tuning.balance.read(before_mg, spoon.vial_mg(), seed, steps.into()).mass_mg;
        waiting.retain(|&target_mg| {
            let seen = Observation { reading_mg, target_mg, pitch_deg: spoon.pitch_deg() };
            let goes_on = tuning.rules.after(steps, &seen) == Episode::Running;
            if !goes_on {
                errors.push((target_mg - spoon.vial_mg()).abs());
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
    use crate::domain::bench::PitchLimits;
    use crate::domain::parameters::ParameterSet;
    use crate::train::formula::Formula;

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
        let other = Spoons::new(&formula, 99);
        let fixed = Schedule { steps: vec![ScheduledStep::FIXED] };
        let (ours, theirs) =
            (score(&tuned.schedule, &levels(), &tuning, &other, 20), score(&fixed, &levels(), &tuning, &other, 20));
        assert!(ours < theirs, "tuned {ours}, fixed {theirs}");
        assert_eq!(tune(&formula, &levels(), &tuning), tuned, "the same seed finds the same schedule");
    }

    #[test]
    fn every_target_gets_exactly_one_error_even_when_nothing_pours() {
        let tuning = Tuning::new(1);
        let formula = Formula { pitch: PitchLimits::WIDE };
        let still = Schedule { steps: vec![ScheduledStep { pitch_deg: 0.0, shake_mm: 0.0 }] };
        let spoon = formula.fill(&ParameterSet::default(), 1);
        assert_eq!(errors_mg(&still, spoon, &tuning, 1), tuning.targets_mg);
    }
}
