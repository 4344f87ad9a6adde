//! The product's emulator on the product's simulator: held-out heaps are where it predicts them.

use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_learn::calibrate::{Design, Heap, Pour, build};
use flip_sim as sim;
use flip_sim::repose::{Settings, repose};
use rayon::prelude::*;
use std::ops::ControlFlow;

const PARTICLES: u32 = 800;
const READINGS: u32 = 4;
const HELD_OUT: u64 = 60;

fn heap(pour: &Pour) -> Result<Heap, String> {
    let settings = Settings { readings: pour.readings, ..Settings::with_particles(pour.particles) };
    let pile =
        repose(&pour.parameters, &settings, pour.seed).map_err(|refusal| refusal.to_string())?;
    Ok(Heap {
        tip_deg: pile.tip_deg,
        tip_sd_deg: pile.tip_sd_deg,
        cone_deg: pile.cone_deg,
        creep_deg_per_s: pile.creep_deg_per_s,
    })
}

/// A set of the box, derived only from its number.
fn held_out(k: u64) -> ParameterSet {
    let uniform = |j: u64| (derive(97, &[k, j]) >> 11) as f64 / (1u64 << 53) as f64;
    ParameterSet::from_unit(std::array::from_fn(|j| uniform(j as u64)))
}

#[test]
#[ignore = "takes a minute of a core or more; `make laws` runs it"]
fn held_out_heaps_are_where_the_emulator_says_as_often_as_it_says() {
    // Less than half of the product's heaps: its uncertainties have to be right at any size.
    let design = Design { runs: 100, initial: 64, round: 18, ..Design::with_particles(PARTICLES) };
    let heaps = |pours: &[Pour]| pours.par_iter().map(heap).collect::<Vec<_>>();
    let emulator =
        build(&design, sim::directions, &[], heaps, |_, _| ControlFlow::Continue(())).unwrap();
    let scores: Vec<f64> = (0..HELD_OUT)
        .into_par_iter()
        .filter_map(|k| {
            let set = held_out(k);
            let expected = emulator.expect(&set);
            // In the range of calibrations; far beyond it, the design is explored only initially.
            if !(22.0..52.0).contains(&expected.mean.mean) {
                return None;
            }
            let (particles, readings, seed) = (PARTICLES, READINGS, derive(98, &[k]));
            let tip_deg = heap(&Pour { parameters: set, particles, readings, seed }).ok()?.tip_deg;
            // The mean of four readings of a heap, which have 0.09 of their variance in common.
            let noise = expected.seed_sd_deg * (1.0 / f64::from(READINGS) + 0.09).sqrt();
            Some((tip_deg - expected.mean.mean) / expected.mean.sd.hypot(noise))
        })
        .collect();
    let n = scores.len() as f64;
    let rms = (scores.iter().map(|z| z * z).sum::<f64>() / n).sqrt();
    let within = scores.iter().filter(|z| z.abs() <= 1.0).count() as f64 / n;
    println!(
        "{n} held-out heaps: root mean square of the scores {rms:.2}, {:.0} % within one",
        100.0 * within
    );
    // With thirty heaps the standard errors are 0.13 and 9 %; three of each.
    assert!(n >= 25.0 && (0.6..=1.4).contains(&rms), "{n} {rms}");
    assert!((0.41..=0.95).contains(&within), "{within}");
}
