//! The validation suite, as `flip validate` runs it: every law holds, or is missed as documented.
//!
//! Laws that take long are run by `make laws` alone: their numbers can change only with the
//! simulator, and recorded heaps and doses, which every run compares bit by bit, tell when it does.

use flip_sim::validate::{Check, Suite, experiments};
use rayon::prelude::*;

/// Runs the named experiments and expects every check to be accounted for.
fn expect(names: &[&str]) {
    let chosen: Vec<_> = experiments().into_iter().filter(|e| names.contains(&e.name)).collect();
    assert_eq!(chosen.len(), names.len(), "an experiment of {names:?} is missing");
    let suite = Suite::default();
    let checks: Vec<Check> =
        chosen.par_iter().with_max_len(1).flat_map_iter(|e| e.run(&suite)).collect();
    for check in &checks {
        assert!(check.is_accounted_for(), "{check:?}, off by {}", check.miss());
        if let Some(known) = check.known_deviation {
            // A documented miss that has shrunk must be documented again.
            assert!(check.miss() >= 0.5 * known.miss, "{check:?}, off by {} only", check.miss());
        }
    }
}

#[test]
fn one_and_two_grains_obey_their_exact_laws() {
    expect(&[
        "free_fall",
        "inelastic_drop",
        "pair_momentum",
        "incline",
        "tetrahedron",
        "pendant_pair",
        "mass_invariance",
    ]);
}

#[test]
#[ignore = "takes a minute of a core or more; `make laws` runs it"]
fn silos_empty_and_bear_load_as_beverloo_and_janssen_say() {
    expect(&["beverloo", "janssen"]);
}

#[test]
#[ignore = "takes minutes of a core; `make laws` runs it"]
fn tall_released_columns_spread_like_sand() {
    expect(&["collapse_tall"]);
}

#[test]
#[ignore = "takes a minute of a core or more; `make laws` runs it"]
fn low_released_columns_spread_like_sand() {
    expect(&["collapse_low"]);
}

#[test]
fn poured_grains_lie_as_densely_as_random_packings() {
    expect(&["packing_poured", "packing_frictionless"]);
}

#[test]
fn grains_that_may_roll_spread_and_rolling_resistance_gives_the_heap_back() {
    expect(&["rotation_smooth", "rotation_rough"]);
}

#[test]
fn the_angle_of_repose_has_converged_in_the_substep() {
    expect(&["repose_substep"]);
}

#[test]
#[ignore = "takes minutes of a core; `make laws` runs it"]
fn the_angle_of_repose_belongs_to_the_powder() {
    expect(&["repose_size", "repose_funnel"]);
}

#[test]
fn the_angle_of_repose_never_falls_with_friction_cohesion_or_a_rougher_base() {
    expect(&["repose_friction", "repose_cohesion", "repose_base_friction"]);
}

#[test]
#[ignore = "takes a minute of a core or more; `make laws` runs it"]
fn a_heap_rests_and_a_tilted_bed_flows_when_it_should() {
    expect(&["rest_free_flowing", "rest_cohesive", "tilted_bed"]);
}

#[test]
#[ignore = "takes minutes of a core; `make laws` runs it"]
fn a_dose_depends_on_the_substep_by_no_more_than_is_documented() {
    expect(&["dose_free_flowing", "dose_frictional"]);
}

#[test]
fn every_experiment_is_in_one_of_these_groups() {
    let source = include_str!("validation.rs");
    for experiment in experiments() {
        assert!(
            source.contains(&format!("\"{}\"", experiment.name)),
            "{} is not tested",
            experiment.name
        );
    }
}
