//! Masses dispensed by single steps, on random courses of the simulated spoon: the data behind the
//! dispenser's prior.
//!
//! ```text
//! flip calibrate --powder all --json > sets.json
//! cargo experiment shake_response -- sets.json [SPOONS] [SEED] [LOWEST_DEG] > steps.csv
//! cargo experiment shake_response -- box:300 [SPOONS] [SEED] [LOWEST_DEG] > box.csv
//! ```
//!
//! `box:300` is 300 sets spread over the whole published box, by the seed. A course goes up or down
//! by at most 8 deg a step to its own pitch, between LOWEST_DEG (10) and 50 deg, and shakes there,
//! each time with another amplitude and a little higher or lower. One line per step: masses in mg,
//! pitches in degrees, the amplitude in mm; the angle of repose is empty where not measured; d1 to
//! d5 are the five numbers that a heap depends on (`sim::directions`).

use flip_core::domain::bench::{Action, INCLINE_CHANGE_DEG_MAX, PitchLimits, SHAKE_MM_MAX};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_core::stats::latin_hypercube::latin_hypercube;
use flip_sim::directions;
use flip_sim::dispense::{Dispenser, Settings};
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
    target_deg: Option<f64>,
    sets: Vec<Set>,
}

#[derive(Deserialize)]
struct Set {
    parameters: ParameterSet,
}

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some(source) = arguments.first() else {
        anyhow::bail!(
            "shake_response SETS [SPOONS] [SEED] [LOWEST_DEG]: SETS is what `flip calibrate --json` printed, or box:300"
        );
    };
    let number = |k: usize, default: u64| arguments.get(k).map_or(Ok(default), |text| text.parse());
    let (spoons, seed) = (number(1, 4)?, number(2, 1)?);
    let lowest_deg: f64 = arguments.get(3).map_or(Ok(10.0), |text| text.parse())?;
    let range = PitchLimits::WIDE.lower_deg..PitchLimits::WIDE.upper_deg;
    anyhow::ensure!(
        range.contains(&lowest_deg),
        "LOWEST_DEG must be from {} to below {}",
        range.start,
        range.end
    );
    let document: Document = match source.strip_prefix("box:") {
        Some(count) => whole_box(count.parse()?, seed),
        None => serde_json::from_slice(&std::fs::read(source)?)?,
    };
    let mut courses = Vec::new();
    for (p, powder) in document.powders.iter().enumerate() {
        for (s, set) in powder.sets.iter().enumerate() {
            let seeds = (0..spoons).map(|spoon| derive(seed, &[p as u64, s as u64, spoon]));
            courses.extend(seeds.map(|seed| (powder, s, &set.parameters, seed)));
        }
    }
    println!(
        "powder,aor_deg,set,course,step,pitch_before_deg,pitch_deg,shake_mm,spoon_mg,poured_mg,spilled_mg,d1,d2,d3,d4,d5"
    );
    let lines: Vec<String> = courses
        .par_iter()
        .map(|(powder, s, set, seed)| course(powder, *s, set, *seed, lowest_deg))
        .collect();
    print!("{}", lines.concat());
    Ok(())
}

/// Sets spread over the published box, in place of calibrated ones.
fn whole_box(count: usize, seed: u64) -> Document {
    let points = latin_hypercube(count, &mut Pcg64Mcg::seed_from_u64(derive(seed, &[])));
    let sets = points
        .into_iter()
        .map(|point| Set { parameters: ParameterSet::from_unit(point) })
        .collect();
    Document { powders: vec![Powder { powder: "box".into(), target_deg: None, sets }] }
}

fn course(
    powder: &Powder,
    number: usize,
    set: &ParameterSet,
    seed: u64,
    lowest_deg: f64,
) -> String {
    let mut rng = Pcg64Mcg::seed_from_u64(derive(seed, &[1]));
    let mut spoon = Dispenser::new(set, &Settings::default(), derive(seed, &[0]));
    let cruise_deg = rng.random_range(lowest_deg..PitchLimits::WIDE.upper_deg);
    let mut lines = String::new();
    let angle = powder.target_deg.map_or(String::new(), |deg| deg.to_string());
    let [d1, d2, d3, d4, d5] = directions(set);
    for step in 0..STEPS {
        let (before_deg, held_mg) = (spoon.pitch_deg(), spoon.spoon_mg());
        let missing = cruise_deg - before_deg;
        let change = if missing.abs() > INCLINE_CHANGE_DEG_MAX {
            INCLINE_CHANGE_DEG_MAX.copysign(missing)
        } else {
            missing + rng.random_range(-3.0..3.0)
        };
        // As many small shakes as large ones, and a fifth of the steps without a shake.
        let shake_mm =
            if rng.random_bool(0.2) { 0.0 } else { rng.random_range(0.0..SHAKE_MM_MAX.ln()).exp() };
        let poured = spoon.step(Action::once(change, shake_mm));
        let name = &powder.powder;
        let (pitch_deg, mg, spilled_mg) = (spoon.pitch_deg(), poured.vial_mg, poured.spilled_mg);
        writeln!(
            lines,
            "{name},{angle},{number},{seed},{step},{before_deg:.2},{pitch_deg:.2},{shake_mm:.3},{held_mg:.3},{mg:.4},{spilled_mg:.4},{d1:.4},{d2:.4},{d3:.4},{d4:.4},{d5:.4}"
        )
        .expect("text grows");
    }
    lines
}
