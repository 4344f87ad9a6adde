//! `flip demo`: from published measurements to weighed doses, once; running it again continues
//! where it stopped.

use super::Common;
use super::benches::BenchArguments;
use super::calibrate::{Search, Target, calibrate};
use super::device::DeviceArguments;
use super::failure::Failure;
use super::lab::Lab;
use super::serve::{self, Address};
use super::session::{StopSignals, interrupted, runtime};
use super::table::table;
use super::token;
use super::train::{Timing, train};
use super::watch::Watch;
use super::weigh::{request, weigh};
use crate::api::ServeError;
use crate::app::{
    App, Calibration, Options, Order, Preset, TrainingRequest, TrainingResult, Weighing,
    WeighingRequest, Who, Workers, acting,
};
use crate::telemetry;
use flip_core::domain::job::JobKind;
use flip_core::domain::powder::PUBLISHED;
use serde::Serialize;
use std::time::Instant;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// Dose weighed of every powder, mg.
const TARGET_MG: f64 = 15.0;
/// Accepted error of a dose in either direction, mg.
const TOLERANCE_MG: f64 = 1.0;

/// Arguments of `flip demo`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Exit after the table instead of going on serving.
    #[arg(long)]
    exit: bool,
    /// Training episodes [default: as for `flip train`].
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    episodes: Option<u32>,
    #[command(flatten)]
    device: DeviceArguments,
    #[command(flatten)]
    search: Search,
    #[command(flatten)]
    address: Address,
    #[command(flatten)]
    bench: BenchArguments,
}

/// The document of `flip demo`.
#[derive(Debug, Serialize)]
struct Document {
    rows: Vec<Row>,
    mean_abs_error_mg: f64,
    training: Learned,
    seed: u64,
    timing: Timing,
}

/// One row of the table.
#[derive(Debug, Serialize)]
struct Row {
    powder: String,
    aor_measured_deg: f64,
    /// Mean over the powder's calibrated sets.
    aor_simulated_deg: f64,
    target_mg: f64,
    /// The policy used by a weighing that names none.
    policy: String,
    dispensed_mg: f64,
    error_mg: f64,
    shakes: u32,
    /// Bench time.
    seconds: f64,
    /// Error of the same dose with the policy trained in this demonstration.
    trained_error_mg: f64,
}

/// Result of the training.
#[derive(Debug, Serialize)]
struct Learned {
    policy: String,
    episodes: u32,
    final_error_mg: f64,
    /// Mean over the powders.
    mean_abs_error_mg: f64,
}

/// Starts the service, runs the demonstration as a client of the same application, and continues
/// serving until asked to stop.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    runtime()?.block_on(async {
        let signals = StopSignals::catch()?;
        let options = Options { workers: Workers::GiveWay, ..arguments.bench.options()? };
        let app = App::open(common.storage()?, options).await?;
        // Cancelled when the service is to end, and by the service when it ends by itself.
        let stop = CancellationToken::new();
        // Before the minutes that come before the training.
        let begun = match app.check_device(JobKind::Training, arguments.device.device()).await {
            Ok(()) => serve(&app, arguments, &stop),
            Err(refused) => Err(refused.into()),
        };
        let service = match begun {
            Ok(service) => service,
            Err(failure) => {
                app.shutdown().await?;
                return Err(failure);
            }
        };
        let result = attended(&app, common, arguments, service.is_some(), &stop, signals).await;
        stop.cancel();
        match service {
            // A service that ends closes the application.
            Some(service) => service.await.map_err(anyhow::Error::from)??,
            None => app.shutdown().await?,
        }
        result
    })
}

/// Serves in the background until `stop`. A demonstration that ends by itself can do without a port
/// that is taken.
fn serve(
    app: &App,
    arguments: &Arguments,
    stop: &CancellationToken,
) -> Result<Option<Service>, Failure> {
    let server = match serve::bind(app, &arguments.address, None) {
        Err(Failure::Failed(error)) if arguments.exit => {
            telemetry::say(format_args!("flip: going on without the page: {error:#}"));
            return Ok(None);
        }
        bound => bound?,
    };
    telemetry::say(format_args!("flip: watch it at {}", arguments.address.url(&server)?));
    let stop = stop.clone();
    Ok(Some(tokio::spawn(async move {
        let result = server.run(stop.clone().cancelled_owned()).await;
        stop.cancel();
        result
    })))
}

/// A service that runs alongside the demonstration.
type Service = JoinHandle<Result<(), ServeError>>;

/// The demonstration, followed by the service, until done, asked to stop, or abandoned by the
/// service.
async fn attended(
    app: &App,
    common: &Common,
    arguments: &Arguments,
    serving: bool,
    stop: &CancellationToken,
    mut signals: StopSignals,
) -> Result<(), Failure> {
    if let Some(token) = token::first(app).await? {
        telemetry::say(format_args!("flip: {}", serve::announce(&token)));
    }
    let lab = Lab::from(app);
    let document = tokio::select! {
        document = acting(Who::command_line(), demonstrate(&lab, common, arguments)) => document?,
        signal = signals.received() => return Err(interrupted(signal)),
        () = stop.cancelled() => return Ok(()),
    };
    common.print(&document, || text(&document))?;
    if serving && !arguments.exit {
        telemetry::say(format_args!("flip: serving on {} until Ctrl-C", arguments.address.listen));
        tokio::select! {
            _ = signals.received() => {}
            () = stop.cancelled() => {}
        }
    }
    Ok(())
}

/// Calibrates, trains, weighs.
async fn demonstrate(
    lab: &Lab,
    common: &Common,
    arguments: &Arguments,
) -> Result<Document, Failure> {
    let (began, watch) = (Instant::now(), Watch::new());
    let targets = PUBLISHED.map(|powder| Target::Powder(powder.id.to_owned()));
    watch.say(&told(&first_dose(lab, &watch, common).await?));
    let calibrations =
        calibrate(lab, &watch, &targets, Some(&arguments.search), None, common.seed).await?;
    let learned = learn(lab, &watch, common, arguments).await?;
    let mut rows = Vec::new();
    for (powder, calibration) in PUBLISHED.iter().zip(&calibrations) {
        let with_trained = dose(lab, &watch, common, powder.id, Some(&learned.policy)).await?;
        rows.push(row(
            calibration,
            dose(lab, &watch, common, powder.id, None).await?,
            &with_trained,
        )?);
    }
    let mean = |errors: &dyn Fn(&Row) -> f64| {
        rows.iter().map(|r| errors(r).abs()).sum::<f64>() / rows.len() as f64
    };
    Ok(Document {
        mean_abs_error_mg: mean(&|row| row.error_mg),
        training: Learned {
            policy: learned.policy,
            episodes: learned.episodes,
            final_error_mg: learned.final_error_mg,
            mean_abs_error_mg: mean(&|row| row.trained_error_mg),
        },
        rows,
        seed: common.seed,
        timing: Timing { wall_s: began.elapsed().as_secs_f64() },
    })
}

/// Weighs a dose of a powder, with the policy of this id or the one that a weighing uses by
/// default.
async fn dose(
    lab: &Lab,
    watch: &Watch,
    common: &Common,
    powder: &str,
    policy: Option<&str>,
) -> Result<Weighing, Failure> {
    watch.say(&format!("weigh {TARGET_MG} mg of {powder}"));
    // The key is derived from everything the dose depends on: a second run finds the doses of the
    // first and pours nothing.
    let key =
        format!("demo-{}-{}-{powder}-{TARGET_MG}-mg", common.seed, policy.unwrap_or("default"));
    let request = request(powder, TARGET_MG, TOLERANCE_MG);
    let request =
        WeighingRequest { policy: policy.map(str::to_owned), seed: Some(common.seed), ..request };
    weigh(lab, watch, request, &key).await
}

/// Weighs something within the first minutes, of a powder calibrated with the quick method; the
/// table has doses of its own.
async fn first_dose(lab: &Lab, watch: &Watch, common: &Common) -> Result<Weighing, Failure> {
    let key = format!("demo-{}-first-{TARGET_MG}-mg", common.seed);
    let request = request(PUBLISHED[0].id, TARGET_MG, TOLERANCE_MG);
    weigh(lab, watch, WeighingRequest { seed: Some(common.seed), ..request }, &key).await
}

/// The first dose, in one line.
fn told(dose: &Weighing) -> String {
    let found = dose
        .dispensed_mg
        .map_or("no mass is known".to_owned(), |mg| format!("{mg:.2} mg are in the vial"));
    format!(
        "first dose: {} of {} mg, {found}; next come five calibrations and a training",
        dose.powder, dose.target_mg
    )
}

async fn learn(
    lab: &Lab,
    watch: &Watch,
    common: &Common,
    arguments: &Arguments,
) -> Result<TrainingResult, Failure> {
    let request = TrainingRequest {
        order: Order::Curriculum,
        preset: Preset::Flip,
        episodes: arguments.episodes,
        seed: Some(common.seed),
        device: arguments.device.device(),
        ..Default::default()
    };
    let training = train(lab, watch, request).await?;
    Ok(training
        .result
        .ok_or_else(|| anyhow::anyhow!("training {} has no result", training.job.id))?)
}

fn row(
    calibration: &Calibration,
    weighing: Weighing,
    with_trained: &Weighing,
) -> Result<Row, Failure> {
    let sets = calibration.result.as_ref().map_or(&[] as &[_], |result| &result.sets);
    let known = |what: &str, value: Option<f64>, of: &Weighing| {
        let why = of.error.as_deref().unwrap_or("it did not end");
        value.ok_or_else(|| anyhow::anyhow!("weighing {} has no {what}: {why}", of.id))
    };
    // Error of the true mass, which the simulator knows.
    let error_mg =
        |of: &Weighing| known("dispensed mass", of.dispensed_mg, of).map(|mg| mg - of.target_mg);
    Ok(Row {
        aor_measured_deg: calibration.target.repose_deg,
        aor_simulated_deg: sets.iter().map(|set| set.repose_deg).sum::<f64>() / sets.len() as f64,
        target_mg: weighing.target_mg,
        dispensed_mg: known("dispensed mass", weighing.dispensed_mg, &weighing)?,
        error_mg: error_mg(&weighing)?,
        trained_error_mg: error_mg(with_trained)?,
        shakes: weighing.shakes.unwrap_or_default(),
        seconds: weighing.seconds.unwrap_or_default(),
        policy: weighing.policy,
        powder: weighing.powder,
    })
}

fn text(document: &Document) -> String {
    let row = |r: &Row| {
        vec![
            r.powder.clone(),
            format!("{:.2}", r.aor_measured_deg),
            format!("{:.2}", r.aor_simulated_deg),
            format!("{:.2}", r.target_mg),
            format!("{:.2}", r.dispensed_mg),
            format!("{:+.2}", r.error_mg),
            r.shakes.to_string(),
            format!("{:.1}", r.seconds),
            format!("{:+.2}", r.trained_error_mg),
        ]
    };
    let header = [
        "powder",
        "AoR measured deg",
        "AoR simulated deg",
        "target mg",
        "dispensed mg",
        "error mg",
        "shakes",
        "seconds",
        "error of the trained policy mg",
    ];
    let rows = table(&header, &document.rows.iter().map(row).collect::<Vec<_>>());
    let worst = document.rows.iter().max_by(|a, b| a.error_mg.abs().total_cmp(&b.error_mg.abs()));
    let worst = worst
        .map_or(String::new(), |row| format!(", largest {:+.2} mg ({})", row.error_mg, row.powder));
    let within = document.rows.iter().filter(|row| row.error_mg.abs() <= TOLERANCE_MG).count();
    format!(
        "\n{rows}\n\nmean |error| {:.2} mg{worst}; {within} of {} within {TOLERANCE_MG} mg\n\
         policy {} trained in {} episodes: mean |error| {:.2} mg, of its last 20 episodes {:.2} mg; {:.0} s in all",
        document.mean_abs_error_mg,
        document.rows.len(),
        document.training.policy,
        document.training.episodes,
        document.training.mean_abs_error_mg,
        document.training.final_error_mg,
        document.timing.wall_s
    )
}
