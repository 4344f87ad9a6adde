//! Readings that FLIP's own simulated spoon makes: nothing is wrong.

use super::super::*;
use super::SETTINGS;
use flip_core::domain::bench::Action;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_core::stats::normal;
use flip_sim::dispense::{self, Dispenser};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Display step of a balance for a spoon of 3 mg, and SD of a reading, mg.
const BALANCE_MG: [f64; 2] = [0.1, 0.03];
const SHAKES: u32 = 12;

/// A dose as the shipped policy makes it: it tips until powder falls, then shakes there.
fn dose(k: u64, seed: u64) -> Weighing {
    let (powder, friction) = [("sand", 0.2), ("salt", 0.6)][(k % 2) as usize];
    let set = ParameterSet::default().with("friction", friction).unwrap();
    let settings = dispense::Settings {
        particles: 200,
        semi_axes_mm: [2.15, 1.5, 0.86],
        ..dispense::Settings::default()
    };
    let mut spoon = Dispenser::new(&set, &settings, derive(seed, &[k]));
    let mut rng = Pcg64::seed_from_u64(derive(seed, &[k, 1]));
    let (mut readings, mut t_s, mut last_mg) = (Vec::new(), 0.0, 0.0);
    for shake in 0..=SHAKES {
        let (before_mg, fill_mg) = (spoon.vial_mg(), spoon.spoon_mg());
        let shake_mm = rng.random_range(3.0..7.0);
        if shake > 0 {
            let incline_change_deg = if last_mg < 0.2 { 4.0 } else { 0.0 };
            spoon.step(Action::once(incline_change_deg, shake_mm));
        }
        last_mg = spoon.vial_mg() - before_mg;
        for _ in 0..5 {
            t_s += 0.2;
            let noise = BALANCE_MG[1] * normal::quantile(rng.random_range(1e-9..1.0));
            readings.push(Reading {
                t_s,
                balance_mg: ((spoon.vial_mg() + noise) / BALANCE_MG[0]).round() * BALANCE_MG[0],
                stable: None,
                shake_index: Some(shake),
                shake_mm: (shake > 0).then_some(shake_mm),
                spoon_pitch_deg: Some(spoon.pitch_deg()),
                spoon_fill_mg: Some(fill_mg),
                relative_humidity_pct: None,
                vibration_rms_m_s2: None,
            });
        }
    }
    Weighing {
        id: format!("w{k}"),
        powder: Some(powder.to_owned()),
        session: Some(format!("d{}", k / 4)),
        kind: Kind::Dose,
        target_mg: None,
        readings,
    }
}

#[test]
fn readings_of_the_simulator_itself_depart_from_nothing() {
    for seed in 1..=2 {
        let traces = Traces { weighings: (0..12).map(|k| dose(k, seed)).collect() };
        let screening = screen_traces(&traces, &SETTINGS).unwrap();
        let best = screening.judged.first().map(|it| (it.mechanism.name().0, it.probability));
        println!("{seed}: p {} {best:?} {:?}", screening.p_value, screening.unjudged);
        assert!(screening.p_value > 0.05, "{seed}: p {} {best:?}", screening.p_value);
        let why = screening.unjudged.map(|unjudged| unjudged.why).unwrap_or_default();
        assert!(why.contains("before powder fell"), "{why}");
    }
}
