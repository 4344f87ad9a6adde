//! Observables other than the angle, on formulas: joint inference, and that nothing is simulated
//! twice.

use super::channel::{NUMBERS, RUNS, carry_out, design, planned};
use super::emulator_tests::{clean_deg, emulator, formula, normal, settings};
use super::posterior::Posterior;
use super::tests::each;
use super::*;
use flip_core::domain::observable::{Observable, Observation};
use flip_core::domain::parameters::ParameterSet;
use flip_core::stats::latin_hypercube::latin_hypercube;
use std::sync::atomic::{AtomicU32, Ordering};

const DRAINED: Observable = Observable::DrainedAngle {};
const INSTRUMENT: Instrument = Instrument { numbers, value };

/// As in the simulator: the numbers a heap depends on, and the diameter and gravity.
fn numbers(set: &ParameterSet) -> [f64; NUMBERS] {
    let unit = set.to_unit();
    [unit[4], unit[7], unit[1], unit[3], unit[6], unit[0], unit[5]]
}

/// The mass of a grain is a known factor.
fn value(observable: &Observable, set: &ParameterSet, reduced: f64) -> f64 {
    match observable {
        Observable::FlowTime { mass_g, .. } => {
            mass_g * 10.0 / set.particle_mass_ug() / reduced.max(0.0)
        }
        _ => reduced,
    }
}

/// Falls with friction where the angle rises, so that the two together separate friction from
/// cohesion.
fn reduced(set: &ParameterSet) -> f64 {
    let unit = set.to_unit();
    1.0 + unit[0] - 0.8 * unit[4] + 0.3 * unit[7]
}

fn noisy(probe: &Probe) -> Result<f64, String> {
    Ok(reduced(&probe.parameters) + 0.02 * normal(probe.seed, 0))
}

fn hear(_: &Probe, _: &Progress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn channel(emulator: &Emulator, observable: Observable, truth: &ParameterSet) -> Channel {
    let runs = carry_out(design(emulator, &INSTRUMENT), &[], "", each(noisy), hear).unwrap();
    let mean = value(&observable, truth, reduced(truth));
    Channel::of(Observation { observable, mean, sd: 0.03 * mean, n: 5 }, &runs, INSTRUMENT).unwrap()
}

fn powder() -> ParameterSet {
    ParameterSet::default().with("friction", 0.3).unwrap().with("cohesion", 0.5).unwrap()
}

fn measured(truth: &ParameterSet) -> Flowability {
    Flowability::new(clean_deg(truth), 1.0, 5).unwrap()
}

#[test]
fn the_design_spreads_over_powders_that_are_asked_for_and_is_the_same_again() {
    let emulator = emulator();
    let plan = design(&emulator, &INSTRUMENT);
    assert_eq!(plan.len(), RUNS);
    assert!(plan.iter().all(|probe| (20.0..=52.0).contains(&emulator.mean_deg(&probe.parameters))));
    let frictions: Vec<f64> = plan.iter().map(|probe| probe.parameters.friction()).collect();
    assert!(frictions.iter().any(|f| *f < 0.1) && frictions.iter().any(|f| *f > 1.0));
    assert_eq!(plan, design(&emulator, &INSTRUMENT));
}

#[test]
fn the_emulator_of_an_observable_knows_what_it_knows() {
    let emulator = emulator();
    let channel = channel(&emulator, DRAINED, &powder());
    let held_out = latin_hypercube(400, &mut Pcg64::seed_from_u64(3));
    let sets = held_out.iter().map(space::parameters_at);
    let scores: Vec<f64> = sets
        .filter(|set| (20.0..=52.0).contains(&emulator.mean_deg(set)))
        .map(|set| (channel.expect(&set), reduced(&set)))
        .map(|(expected, truth)| (truth - expected.mean) / expected.sd)
        .collect();
    let square = scores.iter().map(|z| z * z).sum::<f64>() / scores.len() as f64;
    assert!(scores.len() > 100 && square.sqrt() < 1.5, "{} {square}", scores.len());
    let far = scores.iter().filter(|z| z.abs() > 3.0).count();
    assert!(far * 50 <= scores.len(), "{far} of {}", scores.len());
}

#[test]
fn an_observation_parts_what_the_angle_alone_leaves_together() {
    let (emulator, truth) = (emulator(), powder());
    let channels = [channel(&emulator, DRAINED, &truth)];
    let alone = Posterior::of((&emulator).into(), &measured(&truth), 400, 1);
    let joint = Posterior::of(
        Knowledge { emulator: &emulator, channels: &channels },
        &measured(&truth),
        400,
        1,
    );
    let explains = |draw: &[f64; 9]| {
        let set = ParameterSet::new(*draw).unwrap();
        (reduced(&set) - reduced(&truth)).abs() < 0.15
    };
    assert!(joint.draws.iter().filter(|draw| explains(draw)).count() > 320);
    assert!(alone.draws.iter().filter(|draw| explains(draw)).count() < 240);
}

#[test]
fn the_mass_of_a_grain_is_inert_until_something_weighs_it() {
    let (emulator, truth) = (emulator(), powder());
    let inert = |channels: &[Channel]| {
        let known = Knowledge { emulator: &emulator, channels };
        Posterior::of(known, &measured(&truth), 100, 1).parameters[8].inert
    };
    assert!(inert(&[]) && inert(&[channel(&emulator, DRAINED, &truth)]));
    assert!(!inert(&[channel(
        &emulator,
        Observable::FlowTime { mass_g: 50.0, orifice_mm: 2.5 },
        &truth
    )]));
}

#[test]
fn sets_meet_the_angle_and_the_observation_together() {
    let (emulator, truth) = (emulator(), powder());
    let channels = [channel(&emulator, DRAINED, &truth)];
    let sets = |channels: &[Channel]| {
        let known = Knowledge { emulator: &emulator, channels };
        let found =
            calibrate(&measured(&truth), &settings(3), Some(known), &[], formula, |_, _| {
                ControlFlow::Continue(())
            });
        found.unwrap().sets
    };
    let off = |sets: &[CalibratedSet]| {
        sets.iter().map(|set| (reduced(&set.parameters) - reduced(&truth)).abs()).sum::<f64>()
            / sets.len() as f64
    };
    let (alone, joint) = (sets(&[]), sets(&channels));
    assert_eq!(alone.len(), joint.len());
    assert!(joint.iter().all(|set| set.verified_error_deg <= settings(3).tolerance_deg));
    assert!(
        off(&joint) < 0.1 && off(&alone) > 2.0 * off(&joint),
        "{} {}",
        off(&joint),
        off(&alone)
    );
}

#[test]
fn runs_go_on_where_they_were_stopped_and_none_is_simulated_twice() {
    let plan = planned(&[ParameterSet::default(), powder()], 20, 7);
    let whole = carry_out(plan.clone(), &[], "", each(noisy), hear).unwrap();
    let calls = AtomicU32::new(0);
    let counted = each(|probe: &Probe| {
        calls.fetch_add(1, Ordering::Relaxed);
        noisy(probe)
    });
    assert_eq!(carry_out(plan.clone(), &whole[..13], "", counted, hear).unwrap(), whole);
    assert_eq!(calls.load(Ordering::Relaxed), 27);
    let mut heard = 0;
    let stopped = carry_out(plan.clone(), &[], "", each(noisy), |_, _| {
        heard += 1;
        if heard < 5 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    });
    assert_eq!((stopped, heard), (Err(Error::Stopped), 5));
    let others = planned(&[powder()], 20, 7);
    assert_eq!(carry_out(others, &whole, "", each(noisy), hear), Err(Error::History { index: 0 }));
}
