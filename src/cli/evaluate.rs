//! `flip evaluate`: a policy's errors on the simulated bench beside those of simple controllers.

use super::Common;
use super::calibrate::{Target, calibrate};
use super::failure::Failure;
use super::session::with_app;
use super::table::table;
use super::train::require_policy;
use super::watch::Watch;
use crate::app::{App, Error, Evaluation, EvaluationRequest, EvaluationResult, EvaluationRow, EvaluationSummary};
use crate::domain::powder::PUBLISHED;
use serde::Serialize;

/// Arguments of `flip evaluate`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Policy id [default: the newest].
    #[arg(long, value_name = "ID")]
    policy: Option<String>,
    /// Some of policy, untrained, fixed, schedule, dispenser [default: all].
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    controllers: Option<Vec<String>>,
    /// Powder ids [default: the five published powders].
    #[arg(long, value_name = "ID,…", value_delimiter = ',', num_args = 1..)]
    powders: Option<Vec<String>>,
    /// Targets, mg.
    #[arg(long, value_name = "MG,…", value_delimiter = ',', default_value = "15,20", allow_negative_numbers = true)]
    targets_mg: Vec<f64>,
    /// Weighings of each powder and target.
    #[arg(long, value_name = "N", default_value_t = 5, allow_negative_numbers = true)]
    repeats: u32,
    /// Step of the balance's display, mg.
    #[arg(long, value_name = "MG", default_value_t = 1.0, allow_negative_numbers = true)]
    readability_mg: f64,
    /// Steps of a weighing.
    #[arg(long, value_name = "N", default_value_t = 10, allow_negative_numbers = true)]
    max_shakes: u32,
}

/// The document of `flip evaluate`.
#[derive(Debug, Serialize)]
struct Document {
    policy: String,
    repeats: u32,
    readability_mg: f64,
    max_shakes: u32,
    seed: u64,
    rows: Vec<EvaluationRow>,
    summary: Vec<EvaluationSummary>,
}

/// Evaluate and print the errors.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let evaluation = with_app(common, async |app| evaluate(app, common, arguments).await)?;
    let id = evaluation.job.id;
    let result = evaluation.result.ok_or_else(|| anyhow::anyhow!("evaluation {id} has no result"))?;
    let EvaluationResult { rows, summary } = result;
    let document = Document {
        policy: evaluation.policy,
        repeats: evaluation.repeats,
        readability_mg: evaluation.readability_mg,
        max_shakes: evaluation.max_shakes,
        seed: evaluation.seed,
        rows,
        summary,
    };
    common.print(&document, || text(&document))
}

async fn evaluate(app: &App, common: &Common, arguments: &Arguments) -> Result<Evaluation, Failure> {
    let watch = Watch::new();
    let request = EvaluationRequest {
        policy: arguments.policy.clone(),
        controllers: arguments.controllers.clone(),
        powders: arguments.powders.clone(),
        targets_mg: Some(arguments.targets_mg.clone()),
        repeats: Some(arguments.repeats),
        readability_mg: Some(arguments.readability_mg),
        max_shakes: Some(arguments.max_shakes),
        seed: Some(common.seed),
    };
    let (job, _) = match app.start_evaluation(request.clone()).await {
        Err(Error::Conflict { code: "calibration_missing", message }) => {
            require_policy(app, arguments.policy.as_deref()).await?;
            watch.say(&format!("{message}: calibrating first"));
            let published = || PUBLISHED.map(|powder| powder.id.to_owned()).into();
            let powders = request.powders.clone().unwrap_or_else(published);
            let targets: Vec<Target> = powders.into_iter().map(Target::Powder).collect();
            calibrate(app, &watch, &targets, None, common.seed).await?;
            app.start_evaluation(request).await?
        }
        started => started?,
    };
    watch.job(app, &job.id, "evaluate").await?;
    Ok(app.evaluation(&job.id).await?)
}

fn text(document: &Document) -> String {
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    let row = |r: &EvaluationRow| {
        vec![
            r.controller.clone(),
            r.powder.clone(),
            format!("{}", r.target_mg),
            r.n.to_string(),
            format!("{:.2}", r.mae_mg),
            format!("{:.2}", r.sd_mg),
            format!("{:+.2}", r.bias_mg),
            percent(r.over_share),
            percent(r.zero_share),
            format!("{:.1}", r.shakes_mean),
        ]
    };
    let header = ["controller", "powder", "target mg", "n", "MAE mg", "sd mg", "bias mg", "over", "zero", "shakes"];
    let rows = table(&header, &document.rows.iter().map(row).collect::<Vec<_>>());
    let total = |s: &EvaluationSummary| {
        vec![
            s.controller.clone(),
            format!("{:.2}", s.mae_mg),
            format!("{:.2} to {:.2}", s.ci95[0], s.ci95[1]),
            format!("{:.2}", s.sd_trials_mg),
            format!("{:.2}", s.sd_within_cells_mg),
        ]
    };
    let header = ["controller", "MAE mg", "95 % interval", "sd of trials mg", "sd within cells mg"];
    let summary = table(&header, &document.summary.iter().map(total).collect::<Vec<_>>());
    format!("{rows}\n\n{summary}")
}
