use super::*;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::powder::PUBLISHED;
use flip_core::stats::latin_hypercube::{distance, latin_hypercube};
use flip_core::stats::normal::quantile;
use rayon::prelude::*;
use std::sync::Mutex;

/// A simulator that carries out `one` experiment after another on the threads of the current pool.
pub(super) fn each<E: Sync, O: Send>(one: impl Fn(&E) -> O + Sync) -> impl Fn(&[E]) -> Vec<O> {
    move |experiments| experiments.par_iter().map(&one).collect()
}

/// A formula shaped like the real simulator: friction raises the angle with decreasing slope,
/// cohesion over gravity raises it, six parameters do nothing, each seed adds noise of SD 1 deg.
fn formula(pours: &[Pour]) -> Vec<Result<Heap, String>> {
    each(|pour: &Pour| tip(&pour.parameters, pour.seed))(pours)
}

fn tip(set: &ParameterSet, seed: u64) -> Result<Heap, String> {
    let uniform = ((derive(seed, &[1]) >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
    heap(clean_deg(set) + quantile(uniform))
}

fn clean_deg(set: &ParameterSet) -> f64 {
    12.0 + 32.0 * set.friction().sqrt() + 6.0 * set.cohesion() / set.gravity_scale()
}

fn heap(tip_deg: f64) -> Result<Heap, String> {
    Ok(Heap { tip_deg, tip_sd_deg: None, cone_deg: tip_deg - 2.0, creep_deg_per_s: 0.0 })
}

fn target(repose_deg: f64) -> Flowability {
    Flowability { repose_deg, sd_deg: 1.5, n: 5 }
}

/// Quick settings for tests that are not about the number of simulations.
fn few() -> Settings {
    Settings { sets: 4, seed: 3, ..Settings::default() }
}

fn run(deg: f64, settings: &Settings) -> Result<Calibration, Error> {
    calibrate(&target(deg), settings, None, &[], formula, |_, _| ControlFlow::Continue(()))
}

/// The result and every trial reported.
fn recorded(
    settings: &Settings,
    simulate: impl Fn(&[Pour]) -> Vec<Result<Heap, String>>,
) -> (Vec<Trial>, Result<Calibration, Error>) {
    let mut trials = Vec::new();
    let result = calibrate(&target(36.03), settings, None, &[], simulate, |trial, _| {
        trials.push(trial.clone());
        ControlFlow::Continue(())
    });
    (trials, result)
}

#[test]
fn ten_verified_and_distinct_sets_are_found_for_every_published_powder_within_budget() {
    let (mut evaluations, mut verifications, mut errors) = (Vec::new(), Vec::new(), Vec::new());
    for powder in PUBLISHED {
        for seed in 1..=4 {
            let target = powder.automated;
            let found = run(target.repose_deg, &Settings { seed, ..Settings::default() }).unwrap();
            assert_eq!(found.sets.len(), 10);
            for (i, set) in found.sets.iter().enumerate() {
                assert!(set.error_deg <= 1.5 && set.runs == 2 && set.repose_sd_deg.is_some());
                let point = set.parameters.to_unit();
                let others = found.sets[..i].iter().map(|s| s.parameters.to_unit());
                let nearest = others.map(|o| distance(&point, &o)).fold(9.0, f64::min);
                assert!(nearest > 0.15, "{}, seed {seed}: two sets {nearest} apart", powder.id);
                errors.push((clean_deg(&set.parameters) - target.repose_deg).abs());
            }
            evaluations.push(f64::from(found.evaluations));
            verifications.push(f64::from(found.verification_runs));
        }
    }
    let mean = |values: &[f64]| summary::mean(values).unwrap();
    let most = |values: &[f64]| values.iter().fold(0.0f64, |a, b| a.max(*b));
    println!(
        "20 calibrations: {:.1} evaluations (at most {}), {:.1} verification runs (at most {}), true error {:.2} deg",
        mean(&evaluations),
        most(&evaluations),
        mean(&verifications),
        most(&verifications),
        mean(&errors),
    );
    assert!(mean(&evaluations) <= 25.0 && mean(&verifications) <= 26.0);
    assert!(most(&evaluations) <= 40.0 && mean(&errors) <= 0.75);
}

#[test]
fn random_search_needs_several_times_as_many_simulations() {
    let powder = target(36.03);
    let settings = Settings::default();
    let found = run(powder.repose_deg, &settings).unwrap();
    let budget = found.evaluations + found.verification_runs;
    // Same tolerance and verification, points at random.
    let (mut spent, mut sets) = (0, 0);
    for (i, point) in latin_hypercube(10_000, &mut Pcg64::seed_from_u64(1)).iter().enumerate() {
        let set = ParameterSet::from_unit(*point);
        let tip = |repeat| tip(&set, derive(9, &[i as u64, repeat])).unwrap().tip_deg;
        spent += 1;
        if (tip(0) - powder.repose_deg).abs() <= settings.tolerance_deg {
            spent += 2;
            sets += u32::from(
                ((tip(1) + tip(2)) / 2.0 - powder.repose_deg).abs() <= settings.tolerance_deg,
            );
        }
        if sets == settings.sets {
            break;
        }
    }
    println!("random search: {spent} simulations, Bayesian optimisation: {budget}");
    assert!(spent > 2 * budget, "random {spent}, ours {budget}");
}

#[test]
fn a_run_cut_after_any_trial_and_resumed_ends_with_the_same_bytes_at_any_number_of_threads() {
    let (whole, result) = recorded(&few(), formula);
    let expected = serde_json::to_string(&result.unwrap()).unwrap();
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        for cut in 0..=whole.len() {
            // What a store would return.
            let text = serde_json::to_string(&whole[..cut]).unwrap();
            let history: Vec<Trial> = serde_json::from_str(&text).unwrap();
            let asked = Mutex::new(Vec::new());
            let mut heard = history.clone();
            let counted = each(|pour: &Pour| {
                asked.lock().unwrap().push(pour.seed);
                tip(&pour.parameters, pour.seed)
            });
            let hear = |trial: &Trial, _: &Progress| {
                heard.push(trial.clone());
                ControlFlow::Continue(())
            };
            let resumed = pool
                .install(|| calibrate(&target(36.03), &few(), None, &history, counted, hear))
                .unwrap();
            assert_eq!(serde_json::to_string(&resumed).unwrap(), expected, "cut after {cut}");
            assert!(heard == whole, "another history after a cut at {cut}");
            let asked = asked.into_inner().unwrap();
            assert_eq!(asked.len(), whole.len() - cut);
            assert!(
                history.iter().all(|trial| !asked.contains(&trial.seed)),
                "a trial was simulated again"
            );
        }
    }
}

#[test]
fn a_stop_after_any_trial_keeps_what_was_heard_and_the_rest_follows_from_it() {
    let (whole, _) = recorded(&few(), formula);
    for stop in [1, 5, whole.len() / 2, whole.len()] {
        let mut heard = Vec::new();
        let stopped = calibrate(&target(36.03), &few(), None, &[], formula, |trial, _| {
            heard.push(trial.clone());
            if heard.len() == stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        assert_eq!(stopped, Err(Error::Stopped));
        assert!(heard == whole[..stop]);
    }
}

#[test]
fn trials_are_numbered_without_gaps_and_no_two_share_a_seed() {
    let (trials, result) = recorded(&Settings::default(), formula);
    let mut seeds: Vec<u64> = trials.iter().map(|t| t.seed).collect();
    seeds.sort_unstable();
    seeds.dedup();
    assert_eq!(seeds.len(), trials.len());
    for (i, trial) in trials.iter().enumerate() {
        assert_eq!(trial.index, i as u32);
        let origin = &trials[trial.candidate as usize];
        assert!(origin.phase == Phase::Search && origin.parameters == trial.parameters);
    }
    let result = result.unwrap();
    assert_eq!((result.evaluations + result.verification_runs) as usize, trials.len());
    for set in &result.sets {
        let fresh = trials
            .iter()
            .filter(|t| t.phase == Phase::Verification && t.parameters == set.parameters);
        let tips: Vec<f64> = fresh.filter_map(|t| t.outcome.tip_deg()).collect();
        assert_eq!(summary::mean(&tips), Some(set.repose_deg));
    }
}

#[test]
fn of_good_candidates_those_far_apart_are_verified_first() {
    let (settings, powder) = (Settings::default(), target(36.0));
    let at = |coordinates: [f64; 3]| {
        let [friction, damping, mass] = coordinates;
        space::parameters_at(&[0.5, 0.5, 0.5, 0.5, friction, 0.5, damping, 0.5, mass])
    };
    // All at the target except the last, which is within the tolerance: three neighbours, one at
    // the other end, one in between.
    let points = [
        [0.5, 0.1, 0.1],
        [0.5, 0.12, 0.1],
        [0.5, 0.1, 0.12],
        [0.5, 0.9, 0.9],
        [0.53, 0.5, 0.5],
        [0.1, 0.5, 0.5],
        [0.9, 0.5, 0.5],
    ];
    let trials: Vec<Trial> = (0..)
        .zip(points)
        .map(|(index, point)| {
            let tip = heap(36.0 + 40.0 * (point[0] - 0.5));
            Planned::search(index, at(point), 1).concluded(index, Outcome::of(tip), Some(&powder))
        })
        .collect();
    let emulator = Belief::of(&trials, powder.repose_deg).unwrap();
    let candidates = verify::candidates(&trials, &emulator, &settings);
    assert_eq!(candidates.iter().map(|c| c.index).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
    let first = verify::choose(candidates, Vec::new(), 3, &emulator, &settings);
    let mut first: Vec<u32> = first.iter().map(|c| c.index).collect();
    first.sort_unstable();
    assert!(first[0] <= 2 && first[1..] == [3, 4], "{first:?}");
}

#[test]
fn progress_never_goes_back_and_ends_at_one() {
    let mut last = 0.0;
    let hear = |_: &Trial, progress: &Progress| {
        assert!(progress.fraction >= last && progress.fraction <= 1.0);
        last = progress.fraction;
        ControlFlow::Continue(())
    };
    calibrate(&target(31.41), &few(), None, &[], formula, hear).unwrap();
    assert_eq!(last, 1.0);
}

#[test]
fn refused_simulations_are_recorded_and_then_avoided() {
    // Gravity below 0.7 of the published range never yields a heap: half of the box.
    let picky = each(|pour: &Pour| match pour.parameters.gravity_scale() < 0.7 {
        true => Err("the base is not covered".to_owned()),
        false => tip(&pour.parameters, pour.seed),
    });
    let (mut early, mut late) = ((0, 0), (0, 0));
    for seed in 1..=4 {
        let (trials, result) = recorded(&Settings { seed, ..Settings::default() }, &picky);
        let result = result.unwrap();
        assert!(result.sets.iter().all(|s| s.parameters.gravity_scale() >= 0.7));
        for trial in trials.iter().filter(|t| t.phase == Phase::Search) {
            let refused = trial.outcome == Outcome::Refused("the base is not covered".to_owned());
            assert_eq!(refused, trial.error_deg.is_none());
            let half = if trial.index < 6 { &mut early } else { &mut late };
            (half.0, half.1) = (half.0 + u32::from(refused), half.1 + 1);
        }
    }
    let share = |(refused, all): (u32, u32)| f64::from(refused) / f64::from(all);
    println!("refused: {early:?} of the initial designs, {late:?} of the search");
    assert!(share(early) > 0.3 && share(late) < 0.5 * share(early));
}

#[test]
fn a_target_out_of_reach_is_explained_with_the_nearest_angle() {
    let settings = Settings { trials_max: 40, ..Settings::default() };
    let Err(Error::TooFew(short)) = run(82.0, &settings) else {
        panic!("82 deg cannot be reached")
    };
    assert_eq!((short.partial.sets.len(), short.partial.evaluations), (0, 40));
    // The formula's largest value is 72.5 deg.
    assert!(
        short.nearest_deg.is_some_and(|deg| (66.0..76.0).contains(&deg)),
        "{:?}",
        short.nearest_deg
    );
    let text = short.to_string();
    assert!(
        text.contains("found 0 of 10 sets within 1.5 deg of 82.00 deg in 40 simulations"),
        "{text}"
    );
    assert!(text.contains("nearest single heap had"), "{text}");
}

#[test]
fn a_small_budget_is_kept_to_the_last_run() {
    for trials_max in [1, 2, 7, 8, 9, 13, 21, 30] {
        let settings = Settings { trials_max, ..Settings::default() };
        let Err(Error::TooFew(short)) = run(36.03, &settings) else {
            panic!("ten sets need more than {trials_max}")
        };
        assert_eq!(short.partial.evaluations + short.partial.verification_runs, trials_max);
    }
}

#[test]
fn a_simulator_that_always_refuses_or_answers_nonsense_ends_in_an_explanation() {
    let settings = Settings { trials_max: 20, ..Settings::default() };
    for answer in [Err("diverged".to_owned()), heap(f64::NAN), heap(f64::INFINITY)] {
        let (trials, result) = recorded(&settings, each(|_| answer.clone()));
        let Err(Error::TooFew(short)) = result else { panic!("{result:?}") };
        assert_eq!((trials.len(), short.refused, short.nearest_deg), (20, 20, None));
        assert!(short.to_string().contains("no simulation gave an angle"));
        assert!(!serde_json::to_string(&trials).unwrap().contains("null,"), "a number was lost");
    }
    // Constant angles, and an emulator with nothing to learn.
    let (_, flat) = recorded(&few(), each(|_| heap(36.0)));
    assert_eq!(flat.unwrap().sets.len(), 4);
}

#[test]
fn a_number_that_is_none_now_and_then_never_reaches_a_result() {
    let broken = each(|pour: &Pour| match pour.seed.is_multiple_of(5) {
        true => heap(f64::NAN),
        false => tip(&pour.parameters, pour.seed),
    });
    let (trials, result) = recorded(&few(), broken);
    assert!(trials.iter().any(|t| t.error_deg.is_none()), "the test needs a refusal");
    let result = result.unwrap();
    assert!(
        result.mean_error_deg.unwrap().is_finite()
            && result.sets.iter().all(|s| s.repose_deg.is_finite())
    );
}

#[test]
fn a_history_of_another_calibration_is_refused_by_its_first_foreign_trial() {
    let (trials, _) = recorded(&few(), formula);
    let resume = |deg, settings: &Settings, history: &[Trial]| {
        calibrate(&target(deg), settings, None, history, formula, |_, _| ControlFlow::Continue(()))
    };
    assert_eq!(
        resume(36.03, &Settings { seed: 4, ..few() }, &trials),
        Err(Error::History { index: 0 })
    );
    // The first design is the same for every target, later rounds are not.
    assert!(matches!(resume(28.0, &few(), &trials), Err(Error::History { index }) if index >= 6));
    let mut gap = trials.clone();
    gap.remove(2);
    assert_eq!(resume(36.03, &few(), &gap), Err(Error::History { index: 2 }));
    let mut long = trials.clone();
    long.push(Trial { index: trials.len() as u32, ..trials[0].clone() });
    assert_eq!(resume(36.03, &few(), &long), Err(Error::History { index: trials.len() as u32 }));
}

#[test]
fn settings_and_targets_out_of_bounds_are_refused_by_name() {
    let field = |deg: f64, settings: Settings| match run(deg, &settings) {
        Err(Error::Settings(error)) => error.field,
        other => panic!("{other:?}"),
    };
    assert_eq!(field(36.0, Settings { sets: 0, ..few() }), "sets");
    assert_eq!(field(36.0, Settings { tolerance_deg: f64::NAN, ..few() }), "tolerance_deg");
    assert_eq!(field(36.0, Settings { trials_max: 100_000, ..few() }), "trials_max");
    assert_eq!(field(36.0, Settings { batch: 0, ..few() }), "batch");
    assert_eq!(field(36.0, Settings { verify_repeats: 0, ..few() }), "verify_repeats");
    assert_eq!(field(f64::NAN, few()), "repose_deg");
    assert!(serde_json::from_str::<Settings>(r#"{"set": 3}"#).is_err());
    assert_eq!(
        serde_json::from_str::<Settings>(r#"{"sets": 3}"#).unwrap(),
        Settings { sets: 3, ..Settings::default() }
    );
}

#[test]
fn another_seed_gives_other_sets_that_are_as_good() {
    let [a, b] = [1, 2].map(|seed| run(42.38, &Settings { seed, ..few() }).unwrap());
    assert!(a.sets.iter().all(|s| b.sets.iter().all(|t| s.parameters != t.parameters)));
    assert!([a, b].iter().all(|c| c.mean_error_deg.unwrap() <= 1.5 && c.sd_error_deg.is_some()));
}
