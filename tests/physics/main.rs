//! Does nature hold? Bulk behaviour of the simulator through its public surface.

mod emulator;
mod recorded;
mod validation;

use flip_core::domain::parameters::ParameterSet;
use flip_sim::repose::{Settings, repose};
use rayon::prelude::*;

/// Mean and standard error of the tip angle over seeds.
fn angle(friction: f64, cohesion: f64, seeds: u64) -> (f64, f64) {
    let set = ParameterSet::default()
        .with("friction", friction)
        .unwrap()
        .with("cohesion", cohesion)
        .unwrap();
    let tips: Vec<f64> =
        (1..=seeds).map(|seed| repose(&set, &Settings::default(), seed).unwrap().tip_deg).collect();
    let n = tips.len() as f64;
    let mean = tips.iter().sum::<f64>() / n;
    let variance = tips.iter().map(|t| (t - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

#[test]
#[ignore = "takes a minute of a core or more; `make laws` runs it"]
fn the_angle_of_repose_rises_with_friction_and_with_cohesion() {
    let cells: Vec<(usize, usize)> = (0..5).flat_map(|f| (0..5).map(move |c| (f, c))).collect();
    let grid: Vec<(f64, f64)> = cells
        .par_iter()
        .map(|&(f, c)| angle(1.3 * f as f64 / 4.0, 1.2 * c as f64 / 4.0, 8))
        .collect();
    let at = |f: usize, c: usize| grid[f * 5 + c];
    for (f, c) in cells {
        for (nf, nc) in [(f + 1, c), (f, c + 1)] {
            if nf < 5 && nc < 5 {
                let ((from, se_from), (to, se_to)) = (at(f, c), at(nf, nc));
                let fall = from - to;
                assert!(
                    fall <= 2.0 * se_from.hypot(se_to),
                    "({f},{c}) {from:.2} -> ({nf},{nc}) {to:.2}"
                );
            }
        }
    }
    // The published powders, 28 to 43 deg, lie well inside.
    assert!(at(0, 0).0 < 25.0 && at(4, 4).0 > 46.0, "{:?} {:?}", at(0, 0), at(4, 4));
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_thread() {
    let settings = Settings::with_particles(300);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let heap = |seed: u64| format!("{:?}", repose(&ParameterSet::default(), &settings, seed));
        pool.install(|| (0..6).into_par_iter().map(heap).collect::<Vec<_>>())
    };
    assert_eq!(run(1), run(2));
}
