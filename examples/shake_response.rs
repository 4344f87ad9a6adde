//! What single steps let fall, on random courses of the simulated spoon: the data behind the dispenser's prior.
//!
//! ```text
//! flip calibrate --powder all --json > sets.json
//! cargo run --release --example shake_response -- sets.json [SPOONS] [SEED] > steps.csv
//! ```
//!
//! A course goes up by at most 8 deg a step to a pitch of its own and shakes there, each time with another amplitude and a little higher or
//! lower. A line for each step: masses in mg, pitches in degrees, the amplitude in mm.

use flip::domain::bench::{Action, INCLINE_CHANGE_DEG_MAX, SHAKE_MM_MAX};
use flip::domain::parameters::ParameterSet;
use flip::domain::seed::derive;
use flip::sim::dispense::{Dispenser, Settings};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde::Deserialize;
use std::fmt::Write;

/// Steps of a course.
const STEPS: u32 = 16;

#[derive(Deserialize)]
struct Document {
    powders: Vec<Powder>,
}

#[derive(Deserialize)]
struct Powder {
    powder: String,
    target_deg: f64,
    sets: Vec<Set>,
}

#[derive(Deserialize)]
struct Set {
    parameters: ParameterSet,
}

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some(path) = arguments.first() else {
        anyhow::bail!("shake_response SETS.json [SPOONS] [SEED]: SETS.json is what `flip calibrate --json` prints");
    };
    let number = |k: usize, default: u64| arguments.get(k).map_or(Ok(default), |text| text.parse());
    let (spoons, seed) = (number(1, 4)?, number(2, 1)?);
    let document: Document = serde_json::from_slice(&std::fs::read(path)?)?;
    let mut courses = Vec::new();
    for (p, powder) in document.powders.iter().enumerate() {
        for (s, set) in powder.sets.iter().enumerate() {
            let seeds = (0..spoons).map(|spoon| derive(seed, &[p as u64, s as u64, spoon]));
            courses.extend(seeds.map(|seed| (powder, s, &set.parameters, seed)));
        }
    }
    println!("powder,aor_deg,set,course,step,pitch_before_deg,pitch_deg,shake_mm,spoon_mg,poured_mg,spilled_mg");
    let lines: Vec<String> = courses.par_iter().map(|(powder, s, set, seed)| course(powder, *s, set, *seed)).collect();
    print!("{}", lines.concat());
    Ok(())
}

fn course(powder: &Powder, number: usize, set: &ParameterSet, seed: u64) -> String {
    let mut rng = Pcg64Mcg::seed_from_u64(derive(seed, &[1]));
    let mut spoon = Dispenser::new(set, &Settings::default(), derive(seed, &[0]));
    let cruise_deg = rng.random_range(10.0..50.0f64);
    let mut lines = String::new();
    for step in 0..STEPS {
        let (before_deg, held_mg) = (spoon.pitch_deg(), spoon.spoon_mg());
        let missing = cruise_deg - before_deg;
        let change = if missing.abs() > INCLINE_CHANGE_DEG_MAX {
            INCLINE_CHANGE_DEG_MAX.copysign(missing)
        } else {
            missing + rng.random_range(-3.0..3.0)
        };
        // As many small shakes as large ones, and a fifth of the steps without.
        let shake_mm = if rng.random_bool(0.2) { 0.0 } else { rng.random_range(0.0..SHAKE_MM_MAX.ln()).exp() };
        let poured = spoon.step(Action { incline_change_deg: change, shake_mm });
        let (name, angle) = (&powder.powder, powder.target_deg);
        let (pitch_deg, mg, spilled_mg) = (spoon.pitch_deg(), poured.vial_mg, poured.spilled_mg);
        writeln!(
            lines,
            "{name},{angle},{number},{seed},{step},{before_deg:.2},{pitch_deg:.2},{shake_mm:.3},{held_mg:.3},{mg:.4},{spilled_mg:.4}"
        )
        .expect("text grows");
    }
    lines
}
