//! `flip train`: a policy learned on simulated powders.

use super::Common;
use super::benches::spoon;
use super::calibrate::{Target, calibrate};
use super::device::DeviceArguments;
use super::failure::Failure;
use super::lab::Lab;
use super::labels::LabelArguments;
use super::session::with_app;
use super::simulator::{SimulatorArguments, words};
use super::table::table;
use super::watch::Watch;
use crate::app::{Error, Gradients, Job, Order, Preset, Training, TrainingRequest, TrainingResult};
use clap::ValueEnum;
use flip_core::domain::FieldError;
use flip_core::domain::conditions::Under;
use serde::Serialize;
use std::path::PathBuf;

/// Angles of the published curriculum's levels, degrees.
const PAPER_LEVELS_DEG: [f64; 3] = [28.0, 33.0, 37.0];
/// Powders of FLIP's own curriculum.
const POWDERS: [&str; 3] = ["sand", "sugar", "salt"];

/// Arguments of `flip train`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Order of the levels; several are trained in parallel, and their documents are printed as a
    /// list.
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [OrderFlag::Curriculum])]
    order: Vec<OrderFlag>,
    /// Preset of settings: FLIP's own, or as published.
    #[arg(long, value_enum, default_value_t = PresetFlag::Flip)]
    preset: PresetFlag,
    /// Number of episodes [default: the preset's, 4800 for flip, 4000 for paper].
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    episodes: Option<u32>,
    /// The first N of these run on a fast model of the spoon instead of the simulator [default:
    /// four fifths for flip, 0 for paper].
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    surrogate_episodes: Option<u32>,
    /// Powders whose calibrated sets are the levels [default: sand,sugar,salt]; not with the paper
    /// preset.
    #[arg(long, value_name = "ID,…", value_delimiter = ',')]
    powders: Option<Vec<String>>,
    /// Learnt policy to continue from, e.g. to adapt it to a simulator version; the default is then
    /// 720 episodes, all in the simulator.
    #[arg(long, value_name = "P")]
    from: Option<String>,
    /// Seeds for several otherwise equal trainings, run in parallel; their documents are printed as
    /// a list [default: --seed alone].
    #[arg(long, value_name = "N,…", value_delimiter = ',')]
    seeds: Option<Vec<u64>>,
    /// Shake as the bench's arm was measured to shake by `flip bench calibrate-shake`.
    #[arg(long)]
    as_calibrated: bool,
    /// Bench file whose spoon to use; the fast model ignores it [default: FLIP's own spoon].
    #[arg(long, value_name = "FILE")]
    bench: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArguments,
    /// What computes the gradients of updates; policies differ by it [default: libtorch on the
    /// processor, fused on a card].
    #[arg(long, value_enum)]
    gradients: Option<GradientsFlag>,
    #[command(flatten)]
    labels: LabelArguments,
    #[command(flatten)]
    extended: SimulatorArguments,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum OrderFlag {
    /// From the lowest angle of repose to the highest, moving on once errors are small.
    Curriculum,
    /// A level drawn at random for each episode.
    Random,
    /// From the highest angle of repose to the lowest.
    Reverse,
    /// A parameter set drawn from the whole published box for each episode; the levels are not
    /// used.
    DomainRandomisation,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum PresetFlag {
    /// Episodes end near the target; levels are measured powders.
    Flip,
    /// Exactly ten steps; levels at 28, 33 and 37 degrees.
    Paper,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum GradientsFlag {
    /// libtorch, whose bits depend on the processor.
    Libtorch,
    /// FLIP's own code: the same bits on every processor; with --device cuda it makes the updates on
    /// the card.
    Fused,
}

/// The document of `flip train`.
#[derive(Debug, Serialize)]
struct Document {
    /// Order in which the levels were met.
    order: Order,
    /// Policy id, an address derived from its content.
    policy: String,
    episodes: u32,
    /// Mean absolute error of the last 20 episodes.
    final_error_mg: f64,
    levels: Vec<serde_json::Value>,
    #[serde(skip_serializing_if = "Option::is_none")]
    under: Option<Under>,
    /// The graphics card that simulated, if one did.
    #[serde(skip_serializing_if = "Option::is_none")]
    card: Option<String>,
    seed: u64,
    timing: Timing,
}

/// Wall-clock times, kept apart from reproducible results.
#[derive(Debug, Serialize)]
pub(super) struct Timing {
    /// From the command to its result.
    pub(super) wall_s: f64,
}

/// Trains a policy and prints the result.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let began = std::time::Instant::now();
    let conditions = arguments.extended.conditions()?;
    let spoon = spoon(arguments.bench.as_deref())?;
    let labels = arguments.labels.all()?;
    let request = |order: OrderFlag, seed: u64| TrainingRequest {
        order: order.into(),
        preset: arguments.preset.into(),
        episodes: arguments.episodes,
        surrogate_episodes: arguments.surrogate_episodes,
        powders: arguments.powders.clone(),
        from: arguments.from.clone(),
        device: arguments.device.device(),
        gradients: arguments.gradients.map(Gradients::from),
        seed: Some(seed),
        simulator: arguments.extended.simulator.clone(),
        conditions: conditions.clone(),
        as_calibrated: arguments.as_calibrated,
        spoon,
        labels: labels.clone(),
    };
    let document = |training: Training, seed: u64| {
        let result = training
            .result
            .ok_or_else(|| anyhow::anyhow!("training {} has no result", training.job.id))?;
        let timing = Timing { wall_s: began.elapsed().as_secs_f64() };
        let TrainingResult { policy, episodes, final_error_mg, levels, card } = result;
        Ok::<_, Failure>(Document {
            order: training.order,
            policy,
            episodes,
            final_error_mg,
            levels,
            under: training.under,
            card,
            seed,
            timing,
        })
    };
    let documents: Vec<Document> = with_app(common, async |lab| {
        let (watch, mut jobs, mut documents) = (Watch::new(), Vec::new(), Vec::new());
        for order in &arguments.order {
            for seed in arguments.seeds.as_deref().unwrap_or(&[common.seed]) {
                jobs.push((begin(lab, &watch, request(*order, *seed)).await?, *seed));
            }
        }
        for (job, seed) in jobs {
            watch.job(lab, &job.id, "train").await?;
            documents.push(document(lab.training(&job.id).await?, seed)?);
        }
        Ok::<_, Failure>(documents)
    })?;
    match documents.as_slice() {
        [one] => common.print(one, || text(one)),
        all => common.print(&all, || all.iter().map(text).collect::<Vec<_>>().join("\n\n")),
    }
}

/// Trains as a job (or finds the existing job), first calibrating anything not yet calibrated, and
/// waits for it.
pub(super) async fn train(
    lab: &Lab,
    watch: &Watch,
    request: TrainingRequest,
) -> Result<Training, Failure> {
    let job = begin(lab, watch, request).await?;
    watch.job(lab, &job.id, "train").await?;
    Ok(lab.training(&job.id).await?)
}

async fn begin(lab: &Lab, watch: &Watch, request: TrainingRequest) -> Result<Job, Failure> {
    let job = match start(lab, &request).await {
        Err(Error::Conflict { code: "calibration_missing", message }) => {
            watch.say(&format!("{message}: calibrating first"));
            let levels = levels(&request);
            // Bare angles belong to the base, which equals a version under its reference
            // conditions.
            let simulator = request.simulator.as_deref().filter(|_| request.preset == Preset::Flip);
            calibrate(lab, watch, &levels, None, simulator, request.seed.unwrap_or(1)).await?;
            start(lab, &request).await?
        }
        started => started?,
    };
    Ok(job)
}

async fn start(lab: &Lab, request: &TrainingRequest) -> Result<Job, Error> {
    Ok(lab.start_training(request.clone()).await?.0)
}

fn levels(request: &TrainingRequest) -> Vec<Target> {
    match (request.preset, &request.powders) {
        (Preset::Paper, _) => PAPER_LEVELS_DEG.map(|angle| Target::Angle(angle, None, None)).into(),
        (Preset::Flip, None) => POWDERS.map(|powder| Target::Powder(powder.to_owned())).into(),
        (Preset::Flip, Some(powders)) => powders.iter().cloned().map(Target::Powder).collect(),
    }
}

/// Refuses a policy that does not exist at once, before minutes of calibration.
///
/// # Errors
/// An unknown id is bad input.
pub(super) async fn require_policy(lab: &Lab, id: Option<&str>) -> Result<(), Failure> {
    let Some(id) = id else { return Ok(()) };
    lab.policy(id).await.map(drop).map_err(|error| match error {
        Error::NotFound { .. } => {
            FieldError::new("policy", format!("there is no policy `{id}`")).into()
        }
        error => Failure::from(error),
    })
}

fn text(document: &Document) -> String {
    let plain =
        |value: &serde_json::Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
    let keys: Vec<&str> =
        document.levels.first().and_then(|level| level.as_object()).map_or(Vec::new(), |level| {
            level
                .iter()
                .filter(|(_, value)| !value.is_array() && !value.is_object())
                .map(|(key, _)| &**key)
                .collect()
        });
    let rows: Vec<Vec<String>> = document
        .levels
        .iter()
        .map(|level| keys.iter().map(|key| plain(&level[*key])).collect())
        .collect();
    format!(
        "{}{}order        {}\npolicy       {}\nepisodes     {}\nfinal error  {:.2} mg (mean of the last 20)\n\n{}",
        document.under.as_ref().map_or_else(String::new, |under| words(under) + "\n"),
        document.card.as_ref().map_or_else(String::new, |card| format!("computed on  {card}\n")),
        serde_json::to_value(document.order)
            .ok()
            .and_then(|order| order.as_str().map(str::to_owned))
            .unwrap_or_default(),
        document.policy,
        document.episodes,
        document.final_error_mg,
        table(&keys, &rows)
    )
}

impl From<OrderFlag> for Order {
    fn from(flag: OrderFlag) -> Self {
        match flag {
            OrderFlag::Curriculum => Self::Curriculum,
            OrderFlag::Random => Self::Random,
            OrderFlag::Reverse => Self::Reverse,
            OrderFlag::DomainRandomisation => Self::DomainRandomisation,
        }
    }
}

impl From<PresetFlag> for Preset {
    fn from(flag: PresetFlag) -> Self {
        match flag {
            PresetFlag::Flip => Self::Flip,
            PresetFlag::Paper => Self::Paper,
        }
    }
}

impl From<GradientsFlag> for Gradients {
    fn from(flag: GradientsFlag) -> Self {
        match flag {
            GradientsFlag::Libtorch => Self::Libtorch,
            GradientsFlag::Fused => Self::Fused,
        }
    }
}
