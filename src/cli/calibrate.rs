//! `flip calibrate`: parameter sets whose simulated heaps are as steep as the measured one.

use super::failure::Failure;
use super::session::with_app;
use super::table::table;
use super::watch::Watch;
use super::{Common, FIRST_PAGE};
use crate::app::{App, Calibration, CalibrationRequest};
use crate::domain::parameters::ParameterSet;
use futures::future::try_join_all;
use serde::Serialize;

/// Arguments of `flip calibrate`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Powder id, or `all` for every powder.
    #[arg(long, value_name = "ID")]
    powder: String,
    #[command(flatten)]
    search: Search,
}

/// How far a calibration looks.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct Search {
    /// Parameter sets to find for each powder, 1 to 50.
    #[arg(long, value_name = "N", default_value_t = 10, allow_negative_numbers = true)]
    sets: u32,
    /// Accepted difference between simulated and measured angle, degrees.
    #[arg(long, value_name = "DEG", default_value_t = 1.5, allow_negative_numbers = true)]
    tolerance_deg: f64,
    /// Grains in a simulated heap.
    #[arg(long, value_name = "N", default_value_t = 2000, allow_negative_numbers = true)]
    particles: u32,
    /// Most simulations of the search for each powder.
    #[arg(long, value_name = "N", default_value_t = 150, allow_negative_numbers = true)]
    trials_max: u32,
}

/// What is calibrated.
#[derive(Debug, Clone)]
pub(super) enum Target {
    /// A powder's newest measurement.
    Powder(String),
    /// A bare angle of repose, degrees.
    Angle(f64),
}

/// The document of `flip calibrate`.
#[derive(Debug, Serialize)]
struct Document {
    seed: u64,
    powders: Vec<Powder>,
}

#[derive(Debug, Serialize)]
struct Powder {
    powder: String,
    /// The measured angle that the sets reproduce, degrees.
    target_deg: f64,
    /// Simulations of the search.
    evaluations: u32,
    /// Simulations with fresh seeds that checked candidates.
    verification_runs: u32,
    sets: Vec<Set>,
    mean_error_deg: f64,
    sd_error_deg: Option<f64>,
}

#[derive(Debug, Serialize)]
struct Set {
    id: String,
    parameters: ParameterSet,
    /// Mean over `runs` heaps, degrees.
    repose_deg: f64,
    repose_sd_deg: Option<f64>,
    runs: u32,
    error_deg: f64,
}

/// Calibrate one powder or all, side by side, and print the sets.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let done = with_app(common, async |app| {
        let targets = targets(app, &arguments.powder).await?;
        calibrate(app, &Watch::new(), &targets, Some(&arguments.search), common.seed).await
    })?;
    let powders = done.into_iter().map(powder).collect::<Result<_, _>>()?;
    let document = Document { seed: common.seed, powders };
    common.print(&document, || text(&document))
}

/// Calibrate every target as a job (or find the job that did), and wait for all of them; results in the targets' order.
pub(super) async fn calibrate(
    app: &App,
    watch: &Watch,
    targets: &[Target],
    search: Option<&Search>,
    seed: u64,
) -> Result<Vec<Calibration>, Failure> {
    let mut jobs = Vec::new();
    for target in targets {
        let (job, _) = app.start_calibration(request(target, search, seed)).await?;
        jobs.push((job.id, format!("calibrate {target}")));
    }
    try_join_all(jobs.iter().map(async |(id, label)| {
        watch.job(app, id, label).await?;
        Ok(app.calibration(id).await?)
    }))
    .await
}

fn request(target: &Target, search: Option<&Search>, seed: u64) -> CalibrationRequest {
    let (powder, repose_deg) = match target {
        Target::Powder(powder) => (Some(powder.clone()), None),
        Target::Angle(angle) => (None, Some(*angle)),
    };
    CalibrationRequest {
        powder,
        repose_deg,
        sets: search.map(|s| s.sets),
        tolerance_deg: search.map(|s| s.tolerance_deg),
        particles: search.map(|s| s.particles),
        trials_max: search.map(|s| s.trials_max),
        seed: Some(seed),
    }
}

async fn targets(app: &App, powder: &str) -> Result<Vec<Target>, Failure> {
    if powder != "all" {
        return Ok(vec![Target::Powder(powder.to_owned())]);
    }
    let powders = app.powders(FIRST_PAGE).await?;
    Ok(powders.items.into_iter().map(|powder| Target::Powder(powder.id)).collect())
}

fn powder(calibration: Calibration) -> Result<Powder, Failure> {
    let result =
        calibration.result.ok_or_else(|| anyhow::anyhow!("calibration {} has no result", calibration.job.id))?;
    let set = |set: crate::app::CalibrationSet| Set {
        id: set.id,
        parameters: set.parameters,
        repose_deg: set.repose_deg,
        repose_sd_deg: set.repose_sd_deg,
        runs: set.runs,
        error_deg: set.error_deg,
    };
    Ok(Powder {
        powder: calibration.powder.unwrap_or_default(),
        target_deg: calibration.target.repose_deg,
        evaluations: result.evaluations,
        verification_runs: result.verification_runs,
        sets: result.sets.into_iter().map(set).collect(),
        mean_error_deg: result.mean_error_deg,
        sd_error_deg: result.sd_error_deg,
    })
}

fn text(document: &Document) -> String {
    let row = |p: &Powder| {
        vec![
            p.powder.clone(),
            format!("{:.2}", p.target_deg),
            p.sets.len().to_string(),
            format!("{:.2}", p.mean_error_deg),
            p.sd_error_deg.map_or("-".to_owned(), |sd| format!("{sd:.2}")),
            p.evaluations.to_string(),
            p.verification_runs.to_string(),
        ]
    };
    let header = ["powder", "AoR deg", "sets", "mean error deg", "sd deg", "trials", "verification runs"];
    table(&header, &document.powders.iter().map(row).collect::<Vec<_>>())
}

impl std::fmt::Display for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Powder(powder) => f.write_str(powder),
            Self::Angle(angle) => write!(f, "{angle} deg"),
        }
    }
}
