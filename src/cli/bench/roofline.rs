//! The kernel compared with the machine's two limits: arithmetic and memory (roofline model,
//! Williams et al. 2009).

use super::clock::{Spread, core_s};
use super::ours::Windows;
use flip_sim::column;
use flip_sim::law::SUBSTEP_S;
use serde::Serialize;

/// Buffer sizes for the bandwidth measurements, bytes: within a core's first- and second-level
/// cache, and beyond most caches.
const BUFFERS: [(&str, usize); 3] =
    [("16 KiB", 16 << 10), ("512 KiB", 512 << 10), ("512 MiB", 512 << 20)];
/// Bytes to read for one bandwidth measurement.
const READ: usize = 2 << 30;
/// Rounds for the arithmetic peak.
const ROUNDS: u32 = 20_000_000;

/// The machine's limits on one core, and the kernel compared with them.
#[derive(Debug, Serialize)]
pub(super) struct Roofline {
    /// Unfused multiply and add, in registers, 10^9 operations per second.
    pub peak_gflop_s: Spread,
    pub bandwidths: Vec<Bandwidth>,
    pub scenes: Vec<Scene>,
}

/// Sequential reading.
#[derive(Debug, Serialize)]
pub(super) struct Bandwidth {
    pub buffer: String,
    pub gb_s: Spread,
}

/// The kernel on one scene.
#[derive(Debug, Serialize)]
pub(super) struct Scene {
    pub scene: String,
    /// Memory size of the scene, bytes.
    pub bytes: usize,
    /// Per substep of one grain, counted as executed, including rebuilds of the neighbour list.
    pub flops: f64,
    /// Divisions and square roots among them.
    pub slow_flops: f64,
    pub streamed_bytes: f64,
    pub gathered_bytes: f64,
    /// Rate reached by the kernel, 10^9 operations per second.
    pub gflop_s: f64,
    /// Data streamed and gathered by the kernel, 10^9 bytes per second.
    pub gb_s: f64,
    /// Bandwidth of reading sequentially as many bytes as the scene holds, 10^9 bytes per second.
    pub bandwidth_gb_s: f64,
    /// The lower of the arithmetic peak and flops / streamed_bytes * bandwidth.
    pub roof_gflop_s: f64,
    pub share_of_peak: f64,
    pub share_of_roof: f64,
}

/// Measures the limits, and compares the scenes with them.
pub(super) fn roofline(scenes: &[(String, &Windows)], windows: u32) -> Roofline {
    let peak = Spread::over(windows, |_| {
        let (spent, flops) = core_s(|| column::multiply_add(ROUNDS));
        flops as f64 / spent * 1e-9
    });
    let bandwidths = BUFFERS.map(|(name, bytes)| Bandwidth {
        buffer: name.to_owned(),
        gb_s: bandwidth(bytes, windows),
    });
    let scenes =
        scenes.iter().map(|(name, scene)| place(name, scene, peak.median, windows)).collect();
    Roofline { peak_gflop_s: peak, bandwidths: bandwidths.into(), scenes }
}

fn bandwidth(bytes: usize, windows: u32) -> Spread {
    let numbers = vec![[1.0f32; 16]; (bytes / size_of::<[f32; 16]>()).next_multiple_of(4)];
    let passes = (READ / bytes).max(1) as u32;
    column::read(&numbers, 1);
    Spread::over(windows, |_| {
        let (spent, read) = core_s(|| column::read(&numbers, passes));
        read as f64 / spent * 1e-9
    })
}

fn place(name: &str, windows: &Windows, peak: f64, repeats: u32) -> Scene {
    let bytes = windows.column().bytes();
    let (work, particle_substeps) = windows.count();
    let each = |total: u64| total as f64 / particle_substeps;
    let (flops, streamed, gathered) =
        (each(work.flops), each(work.streamed_bytes), each(work.gathered_bytes));
    // The windows differ in how often they build the list; the count is over all windows, so the
    // time must be too.
    let mean_cost = windows.costs.iter().sum::<f64>() / windows.costs.len() as f64;
    let rate = windows.column().particles() as f64 / SUBSTEP_S / mean_cost * 1e-9;
    let bandwidth = bandwidth(bytes, repeats).median;
    let roof = peak.min(flops / streamed * bandwidth);
    Scene {
        scene: name.to_owned(),
        bytes,
        flops,
        slow_flops: each(work.slow_flops),
        streamed_bytes: streamed,
        gathered_bytes: gathered,
        gflop_s: flops * rate,
        gb_s: (streamed + gathered) * rate,
        bandwidth_gb_s: bandwidth,
        roof_gflop_s: roof,
        share_of_peak: flops * rate / peak,
        share_of_roof: flops * rate / roof,
    }
}
