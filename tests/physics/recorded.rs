//! Heaps and doses bit by bit. Whoever changes them on purpose runs `make laws`, writes the results
//! into docs/validation.md, and records them again with `UPDATE=1`.

use flip_core::domain::bench::Action;
use flip_core::domain::parameters::ParameterSet;
use flip_sim::dispense::{self, Dispenser};
use flip_sim::repose::{self, repose};
use std::fmt::Write;
use std::{env, fs};

/// Friction and cohesion of a powder.
const POWDERS: [[f64; 2]; 3] = [[0.2, 0.0], [0.6, 0.2], [0.9, 0.8]];
/// Pitches and strokes of one dose: degrees, mm.
const STEPS: [[f64; 2]; 4] = [[16.0, 4.0], [0.0, 8.0], [16.0, 4.0], [0.0, 8.0]];
const SEED: u64 = 7;

fn measured() -> String {
    let mut lines = String::new();
    for [friction, cohesion] in POWDERS {
        let powder = ParameterSet::default().with("friction", friction).unwrap();
        let powder = powder.with("cohesion", cohesion).unwrap();
        let heap = repose(&powder, &repose::Settings::with_particles(400), SEED).unwrap();
        let mut spoon = Dispenser::new(&powder, &dispense::Settings::default(), SEED);
        let masses = STEPS.map(|[pitch, stroke]| spoon.step(Action::once(pitch, stroke)).vial_mg);
        writeln!(lines, "friction {friction} cohesion {cohesion}: heap tip {:?} deg, cone {:?} deg; doses {masses:?} mg", heap.tip_deg, heap.cone_deg).unwrap();
    }
    lines
}

#[test]
fn heaps_and_doses_are_those_whose_laws_are_documented() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/physics/recorded.txt");
    let measured = measured();
    if env::var_os("UPDATE").is_some() {
        fs::write(path, &measured).unwrap();
    }
    assert_eq!(measured, fs::read_to_string(path).unwrap(), "see the head of this file");
}
