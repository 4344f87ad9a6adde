//! The document of `flip bench sim` as tables.

use super::super::table::table;
use super::clock::Spread;
use super::ours::Size;
use super::peers::Row;
use super::roofline::{Roofline, Scene as Placed};
use super::sim::{Document, Scene};

/// `median (min to max)` with this many decimals.
fn spread(s: Spread, decimals: usize) -> String {
    format!("{:.decimals$} ({:.decimals$} to {:.decimals$})", s.median, s.min, s.max)
}

fn percent(share: f64, decimals: usize) -> String {
    format!("{:.decimals$} %", 100.0 * share)
}

/// All tables, medians with minimum and maximum over the windows.
pub(super) fn of(d: &Document) -> String {
    [
        format!(
            "{} on one core's {} path, substep {} us; {} windows: median (least to most)",
            d.simulator,
            d.path,
            d.substep_s * 1e6,
            d.windows
        ),
        format!(
            "A settled column released on a plane, 4 to {} ms after\n{}",
            4 + 2 * d.windows,
            comparison(&d.comparison)
        ),
        format!(
            "The same columns here, million particle-substeps per core-second\n{}",
            scenes(&d.scenes)
        ),
        format!("Cost by size, ns per particle-substep, own beds\n{}", sizes(&d.sizes)),
        format!(
            "heap of 2000 grains   {} core-s\nstep of a weighing    {} core-s\n\
             {} simulations         {} s on 1 thread, {} s on {}: {:.2} times as fast",
            spread(d.heap_core_s, 3),
            spread(d.weighing_step_core_s, 4),
            d.threads.simulations,
            spread(d.threads.one_thread_s, 3),
            spread(d.threads.all_threads_s, 3),
            d.threads.threads,
            d.threads.speed_up
        ),
        roofline(&d.roofline),
    ]
    .join("\n\n")
}

fn comparison(rows: &[Row]) -> String {
    let cells = |row: &Row| match row {
        Row::Measured { report: r, ratio } => vec![
            r.peer.clone(),
            r.particles.to_string(),
            format!("{:.0}", r.dt_s * 1e6),
            r.iterations.to_string(),
            percent(r.overlap_mean, 3),
            spread(r.core_s_per_sim_s, 2),
            format!("{ratio:.1}"),
            format!("{:.2}", r.particle_steps_per_core_s * 1e-6),
            r.rss_mb.map_or("-".to_owned(), |mb| format!("{mb:.0}")),
        ],
        Row::NotMeasured { peer, particles, .. } => {
            let mut cells = vec![String::new(); 9];
            cells[0].clone_from(peer);
            cells[1] = particles.to_string();
            cells[5] = "not measured".to_owned();
            cells
        }
    };
    let header = [
        "simulator",
        "N",
        "dt us",
        "iterations",
        "overlap",
        "core-s per sim-s",
        "ratio",
        "M steps/core-s",
        "MiB",
    ];
    let reasons = rows.iter().filter_map(|row| match row {
        Row::NotMeasured { peer, particles, not_measured } => {
            Some(format!("\nnot measured: {peer} on {particles} grains: {not_measured}"))
        }
        Row::Measured { .. } => None,
    });
    table(&header, &rows.iter().map(cells).collect::<Vec<_>>()) + &reasons.collect::<String>()
}

fn scenes(scenes: &[Scene]) -> String {
    let row = |s: &Scene| {
        vec![
            s.particles.to_string(),
            s.bed.to_owned(),
            spread(s.flowing_particle_substeps_per_core_s.scaled(1e-6), 1),
            spread(s.resting_particle_substeps_per_core_s.scaled(1e-6), 1),
            percent(s.resting_overlap_mean, 3),
        ]
    };
    let header = ["N", "bed", "flowing", "at rest", "overlap at rest"];
    table(&header, &scenes.iter().map(row).collect::<Vec<_>>())
}

fn sizes(sizes: &[Size]) -> String {
    let row = |s: &Size| {
        vec![
            s.particles.to_string(),
            spread(s.flowing_ns, 1),
            spread(s.resting_ns, 1),
            format!("{:.2}", s.ratio),
            format!("{:.2}", s.resting_rms_mm_s),
            format!("{:.3}", s.lists_per_substep),
            spread(s.list_ns, 0),
            percent(s.list_share, 0),
            format!("{:.0}", s.bytes_per_particle),
        ]
    };
    let header = [
        "N",
        "flowing",
        "at rest",
        "ratio flowing",
        "rms at rest mm/s",
        "lists/substep",
        "one list",
        "in lists",
        "bytes/grain",
    ];
    table(&header, &sizes.iter().map(row).collect::<Vec<_>>())
}

fn roofline(r: &Roofline) -> String {
    let reads =
        r.bandwidths.iter().map(|b| format!("{} GB/s from {}", spread(b.gb_s, 1), b.buffer));
    let row = |s: &Placed| {
        vec![
            s.scene.clone(),
            format!("{:.0}", s.flops),
            format!("{:.1}", s.slow_flops),
            format!("{:.0}", s.streamed_bytes),
            format!("{:.0}", s.gathered_bytes),
            format!("{:.2}", s.gflop_s),
            format!("{:.1}", s.gb_s),
            format!("{:.2}", s.bytes as f64 / f64::from(1 << 20)),
            format!("{:.1}", s.bandwidth_gb_s),
            format!("{:.1}", s.roof_gflop_s),
            percent(s.share_of_peak, 1),
            percent(s.share_of_roof, 1),
        ]
    };
    let header = [
        "scene",
        "flops",
        "div, sqrt",
        "streamed B",
        "gathered B",
        "Gflop/s",
        "GB/s",
        "holds MiB",
        "read GB/s",
        "roof",
        "of peak",
        "of roof",
    ];
    format!(
        "Roofline: {} Gflop/s multiply and add unfused; reads {}\nflops and bytes are for one particle-substep, idle lanes \
         included\n{}",
        spread(r.peak_gflop_s, 1),
        reads.collect::<Vec<_>>().join(", "),
        table(&header, &r.scenes.iter().map(row).collect::<Vec<_>>())
    )
}
