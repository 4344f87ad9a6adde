use super::*;
use crate::domain::powder::PUBLISHED;
use crate::stats::normal::quantile;

/// A formula shaped like the real simulator: friction raises the angle with falling slope, cohesion over gravity
/// raises it, six parameters do nothing, each seed adds noise of SD 1 deg.
fn formula(set: &ParameterSet, seed: u64) -> Result<Heap, String> {
    let uniform = ((derive(seed, &[1]) >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
    let clean = 12.0 + 32.0 * set.friction().sqrt() + 6.0 * set.cohesion() / set.gravity_scale();
    let tip_deg = clean + quantile(uniform);
    Ok(Heap { tip_deg, cone_deg: tip_deg - 2.0, creep_deg_per_s: 0.0 })
}

fn target(repose_deg: f64) -> Flowability {
    Flowability { repose_deg, sd_deg: 1.5, n: 5 }
}

fn run(deg: f64, settings: &Settings) -> Result<Calibration, Error> {
    calibrate(&target(deg), settings, &[], formula, |_, _| ControlFlow::Continue(()))
}

#[test]
fn ten_verified_and_diverse_sets_are_found_for_every_published_powder_within_budget() {
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
                let nearest = others.map(|o| crate::stats::latin_hypercube::distance(&point, &o)).fold(9.0, f64::min);
                assert!(nearest > 0.15, "{}, seed {seed}: two sets {nearest} apart", powder.id);
            }
            evaluations.push(f64::from(found.evaluations));
            verifications.push(f64::from(found.verification_runs));
            errors.push(found.mean_error_deg.unwrap());
        }
    }
    let mean = |values: &[f64]| summary::mean(values).unwrap();
    println!(
        "20 calibrations: {:.1} evaluations (max {}), {:.1} verification runs (max {}), mean error {:.2} deg",
        mean(&evaluations),
        evaluations.iter().fold(0.0, |a: f64, b| a.max(*b)),
        mean(&verifications),
        verifications.iter().fold(0.0, |a: f64, b| a.max(*b)),
        mean(&errors),
    );
    assert!(mean(&evaluations) <= 30.0 && mean(&verifications) <= 25.0);
    assert!(evaluations.iter().all(|n| *n <= 40.0) && mean(&errors) < 0.8);
}
