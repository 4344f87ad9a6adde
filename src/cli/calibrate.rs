//! `flip calibrate`: parameter sets whose simulated heaps have the measured angle of repose.

use super::device::DeviceArguments;
use super::failure::Failure;
use super::lab::Lab;
use super::labels::LabelArguments;
use super::session::with_app;
use super::shakes::Bench;
use super::simulator::{SimulatorArguments, words};
use super::table::table;
use super::watch::Watch;
use super::{Common, observe, parameters};
use crate::app::{
    Calibration, CalibrationMethod, CalibrationRequest, EmulatorUse, Marginal, Observed,
    PAPER_LEVELS_DEG, Pair, Posterior, StoredShakes,
};
use clap::ValueEnum;
use flip_core::domain::FieldError;
use flip_core::domain::conditions::Under;
use flip_core::domain::observable::Observation;
use flip_core::domain::parameters::ParameterSet;
use futures::future::try_join_all;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write;

/// Number of sets per level of a data set.
const DATA_SET_SETS: u32 = 7;
/// Grains per verification heap, relative to the heaps of the search.
const DATA_SET_LARGER: u32 = 2;

/// Arguments of `flip calibrate`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Powder id, or `all` for every powder.
    #[arg(long, value_name = "ID", required_unless_present_any = ["repose_deg", "data_set"], conflicts_with_all = ["repose_deg", "data_set"])]
    powder: Option<String>,
    /// Target angle of repose instead of a powder's, degrees; several, comma-separated, make a data
    /// set of flowabilities.
    #[arg(long, value_name = "DEG", value_delimiter = ',', allow_negative_numbers = true)]
    repose_deg: Vec<f64>,
    /// Standard deviation of the repeats behind `--repose-deg`, degrees; if omitted, the angle is
    /// taken as exact.
    #[arg(long, value_name = "DEG", requires = "repose_deg", allow_negative_numbers = true)]
    sd_deg: Option<f64>,
    /// Number of repeats behind `--repose-deg`.
    #[arg(long, value_name = "N", requires = "repose_deg", allow_negative_numbers = true)]
    n: Option<u32>,
    /// Make a data set of flowabilities for training: 28, 33 and 37 deg (or those of
    /// `--repose-deg`), 7 sets each, verified with heaps of twice the grains.
    #[arg(long)]
    data_set: bool,
    /// Other measurement: an experiment as in `flip observe` plus `mean`, `sd` and `n`, for example
    /// `flow_time:mass_g=50,orifice_mm=2.54,mean=62,sd=2,n=5`; may be repeated [default: those
    /// registered for the powder].
    #[arg(long, value_name = "KIND:SETTING=VALUE,...")]
    observation: Vec<String>,
    /// Use the powder's stored shakes in place of other measurements: angle and spoon are met
    /// together, and gravity is held at 1 unless `--fix` says otherwise.
    #[arg(long, requires = "powder", conflicts_with = "observation")]
    shakes: bool,
    /// Use only stored shakes of this lot.
    #[arg(long, requires = "shakes")]
    lot: Option<String>,
    /// Use only stored shakes of weighings on this kind of bench, and imported ones.
    #[arg(long, value_enum, requires = "shakes")]
    shaken_on: Option<Bench>,
    /// Parameters to hold at a value instead of searching them, as in `gravity_scale=1`
    /// [default: all nine are searched].
    #[arg(long, value_name = "NAME=VALUE,…", value_delimiter = ',')]
    fix: Vec<String>,
    #[command(flatten)]
    device: DeviceArguments,
    #[command(flatten)]
    labels: LabelArguments,
    #[command(flatten)]
    extended: SimulatorArguments,
    #[command(flatten)]
    search: Search,
}

/// How to search for sets, as typed.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(super) enum MethodFlag {
    /// Read off one emulator of the angle, shared by all calibrations, then verified.
    Emulator,
    /// Algorithm 1 of the publication.
    Paper,
    /// Bayesian optimisation of the angle for this powder alone.
    Sequential,
}

/// Extent of a calibration's search. Omitted options take the method's defaults.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct Search {
    /// How to search for sets [default: `emulator` for `flip calibrate`, `sequential` for
    /// `flip demo`].
    #[arg(long, value_enum)]
    method: Option<MethodFlag>,
    /// Parameter sets to find per powder, 1 to 100 [default: 10, for a data set 7].
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    sets: Option<u32>,
    /// Accepted difference between simulated and measured angle, degrees [default: 0.5, with the
    /// other methods 1.5].
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    tolerance_deg: Option<f64>,
    /// Grains per simulated heap.
    #[arg(long, value_name = "N", default_value_t = 2000, allow_negative_numbers = true)]
    particles: u32,
    /// Maximum simulations per powder [default: three times what verifying all sets takes, with the
    /// other methods 150].
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    trials_max: Option<u32>,
    /// Heaps simulated to verify each set [default: 8, with the method `sequential` 2].
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    verify_repeats: Option<u32>,
    /// Grains per verification heap, if different from the search [default for a data set: twice as
    /// many]. Not with the method `sequential`.
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    verify_particles: Option<u32>,
    /// Readings per verification heap [default: 4, with the method `sequential` 1].
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    readings: Option<u32>,
}

impl Search {
    /// Uses this method unless another was given.
    pub(super) fn by(self, method: MethodFlag) -> Self {
        Self { method: self.method.or(Some(method)), ..self }
    }
}

/// Target of a calibration.
#[derive(Debug, Clone)]
pub(super) enum Target {
    /// A powder's newest measurement.
    Powder(String),
    /// A bare angle of repose, degrees, with the SD and number of the repeats behind it.
    Angle(f64, Option<f64>, Option<u32>),
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
    method: CalibrationMethod,
    /// The measured angle that the sets reproduce, degrees; under an extended simulator version,
    /// the angle under its reference conditions.
    target_deg: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    under: Option<Under>,
    /// Parameters held at a value instead of searched.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    fixed: BTreeMap<String, f64>,
    /// Whether as many sets were found as requested; if not, the next two fields explain why.
    reached: bool,
    /// The parameter whose bound prevents it.
    limiting_parameter: Option<String>,
    /// The nearest simulated angle, degrees.
    nearest_repose_deg: Option<f64>,
    /// Simulations of the search.
    evaluations: u32,
    /// Simulations with fresh seeds that checked candidates.
    verification_runs: u32,
    sets: Vec<Set>,
    mean_error_deg: Option<f64>,
    sd_error_deg: Option<f64>,
    /// Mean over the sets of |mean over fresh seeds - target|, degrees.
    verified_error_deg: Option<f64>,
    /// SD of that over the sets, degrees.
    verified_sd_deg: Option<f64>,
    /// Mean standard error of a set's mean over fresh seeds, degrees.
    standard_error_deg: Option<f64>,
    /// Grains per verification heap, if their number differs from the search's.
    verify_particles: Option<u32>,
    /// Angle of these heaps minus that of the search's, degrees.
    size_shift_deg: Option<f64>,
    emulator: Option<EmulatorUse>,
    /// Comparison of the sets with all other measurements.
    observed: Vec<Observed>,
    /// Posterior knowledge of each parameter; absent with a method that has no posterior.
    posterior: Option<Known>,
}

/// A posterior without its draws.
#[derive(Debug, Serialize)]
struct Known {
    parameters: Vec<Marginal>,
    together: Vec<Pair>,
    effective: f64,
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
    verified_error_deg: Option<f64>,
}

/// Calibrates one powder or all, side by side, and prints the sets.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let mut search = arguments.search.clone().by(MethodFlag::Emulator);
    if arguments.data_set {
        search.sets = search.sets.or(Some(DATA_SET_SETS));
        search.verify_particles =
            search.verify_particles.or(Some(search.particles.saturating_mul(DATA_SET_LARGER)));
    }
    let typed: Vec<Observation> = arguments
        .observation
        .iter()
        .map(|text| observe::observation(text))
        .collect::<Result<_, _>>()?;
    let conditions = arguments.extended.conditions()?;
    let fixed = parameters::fixed(&arguments.fix)?;
    let labels = arguments.labels.all()?;
    let observations = (!typed.is_empty()).then_some(typed);
    let shakes = arguments.shakes.then(|| StoredShakes {
        powder: None,
        lot: arguments.lot.clone(),
        bench: arguments.shaken_on.map(Bench::kind),
    });
    let done = with_app(common, async |lab| {
        let targets = targets(lab, arguments).await?;
        if observations.is_some() && targets.len() > 1 {
            return Err(FieldError::new(
                "observation",
                "belongs to one powder: name it with --powder or --repose-deg",
            )
            .into());
        }
        let requests = targets.into_iter().map(|target| {
            let request = request(&target, Some(&search), common.seed);
            let request = CalibrationRequest {
                observations: observations.clone(),
                shakes: shakes.clone(),
                fixed: fixed.clone(),
                simulator: arguments.extended.simulator.clone(),
                conditions: conditions.clone(),
                device: arguments.device.device(),
                labels: labels.clone(),
                ..request
            };
            (target, request)
        });
        let mut done = Vec::new();
        for calibration in calibrate_each(lab, &Watch::new(), requests.collect()).await? {
            let has = calibration.result.as_ref().is_some_and(|result| result.posterior.is_some());
            let posterior =
                if has { Some(lab.posterior(&calibration.job.id).await?) } else { None };
            done.push((calibration, posterior));
        }
        Ok(done)
    })?;
    let powders =
        done.into_iter().map(|(it, posterior)| powder(it, posterior)).collect::<Result<_, _>>()?;
    let document = Document { seed: common.seed, powders };
    common.print(&document, || text(&document))
}

/// Calibrates every target as a job (or finds the existing job), and waits for all of them; results
/// in the order of the targets.
pub(super) async fn calibrate(
    lab: &Lab,
    watch: &Watch,
    targets: &[Target],
    search: Option<&Search>,
    simulator: Option<&str>,
    seed: u64,
) -> Result<Vec<Calibration>, Failure> {
    let requests = targets.iter().map(|target| {
        let simulator = simulator.map(str::to_owned);
        (target.clone(), CalibrationRequest { simulator, ..request(target, search, seed) })
    });
    calibrate_each(lab, watch, requests.collect()).await
}

async fn calibrate_each(
    lab: &Lab,
    watch: &Watch,
    requests: Vec<(Target, CalibrationRequest)>,
) -> Result<Vec<Calibration>, Failure> {
    let mut jobs = Vec::new();
    for (target, request) in requests {
        let (job, _) = lab.start_calibration(request).await?;
        jobs.push((job.id, format!("calibrate {target}")));
    }
    try_join_all(jobs.iter().map(async |(id, label)| {
        watch.job(lab, id, label).await?;
        Ok(lab.calibration(id).await?)
    }))
    .await
}

fn request(target: &Target, search: Option<&Search>, seed: u64) -> CalibrationRequest {
    let bare = match target {
        Target::Powder(powder) => {
            CalibrationRequest { powder: Some(powder.clone()), ..Default::default() }
        }
        Target::Angle(angle, sd_deg, n) => CalibrationRequest {
            repose_deg: Some(*angle),
            sd_deg: *sd_deg,
            n: *n,
            ..Default::default()
        },
    };
    CalibrationRequest {
        // Calibrations made as a prerequisite need sets, not the angle to a tenth of a degree.
        method: Some(match search.and_then(|s| s.method).unwrap_or(MethodFlag::Sequential) {
            MethodFlag::Emulator => CalibrationMethod::Emulator,
            MethodFlag::Paper => CalibrationMethod::Paper,
            MethodFlag::Sequential => CalibrationMethod::Sequential,
        }),
        sets: search.and_then(|s| s.sets),
        tolerance_deg: search.and_then(|s| s.tolerance_deg),
        particles: search.map(|s| s.particles),
        trials_max: search.and_then(|s| s.trials_max),
        verify_repeats: search.and_then(|s| s.verify_repeats),
        verify_particles: search.and_then(|s| s.verify_particles),
        readings: search.and_then(|s| s.readings),
        seed: Some(seed),
        ..bare
    }
}

async fn targets(lab: &Lab, arguments: &Arguments) -> Result<Vec<Target>, Failure> {
    let Arguments { powder, repose_deg, sd_deg, n, .. } = arguments;
    let levels =
        || PAPER_LEVELS_DEG.iter().map(|angle| Target::Angle(*angle, *sd_deg, *n)).collect();
    match powder.as_deref() {
        None if repose_deg.is_empty() => Ok(levels()),
        None => Ok(repose_deg.iter().map(|angle| Target::Angle(*angle, *sd_deg, *n)).collect()),
        Some("all") => {
            let powders = lab.powders().await?;
            Ok(powders.into_iter().map(|powder| Target::Powder(powder.id)).collect())
        }
        Some(powder) => Ok(vec![Target::Powder(powder.to_owned())]),
    }
}

fn powder(calibration: Calibration, posterior: Option<Posterior>) -> Result<Powder, Failure> {
    let result = calibration
        .result
        .ok_or_else(|| anyhow::anyhow!("calibration {} has no result", calibration.job.id))?;
    let set = |set: crate::app::CalibrationSet| Set {
        id: set.id,
        parameters: set.parameters,
        repose_deg: set.repose_deg,
        repose_sd_deg: set.repose_sd_deg,
        runs: set.runs,
        error_deg: set.error_deg,
        verified_error_deg: set.verified_error_deg,
    };
    let errors: Vec<f64> = result.sets.iter().filter_map(|set| set.verified_error_deg).collect();
    let standard =
        result.sets.iter().filter_map(|set| Some(set.repose_sd_deg? / f64::from(set.runs).sqrt()));
    let standard: Vec<f64> = standard.collect();
    let method = calibration.settings.get("method").cloned().unwrap_or_default();
    let fixed = calibration.settings.get("fixed").cloned();
    let fixed = fixed.map_or_else(|| Ok(BTreeMap::new()), serde_json::from_value);
    Ok(Powder {
        fixed: fixed.map_err(|error| anyhow::anyhow!(error))?,
        powder: calibration.powder.unwrap_or_default(),
        method: serde_json::from_value(method).map_err(|error| anyhow::anyhow!(error))?,
        target_deg: calibration.target.repose_deg,
        under: calibration.under,
        reached: result.reached,
        limiting_parameter: result
            .shortfall
            .as_ref()
            .and_then(|shortfall| shortfall.limiting_parameter.clone()),
        nearest_repose_deg: result.shortfall.as_ref().map(|shortfall| shortfall.nearest_repose_deg),
        evaluations: result.evaluations,
        verification_runs: result.verification_runs,
        sets: result.sets.into_iter().map(set).collect(),
        mean_error_deg: result.mean_error_deg,
        sd_error_deg: result.sd_error_deg,
        verified_error_deg: result.verified_error_deg,
        verified_sd_deg: spread(&errors),
        standard_error_deg: mean(&standard),
        verify_particles: calibration.settings["verify_particles"]
            .as_u64()
            .map(|count| count as u32),
        size_shift_deg: result.size_shift_deg,
        emulator: result.emulator,
        observed: result.observed,
        posterior: posterior.map(|Posterior { parameters, together, effective, .. }| Known {
            parameters,
            together,
            effective,
        }),
    })
}

/// Mean; none of an empty slice.
pub(super) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Sample standard deviation; none for fewer than two values.
pub(super) fn spread(values: &[f64]) -> Option<f64> {
    let (n, centre) = (values.len() as f64, mean(values)?);
    (n > 1.0).then(|| {
        (values.iter().map(|value| (value - centre).powi(2)).sum::<f64>() / (n - 1.0)).sqrt()
    })
}

fn text(document: &Document) -> String {
    let two = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
    let row = |p: &Powder| {
        vec![
            p.powder.clone(),
            format!("{:.2}", p.target_deg),
            p.sets.len().to_string(),
            two(p.mean_error_deg),
            two(p.sd_error_deg),
            two(p.verified_error_deg),
            two(p.verified_sd_deg),
            two(p.standard_error_deg),
            (p.evaluations + p.emulator.as_ref().map_or(0, |used| used.built)).to_string(),
            p.verification_runs.to_string(),
        ]
    };
    let header = [
        "powder",
        "AoR deg",
        "sets",
        "mean error deg",
        "sd deg",
        "verified error deg",
        "sd deg",
        "standard error deg",
        "evaluations",
        "verification runs",
    ];
    let mut text = table(&header, &document.powders.iter().map(row).collect::<Vec<_>>());
    for p in &document.powders {
        if let Some(under) = &p.under {
            let _ = write!(text, "\n{:.2} deg: at the reference of {}", p.target_deg, words(under));
        }
        for (key, value) in &p.fixed {
            let _ = write!(text, "\n{:.2} deg: {key} held at {value}", p.target_deg);
        }
        if let (Some(particles), Some(shift)) = (p.verify_particles, p.size_shift_deg) {
            let _ = write!(
                text,
                "\n{:.2} deg: verified by heaps of {particles} grains, which stand {shift:+.2} deg beside the search's",
                p.target_deg
            );
        }
        for observed in &p.observed {
            let Observation { observable, mean, sd, n } = observed.observation;
            let verdict = if observed.agrees { "agrees with" } else { "differs from" };
            let _ = write!(
                text,
                "\n{:.2} deg: {} of the sets {} {} {verdict} {mean} (sd {sd}, n {n})",
                p.target_deg,
                observable.kind(),
                two(observed.mean),
                observable.unit()
            );
        }
    }
    for p in document.powders.iter().filter(|p| !p.reached) {
        let nearest = two(p.nearest_repose_deg);
        let _ = match &p.limiting_parameter {
            Some(key) => write!(
                text,
                "\n{:.2} deg is out of reach: the nearest simulated angle is {nearest} deg, and the bound of {key} stands in the way",
                p.target_deg
            ),
            None => write!(
                text,
                "\n{:.2} deg: fewer sets than wanted; the nearest simulated angle is {nearest} deg; allow more trials",
                p.target_deg
            ),
        };
    }
    text
}

impl std::fmt::Display for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Powder(powder) => f.write_str(powder),
            Self::Angle(angle, ..) => write!(f, "{angle} deg"),
        }
    }
}
