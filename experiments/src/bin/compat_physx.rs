//! Measures `compat = "physx"`, as CSV: `cargo experiment compat_physx -- frames` for
//! the choice of the frame, `-- angles` for angles of repose alongside the physical semantics. The
//! second argument is the number of grains (2000), the third the number of heaps per row (4).

use flip_core::domain::parameters::ParameterSet;
use flip_sim::repose::{Compat, Repose, Settings, repose};
use rayon::prelude::*;

fn set(changes: &[(&str, f64)]) -> ParameterSet {
    let changed = |set: ParameterSet, (key, value): &(&str, f64)| {
        set.with(key, *value).expect("within the bounds")
    };
    changes.iter().fold(ParameterSet::default(), changed)
}

/// One row: the heaps of one setting.
fn row(changes: &[(&str, f64)], settings: &Settings, heaps: u64) {
    let poured: Vec<_> =
        (1..=heaps).into_par_iter().map(|seed| repose(&set(changes), settings, seed)).collect();
    let angled: Vec<&Repose> = poured.iter().flatten().collect();
    let mean = |of: fn(&Repose) -> f64| {
        angled.iter().map(|heap| of(heap)).sum::<f64>() / angled.len() as f64
    };
    let tip = mean(|heap| heap.tip_deg);
    let sd = (angled.iter().map(|heap| (heap.tip_deg - tip).powi(2)).sum::<f64>()
        / (angled.len() as f64 - 1.0))
        .sqrt();
    let words: Vec<String> = changes.iter().map(|(key, value)| format!("{key}={value}")).collect();
    println!(
        "{:?},{},{},{},{},{},{tip:.2},{sd:.2},{:.2},{:.3},{:.2},{:.2},{:.2},{}",
        settings.compat,
        words.join(" "),
        settings.particles,
        settings.frame_s,
        settings.iterations,
        settings.settle_max_s,
        mean(|heap| heap.cone_deg),
        mean(|heap| heap.creep_deg_per_s),
        mean(|heap| heap.speed_rms_mm_s),
        100.0 * mean(|heap| heap.overlap_mean),
        100.0 * angled.iter().fold(0.0, |top, heap| heap.overlap_max.max(top)),
        poured.len() - angled.len(),
    );
    poured
        .iter()
        .filter_map(|heap| heap.as_ref().err())
        .take(1)
        .for_each(|refusal| println!("# {refusal}"));
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |place: usize, default: u32| {
        arguments.get(place).and_then(|a| a.parse().ok()).unwrap_or(default)
    };
    let (grains, heaps) = (number(1, 2000), u64::from(number(2, 4)));
    let physx = Settings { compat: Compat::Physx, ..Settings::with_particles(grains) };
    println!(
        "compat,parameters,grains,frame_s,iterations,settle_s,tip_deg,tip_sd_deg,cone_deg,creep_deg_per_s,rms_mm_s,\
         overlap_mean_percent,overlap_max_percent,refused"
    );
    match arguments.first().map(String::as_str) {
        Some("frames") => {
            for frame_s in [1.0 / 60.0, 0.004, 0.002, 0.001, 0.0005, 0.00025] {
                row(&[("friction", 0.5)], &Settings { frame_s, ..physx }, heaps);
            }
            for iterations in [4, 8, 32, 128] {
                row(&[("friction", 0.5)], &Settings { iterations, ..physx }, heaps);
            }
            for settle_max_s in [0.5, 2.0] {
                row(&[("friction", 0.5)], &Settings { settle_max_s, ..physx }, heaps);
            }
        }
        Some("angles") => {
            let physical = Settings { compat: Compat::Physical, ..physx };
            for friction in [0.2, 0.5, 0.8, 1.3] {
                row(&[("friction", friction)], &physx, heaps);
                row(&[("friction", friction)], &physical, heaps);
            }
            row(&[("friction", 0.5), ("cohesion", 1.2)], &physx, heaps);
            row(
                &[("friction", 0.5), ("adhesion", 1.3), ("particle_adhesion_scale", 1.3)],
                &physx,
                heaps,
            );
            row(
                &[("friction", 0.5), ("adhesion", 1.3), ("adhesion_offset_scale", 0.000_05)],
                &physx,
                heaps,
            );
            row(&[("friction", 0.5), ("gravity_scale", 0.3)], &physx, heaps);
            row(&[("friction", 0.5), ("damping", 1.0)], &physx, heaps);
        }
        _ => println!("say frames or angles"),
    }
}
