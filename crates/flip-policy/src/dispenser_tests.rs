use super::*;
use crate::{Controller, Episode};

const FITTED: Response = Response::FITTED;

/// The result of a dose.
struct Dosed {
    error_mg: f64,
    pitches_deg: Vec<f64>,
    masses_mg: Vec<f64>,
}

/// Doses from a spoon that obeys the model, with a balance that shows whole milligrams.
fn dose(
    controller: &Controller,
    spoon: &Spoonful,
    target_mg: f64,
    steps_max: u32,
    seed: usize,
) -> Dosed {
    let rules = Rules { steps_max, ..Rules::FLIP };
    let mut dosing = controller.begin(&rules, 1.0);
    let (mut pitch_deg, mut poured_mg) = (0.0, 0.0f64);
    let (mut pitches_deg, mut masses_mg) = (Vec::new(), Vec::new());
    for steps in 0.. {
        let seen = Observation { reading_mg: poured_mg.round(), target_mg, pitch_deg };
        if rules.after(steps, &seen, 1.0) != Episode::Running {
            break;
        }
        let action = dosing.propose(&seen);
        pitch_deg += action.incline_change_deg;
        assert!((rules.pitch.lower_deg..=rules.pitch.upper_deg).contains(&pitch_deg));
        let mean = spoon.mean_mg(&FITTED, pitch_deg, action.executed_shake_mm(), poured_mg);
        let z = quantile(radical_inverse(7919 * (seed + 1) + steps as usize, 2));
        let mass = if mean > 0.0 { FITTED.draw(mean, z) } else { 0.0 };
        poured_mg += mass;
        pitches_deg.push(pitch_deg);
        masses_mg.push(mass);
    }
    Dosed { error_mg: poured_mg - target_mg, pitches_deg, masses_mg }
}

fn dispenser() -> Controller {
    Controller::Dispenser(Dispenser::new(FITTED))
}

/// A spoon that releases most of its powder at 15 deg, and one that retains everything below 25.
const EASY: Spoonful = Spoonful { onset_deg: -10.0, slope_mg_deg: 0.7, stroke_mm: 100.0 };
const HARD: Spoonful = Spoonful { onset_deg: 25.0, slope_mg_deg: 1.5, stroke_mm: 150.0 };

#[test]
fn what_is_let_go_of_is_the_formula() {
    // Far above the onset, softplus equals its argument: 0.7 (20 + reach ln 4 + 10) mg, of which a
    // shake takes 1 - exp(-(4 / 100)^bend).
    let loose = 0.7 * (30.0 + FITTED.reach_deg * 4.0f64.ln());
    assert!((EASY.loose_mg(&FITTED, 20.0, 4.0) - loose).abs() < 1e-9);
    let share = 1.0 - (-(0.04f64.powf(FITTED.bend))).exp();
    assert!((EASY.mean_mg(&FITTED, 20.0, 4.0, 5.0) - (loose - 5.0) * share).abs() < 1e-9);
    assert_eq!(EASY.mean_mg(&FITTED, 20.0, 4.0, loose + 1.0), 0.0, "nothing is loose any more");
    assert_eq!(EASY.mean_mg(&FITTED, 20.0, 0.0, 0.0), 0.0, "without a shake nothing falls");
    assert!(
        HARD.loose_mg(&FITTED, 5.0, 16.0) < 1e-9
            && HARD.loose_mg(&FITTED, 60.0, 16.0) == FITTED.held_mg
    );
    // The pitch for a given mean is the inverse.
    for (guess, mean, poured) in [(EASY, 2.0, 3.0), (HARD, 0.4, 9.0)] {
        let pitch = guess.pitch_for(&FITTED, USUAL_MM, mean, poured);
        assert!((guess.mean_mg(&FITTED, pitch, USUAL_MM, poured) - mean).abs() < 1e-6);
    }
}

#[test]
fn guesses_have_the_moments_and_correlations_they_are_drawn_from() {
    let dispenser = Dispenser::new(FITTED);
    let columns = [
        dispenser
            .guesses
            .iter()
            .map(|g| (g.onset_deg - FITTED.onset_deg[0]) / FITTED.onset_deg[1])
            .collect::<Vec<f64>>(),
        dispenser
            .guesses
            .iter()
            .map(|g| (g.slope_mg_deg.ln() - FITTED.ln_slope_mg_deg[0]) / FITTED.ln_slope_mg_deg[1])
            .collect(),
        dispenser
            .guesses
            .iter()
            .map(|g| (g.stroke_mm.ln() - FITTED.ln_stroke_mm[0]) / FITTED.ln_stroke_mm[1])
            .collect(),
    ];
    let product =
        |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>() / a.len() as f64;
    for column in &columns {
        assert!(column.iter().sum::<f64>().abs() / (GUESSES as f64) < 0.05);
        assert!((product(column, column) - 1.0).abs() < 0.1);
    }
    for ((a, b), expected) in [(0, 1), (0, 2), (1, 2)].into_iter().zip(FITTED.correlations) {
        assert!((product(&columns[a], &columns[b]) - expected).abs() < 0.1, "{a} {b}");
    }
    let refused = Response { correlations: [0.9, 0.9, -0.9], ..FITTED }.checked();
    assert_eq!(refused.unwrap_err().field, "correlations");
}

#[test]
fn what_the_balance_shows_tells_one_spoon_from_another() {
    let dispenser = Dispenser::new(FITTED);
    let seen = |reading_mg, pitch_deg| Observation { reading_mg, target_mg: 15.0, pitch_deg };
    let shaken = |before_mg, after_mg| Done {
        before: seen(before_mg, 0.0),
        action: Action::once(8.0, 8.0),
        after: seen(after_mg, 8.0),
    };
    let expected = |done: &[Done]| {
        let weights = dispenser.weights(done, 1.0);
        let next = dispenser.guesses.iter().map(|g| {
            g.mean_mg(&FITTED, 16.0, 8.0, done.last().map_or(0.0, |d| d.after.reading_mg))
        });
        weights.iter().zip(next).map(|(w, m)| w * m).sum::<f64>() / weights.iter().sum::<f64>()
    };
    let [nothing, little, much] = [0.0, 1.0, 6.0].map(|mg| expected(&[shaken(0.0, mg)]));
    assert!(nothing < little && little < much, "{nothing} {little} {much}");
    // Without a shake nothing is learned.
    let still = Done { action: Action::once(8.0, 0.0), ..shaken(0.0, 0.0) };
    assert!(dispenser.weights(&[still], 1.0).iter().all(|w| *w == 1.0));
    // However unlikely the reading, the weights remain finite.
    assert!(
        dispenser.weights(&[shaken(0.0, 1e6), shaken(1e6, 0.0)], 1.0).iter().all(|w| w.is_finite())
    );
}

#[test]
fn aims_shrink_with_the_steps_left_and_meet_a_brute_force_search() {
    let aims = Aims::new(&FITTED);
    assert_eq!((aims.of(3, 0.0), aims.of(3, -2.0)), (0.0, 0.0));
    assert!(
        (1..9).all(|left| aims.of(left, 10.0) >= aims.of(left + 1, 10.0) - 1e-9),
        "more steps, smaller bites"
    );
    // Thirty steps are the most that shipped rules have: each of them changes an aim, and none
    // beyond.
    let row = |left: u32| (1..CELLS).map(|cell| aims.of(left, cell as f64 * GRID_MG)).collect();
    let rows: Vec<Vec<f64>> = (1..=40).map(row).collect();
    let changes: Vec<usize> = (1..40).filter(|k| rows[*k] != rows[k - 1]).collect();
    assert_eq!(changes, (1..30).collect::<Vec<_>>());
    // The last step by brute force: the mean with the least expected loss over many draws.
    let loss = |mean: f64| {
        let draw = |k: usize| FITTED.draw(mean, quantile((k as f64 + 0.5) / 4000.0));
        (0..4000).map(|k| FITTED.loss(10.0 - draw(k))).sum::<f64>() / 4000.0
    };
    let best =
        (1..=400).map(|k| k as f64 * 0.05).min_by(|a, b| loss(*a).total_cmp(&loss(*b))).unwrap();
    assert!(loss(aims.of(1, 10.0)) < loss(best) * 1.03, "{} against {best}", aims.of(1, 10.0));
}

#[test]
fn spoons_that_obey_the_model_are_dosed_to_a_milligram_or_so_and_the_same_dose_again_is_the_same() {
    let dispenser = dispenser();
    let mut errors = Vec::new();
    for (spoon, target_mg) in [(EASY, 5.0), (EASY, 15.0), (HARD, 5.0), (HARD, 15.0)] {
        for seed in 0..6 {
            let dosed = dose(&dispenser, &spoon, target_mg, 10, seed);
            errors.push(dosed.error_mg.abs());
            let again = dose(&dispenser, &spoon, target_mg, 10, seed);
            assert_eq!((dosed.pitches_deg, dosed.masses_mg), (again.pitches_deg, again.masses_mg));
        }
    }
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    println!("{} doses: {mean:.2} mg", errors.len());
    assert!(mean < 1.5, "{mean}");
    // The largest first step of an easy spoon would be 15 mg; it is not taken when the target is 5
    // mg.
    assert!(dose(&dispenser, &EASY, 5.0, 10, 3).masses_mg[0] < 5.0);
}

#[test]
fn it_climbs_to_where_a_hard_spoon_lets_go_and_takes_its_time_when_it_has_more() {
    let dispenser = dispenser();
    let dosed = dose(&dispenser, &HARD, 10.0, 10, 1);
    assert!(dosed.pitches_deg.iter().any(|deg| *deg > 20.0), "{:?}", dosed.pitches_deg);
    let mean = |steps_max| {
        (0..8)
            .map(|seed| dose(&dispenser, &EASY, 15.0, steps_max, seed).error_mg.abs())
            .sum::<f64>()
            / 8.0
    };
    let (hurried, patient) = (mean(4), mean(20));
    assert!(patient < hurried, "{patient} with 20 steps, {hurried} with 4");
}
