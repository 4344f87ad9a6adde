//! A friction-cohesion grid of simulated angles of repose, as CSV: `cargo run --release --example repose_grid -- 5 8`.

use flip::domain::parameters::ParameterSet;
use flip::sim::repose::{Settings, repose};
use rayon::prelude::*;

fn main() {
    let arguments: Vec<u64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let [side, seeds] = [arguments.first().copied().unwrap_or(5), arguments.get(1).copied().unwrap_or(8)];
    println!("friction,cohesion,seeds,tip_deg,tip_sd_deg,cone_deg,refused");
    let cells: Vec<(u64, u64)> = (0..side).flat_map(|f| (0..side).map(move |c| (f, c))).collect();
    let rows: Vec<String> = cells
        .par_iter()
        .map(|&(f, c)| {
            let share = |k: u64| k as f64 / (side - 1) as f64;
            let mut fractions = ParameterSet::default().to_unit();
            (fractions[4], fractions[7]) = (share(f), share(c));
            let set = ParameterSet::from_unit(fractions);
            let heaps: Vec<_> = (1..=seeds).filter_map(|seed| repose(&set, &Settings::default(), seed).ok()).collect();
            let n = heaps.len() as f64;
            let tip = heaps.iter().map(|h| h.tip_deg).sum::<f64>() / n;
            let cone = heaps.iter().map(|h| h.cone_deg).sum::<f64>() / n;
            let sd = (heaps.iter().map(|h| (h.tip_deg - tip).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
            let refused = seeds as usize - heaps.len();
            format!("{:.3},{:.3},{seeds},{tip:.2},{sd:.2},{cone:.2},{refused}", set.friction(), set.cohesion())
        })
        .collect();
    rows.iter().for_each(|row| println!("{row}"));
}
