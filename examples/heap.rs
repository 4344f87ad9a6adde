//! Pour a heap and read its angle: `cargo run --release --example heap -- 0.5 0.2`.

use flip::domain::parameters::ParameterSet;
use flip::sim::repose::{Settings, repose};

fn main() {
    let arguments: Vec<f64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let [friction, cohesion] = [arguments.first().copied().unwrap_or(0.5), arguments.get(1).copied().unwrap_or(0.0)];
    let set = ParameterSet::default()
        .with("friction", friction)
        .and_then(|set| set.with("cohesion", cohesion))
        .expect("friction 0-1.3 and cohesion 0-1.2");
    for seed in 1..=2 {
        let start = std::time::Instant::now();
        match repose(&set, &Settings::default(), seed) {
            Ok(heap) => println!("{heap:?} {:.2}s", start.elapsed().as_secs_f64()),
            Err(refusal) => println!("{refusal}"),
        }
    }
}
