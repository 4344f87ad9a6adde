//! Masses dispensed by repeated shakes at fixed pitches: `cargo experiment shake_map
//! -- FRICTION COHESION`.

use flip_core::domain::bench::Action;
use flip_core::domain::parameters::ParameterSet;
use flip_sim::dispense::{Dispenser, Settings};
use rayon::prelude::*;

fn main() {
    let arguments: Vec<f64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let [friction, cohesion] =
        [arguments.first().copied().unwrap_or(0.5), arguments.get(1).copied().unwrap_or(0.0)];
    let set = ParameterSet::default()
        .with("friction", friction)
        .and_then(|set| set.with("cohesion", cohesion))
        .expect("friction 0-1.3 and cohesion 0-1.2");
    let full = Dispenser::new(&set, &Settings::default(), 1);
    let cells: Vec<(f64, f64)> = [20.0, 25.0, 30.0, 35.0, 40.0, 45.0]
        .iter()
        .flat_map(|&p| [2.0, 6.0, 16.0].map(|a| (p, a)))
        .collect();
    let rows: Vec<String> = cells
        .par_iter()
        .map(|&(pitch, shake_mm)| {
            let mut spoon = full.clone();
            while spoon.pitch_deg() < pitch {
                let change = (pitch - spoon.pitch_deg()).min(8.0);
                spoon.step(Action::once(change, 0.0));
            }
            let tilted = spoon.vial_mg();
            let doses: Vec<String> = (0..5)
                .map(|_| format!("{:.2}", spoon.step(Action::once(0.0, shake_mm)).vial_mg))
                .collect();
            format!(
                "{pitch} deg {shake_mm} mm: tilt {tilted:.2}, shakes {} mg, spilled {:.2}",
                doses.join(" "),
                spoon.spilled_mg()
            )
        })
        .collect();
    println!("spoon {:.1} mg\n{}", full.spoon_mg(), rows.join("\n"));
}
