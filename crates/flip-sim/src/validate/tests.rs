//! A broken law must fail its check, so that the suite cannot pass vacuously; and its instruments
//! must read correctly.

use super::super::constraints::{Vector, vector};
use super::super::law::Law;
use super::super::scene::{at_rest, line, packing_fraction, power_law, threshold};
use super::collapse::front;
use super::discharge::floor_load;
use super::{Check, SMOOTH, Suite, experiments};

/// The named check under a modified law.
fn check(name: &str, revise: fn(Law) -> Law) -> Check {
    let experiment = experiments().into_iter().find(|e| e.checks.contains(&name)).unwrap();
    experiment.run(&Suite::revised(revise)).into_iter().find(|check| check.name == name).unwrap()
}

/// A deliberately broken law.
type Fault = fn(Law) -> Law;

#[test]
fn a_broken_law_fails_its_check() {
    let faults: [(&str, Fault); 11] = [
        ("free_fall", |law| Law { gravity: 1.02 * law.gravity, ..law }),
        ("inelastic_drop", |mut law| {
            law.wall.normal_damping = 0.0;
            law
        }),
        ("pair_momentum", |law| Law { drag: 0.9999, ..law }),
        ("incline_threshold", |mut law| {
            law.wall.friction *= 0.5;
            law
        }),
        ("incline_acceleration", |mut law| {
            law.wall.friction *= 0.5;
            law
        }),
        ("tetrahedron_escape", |mut law| {
            law.grain = law.grain.attracted(law.gravity);
            law
        }),
        ("pendant_pair", |mut law| {
            law.grain.attraction *= 1.05;
            law
        }),
        ("packing_poured", |mut law| {
            law.grain = law.grain.attracted(10.0 * law.gravity);
            law
        }),
        ("janssen_stress_ratio", |mut law| {
            law.wall.friction *= 0.25;
            law
        }),
        ("repose_friction_rise", |mut law| {
            law.grain.friction = 0.16;
            law
        }),
        ("rest_overlap_mean", |mut law| {
            law.grain.normal *= 0.3;
            law
        }),
    ];
    for (name, fault) in faults {
        let check = check(name, fault);
        assert!(!check.passed && !check.is_accounted_for(), "{check:?}");
    }
}

#[test]
fn a_check_passes_within_its_tolerance_and_an_experiment_without_a_number_fails() {
    let check = |measured| Check::within("free_fall", measured, [1.0, 3.0], "", "");
    assert!(check(1.0).passed && check(3.0).passed && !check(3.1).passed && !check(0.9).passed);
    assert!((check(3.5).miss() - 0.5).abs() < 1e-12 && check(2.0).miss() == 0.0);
    assert!(!check(f64::NAN).passed && !check(f64::NAN).is_accounted_for());
}

#[test]
fn every_experiment_returns_the_checks_that_it_names_and_no_name_is_used_twice() {
    let mut names: Vec<&str> =
        experiments().iter().flat_map(|e| e.checks.iter().copied()).collect();
    let count = names.len();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), count);
    for experiment in
        experiments().iter().filter(|e| ["free_fall", "incline", "pendant_pair"].contains(&e.name))
    {
        let returned: Vec<&str> =
            experiment.run(&Suite::default()).iter().map(|check| check.name).collect();
        assert_eq!(returned, experiment.checks);
    }
}

#[test]
fn a_floor_between_frictionless_walls_bears_the_whole_weight() {
    let law = Suite::default().law_of_deep_bed(0.0);
    let [filled, borne] = floor_load(&law, 12.0);
    assert!((borne / filled - 1.0).abs() < 0.01, "{borne} of {filled}");
    let [filled, borne] = floor_load(&Suite::default().law_of_deep_bed(SMOOTH), 12.0);
    assert!(borne < 0.9 * filled, "friction bears the rest: {borne} of {filled}");
}

/// A cubic lattice of touching grains.
fn lattice() -> impl Iterator<Item = Vector> {
    let side = -20..20i8;
    let place = |i: i8| f32::from(i) + 0.5;
    side.clone().flat_map(move |i| {
        let side = side.clone();
        side.clone()
            .flat_map(move |j| side.clone().map(move |k| vector(place(i), place(j), place(k))))
    })
}

#[test]
fn a_cubic_lattice_is_packed_by_pi_over_six() {
    let fraction =
        packing_fraction(&at_rest(&Suite::default().law(SMOOTH), lattice()), 15.0, [-10.0, 10.0]);
    assert!((fraction - std::f64::consts::PI / 6.0).abs() < 0.01, "{fraction}");
}

#[test]
fn the_front_of_a_round_layer_is_its_radius() {
    let layer = lattice().filter(|x| x[2] == 0.5 && x[0].hypot(x[1]) < 12.0);
    let front = front(at_rest(&Suite::default().law(SMOOTH), layer).centres());
    assert!((front - 12.0).abs() < 0.5, "{front}");
}

#[test]
fn lines_power_laws_and_thresholds_are_found() {
    let points = |of: fn(f64) -> f64| [1.0, 2.0, 4.0].map(|x| [x, of(x)]);
    let [slope, at_zero] = line(&points(|x| 3.0 - 2.0 * x));
    assert!((slope + 2.0).abs() < 1e-12 && (at_zero - 3.0).abs() < 1e-12);
    let [exponent, prefactor] = power_law(&points(|x| 1.6 * x.sqrt()));
    assert!((exponent - 0.5).abs() < 1e-12 && (prefactor - 1.6).abs() < 1e-12);
    assert!((threshold([0.0, 8.0], 20, |x| x > 5.0) - 5.0).abs() < 1e-5);
}
