//! `flip heap`: the heap experiment, repeated over seeds in parallel.

use super::failure::Failure;
use super::{Common, parameters, view};
use clap::ValueEnum;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_core::domain::{FieldError, bounded};
use flip_sim as sim;
use flip_sim::repose::{Compat, Refusal, Repose, Settings};
use flip_sim::snapshot::Camera;
use rayon::prelude::*;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

/// Maximum number of repeats; more give no new information, and a typo should not run for a day.
const REPEATS_MAX: u32 = 1000;
/// Allowed number of grains in a heap: fewer do not cover the base, more take hours.
const PARTICLES: std::ops::RangeInclusive<u32> = 200..=20_000;

/// Allowed number of readings per heap: more would cost more than another heap.
const READINGS: std::ops::RangeInclusive<u32> = 1..=64;

/// The simulator's semantics, as typed.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum CompatFlag {
    /// FLIP's own: heaps come to rest, every parameter acts.
    Physical,
    /// Those of the published engine: heaps creep, cohesion and mass have no effect.
    Physx,
}

/// Arguments of `flip heap`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Grains to pour, 200 to 20000; a heap that does not cover its base is refused.
    #[arg(long, value_name = "N", default_value_t = 2000, allow_negative_numbers = true)]
    particles: u32,
    /// Heaps to pour, each with its own seed.
    #[arg(long, value_name = "N", default_value_t = 1, allow_negative_numbers = true)]
    repeats: u32,
    /// Readings per heap, 1 to 64, with 15 % more grains poured between readings.
    #[arg(long, value_name = "N", default_value_t = 1, allow_negative_numbers = true)]
    readings: u32,
    /// Mechanisms missing from the base simulator, with their amplitudes, as in
    /// `rotation=1,rolling_friction=0.5`.
    #[arg(long, value_name = "NAME=AMPLITUDE,…", value_delimiter = ',')]
    extension: Vec<String>,
    /// Cover the base with a layer of fixed grains.
    #[arg(long)]
    rough_base: bool,
    /// Coulomb friction coefficient of the base, 0 to 2.
    #[arg(long, value_name = "MU", default_value_t = 0.8, allow_negative_numbers = true)]
    base_friction: f64,
    /// Height of the opening above the heap's apex, grain diameters, 1 to 20
    #[arg(long, value_name = "D", default_value_t = Settings::default().funnel_clearance_diameters)]
    funnel_clearance: f64,
    /// Write an SVG picture of the first heap with the fitted cone and the apex triangle.
    #[arg(long, value_name = "FILE")]
    view: Option<PathBuf>,
    /// Write the grains of the first heap, one snapshot per 1/50 s, in the format of
    /// `sim::snapshot`.
    #[arg(long, value_name = "FILE")]
    snapshots: Option<PathBuf>,
    /// Semantics of the simulator.
    #[arg(long, value_enum, default_value_t = CompatFlag::Physical)]
    compat: CompatFlag,
    #[command(flatten)]
    parameters: parameters::Flags,
}

/// The document of `flip heap`: it contains no times and no thread count, so equal inputs give
/// equal bytes.
#[derive(Debug, Serialize)]
struct Document {
    /// Mean over the heaps of atan(2 h / d_base), degrees.
    repose_deg: f64,
    /// Mean slope of the cone fitted between 20 % and 80 % of the height, degrees.
    cone_deg: f64,
    /// Standard deviation of `repose_deg` over the heaps; absent with fewer than two.
    #[serde(skip_serializing_if = "Option::is_none")]
    repose_sd_deg: Option<f64>,
    particles: u32,
    /// Mean change of the cone angle over the last 0.2 s.
    creep_deg_per_s: f64,
    parameters: ParameterSet,
    settings: Settings,
    seed: u64,
    repeats: u32,
    simulator: &'static str,
    heaps: Vec<Repose>,
    /// Heaps without an angle, and why; the means above exclude them.
    refusals: Vec<String>,
}

/// Pours `--repeats` heaps and prints their measurements.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let set = arguments.parameters.set()?;
    if !(1..=REPEATS_MAX).contains(&arguments.repeats) {
        let message = format!("must be from 1 to {REPEATS_MAX} heaps, got {}", arguments.repeats);
        return Err(FieldError::new("repeats", message).into());
    }
    if !PARTICLES.contains(&arguments.particles) {
        let message = format!(
            "must be from {} to {} grains, got {}",
            PARTICLES.start(),
            PARTICLES.end(),
            arguments.particles
        );
        return Err(FieldError::new("particles", message).into());
    }
    if !READINGS.contains(&arguments.readings) {
        let message = format!(
            "must be from {} to {}, got {}",
            READINGS.start(),
            READINGS.end(),
            arguments.readings
        );
        return Err(FieldError::new("readings", message).into());
    }
    let compat = match arguments.compat {
        CompatFlag::Physical => Compat::Physical,
        CompatFlag::Physx => Compat::Physx,
    };
    let settings = Settings {
        base_friction: bounded("base_friction", arguments.base_friction, 0.0, 2.0, "")?,
        funnel_clearance_diameters: bounded(
            "funnel_clearance",
            arguments.funnel_clearance,
            1.0,
            20.0,
            "d",
        )?,
        readings: arguments.readings,
        rough_base: arguments.rough_base,
        extensions: parameters::extensions(&arguments.extension)?,
        compat,
        ..Settings::with_particles(arguments.particles)
    };
    if compat == Compat::Physx && (settings.rough_base || !settings.extensions.is_none()) {
        let message =
            "the published engine has no extensions and no rough base; leave out --compat or them";
        return Err(FieldError::new("compat", message).into());
    }
    if arguments.view.is_some() || arguments.snapshots.is_some() {
        picture(&set, &settings, common.seed, arguments)?;
    }
    let outcomes = pour(&set, &settings, common.seed, arguments.repeats);
    let document = summarise(set, settings, common.seed, outcomes)?;
    common.print(&document, || text(&document))
}

/// Pours the first heap and writes the requested files.
fn picture(
    set: &ParameterSet,
    settings: &Settings,
    seed: u64,
    arguments: &Arguments,
) -> Result<(), Failure> {
    let frames = Arc::new(Mutex::new(Vec::new()));
    let kept = Arc::clone(&frames);
    let camera = arguments.snapshots.is_some().then(|| Camera {
        every_s: 0.02,
        see: Arc::new(move |snapshot| {
            if let Ok(mut frames) = kept.lock() {
                frames.extend(snapshot.to_bytes());
            }
        }),
    });
    let pile = sim::repose::pile(set, settings, derive(seed, &[0]), camera)
        .map_err(|r| anyhow::anyhow!("{r}"))?;
    if let Some(file) = &arguments.view {
        std::fs::write(file, view::svg(&pile, settings, set.particle_diameter_mm()))?;
    }
    if let (Some(file), Ok(frames)) = (&arguments.snapshots, frames.lock()) {
        std::fs::write(file, &*frames)?;
    }
    Ok(())
}

/// Pours one heap per repeat; `collect` keeps their order, so the number of threads does not affect
/// the result.
fn pour(
    set: &ParameterSet,
    settings: &Settings,
    seed: u64,
    repeats: u32,
) -> Vec<Result<Repose, Refusal>> {
    (0..repeats)
        .into_par_iter()
        .map(|repeat| sim::repose::repose(set, settings, derive(seed, &[u64::from(repeat)])))
        .collect()
}

fn summarise(
    parameters: ParameterSet,
    settings: Settings,
    seed: u64,
    outcomes: Vec<Result<Repose, Refusal>>,
) -> Result<Document, Failure> {
    let repeats = outcomes.len() as u32;
    let (mut heaps, mut refusals) = (Vec::new(), Vec::new());
    for outcome in outcomes {
        match outcome {
            Ok(heap) => heaps.push(heap),
            Err(refusal) => refusals.push(refusal.to_string()),
        }
    }
    if heaps.is_empty() {
        return Err(Failure::Failed(anyhow::anyhow!(
            "no heap has an angle of repose: {}",
            refusals.join("; ")
        )));
    }
    let mean = |of: fn(&Repose) -> f64| heaps.iter().map(of).sum::<f64>() / heaps.len() as f64;
    let repose_deg = mean(|heap| heap.tip_deg);
    let squares: f64 = heaps.iter().map(|heap| (heap.tip_deg - repose_deg).powi(2)).sum();
    Ok(Document {
        repose_deg,
        cone_deg: mean(|heap| heap.cone_deg),
        repose_sd_deg: (heaps.len() > 1).then(|| (squares / (heaps.len() - 1) as f64).sqrt()),
        particles: settings.particles,
        creep_deg_per_s: mean(|heap| heap.creep_deg_per_s),
        parameters,
        settings,
        seed,
        repeats,
        simulator: sim::VERSION,
        heaps,
        refusals,
    })
}

fn text(d: &Document) -> String {
    let spread = d.repose_sd_deg.map_or(String::new(), |sd| format!(" +- {sd:.2}"));
    let mut text = format!(
        "angle of repose  {:.2}{spread} deg (tip)\ncone fit         {:.2} deg\ncreep            {:.3} deg/s\n\
         particles        {}\nheaps            {} of {}",
        d.repose_deg,
        d.cone_deg,
        d.creep_deg_per_s,
        d.particles,
        d.heaps.len(),
        d.repeats
    );
    if d.settings.compat == Compat::Physx {
        text.push_str("\ncompat           physx: the published engine's semantics, not FLIP's");
    }
    for refusal in &d.refusals {
        text.push_str(&format!("\nrefused          {refusal}"));
    }
    text
}
