//! Simulation of observables other than the angle of repose.
//!
//! A simulation returns a *reduced* number: without the exactly known factors, so that little is
//! left to learn, and on a scale where differences matter. [`value`] converts it to the
//! observable's own unit.
//!
//! | observable | scene | reduced number | its value |
//! |---|---|---|---|
//! | flow time | `cup.rs` | w^(2/5), w grains leave in sqrt(d / g): linear in the hole (Beverloo et al. 1961) | mass / (w m) sqrt(d / g) |
//! | mass per shake | `dispense.rs` | ln(1 + grains of one shake) | that number of grains, times m |
//! | drained angle | `cup.rs` | the angle | the same |
//! | height of a heap | `repose.rs` | its angle | half the base times its tangent |
//!
//! m is the mass of a grain, g = gravity_scale * 9.81 m/s^2.

use super::batch::heaps::{Wanted, pour_on};
use super::batch::{Engine, Failed, Motion, Stand, in_step};
use super::cup;
use super::directions::{DIRECTIONS, directions};
use super::dispense::{self, Dispenser};
use super::law::GRAVITY;
use super::repose::{self, Refusal, Repose};
use flip_core::domain::bench::{Action, PitchLimits};
use flip_core::domain::conditions::Patch;
use flip_core::domain::observable::Observable;
use flip_core::domain::parameters::ParameterSet;
use std::ops::ControlFlow;

/// Number of inputs an observable depends on.
pub const NUMBERS: usize = DIRECTIONS + 2;
/// Number of shakes of a full spoon to average.
const SHAKES: u32 = 3;

/// The inputs of a set, 0 to 1: those of a heap, plus diameter and gravity, which matter where a
/// length or a time is not set by the grains.
pub fn numbers(set: &ParameterSet) -> [f64; NUMBERS] {
    let (heap, unit) = (directions(set), set.to_unit());
    let own = ["particle_diameter_mm", "gravity_scale"].map(|key| {
        let k = flip_core::domain::parameters::PARAMETERS.iter().position(|p| p.key == key);
        unit[k.expect("a published parameter")]
    });
    std::array::from_fn(|k| if k < DIRECTIONS { heap[k] } else { own[k - DIRECTIONS] })
}

/// Simulates the reduced number. Same inputs, same bytes.
///
/// # Errors
/// [`Refusal`]: a heap without an angle, or a solver that diverged.
pub fn observe(observable: &Observable, set: &ParameterSet, seed: u64) -> Result<f64, Refusal> {
    observe_under(observable, set, &Patch::default(), seed)
}

/// The same with what a version changes about spoons: other observables ignore it. A mechanism that
/// this simulator lacks was refused where the version was made.
///
/// # Errors
/// As [`observe`].
pub fn observe_under(
    observable: &Observable,
    set: &ParameterSet,
    patch: &Patch,
    seed: u64,
) -> Result<f64, Refusal> {
    match *observable {
        Observable::FlowTime { orifice_mm, .. } => {
            Ok(libm::pow(cup::flow(set, orifice_mm / set.particle_diameter_mm(), seed)?, 0.4))
        }
        Observable::ShakeMass { pitch_deg, shake_mm } => {
            let grains = shakes(set, patch, [pitch_deg, shake_mm], SHAKES, seed)?;
            Ok(libm::log1p(grains.iter().sum::<f64>() / f64::from(SHAKES)))
        }
        Observable::DrainedAngle {} => cup::drained_deg(set, seed),
        Observable::PileHeight { base_diameter_mm, fall_mm } => {
            Ok(repose::repose(set, &heap(base_diameter_mm, fall_mm), seed)?.tip_deg)
        }
    }
}

/// The heap on such a base, poured from such a height.
fn heap(base_diameter_mm: f64, fall_mm: f64) -> repose::Settings {
    let default = repose::Settings::default();
    let funnel_clearance_diameters =
        2.0 * default.base_radius_diameters * fall_mm / base_diameter_mm;
    repose::Settings { funnel_clearance_diameters, ..default }
}

/// Whether an engine of batches can simulate it: spoons and heaps, but no cups.
pub fn is_on_engines(observable: &Observable) -> bool {
    matches!(observable, Observable::ShakeMass { .. } | Observable::PileHeight { .. })
}

/// The same as [`observe`] with each of these seeds, side by side on an engine.
///
/// # Errors
/// The engine failed, or the observable [is not on engines](is_on_engines).
pub fn observe_on(
    engine: &dyn Engine,
    observable: &Observable,
    set: &ParameterSet,
    seeds: &[u64],
) -> Result<Vec<Result<f64, Refusal>>, Failed> {
    match *observable {
        Observable::ShakeMass { pitch_deg, shake_mm } => {
            let settings = shaken(&Patch::default());
            let loose = |seed: &u64| Dispenser::loose(set, &settings, *seed);
            let loose: Vec<Dispenser> = seeds.iter().map(loose).collect();
            let shake = Motion::Act(Action::once(0.0, shake_mm));
            let motions: Vec<Motion> = [Motion::Act(Action::once(pitch_deg, 0.0))]
                .into_iter()
                .chain((0..SHAKES).map(|_| shake))
                .collect();
            let stands = in_step(engine, &loose, &motions)?;
            Ok(stands.iter().map(|stands| mean_of_shakes(set, stands)).collect())
        }
        Observable::PileHeight { base_diameter_mm, fall_mm } => {
            let settings = heap(base_diameter_mm, fall_mm);
            let wanted = |seed: &u64| Wanted { set: *set, settings, seed: *seed };
            let wanted: Vec<Wanted> = seeds.iter().map(wanted).collect();
            let mut angles = vec![None; wanted.len()];
            let mut each = |k: usize, heap: Result<Repose, Refusal>| {
                angles[k] = Some(heap.map(|heap| heap.tip_deg));
                ControlFlow::Continue(())
            };
            pour_on(engine, &wanted, &mut each)?;
            Ok(angles.into_iter().flatten().collect())
        }
        Observable::FlowTime { .. } | Observable::DrainedAngle {} => {
            Err(Failed(format!("{} empties no cups", engine.name())))
        }
    }
}

/// The reduced number of a spoon that has stood so: at rest, pitched, and after each shake.
fn mean_of_shakes(set: &ParameterSet, stands: &[Stand]) -> Result<f64, Refusal> {
    if let Some(it) = stands.iter().find(|it| it.fault.is_some()) {
        let cause = it.fault.clone().unwrap_or_default();
        return Err(Refusal::Diverged { at_s: it.duration_s, cause });
    }
    let fallen_mg = |it: &Stand| it.vial_mg + it.spilled_mg;
    let mg = fallen_mg(&stands[stands.len() - 1]) - fallen_mg(&stands[1]);
    Ok(libm::log1p(mg * 1e3 / set.particle_mass_ug() / f64::from(SHAKES)))
}

/// Converts a reduced number of a set to the observable's unit.
pub fn value(observable: &Observable, set: &ParameterSet, reduced: f64) -> f64 {
    match *observable {
        Observable::FlowTime { mass_g, .. } => {
            let per_fall_ug = libm::pow(reduced.max(0.0), 2.5) * set.particle_mass_ug();
            mass_g * 1e6 / per_fall_ug * fall_s(set)
        }
        Observable::ShakeMass { .. } => {
            libm::expm1(reduced).max(0.0) * set.particle_mass_ug() * 1e-3
        }
        Observable::DrainedAngle {} => reduced,
        Observable::PileHeight { base_diameter_mm, .. } => {
            0.5 * base_diameter_mm * libm::tan(reduced.to_radians())
        }
    }
}

/// sqrt(d / g), s.
fn fall_s(set: &ParameterSet) -> f64 {
    (set.particle_diameter_mm() * 1e-3 / (set.gravity_scale() * GRAVITY)).sqrt()
}

/// Number of grains that fall at each of `count` shakes of a full spoon, at a pitch (deg) and an
/// amplitude (mm). Grains that fall while the
/// spoon is pitched are not counted.
///
/// # Errors
/// [`Refusal`] if the solver diverged.
pub fn shakes(
    set: &ParameterSet,
    patch: &Patch,
    [pitch_deg, shake_mm]: [f64; 2],
    count: u32,
    seed: u64,
) -> Result<Vec<f64>, Refusal> {
    let mut spoon = Dispenser::new(&patch.powder(set), &shaken(patch), seed);
    let mut act = |incline_change_deg, shake_mm| {
        let poured = spoon.step(Action::once(incline_change_deg, shake_mm));
        match spoon.fault() {
            Some(cause) => {
                Err(Refusal::Diverged { at_s: poured.duration_s, cause: cause.to_owned() })
            }
            None => Ok((poured.vial_mg + poured.spilled_mg) * 1e3 / set.particle_mass_ug()),
        }
    };
    act(pitch_deg, 0.0)?;
    (0..count).map(|_| act(0.0, shake_mm)).collect()
}

/// A spoon that may be pitched as far as any.
fn shaken(patch: &Patch) -> dispense::Settings {
    let usual = dispense::Settings::default();
    dispense::Settings {
        pitch: PitchLimits { lower_deg: 0.0, upper_deg: 90.0 },
        extensions: usual.extensions.patched(patch).unwrap_or(usual.extensions),
        ..usual
    }
}

#[cfg(test)]
mod tests {
    use super::super::batch::Cores;
    use super::*;

    fn set(changes: &[(&str, f64)]) -> ParameterSet {
        changes
            .iter()
            .fold(ParameterSet::default(), |set, (key, value)| set.with(key, *value).unwrap())
    }

    #[test]
    fn factors_that_are_known_are_exact() {
        let [light, heavy] = [13.0, 16.0].map(|ug| set(&[("particle_mass_ug", ug)]));
        let hall = Observable::FlowTime { mass_g: 50.0, orifice_mm: 2.54 };
        assert!(
            (value(&hall, &light, 2.0) / value(&hall, &heavy, 2.0) - 16.0 / 13.0).abs() < 1e-12
        );
        assert_eq!(value(&hall, &light, 0.0), f64::INFINITY);
        let shake = Observable::ShakeMass { pitch_deg: 30.0, shake_mm: 4.0 };
        assert!((value(&shake, &light, 101f64.ln()) - 1.3).abs() < 1e-12);
        let pile = Observable::PileHeight { base_diameter_mm: 40.0, fall_mm: 5.0 };
        assert!((value(&pile, &light, 45.0) - 20.0).abs() < 1e-12);
    }

    #[test]
    fn the_reduced_flow_is_linear_in_the_hole() {
        // Beverloo: w^(2/5) = a (D - k d), k near 1.4, for three holes of one powder.
        let easy = set(&[("friction", 0.4)]);
        let flow = |orifice_mm| {
            observe(&Observable::FlowTime { mass_g: 1.0, orifice_mm }, &easy, 1).unwrap()
        };
        let [small, middle, large] = [1.6, 2.1, 2.6].map(flow);
        assert!(
            small > 0.5
                && (large - middle) / (middle - small) > 0.7
                && (large - middle) / (middle - small) < 1.4
        );
        let offset = 1.6 - small * (2.6 - 1.6) / (large - small);
        assert!((0.8..2.4).contains(&(offset / 0.27)), "{offset}");
    }

    #[test]
    fn on_the_cores_behind_the_interface_of_engines_spoons_and_heaps_show_the_same() {
        let set = set(&[("friction", 0.3)]);
        let shake = Observable::ShakeMass { pitch_deg: 20.0, shake_mm: 8.0 };
        let pile = Observable::PileHeight { base_diameter_mm: 40.0, fall_mm: 5.0 };
        for observable in [shake, pile] {
            let seeds = [1, 2];
            let expected = seeds.map(|seed| observe(&observable, &set, seed).unwrap());
            let found = observe_on(&Cores, &observable, &set, &seeds).unwrap();
            for (found, expected) in found.into_iter().zip(expected) {
                let found = found.unwrap();
                assert!(expected > 0.0 && (found - expected).abs() < 1e-9, "{observable:?}");
            }
        }
        let drained = Observable::DrainedAngle {};
        assert!(!is_on_engines(&drained) && is_on_engines(&shake) && is_on_engines(&pile));
        assert!(observe_on(&Cores, &drained, &set, &[1]).is_err());
    }

    #[test]
    fn a_cup_empties_in_beverloos_time() {
        // 50 g through 2.54 mm: W = 0.58 rho_bulk sqrt(g) (D - 1.4 d)^(5/2), with rho_bulk 0.58 of
        // the grain density.
        let set = set(&[("friction", 0.4)]);
        let hall = Observable::FlowTime { mass_g: 50.0, orifice_mm: 2.54 };
        let seconds = value(&hall, &set, observe(&hall, &set, 1).unwrap());
        let d = set.particle_diameter_mm() * 1e-3;
        let bulk = 0.58 * set.particle_mass_ug() * 1e-9 / (std::f64::consts::PI / 6.0 * d.powi(3));
        let expected = 0.05 / (0.58 * bulk * GRAVITY.sqrt() * (2.54e-3 - 1.4 * d).powf(2.5));
        assert!((seconds / expected - 1.0).abs() < 0.2, "{seconds} {expected}");
    }

    #[test]
    fn a_rough_powder_flows_slower_a_sticky_one_drains_steeper_a_steep_spoon_gives_more() {
        let [smooth, rough] = [set(&[("friction", 0.1)]), set(&[("friction", 1.2)])];
        let sticky = set(&[("friction", 0.1), ("cohesion", 1.0)]);
        let of = |observable: &Observable, set| {
            value(observable, set, observe(observable, set, 1).unwrap())
        };
        let flow = Observable::FlowTime { mass_g: 1.0, orifice_mm: 2.0 };
        assert!(of(&flow, &smooth) < of(&flow, &rough));
        let drained = Observable::DrainedAngle {};
        let [slack, steep] = [of(&drained, &smooth), of(&drained, &sticky)];
        assert!(slack + 3.0 < steep && (15.0..45.0).contains(&slack), "{slack} {steep}");
        let shake = |pitch_deg| of(&Observable::ShakeMass { pitch_deg, shake_mm: 4.0 }, &rough);
        assert!(shake(10.0) < shake(30.0), "{} {}", shake(10.0), shake(30.0));
        let steep = Observable::ShakeMass { pitch_deg: 30.0, shake_mm: 4.0 };
        let stuck =
            Patch { amplitudes: [("spoon_adhesion".to_owned(), 6.0)].into(), ..Patch::default() };
        let held = observe_under(&steep, &rough, &stuck, 1).unwrap();
        assert!(held < 0.7 * observe(&steep, &rough, 1).unwrap(), "{held}");
        let again = observe(&drained, &smooth, 1).unwrap();
        assert_eq!(slack, again);
    }
}
