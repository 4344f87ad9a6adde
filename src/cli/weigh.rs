//! `flip weigh`: one dose, through the same intent, bench and guard as a request over HTTP.

use super::Common;
use super::bench::several::NameArguments;
use super::benches::BenchArguments;
use super::calibrate::{Target as CalibrationTarget, calibrate};
use super::failure::Failure;
use super::lab::{Lab, Look};
use super::labels::LabelArguments;
use super::session::{beside, with_bench};
use super::simulator::{SimulatorArguments, words};
use super::train::require_policy;
use super::watch::Watch;
use super::weigh_list::{self, stands};
use crate::app::{
    Asked, Error, Labels, MeasuredMass, Target, Tolerance, VialCheck, VialReadyRequest, Weighing,
    WeighingRequest,
};
use crate::telemetry;
use flip_core::domain::conditions::{Conditions, Under};
use flip_core::domain::weighing::{Outcome, WeighingState};
use serde::Serialize;
use std::path::PathBuf;
use std::time::Duration;

/// How often a weighing is looked at while its vial may be wanted.
pub(super) const OFTEN: Look = Look { here: Duration::from_millis(50), there_s: 1 };
/// How often it is looked at while it moves.
const SELDOM: Look = Look { there_s: 30, ..OFTEN };

/// Arguments of `flip weigh`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Powder id.
    #[arg(long, value_name = "ID", required_unless_present = "list")]
    powder: Option<String>,
    /// Target mass, mg; at most what the spoon holds.
    #[arg(
        long,
        value_name = "MG",
        required_unless_present = "list",
        allow_negative_numbers = true
    )]
    target_mg: Option<f64>,
    /// Doses to weigh one after another: a table as CSV, with a header and a row for each dose
    /// (`powder`, `target_mg`, and if wanted `tolerance_mg`, `position`, `vial`, `lot`, `operator`,
    /// `repeats`). All rows are checked before anything moves. After an interruption the same
    /// command goes on.
    #[arg(
        long,
        value_name = "FILE",
        conflicts_with_all = ["powder", "target_mg", "lot", "vial", "simulator"]
    )]
    list: Option<PathBuf>,
    /// Name of the list, a new one [default: the name of the file].
    #[arg(long, value_name = "TEXT", requires = "list")]
    pub(super) name: Option<String>,
    /// Tolerance either way, mg; of a list, for rows that give none.
    #[arg(long, value_name = "MG", default_value_t = 1.0, allow_negative_numbers = true)]
    pub(super) tolerance_mg: f64,
    /// Policy id [default: the one with the smallest evaluated error for the powder, or the shipped
    /// one if none is evaluated].
    #[arg(long, value_name = "ID")]
    pub(super) policy: Option<String>,
    /// Lot of the powder.
    #[arg(long, value_name = "TEXT")]
    lot: Option<String>,
    /// Name of the operator.
    #[arg(long, value_name = "NAME")]
    pub(super) operator: Option<String>,
    /// Label of the vial on the pan. It must be empty, and the balance is checked for that; if
    /// omitted, FLIP doses into whatever is on the pan.
    #[arg(long, value_name = "TEXT")]
    vial: Option<String>,
    #[command(flatten)]
    pub(super) labels: LabelArguments,
    #[command(flatten)]
    extended: SimulatorArguments,
    /// Bench to weigh on, by its name, or `any`: the least busy of those that hold the powder. With a
    /// service or a server's database [default: its own].
    #[arg(long, value_name = "NAME", conflicts_with = "list")]
    bench_name: Option<String>,
    #[command(flatten)]
    pub(super) bench: BenchArguments,
}

/// The document of `flip weigh`.
#[derive(Debug, Serialize)]
struct Document {
    outcome: Option<Outcome>,
    powder: String,
    target_mg: f64,
    /// Mass in the vial, known only in a simulation.
    dispensed_mg: Option<f64>,
    /// Balance reading with everything at rest: the outcome and the error refer to it.
    reading_mg: Option<f64>,
    /// Reading minus target.
    error_mg: Option<f64>,
    /// Gross, tare, uncertainty, drift, stability, devices: if a balance weighed.
    #[serde(skip_serializing_if = "Option::is_none")]
    measured: Option<MeasuredMass>,
    shakes: Option<u32>,
    /// Bench time, which is simulated and reproducible; not wall-clock time.
    seconds: Option<f64>,
    policy: String,
    parameter_set: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    under: Option<Under>,
    seed: u64,
}

/// Weighs one dose, or those of a list, and prints how it ended.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    if let Some(file) = &arguments.list {
        return weigh_list::run(common, arguments, file);
    }
    // Both are required without a list.
    let powder = arguments.powder.as_deref().unwrap_or_default();
    let target_mg = arguments.target_mg.unwrap_or_default();
    let request = request(powder, target_mg, arguments.tolerance_mg);
    let (simulator, conditions) =
        (arguments.extended.simulator.clone(), arguments.extended.conditions()?);
    let policy = arguments.policy.clone();
    let (lot, operator, vial) =
        (arguments.lot.clone(), arguments.operator.clone(), arguments.vial.clone());
    let vial_check = if vial.is_some() { VialCheck::Confirm } else { VialCheck::Skip };
    let asked = Asked { lot, operator, vial, ..Asked::default() };
    let request = WeighingRequest {
        policy,
        seed: Some(common.seed),
        simulator,
        conditions,
        asked,
        vial_check,
        labels: arguments.labels.all()?,
        bench_name: arguments.bench_name.clone(),
        ..request
    };
    // A new key: running the command again means another dose.
    let key = uuid::Uuid::now_v7().to_string();
    let named = NameArguments { bench_name: arguments.bench_name.clone() };
    if named.named(common)?.is_some() {
        // What its bench is like only its own process knows.
        let weighing = beside(common, async |lab| weigh(lab, &Watch::new(), request, &key).await)?;
        return report(common, weighing);
    }
    let weighing = with_bench(common, &arguments.bench, async |lab| {
        look(lab, vial_check).await?;
        weigh(lab, &Watch::new(), request, &key).await
    })?;
    report(common, weighing)
}

/// Checks that nothing prevents a dose requested now from starting; prints a notice if the vial on
/// the pan is not empty.
pub(super) async fn look(lab: &Lab, vial_check: VialCheck) -> Result<(), Failure> {
    let found = lab.bench().await?;
    let in_the_way = |why: String| Err(Failure::Failed(anyhow::anyhow!(why)));
    if let Some(held) = &found.held {
        let advice = "`flip bench resume` lets it go on";
        return in_the_way(format!(
            "the bench is held since {}: {}. {advice}",
            held.at, held.reason
        ));
    }
    if found.exchanges_vials == Some(true) {
        return Ok(());
    }
    if let Some(first) = found.waiting.first() {
        if lab.is_shared() {
            telemetry::say(format_args!("flip: weighing {} was asked for before", first.id));
            return Ok(());
        }
        let advice = format!("`flip bench vial-ready {}` carries it out", first.id);
        return in_the_way(format!(
            "weighing {} was asked for before and waits for its vial: {advice}",
            first.id
        ));
    }
    let holds_mg = found
        .vial
        .and_then(|vial| vial.holds_mg)
        .filter(|mg| *mg > 0.0 && vial_check == VialCheck::Skip);
    if let Some(holds_mg) = holds_mg {
        telemetry::say(format_args!(
            "flip: the vial on the pan holds {holds_mg:.1} mg unless it was exchanged; --vial NAME asks the balance"
        ));
    }
    Ok(())
}

/// Prints how a dose ended.
pub(super) fn report(common: &Common, weighing: Weighing) -> Result<(), Failure> {
    let document = Document {
        outcome: weighing.outcome,
        powder: weighing.powder,
        target_mg: weighing.target_mg,
        dispensed_mg: weighing.dispensed_mg,
        reading_mg: weighing.reading_mg,
        error_mg: weighing.error_mg,
        measured: weighing.measured,
        shakes: weighing.shakes,
        seconds: weighing.seconds,
        policy: weighing.policy,
        parameter_set: weighing.parameter_set,
        under: weighing.under,
        seed: weighing.seed,
    };
    match weighing
        .error
        .filter(|_| matches!(weighing.state, WeighingState::Aborted | WeighingState::Unknown))
    {
        Some(error) => Err(Failure::Failed(anyhow::anyhow!("weighing {}: {error}", weighing.id))),
        None => common.print(&document, || text(&document)),
    }
}

/// A request in mg with the default policy and a seed of its own.
pub(super) fn request(powder: &str, target_mg: f64, tolerance_mg: f64) -> WeighingRequest {
    WeighingRequest {
        bench_name: None,
        powder: powder.to_owned(),
        target: Target { value: target_mg, unit: "mg".into() },
        tolerance: Tolerance { lower: tolerance_mg, upper: tolerance_mg, unit: "mg".into() },
        policy: None,
        seed: None,
        simulator: None,
        conditions: Conditions::new(),
        asked: Asked::default(),
        vial_check: VialCheck::Skip,
        reservation: None,
        labels: Labels::default(),
    }
}

/// Commits the intent (or finds the one created with `key` before), first calibrating the powder if
/// necessary, and waits until the bench has carried it out.
pub(super) async fn weigh(
    lab: &Lab,
    watch: &Watch,
    request: WeighingRequest,
    key: &str,
) -> Result<Weighing, Failure> {
    let weighing = match lab.start_weighing(request.clone(), key).await {
        Err(Error::Conflict { code: "calibration_missing", message }) => {
            let (policy, simulator) = (request.policy.as_deref(), request.simulator.as_deref());
            let seed = request.seed.unwrap_or(1);
            calibrate_first(lab, watch, &message, &request.powder, policy, simulator, seed).await?;
            lab.start_weighing(request, key).await.map_err(in_flags)?
        }
        started => started.map_err(in_flags)?,
    };
    ended(lab, &weighing.id, &VialReadyRequest::default()).await
}

/// Calibrates a powder that is to be weighed or probed, and says why.
pub(super) async fn calibrate_first(
    lab: &Lab,
    watch: &Watch,
    why: &str,
    powder: &str,
    policy: Option<&str>,
    simulator: Option<&str>,
    seed: u64,
) -> Result<(), Failure> {
    require_policy(lab, policy).await?;
    watch.say(&format!("{why}: calibrating first"));
    let target = CalibrationTarget::Powder(powder.to_owned());
    calibrate(lab, watch, &[target], None, simulator, seed).await?;
    Ok(())
}

/// Waits until the dose has ended; if it waits for its vial, confirms that the vial is in.
pub(super) async fn ended(
    lab: &Lab,
    id: &str,
    vial: &VialReadyRequest,
) -> Result<Weighing, Failure> {
    let (mut said, mut told) = (false, false);
    let mut weighing = lab.weighing(id).await?.weighing;
    loop {
        let look = match weighing.state {
            WeighingState::Done | WeighingState::Aborted | WeighingState::Unknown => {
                lab.has_ended(id);
                return Ok(weighing);
            }
            WeighingState::AwaitingVial if !said => {
                lab.vial_ready(id, vial.clone()).await?;
                said = true;
                OFTEN
            }
            WeighingState::Planned | WeighingState::AwaitingVial => {
                told = told || tell_why_it_waits(lab, id).await?;
                OFTEN
            }
            WeighingState::Armed | WeighingState::Dosing | WeighingState::Settling => SELDOM,
        };
        weighing = lab.weighing_later(id, look).await?.weighing;
    }
}

/// Says that a server's bench starts nothing, if that is why; the weighing keeps its place meanwhile.
async fn tell_why_it_waits(lab: &Lab, id: &str) -> Result<bool, Failure> {
    let why = if lab.is_shared() { stands(lab).await? } else { None };
    if let Some(why) = &why {
        telemetry::say(format_args!("flip: weighing {id} waits, because {why}"));
    }
    Ok(why.is_some())
}

/// The refusal in terms of the flags: `target.value` is `--target-mg` here.
fn in_flags(error: Error) -> Failure {
    let Error::Invalid(mut errors) = error else { return error.into() };
    for error in &mut errors {
        if error.field.starts_with("target") {
            error.field = "target_mg".into();
        } else if error.field.starts_with("tolerance") {
            error.field = "tolerance_mg".into();
        }
    }
    Failure::BadInput(errors)
}

fn text(document: &Document) -> String {
    let mg = |value: Option<f64>| {
        value.map_or_else(|| "unknown".into(), |value| format!("{value:.2} mg"))
    };
    let outcome = serde_json::to_value(document.outcome).ok();
    let measured = document.measured.as_ref();
    let is_unproven = document.outcome == Some(Outcome::Within)
        && measured.is_some_and(|measured| measured.proven == Some(false));
    format!(
        "outcome    {}{}\ntarget     {:.2} mg\nreading    {}{}\nerror      {}\ndispensed  {}\nshakes     {}\nseconds    {:.1}\n\
         policy     {}{}",
        outcome.as_ref().and_then(|value| value.as_str()).unwrap_or("unknown"),
        if is_unproven { ", not proven" } else { "" },
        document.target_mg,
        mg(document.reading_mg),
        measured.map_or_else(String::new, |measured| format!(
            " +- {:.2} mg (k = 2)",
            measured.uncertainty_mg
        )),
        mg(document.error_mg),
        document
            .dispensed_mg
            .map_or_else(|| "unknown".into(), |mg| format!("{mg:.2} mg, true mass")),
        document.shakes.unwrap_or_default(),
        document.seconds.unwrap_or_default(),
        document.policy,
        document
            .under
            .as_ref()
            .map_or_else(String::new, |under| format!("\nbench      {}", words(under)))
    )
}
