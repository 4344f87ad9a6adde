//! What one shake gives at each pitch: `cargo run --release --example shake_map -- FRICTION COHESION`.

use flip::domain::bench::Action;
use flip::domain::parameters::ParameterSet;
use flip::sim::dispense::{Dispenser, Settings};

fn main() {
    let arguments: Vec<f64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let [friction, cohesion] = [arguments.first().copied().unwrap_or(0.5), arguments.get(1).copied().unwrap_or(0.0)];
    let set = ParameterSet::default()
        .with("friction", friction)
        .and_then(|set| set.with("cohesion", cohesion))
        .expect("friction 0-1.3 and cohesion 0-1.2");
    let start = std::time::Instant::now();
    let full = Dispenser::new(&set, &Settings::default(), 1);
    println!("filled {:.1} mg in {:.2} s", full.spoon_mg(), start.elapsed().as_secs_f64());
    for shake_mm in [0.0, 4.0, 8.0, 16.0] {
        let mut spoon = full.clone();
        print!("{shake_mm:4} mm:");
        for _ in 0..10 {
            let start = std::time::Instant::now();
            let poured = spoon.step(Action { incline_change_deg: 5.0, shake_mm });
            print!(
                "  {:.0}deg {:.2}+{:.2} mg ({:.2} s, {:.2} cpu)",
                spoon.pitch_deg(),
                poured.vial_mg,
                poured.spilled_mg,
                poured.duration_s,
                start.elapsed().as_secs_f64()
            );
        }
        println!("  fault {:?}", spoon.fault());
    }
}
