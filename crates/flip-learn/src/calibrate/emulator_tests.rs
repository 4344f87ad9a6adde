//! The emulator, the sets read off it and the posterior, on a formula; the published method on the
//! same formula.

use super::emulator::{DIRECTIONS, Design, Emulator, build};
use super::posterior::{Posterior, Prior};
use super::tests::each;
use super::*;
use flip_core::domain::parameters::{COUNT, PARAMETERS, ParameterSet};
use flip_core::domain::powder::PUBLISHED;
use flip_core::stats::latin_hypercube::{distance, latin_hypercube};
use flip_core::stats::normal::quantile;
use flip_core::stats::summary;
use std::sync::atomic::{AtomicU32, Ordering};

/// Five numbers as in the simulator: friction, an attraction over gravity, and three with less
/// effect.
fn numbers(set: &ParameterSet) -> [f64; DIRECTIONS] {
    let unit = set.to_unit();
    [unit[4], (0.3 * set.cohesion() / set.gravity_scale() / 1.2).sqrt(), unit[1], unit[3], unit[6]]
}

pub(super) fn clean_deg(set: &ParameterSet) -> f64 {
    let [friction, attraction, wall, reach, _] = numbers(set);
    22.0 + 18.0 * friction.powf(0.7)
        + 12.0 * attraction * (1.0 + 0.2 * reach)
        + 2.0 * wall * friction
}

/// How much flatter a heap of this many grains is than one of 2000, degrees; slightly more for
/// steep ones.
fn flatter_deg(set: &ParameterSet, particles: u32) -> f64 {
    0.7 * (f64::from(particles) / 2000.0).log2() * (1.0 + 0.3 * numbers(set)[0])
}

/// Standard deviation of a reading.
fn noise_deg(set: &ParameterSet) -> f64 {
    0.7 + numbers(set)[1]
}

pub(super) fn normal(seed: u64, k: u64) -> f64 {
    quantile(((derive(seed, &[k]) >> 11) as f64 + 0.5) / (1u64 << 53) as f64)
}

/// Heaps read this many times, including the variance their readings share.
pub(super) fn formula(pours: &[Pour]) -> Vec<Result<Heap, String>> {
    each(heap)(pours)
}

fn heap(&Pour { parameters, particles, readings, seed }: &Pour) -> Result<Heap, String> {
    let set = &parameters;
    let sd = noise_deg(set);
    let common = 0.3 * sd * normal(seed, 1000);
    let tips: Vec<f64> = (0..readings)
        .map(|k| {
            clean_deg(set) - flatter_deg(set, particles)
                + common
                + sd * (1.0f64 - 0.09).sqrt() * normal(seed, u64::from(k))
        })
        .collect();
    let tip_deg = summary::mean(&tips).unwrap();
    Ok(Heap { tip_deg, tip_sd_deg: summary::sd(&tips), cone_deg: tip_deg, creep_deg_per_s: 0.0 })
}

fn design() -> Design {
    Design { runs: 120, initial: 60, round: 30, ..Design::with_particles(2000) }
}

pub(super) fn emulator() -> Emulator {
    build(&design(), numbers, &[], formula, |_, _| ControlFlow::Continue(())).unwrap()
}

pub(super) fn settings(seed: u64) -> Settings {
    Settings { seed, ..Settings::of(Method::Emulator) }
}

fn run(emulator: &Emulator, deg: f64, settings: &Settings) -> Calibration {
    let target = Flowability { repose_deg: deg, sd_deg: 2.0, n: 5 };
    calibrate(&target, settings, Some(emulator.into()), &[], formula, |_, _| {
        ControlFlow::Continue(())
    })
    .unwrap()
}

fn sets_of_the_box(count: usize, seed: u64) -> Vec<ParameterSet> {
    latin_hypercube(count, &mut Pcg64::seed_from_u64(seed))
        .iter()
        .map(space::parameters_at)
        .collect()
}

#[test]
fn an_emulator_knows_the_angle_its_own_error_and_the_scatter() {
    check(&emulator());
}

fn check(emulator: &Emulator) {
    let (mut errors, mut scores, mut spreads) = (Vec::new(), Vec::new(), Vec::new());
    for set in sets_of_the_box(300, 77).iter().filter(|set| (22.0..50.0).contains(&clean_deg(set)))
    {
        let expected = emulator.expect(set);
        let error = expected.mean.mean - clean_deg(set);
        errors.push(error * error);
        scores.push((error / expected.mean.sd).powi(2));
        spreads.push((expected.seed_sd_deg / noise_deg(set)).ln());
    }
    let rms = |values: &[f64]| summary::mean(values).unwrap().sqrt();
    assert!(rms(&errors) < 0.6, "{}", rms(&errors));
    // One if the predicted uncertainties match the errors.
    assert!((0.5..1.4).contains(&rms(&scores)), "{}", rms(&scores));
    let [bias, scatter] = [summary::mean(&spreads).unwrap(), summary::sd(&spreads).unwrap()];
    assert!(bias.abs() < 0.2 && scatter < 0.35, "{bias} {scatter}");
}

/// Answers a batch as a whole, and counts the batches.
struct Whole<'a>(&'a AtomicU32);

impl Simulate<Pour, Heap> for Whole<'_> {
    fn simulate(&self, pours: &[Pour], heard: &mut Heard<'_, Heap>) {
        self.0.fetch_add(1, Ordering::Relaxed);
        let _ = formula(pours).into_iter().try_for_each(heard);
    }
}

#[test]
fn an_emulator_of_one_round_knows_as_much_and_sets_read_off_it_need_one_more() {
    let batches = AtomicU32::new(0);
    let design = Design { runs: 120, initial: 120, ..Design::at_once(2000) };
    let go_on = |_: &Trial, _: &Progress| ControlFlow::Continue(());
    let emulator = build(&design, numbers, &[], Whole(&batches), go_on).unwrap();
    assert_eq!(batches.load(Ordering::Relaxed), 1);
    check(&emulator);
    // Whatever is verified comes at once.
    let settings = Settings { tried_first: 0, ..settings(1) };
    let target = Flowability { repose_deg: 36.03, sd_deg: 2.0, n: 5 };
    let (knowledge, whole) = (Some((&emulator).into()), Whole(&batches));
    let found = calibrate(&target, &settings, knowledge, &[], whole, go_on).unwrap();
    assert_eq!((found.sets.len(), found.evaluations), (10, 0));
    let missed = found.verification_runs / settings.verify_repeats - 10;
    assert!(batches.load(Ordering::Relaxed) <= 2 + missed, "{missed} missed");
}

#[test]
fn an_interrupted_build_goes_on_and_ends_with_the_same_bytes_on_any_number_of_threads() {
    let design = Design { runs: 70, initial: 40, round: 15, ..design() };
    let whole = build(&design, numbers, &[], formula, |_, _| ControlFlow::Continue(())).unwrap();
    for (threads, stop) in [(1, 13), (2, 47), (3, 66)] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut heard = Vec::new();
        let stopped = build(&design, numbers, &[], formula, |run: &Trial, _: &Progress| {
            heard.push(run.clone());
            if heard.len() == stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        assert_eq!(stopped.unwrap_err(), Error::Stopped);
        let simulated = AtomicU32::new(0);
        let counted = each(|pour: &Pour| {
            simulated.fetch_add(1, Ordering::Relaxed);
            heap(pour)
        });
        let resumed = pool
            .install(|| build(&design, numbers, &heard, counted, |_, _| ControlFlow::Continue(())))
            .unwrap();
        assert_eq!(resumed.hash(), whole.hash());
        assert_eq!(simulated.load(Ordering::Relaxed) as usize, 70 - stop);
        let set = ParameterSet::default();
        assert_eq!(resumed.expect(&set), whole.expect(&set));
    }
    // The history of another design is refused.
    let mut heard = Vec::new();
    build(&design, numbers, &[], formula, |run: &Trial, _: &Progress| {
        heard.push(run.clone());
        ControlFlow::Continue(())
    })
    .unwrap();
    let other = Design { seed: 2, ..design };
    let refused = build(&other, numbers, &heard, formula, |_, _| ControlFlow::Continue(()));
    assert_eq!(refused.unwrap_err(), Error::History { index: 0 });
    assert_ne!(other.id("pbd"), Design { seed: 1, ..other.clone() }.id("pbd"));
}

#[test]
fn ten_different_verified_sets_are_read_off_the_emulator_for_every_powder() {
    let emulator = emulator();
    for powder in PUBLISHED {
        let deg = powder.automated.repose_deg;
        let found = run(&emulator, deg, &settings(1));
        assert!(found.sets.len() == 10 && found.evaluations <= 10 && found.shortfall.is_none());
        assert!(found.sets.iter().all(|set| set.runs == 8 && set.verified_error_deg <= 0.5));
        // The true error, unknown to any verification.
        let truth: Vec<f64> =
            found.sets.iter().map(|set| (clean_deg(&set.parameters) - deg).abs()).collect();
        assert!(summary::mean(&truth).unwrap() < 0.45, "{truth:?}");
        let points: Vec<_> = found.sets.iter().map(|set| set.parameters.to_unit()).collect();
        let gaps = (0..10)
            .flat_map(|i| (0..i).map(move |j| (i, j)))
            .map(|(i, j)| distance(&points[i], &points[j]));
        let nearest = gaps.fold(9.0, f64::min);
        // Two random points of the cube are 1.2 apart, the nearest pair of ten about 0.6.
        assert!(nearest > 0.5, "{nearest}");
    }
}

#[test]
fn the_same_seed_and_emulator_give_the_same_sets_and_another_seed_others_as_good() {
    let emulator = emulator();
    let [a, again, other] = [1, 1, 2].map(|seed| run(&emulator, 36.03, &settings(seed)));
    assert_eq!(a, again);
    assert!(a.sets.iter().all(|set| other.sets.iter().all(|o| o.parameters != set.parameters)));
    let mean = |c: &Calibration| {
        summary::mean(&c.sets.iter().map(|set| set.repose_deg).collect::<Vec<_>>()).unwrap()
    };
    // Ten sets of up to 0.5 deg each.
    assert!(
        (mean(&a) - mean(&other)).abs() < 2.0 * 0.5 / 10f64.sqrt(),
        "{} {}",
        mean(&a),
        mean(&other)
    );
}

#[test]
fn an_interrupted_calibration_on_an_emulator_goes_on_where_it_was() {
    let emulator = emulator();
    let target = Flowability { repose_deg: 31.41, sd_deg: 1.42, n: 5 };
    let mut all = Vec::new();
    let whole =
        calibrate(&target, &settings(3), Some((&emulator).into()), &[], formula, |trial, _| {
            all.push(trial.clone());
            ControlFlow::Continue(())
        });
    for kept in [1, 9, 37, all.len() - 1] {
        let mut new = 0;
        let resumed = calibrate(
            &target,
            &settings(3),
            Some((&emulator).into()),
            &all[..kept],
            formula,
            |_, _| {
                new += 1;
                ControlFlow::Continue(())
            },
        );
        assert_eq!((resumed, new), (whole.clone(), all.len() - kept));
    }
    let unfit =
        calibrate(&target, &settings(3), None, &[], formula, |_, _| ControlFlow::Continue(()));
    assert_eq!(unfit, Err(Error::NoEmulator));
}

#[test]
fn a_target_out_of_reach_names_the_nearest_angle_and_the_bound_in_the_way() {
    let emulator = emulator();
    let above = run(&emulator, 70.0, &settings(1));
    let steepest =
        clean_deg(&ParameterSet::from_unit([0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0]));
    let shortfall = above.shortfall.unwrap();
    assert!(above.sets.is_empty() && (above.evaluations, above.verification_runs) == (0, 8));
    assert!((shortfall.nearest_repose_deg - steepest).abs() < 2.0, "{shortfall:?} of {steepest}");
    let named = shortfall.limiting_parameter.unwrap();
    assert!(["friction", "cohesion", "gravity_scale"].contains(&named.as_str()), "{named}");
    let below = run(&emulator, 15.0, &settings(1)).shortfall.unwrap();
    assert!((below.nearest_repose_deg - 22.0).abs() < 2.0, "{below:?}");
    let named = below.limiting_parameter.unwrap();
    assert!(["friction", "cohesion"].contains(&named.as_str()), "{named}");
}

#[test]
fn a_budget_too_small_is_kept_and_said() {
    let emulator = emulator();
    let found = run(&emulator, 36.03, &Settings { trials_max: 40, ..settings(1) });
    assert!(found.evaluations + found.verification_runs <= 40 && found.sets.len() < 10);
    let thorough = Settings { verify_repeats: 40, ..settings(1) };
    assert_eq!(
        (settings(1).budget(), thorough.budget()),
        (300, 1200),
        "three verifications of every set"
    );
    let shortfall = found.shortfall.unwrap();
    assert!(
        shortfall.limiting_parameter.is_none()
            && (shortfall.nearest_repose_deg - 36.03).abs() < 2.0
    );
}

/// A measurement of five repeats around an angle.
fn measurement(angle_deg: f64, sd_deg: f64, seed: u64) -> Flowability {
    let repeats: Vec<f64> = (0..5).map(|k| angle_deg + sd_deg * normal(seed, k)).collect();
    Flowability {
        repose_deg: summary::mean(&repeats).unwrap(),
        sd_deg: summary::sd(&repeats).unwrap(),
        n: 5,
    }
}

/// Simulation-based calibration (Talts et al. 2018): if the truth comes from the prior, its rank
/// among the draws is uniform.
#[test]
fn posterior_ranks_are_uniform_and_intervals_cover_what_they_say() {
    const POWDERS: usize = 400;
    const DRAWS: usize = 99;
    const BINS: usize = 10;
    let emulator = emulator();
    let prior = Prior::of((&emulator).into(), 5);
    let mut counts = [[0u32; BINS]; COUNT + 1];
    let mut covered = [0u32; COUNT + 1];
    for (k, truth) in sets_of_the_box(POWDERS, 11).iter().enumerate() {
        // The emulator's prediction for this powder, so that only the inference is tested here.
        let at = emulator.expect(truth).mean;
        let angle = at.mean + at.sd * normal(derive(8, &[k as u64]), 99);
        let posterior = prior.given(&measurement(angle, 2.0, derive(9, &[k as u64])), DRAWS);
        let values = truth.values();
        let drawn = |j: usize| -> Vec<f64> {
            if j < COUNT {
                posterior.draws.iter().map(|d| d[j]).collect()
            } else {
                posterior.repose_deg.clone()
            }
        };
        for j in 0..=COUNT {
            let is = if j < COUNT { values[j] } else { angle };
            let mut draws = drawn(j);
            let rank = draws.iter().filter(|d| **d < is).count();
            counts[j][rank * BINS / (DRAWS + 1)] += 1;
            draws.sort_by(f64::total_cmp);
            covered[j] += u32::from((draws[16]..=draws[82]).contains(&is));
        }
    }
    let expected = POWDERS as f64 / BINS as f64;
    for j in 0..=COUNT {
        let name = PARAMETERS.get(j).map_or("angle", |p| p.key);
        let chi2: f64 =
            counts[j].iter().map(|c| (f64::from(*c) - expected).powi(2) / expected).sum();
        let share = f64::from(covered[j]) / POWDERS as f64;
        println!(
            "{name}: 68 % interval covers {:.1} % of {POWDERS} powders, chi2 of ranks {chi2:.1} of 9",
            100.0 * share
        );
        // The 99.9 % quantile of chi^2_9 is 27.9; ten are checked.
        assert!(chi2 < 30.0, "{name}: {:?}", counts[j]);
        assert!((0.60..=0.76).contains(&share), "{name}: {share}");
    }
}

/// The same with the formula as the truth instead of the emulator's prediction: its errors must
/// match its stated uncertainty.
#[test]
fn intervals_cover_powders_that_the_emulator_has_not_made() {
    const POWDERS: usize = 300;
    let emulator = emulator();
    let prior = Prior::of((&emulator).into(), 6);
    let mut covered = 0;
    for (k, truth) in sets_of_the_box(POWDERS, 12).iter().enumerate() {
        let posterior =
            prior.given(&measurement(clean_deg(truth), 1.5, derive(10, &[k as u64])), 200);
        let mut angles = posterior.repose_deg;
        angles.sort_by(f64::total_cmp);
        covered += u32::from((angles[32]..=angles[168]).contains(&clean_deg(truth)));
    }
    let share = f64::from(covered) / POWDERS as f64;
    println!("angle: 68 % interval covers {:.1} % of {POWDERS} powders", 100.0 * share);
    assert!((0.60..=0.76).contains(&share), "{share}");
}

#[test]
fn a_posterior_says_what_was_learnt_and_what_only_together() {
    let emulator = emulator();
    let measured = |sd_deg: f64| Flowability { repose_deg: 33.0, sd_deg, n: 5 };
    let posterior = Posterior::of((&emulator).into(), &measured(1.0), 400, 1);
    let of = |posterior: &Posterior, key: &str| {
        posterior.parameters.iter().find(|p| p.key == key).unwrap().clone()
    };
    for key in ["particle_mass_ug", "particle_diameter_mm"] {
        let mass = of(&posterior, key);
        assert!(mass.inert && mass.learnt.abs() < 0.15, "{mass:?}");
    }
    let friction = of(&posterior, "friction");
    assert!(!friction.inert && friction.learnt > 0.3, "{friction:?}");
    let pair = &posterior.together[0];
    assert_eq!(
        pair.keys,
        ["friction".to_owned(), "cohesion".to_owned()],
        "{:?}",
        posterior.together
    );
    assert!(pair.correlation < -0.3, "more of one asks for less of the other: {pair:?}");
    // A less precise measurement is less informative.
    let wide = Posterior::of((&emulator).into(), &measured(8.0), 400, 1);
    let width = |p: &Posterior| summary::sd(&p.repose_deg).unwrap();
    assert!(width(&wide) > 2.0 * width(&posterior) && wide.effective > posterior.effective);
    // An exact measurement is matched exactly.
    let exact = Posterior::of(
        (&emulator).into(),
        &Flowability { repose_deg: 33.0, sd_deg: 0.0, n: 1 },
        100,
        1,
    );
    assert!(exact.repose_deg.iter().all(|deg| *deg == 33.0));
}

/// All trials of a calibration with the published method.
fn published(settings: &Settings, deg: f64) -> (Vec<Trial>, Calibration) {
    let target = Flowability { repose_deg: deg, sd_deg: 2.0, n: 5 };
    let mut trials = Vec::new();
    let found = calibrate(&target, settings, None, &[], formula, |trial, _| {
        trials.push(trial.clone());
        ControlFlow::Continue(())
    });
    (trials, found.unwrap())
}

#[test]
fn the_published_method_ends_with_ten_solutions_below_one_degree_and_verifies_what_it_retains() {
    let settings = Settings { seed: 4, ..Settings::of(Method::Paper) };
    let (trials, found) = published(&settings, 36.03);
    let search: Vec<&Trial> = trials.iter().filter(|t| t.phase == Phase::Search).collect();
    let solutions =
        |trials: &[&Trial]| trials.iter().filter(|t| t.error_deg.unwrap() < 1.0).count();
    assert_eq!(solutions(&search), 10, "it ends with the tenth");
    assert!(search.last().unwrap().error_deg.unwrap() < 1.0 && search.len() <= 150);
    assert!(
        found.sets.len() == 10
            && found.sets.iter().all(|set| set.error_deg <= 1.5 && set.runs == 8)
    );
    assert_eq!(found.verification_runs, 80);
    assert!(trials[search.len()..].iter().all(|t| t.phase == Phase::Verification));
    // One lucky heap chose each set; fresh heaps show its true error.
    assert!(found.verified_error_deg.unwrap() > found.mean_error_deg.unwrap());
    let (again, _) = published(&settings, 36.03);
    assert_eq!(again, trials);
}

#[test]
fn without_solutions_the_published_bounds_shrink_to_the_best_tenth_until_nothing_is_left() {
    // No angle of the formula is near 80 deg.
    let settings =
        Settings { stagnation: 15, trials_max: 90, initial: 10, ..Settings::of(Method::Paper) };
    let (trials, found) = published(&settings, 80.0);
    assert!(found.sets.is_empty() && found.shortfall.is_some());
    let range = |trials: &[Trial]| {
        let mut best: Vec<&Trial> = trials.iter().collect();
        best.sort_by(|a, b| a.error_deg.unwrap().total_cmp(&b.error_deg.unwrap()));
        best.truncate(trials.len().div_ceil(10).max(2));
        let points: Vec<_> = best.iter().map(|t| t.parameters.to_unit()).collect();
        let side = |k: usize| points.iter().map(move |p| p[k]);
        std::array::from_fn::<[f64; 2], COUNT, _>(|k| {
            [side(k).fold(1.0, f64::min), side(k).fold(0.0, f64::max)]
        })
    };
    let mut shrunk = 0;
    for after in (15..trials.len()).step_by(15) {
        let bounds = range(&trials[..after]);
        for trial in &trials[after..(after + 15).min(trials.len())] {
            let point = trial.parameters.to_unit();
            assert!(
                point
                    .iter()
                    .zip(bounds)
                    .all(|(x, [low, high])| (low - 1e-5..=high + 1e-5).contains(x))
            );
        }
        shrunk += 1;
    }
    assert!(shrunk >= 2, "{} trials", trials.len());
}

#[test]
fn sets_verified_in_larger_heaps_have_the_angle_there_and_the_shift_between_the_sizes_is_told() {
    let emulator = emulator();
    let target = Flowability { repose_deg: 33.0, sd_deg: 2.0, n: 5 };
    let settings = Settings { verify_particles: Some(8000), ..settings(4) };
    let mut trials = Vec::new();
    let whole =
        calibrate(&target, &settings, Some((&emulator).into()), &[], formula, |trial, _| {
            trials.push(trial.clone());
            ControlFlow::Continue(())
        })
        .unwrap();
    assert_eq!(whole.sets.len(), 10);
    let there = |set: &ParameterSet| clean_deg(set) - flatter_deg(set, 8000);
    let angles: Vec<f64> = whole.sets.iter().map(|set| there(&set.parameters)).collect();
    assert!((summary::mean(&angles).unwrap() - 33.0).abs() < 0.3, "{angles:?}");
    let shifts: Vec<f64> =
        whole.sets.iter().map(|set| -flatter_deg(&set.parameters, 8000)).collect();
    assert!((whole.size_shift_deg.unwrap() - summary::mean(&shifts).unwrap()).abs() < 0.3);
    // The pilots miss by the shift; hardly any set after them does.
    let wasted = whole.verification_runs / settings.verify_repeats - 10;
    assert!((1..=4).contains(&wasted), "{wasted} sets verified for nothing");
    let resumed =
        calibrate(&target, &settings, Some((&emulator).into()), &trials[..25], formula, |_, _| {
            ControlFlow::Continue(())
        });
    assert_eq!(resumed.unwrap(), whole);
    // Heaps of one size have no shift, and out of reach stays out of reach.
    assert_eq!(run(&emulator, 33.0, &self::settings(4)).size_shift_deg, None);
    let steep = run(&emulator, 70.0, &settings);
    let nearest = steep.shortfall.unwrap().nearest_repose_deg;
    assert!(steep.sets.is_empty() && (35.0..60.0).contains(&nearest), "{nearest}");
    let refused = Settings { verify_particles: Some(8000), ..Settings::default() }.checked();
    assert_eq!(refused.unwrap_err().field, "verify_particles");
}
