//! `flip bench sim`: every number about the simulator's speed in one run.

use super::Failure;
use super::clock::Spread;
use super::ours::{self, Size, Threads, Windows};
use super::peers::{Peers, Row};
use super::roofline::{Roofline, roofline};
use super::{Common, require_particles, text};
use flip_core::domain::FieldError;
use flip_sim::{self as sim, column};
use serde::Serialize;
use std::path::PathBuf;

/// Grain counts of the column on which other simulators run too.
const COMPARED: [u32; 2] = [2000, 10_000];
/// Maximum number of windows; more give no new information.
const WINDOWS_MAX: u32 = 100;

/// Arguments of `flip bench sim`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Also run other simulators: the folder of their scripts (benches/peers), or one whose data
    /// folder holds beds bed_N.csv.
    #[arg(long, value_name = "DIR")]
    peers: Option<PathBuf>,
    /// Windows per measurement; median, minimum and maximum are printed.
    #[arg(long, value_name = "N", default_value_t = 5, allow_negative_numbers = true)]
    windows: u32,
    /// Numbers of grains at which to measure the cost per grain.
    #[arg(long, value_name = "N,…", value_delimiter = ',', default_value = "2000,16000,64000")]
    sizes: Vec<u32>,
}

/// The document of `flip bench sim`. Times are processor time on one core unless named clock time.
#[derive(Debug, Serialize)]
pub(super) struct Document {
    pub simulator: &'static str,
    pub path: &'static str,
    pub substep_s: f64,
    pub windows: u32,
    pub scenes: Vec<Scene>,
    /// The simulators on those scenes, this one first.
    pub comparison: Vec<Row>,
    pub sizes: Vec<Size>,
    pub heap_core_s: Spread,
    pub weighing_step_core_s: Spread,
    pub threads: Threads,
    pub roofline: Roofline,
}

/// Results of this simulator for one of the compared columns.
#[derive(Debug, Serialize)]
pub(super) struct Scene {
    pub particles: usize,
    /// `own` or `given`.
    pub bed: &'static str,
    pub flowing_particle_substeps_per_core_s: Spread,
    pub resting_particle_substeps_per_core_s: Spread,
    /// Mean overlap of overlapping grains at rest, in diameters.
    pub resting_overlap_mean: f64,
}

/// Measures everything and prints it.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    if !(1..=WINDOWS_MAX).contains(&arguments.windows) {
        let message = format!("must be from 1 to {WINDOWS_MAX}, got {}", arguments.windows);
        return Err(FieldError::new("windows", message).into());
    }
    for &particles in &arguments.sizes {
        require_particles("sizes", particles)?;
    }
    let peers = Peers::new(arguments.peers.as_deref())?;
    let document = measure(&peers, arguments, common.seed)?;
    common.print(&document, || text::of(&document))
}

fn measure(peers: &Peers, arguments: &Arguments, seed: u64) -> Result<Document, Failure> {
    let windows = arguments.windows;
    let (mut scenes, mut comparison, mut columns) = (Vec::new(), Vec::new(), Vec::new());
    for particles in COMPARED {
        let (centres, bed) = peers.bed(particles)?;
        let (flowing, rows) = peers.compare(&centres, windows)?;
        let resting = Windows::resting(&centres).time(windows);
        let rate = |scene: &Windows| {
            Spread::of(
                &scene
                    .costs
                    .iter()
                    .map(|cost| centres.len() as f64 / cost / sim::law::SUBSTEP_S)
                    .collect::<Vec<_>>(),
            )
        };
        scenes.push(Scene {
            particles: centres.len(),
            bed,
            flowing_particle_substeps_per_core_s: rate(&flowing),
            resting_particle_substeps_per_core_s: rate(&resting),
            resting_overlap_mean: resting.overlap_mean(),
        });
        comparison.extend(rows);
        columns.push((format!("{particles} flowing"), flowing));
        columns.push((format!("{particles} at rest"), resting));
    }
    let columns: Vec<_> = columns.iter().map(|(name, windows)| (name.clone(), windows)).collect();
    Ok(Document {
        simulator: sim::VERSION,
        path: column::path(),
        substep_s: sim::law::SUBSTEP_S,
        windows,
        scenes,
        comparison,
        sizes: ours::sizes(&arguments.sizes, windows)?,
        heap_core_s: ours::heap(windows, seed),
        weighing_step_core_s: ours::weighing_step(windows, seed),
        threads: ours::threads(columns[0].1, windows)?,
        roofline: roofline(&columns, windows),
    })
}
