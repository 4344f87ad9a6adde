//! Calibrations that hold some parameters at a value, on the formula of the emulator's tests.

use super::emulator_tests::{emulator, formula};
use super::posterior::Posterior;
use super::*;
use flip_core::domain::parameters::ParameterSet;
use std::collections::BTreeMap;

fn fixed(values: &[(&str, f64)]) -> BTreeMap<String, f64> {
    values.iter().map(|(key, value)| ((*key).to_owned(), *value)).collect()
}

/// Settings that hold gravity, with which each method finds its sets quickly.
fn earth(method: Method) -> Settings {
    let quick = Settings { sets: 4, tolerance_deg: 1.5, ..Settings::of(method) };
    Settings { fixed: fixed(&[("gravity_scale", 1.0)]), ..quick }
}

fn found(deg: f64, settings: &Settings, emulator: &Emulator) -> (Vec<Trial>, Calibration) {
    let target = Flowability { repose_deg: deg, sd_deg: 2.0, n: 5 };
    let mut trials = Vec::new();
    let found =
        calibrate(&target, settings, Some(emulator.into()), &[], formula, |trial: &Trial, _| {
            trials.push(trial.clone());
            ControlFlow::Continue(())
        });
    (trials, found.unwrap())
}

#[test]
fn every_method_holds_what_is_fixed_in_every_simulation_and_still_finds_its_sets() {
    let emulator = emulator();
    for method in [Method::Emulator, Method::Sequential, Method::Paper] {
        let (trials, held) = found(36.0, &earth(method), &emulator);
        assert_eq!(held.sets.len(), 4, "{method:?}");
        let gravity = |trial: &Trial| trial.parameters.gravity_scale();
        assert!(trials.iter().all(|trial| gravity(trial) == 1.0), "{method:?}");
        let different: std::collections::HashSet<String> =
            held.sets.iter().map(|set| set.parameters.id()).collect();
        assert_eq!(different.len(), 4, "{method:?}: the other parameters are searched");
        let free = Settings { fixed: BTreeMap::new(), ..earth(method) };
        let (trials, _) = found(36.0, &free, &emulator);
        assert!(trials.iter().any(|trial| gravity(trial) < 0.9), "{method:?}");
    }
}

#[test]
fn a_target_beyond_a_slice_is_limited_by_a_parameter_that_is_searched() {
    let emulator = emulator();
    let slippery = fixed(&[("friction", 0.1), ("cohesion", 0.0)]);
    let settings = Settings { fixed: slippery, ..earth(Method::Emulator) };
    let (_, found) = found(45.0, &settings, &emulator);
    let shortfall = found.shortfall.unwrap();
    assert!(shortfall.nearest_repose_deg < 40.0, "{shortfall:?}");
    let limiting = shortfall.limiting_parameter.unwrap_or_default();
    assert!(!["friction", "cohesion"].contains(&limiting.as_str()), "{limiting}");
    for set in &found.sets {
        assert_eq!((set.parameters.friction(), set.parameters.cohesion()), (0.1, 0.0));
    }
}

#[test]
fn a_posterior_within_a_slice_learns_of_the_others_alone() {
    let emulator = emulator();
    let measured = Flowability { repose_deg: 33.0, sd_deg: 1.0, n: 5 };
    let space = earth(Method::Emulator).space().unwrap();
    let held = Posterior::within(space, (&emulator).into(), &measured, 200, 1);
    let of = |key: &str| held.parameters.iter().find(|p| p.key == key).unwrap().clone();
    let gravity = of("gravity_scale");
    assert_eq!((gravity.mean, gravity.interval, gravity.learnt), (1.0, [1.0; 2], 0.0));
    assert!(of("friction").learnt > 0.3);
    let free = Posterior::within(Space::default(), (&emulator).into(), &measured, 200, 1);
    assert_eq!(free, Posterior::of((&emulator).into(), &measured, 200, 1));
}

#[test]
fn settings_without_fixed_parameters_keep_their_text() {
    let usual = serde_json::to_string(&Settings::default()).unwrap();
    assert!(!usual.contains("fixed"), "{usual}");
    let held = serde_json::to_string(&earth(Method::Emulator)).unwrap();
    assert_eq!(serde_json::from_str::<Settings>(&held).unwrap(), earth(Method::Emulator));
    let wrong = Settings { fixed: fixed(&[("gravity_scale", 2.0)]), ..Settings::default() };
    assert_eq!(wrong.checked().unwrap_err().field, "fixed.gravity_scale");
    assert_eq!(ParameterSet::default().gravity_scale(), 1.0, "what the documents recommend");
}
