//! Scoops a powder from a bed and shows what the spoon took: `cargo run --release --example scoop
//! -- 2.0 0.4 0.0` (immersion mm, friction, cohesion).

use flip_core::domain::parameters::ParameterSet;
use flip_sim::scoop::{Settings, scoop};

fn main() {
    let numbers: Vec<f64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let number = |k: usize, default: f64| numbers.get(k).copied().unwrap_or(default);
    let powder = ParameterSet::default()
        .with("friction", number(1, 0.4))
        .and_then(|set| set.with("cohesion", number(2, 0.0)))
        .expect("friction from 0 to 1.3 and cohesion from 0 to 1.2");
    let immersion_mm = number(0, Settings::default().immersion_mm);
    let settings =
        Settings { immersion_mm, bed_depth_mm: immersion_mm + 3.0, ..Settings::default() };
    for seed in 1..=2 {
        match scoop(&powder, &settings, seed, None) {
            Ok(scooped) => println!(
                "seed {seed}: {:.1} mg of {:.0} mg in {:.2} s",
                scooped.taken_mg, scooped.bed_mg, scooped.simulated_s
            ),
            Err(failure) => println!("seed {seed}: {failure}"),
        }
    }
}
