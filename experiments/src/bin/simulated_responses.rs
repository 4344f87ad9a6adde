//! How far each mechanism of the simulator moves the angle of repose, over the angles of powders:
//! the table of `crates/flip-discover/src/causes/response.rs`.
//!
//! `cargo experiment simulated_responses -- [sets] [grains] [readings]`
//! pours, for random parameter sets whose heaps stand at 22 to 50 deg, a heap as it is and one for
//! each mechanism and amplitude, with the same seed, and prints one line of JSON for each pair.
//! With `fit` and such lines on the standard input (`docs/simulated_responses.jsonl`: 28 sets, 2
//! readings) it prints the table.

use flip_core::domain::parameters::{COUNT, ParameterSet};
use flip_sim::mechanisms::Extensions;
use flip_sim::repose::{Settings, repose};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;

/// The setting changed, and the amplitudes.
const HOOKS: [(&str, [f64; 3]); 9] = [
    ("humidity", [0.1, 0.3, 0.8]),
    ("consolidation", [0.3, 1.0, 3.0]),
    ("vibration_g", [0.05, 0.1, 0.2]),
    ("size_spread", [0.1, 0.2, 0.3]),
    ("charge", [1.0, 3.0, 10.0]),
    ("cohesion", [0.1, 0.3, 0.6]),
    ("friction", [0.1, 0.2, 0.4]),
    ("funnel_clearance", [1.0, 2.0, 4.0]),
    ("base_friction", [-0.1, -0.25, -0.45]),
];
/// Range of angles of repose of powders, degrees.
const ANGLES_DEG: [f64; 2] = [22.0, 50.0];

/// The set and settings with one thing changed; `None` where a parameter would leave its bounds.
fn changed(
    hook: &str,
    amplitude: f64,
    set: &ParameterSet,
    settings: &Settings,
) -> Option<(ParameterSet, Settings)> {
    let mut other = *settings;
    match hook {
        "cohesion" => return Some((set.with("cohesion", set.cohesion() + amplitude).ok()?, other)),
        "friction" => return Some((set.with("friction", set.friction() + amplitude).ok()?, other)),
        "funnel_clearance" => other.funnel_clearance_diameters += amplitude,
        "base_friction" => other.base_friction += amplitude,
        name => other.extensions = Extensions::default().with(name, amplitude).ok()?,
    }
    Some((*set, other))
}

#[derive(serde::Deserialize)]
struct Pair {
    hook: String,
    amplitude: f64,
    base_deg: f64,
    shift_deg: f64,
}

/// Angle at which the table gives the shift, and degrees per unit of its slope.
const MIDDLE_DEG: f64 = 36.0;
const SLOPE_DEG: f64 = 10.0;

/// Fits a least-squares line for each mechanism and amplitude.
fn fit() {
    let pairs: Vec<Pair> = std::io::stdin()
        .lines()
        .map(|line| serde_json::from_str(&line.unwrap()).expect("lines of this example"))
        .collect();
    println!(
        "mechanism          amplitude  pairs  shift at 36 deg  change per 10 deg  SD around it"
    );
    for (hook, amplitudes) in HOOKS {
        for amplitude in amplitudes {
            let of = pairs.iter().filter(|it| it.hook == hook && it.amplitude == amplitude);
            let points: Vec<(f64, f64)> =
                of.map(|it| ((it.base_deg - MIDDLE_DEG) / SLOPE_DEG, it.shift_deg)).collect();
            let n = points.len() as f64;
            let mean = |value: fn(&(f64, f64)) -> f64| points.iter().map(value).sum::<f64>() / n;
            let (x, y) = (mean(|p| p.0), mean(|p| p.1));
            let across: f64 = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
            let slope = across / points.iter().map(|p| (p.0 - x).powi(2)).sum::<f64>();
            let left: f64 = points.iter().map(|p| (p.1 - y - slope * (p.0 - x)).powi(2)).sum();
            println!(
                "{hook:<17} {amplitude:>10} {n:>6} {:>16.2} {slope:>18.2} {:>13.2}",
                y - slope * x,
                (left / (n - 2.0)).sqrt()
            );
        }
    }
}

fn main() {
    if std::env::args().nth(1).as_deref() == Some("fit") {
        return fit();
    }
    let arguments: Vec<u32> =
        std::env::args().skip(1).filter_map(|text| text.parse().ok()).collect();
    let [sets, grains, readings] =
        [(0, 48), (1, 2000), (2, 4)].map(|(k, usual)| *arguments.get(k).unwrap_or(&usual));
    let settings = Settings { readings, ..Settings::with_particles(grains) };
    let angle = |set: &ParameterSet, settings: &Settings, seed: u64| {
        repose(set, settings, seed).ok().map(|it| it.cone_deg)
    };
    let mut rng = Pcg64::seed_from_u64(1);
    let candidates: Vec<ParameterSet> = (0..6 * sets)
        .map(|_| ParameterSet::from_unit(std::array::from_fn::<f64, COUNT, _>(|_| rng.random())))
        .collect();
    let quick = Settings { readings: 1, ..settings };
    let stands = |(k, set): (usize, &ParameterSet)| {
        angle(set, &quick, k as u64)
            .filter(|angle| (ANGLES_DEG[0]..ANGLES_DEG[1]).contains(angle))
            .map(|_| (k, *set))
    };
    let mut chosen: Vec<(usize, ParameterSet)> =
        candidates.par_iter().enumerate().filter_map(stands).collect();
    chosen.truncate(sets as usize);
    // A few sets at a time, so that a stopped run leaves what it has.
    for few in chosen.chunks(4) {
        pour(few, &settings, &angle);
    }
}

/// Pours every heap of these sets and prints the pairs.
fn pour(
    chosen: &[(usize, ParameterSet)],
    settings: &Settings,
    angle: &(impl Fn(&ParameterSet, &Settings, u64) -> Option<f64> + Sync),
) {
    let tasks: Vec<(usize, ParameterSet, &str, f64)> = chosen
        .iter()
        .flat_map(|&(k, set)| {
            let changes =
                HOOKS.into_iter().flat_map(|(hook, all)| all.map(|amplitude| (hook, amplitude)));
            std::iter::once(("", 0.0))
                .chain(changes)
                .map(move |(hook, amplitude)| (k, set, hook, amplitude))
        })
        .collect();
    let of = |(k, set, hook, amplitude): &(usize, ParameterSet, &str, f64)| {
        let (set, settings) = match *hook {
            "" => (*set, *settings),
            hook => changed(hook, *amplitude, set, settings)?,
        };
        angle(&set, &settings, 1000 + *k as u64)
    };
    let angles: Vec<Option<f64>> = tasks.par_iter().map(of).collect();
    let unchanged = |k: usize| {
        tasks.iter().position(|task| task.0 == k && task.2.is_empty()).and_then(|at| angles[at])
    };
    for ((k, _, hook, amplitude), angle) in tasks.iter().zip(&angles) {
        if let (false, Some(angle), Some(base)) = (hook.is_empty(), angle, unchanged(*k)) {
            let shift = angle - base;
            println!(
                r#"{{"set":{k},"hook":"{hook}","amplitude":{amplitude},"base_deg":{base:.3},"shift_deg":{shift:.3}}}"#
            );
        }
    }
}
