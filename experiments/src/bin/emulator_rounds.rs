//! What an emulator of the angle loses if its heaps are poured in fewer and larger rounds, as suits a
//! graphics card: its error on heaps that it has not seen, for several rounds and seeds.
//!
//! `cargo experiment emulator_rounds -- 22,88,176 3 150`: heaps of a round after the first 64, seeds of
//! the design, heaps that it is asked about.

use flip_core::domain::parameters::ParameterSet;
use flip_core::stats::latin_hypercube::latin_hypercube;
use flip_core::stats::summary;
use flip_learn::calibrate::{Design, Emulator, Heap, Pour, build};
use flip_sim::directions;
use flip_sim::repose::{Settings, repose};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use rayon::prelude::*;
use std::ops::ControlFlow;

/// Angles that powders have, degrees: heaps outside are not asked about.
const ASKED: [f64; 2] = [20.0, 52.0];

fn poured(pour: &Pour) -> Result<Heap, String> {
    let settings = Settings { readings: pour.readings, ..Settings::with_particles(pour.particles) };
    let heap = repose(&pour.parameters, &settings, pour.seed).map_err(|why| why.to_string())?;
    Ok(Heap {
        tip_deg: heap.tip_deg,
        tip_sd_deg: heap.tip_sd_deg,
        cone_deg: heap.cone_deg,
        creep_deg_per_s: heap.creep_deg_per_s,
    })
}

fn all(pours: &[Pour]) -> Vec<Result<Heap, String>> {
    pours.par_iter().map(poured).collect()
}

/// Root-mean-square error of a heap's prediction, degrees, and of its error in standard deviations,
/// the scatter of the heap included.
fn errors(emulator: &Emulator, asked: &[(ParameterSet, Heap)], readings: u32) -> [f64; 2] {
    let of = |(set, heap): &(ParameterSet, Heap)| {
        let expected = emulator.expect(set);
        let error = heap.tip_deg - expected.mean.mean;
        let scatter2 = expected.seed_sd_deg.powi(2) / f64::from(readings);
        [error.powi(2), error.powi(2) / (expected.mean.sd.powi(2) + scatter2)]
    };
    let squares: Vec<[f64; 2]> = asked.iter().map(of).collect();
    [0, 1].map(|k| {
        let each: Vec<f64> = squares.iter().map(|it| it[k]).collect();
        summary::mean(&each).unwrap_or(f64::NAN).sqrt()
    })
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let argument = |k: usize, usual| arguments.get(k).map_or(usual, String::as_str);
    let rounds: Vec<u32> =
        argument(0, "22,88,176").split(',').map(str::parse).collect::<Result<_, _>>()?;
    let (seeds, asked): (u64, usize) = (argument(1, "3").parse()?, argument(2, "150").parse()?);
    let usual = Design::with_particles(Settings::default().particles);
    let points = latin_hypercube(asked, &mut Pcg64::seed_from_u64(20_261_130));
    let heap = |(k, point): (usize, &[f64; flip_core::domain::parameters::COUNT])| {
        let parameters = ParameterSet::from_unit(*point);
        let Design { particles, readings, .. } = usual;
        let pour = Pour { parameters, particles, readings, seed: 1_000_000 + k as u64 };
        poured(&pour).ok().map(|heap| (parameters, heap))
    };
    let mut unseen: Vec<_> = points.par_iter().enumerate().filter_map(heap).collect();
    unseen.retain(|(_, heap)| (ASKED[0]..=ASKED[1]).contains(&heap.tip_deg));
    println!("{} heaps of {} that were not seen, within {ASKED:?} deg\n", unseen.len(), asked);
    println!("| heaps of a round | rounds | seed | error deg | in standard deviations |");
    println!("|---|---|---|---|---|");
    for &round in &rounds {
        for seed in 1..=seeds {
            let design = Design { round, seed, ..usual };
            let emulator = build(&design, directions, &[], all, |_, _| ControlFlow::Continue(()))?;
            let [error_deg, score] = errors(&emulator, &unseen, usual.readings);
            let many = 1 + (usual.runs - usual.initial).div_ceil(round);
            println!("| {round} | {many} | {seed} | {error_deg:.3} | {score:.2} |");
        }
    }
    Ok(())
}
