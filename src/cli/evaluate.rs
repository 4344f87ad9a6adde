//! `flip evaluate`: a policy's errors on the simulated bench compared with those of other
//! controllers.

use super::Common;
use super::benches::spoon;
use super::calibrate::{Target, calibrate};
use super::device::DeviceArguments;
use super::failure::Failure;
use super::lab::Lab;
use super::labels::LabelArguments;
use super::parameters;
use super::session::with_app;
use super::simulator::{SimulatorArguments, words};
use super::table::table;
use super::train::require_policy;
use super::watch::Watch;
use crate::app::{
    Conditions, Error, Evaluation, EvaluationRequest, EvaluationResult, EvaluationRow,
    EvaluationSummary,
};
use flip_core::domain::conditions::Under;
use flip_core::domain::powder::{PUBLISHED, PUBLISHED_DOSES_OVERALL_MG, published_mae_mg};
use serde::Serialize;
use std::path::PathBuf;

/// Arguments of `flip evaluate`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Policy id [default: the newest, or the shipped one until a policy is trained].
    #[arg(long, value_name = "ID")]
    policy: Option<String>,
    /// Any of policy, untrained, fixed, schedule, dispenser, pid, fuzzy, paced [default: all];
    /// `--policy` is always included.
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    controllers: Option<Vec<String>>,
    /// Powder ids [default: the five published powders].
    #[arg(long, value_name = "ID,…", value_delimiter = ',', num_args = 1..)]
    powders: Option<Vec<String>>,
    /// Target masses, mg.
    #[arg(
        long,
        value_name = "MG,…",
        value_delimiter = ',',
        default_value = "15,20",
        allow_negative_numbers = true
    )]
    targets_mg: Vec<f64>,
    /// Weighings per powder and target.
    #[arg(long, value_name = "N", default_value_t = 5, allow_negative_numbers = true)]
    repeats: u32,
    /// Readability (display step) of the balance, mg.
    #[arg(long, value_name = "MG", default_value_t = 1.0, allow_negative_numbers = true)]
    readability_mg: f64,
    /// Maximum steps per weighing.
    #[arg(long, value_name = "N", default_value_t = 10, allow_negative_numbers = true)]
    max_shakes: u32,
    /// Grains on the spoon, 500 to 4000; their mass is all the powder there is [default: 2500,
    /// about 37 mg].
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    particles: Option<u32>,
    /// Mechanisms absent from all training, with their amplitudes, as in
    /// `rotation=1,rolling_friction=0.5`.
    #[arg(long, value_name = "NAME=AMPLITUDE,…", value_delimiter = ',')]
    extension: Vec<String>,
    /// Shake as the bench's arm was measured to shake (`flip bench calibrate-shake`).
    #[arg(long)]
    as_calibrated: bool,
    /// Substep of the simulator, 10 to 160 us; half of it takes twice as long [default: 80]. Errors
    /// at another one do not count for which policy weighs best.
    #[arg(long, value_name = "US", allow_negative_numbers = true)]
    substep_us: Option<u32>,
    /// Bench file whose spoon to use [default: FLIP's own spoon].
    #[arg(long, value_name = "FILE")]
    bench: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArguments,
    #[command(flatten)]
    labels: LabelArguments,
    #[command(flatten)]
    extended: SimulatorArguments,
}

/// The document of `flip evaluate`.
#[derive(Debug, Serialize)]
struct Document {
    policy: String,
    repeats: u32,
    readability_mg: f64,
    max_shakes: u32,
    conditions: Conditions,
    #[serde(skip_serializing_if = "Option::is_none")]
    under: Option<Under>,
    /// The graphics card that simulated, if one did.
    #[serde(skip_serializing_if = "Option::is_none")]
    card: Option<String>,
    seed: u64,
    rows: Vec<EvaluationRow>,
    summary: Vec<EvaluationSummary>,
}

/// Evaluates and prints the errors.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let evaluation = with_app(common, async |lab| evaluate(lab, common, arguments).await)?;
    let id = evaluation.job.id;
    let result =
        evaluation.result.ok_or_else(|| anyhow::anyhow!("evaluation {id} has no result"))?;
    let EvaluationResult { rows, summary, card } = result;
    let document = Document {
        policy: evaluation.policy,
        repeats: evaluation.repeats,
        readability_mg: evaluation.readability_mg,
        max_shakes: evaluation.max_shakes,
        conditions: evaluation.conditions,
        under: evaluation.under,
        card,
        seed: evaluation.seed,
        rows,
        summary,
    };
    common.print(&document, || text(&document))
}

async fn evaluate(
    lab: &Lab,
    common: &Common,
    arguments: &Arguments,
) -> Result<Evaluation, Failure> {
    let watch = Watch::new();
    let request = EvaluationRequest {
        policy: arguments.policy.clone(),
        controllers: arguments.controllers.clone(),
        powders: arguments.powders.clone(),
        targets_mg: Some(arguments.targets_mg.clone()),
        repeats: Some(arguments.repeats),
        readability_mg: Some(arguments.readability_mg),
        max_shakes: Some(arguments.max_shakes),
        particles: arguments.particles,
        extensions: parameters::amplitudes(&arguments.extension)?,
        as_calibrated: arguments.as_calibrated,
        substep_us: arguments.substep_us,
        spoon: spoon(arguments.bench.as_deref())?,
        device: arguments.device.device(),
        simulator: arguments.extended.simulator.clone(),
        conditions: arguments.extended.conditions()?,
        seed: Some(common.seed),
        labels: arguments.labels.all()?,
    };
    let (job, _) = match lab.start_evaluation(request.clone()).await {
        Err(Error::Conflict { code: "calibration_missing", message }) => {
            require_policy(lab, arguments.policy.as_deref()).await?;
            watch.say(&format!("{message}: calibrating first"));
            let published = || PUBLISHED.map(|powder| powder.id.to_owned()).into();
            let powders = request.powders.clone().unwrap_or_else(published);
            let targets: Vec<Target> = powders.into_iter().map(Target::Powder).collect();
            calibrate(lab, &watch, &targets, None, request.simulator.as_deref(), common.seed)
                .await?;
            lab.start_evaluation(request).await?
        }
        started => started?,
    };
    watch.job(lab, &job.id, "evaluate").await?;
    Ok(lab.evaluation(&job.id).await?)
}

fn text(document: &Document) -> String {
    let published: Vec<Option<f64>> =
        document.rows.iter().map(|row| published_mae_mg(&row.powder, row.target_mg)).collect();
    let row = |(r, published): (&EvaluationRow, &Option<f64>)| {
        vec![
            r.controller.clone(),
            r.powder.clone(),
            format!("{}", r.target_mg),
            r.n.to_string(),
            format!("{:.2}", r.mae_mg),
            published.map_or("-".to_owned(), |mae_mg| format!("{mae_mg:.1}")),
            format!("{:.2}", r.sd_mg),
            format!("{:+.2}", r.bias_mg),
            percent(Some(r.over_share)),
            percent(Some(r.zero_share)),
            number(Some(r.shakes_mean), 1),
            number(r.seconds_mean, 0),
        ]
    };
    let header = [
        "controller",
        "powder",
        "target mg",
        "n",
        "MAE mg, simulation",
        "MAE mg, published, real robot",
        "sd mg",
        "bias mg",
        "over",
        "zero",
        "shakes",
        "s",
    ];
    let rows = table(&header, &document.rows.iter().zip(&published).map(row).collect::<Vec<_>>());
    let total = |s: &EvaluationSummary| {
        vec![
            s.controller.clone(),
            format!("{:.2}", s.mae_mg),
            format!("{:.2} to {:.2}", s.ci95[0], s.ci95[1]),
            format!("{:.2}", s.sd_trials_mg),
            format!("{:.2}", s.sd_within_cells_mg),
            s.bias_mg.map_or("-".to_owned(), |bias| format!("{bias:+.2}")),
            percent(s.over_share),
            percent(s.zero_share),
            number(s.shakes_mean, 1),
            number(s.seconds_mean, 0),
        ]
    };
    let header = [
        "controller",
        "MAE mg, simulation",
        "95 % interval",
        "sd of trials mg",
        "sd within cells mg",
        "bias mg",
        "over",
        "zero",
        "shakes",
        "s",
    ];
    let summary = table(&header, &document.summary.iter().map(total).collect::<Vec<_>>());
    let mut text = format!("{}\n\n{rows}\n\n{summary}", setting(document));
    if published.iter().any(Option::is_some) {
        let [mean, spread] = PUBLISHED_DOSES_OVERALL_MG;
        text.push_str(&format!(
            "\n\nPublished, real robot: {mean} +- {spread} mg over salt, sugar, sand, sodium bicarbonate and semolina at 15 and \
             20 mg (arXiv:2506.03896). Those doses were weighed by a robot, ours in a simulation: the columns are not one experiment."
        ));
    }
    text
}

/// Settings of the evaluation: the balance, the steps, the spoon.
fn setting(document: &Document) -> String {
    let extensions: Vec<String> = document
        .conditions
        .amplitudes()
        .iter()
        .map(|(name, amplitude)| format!("{name} {amplitude}"))
        .collect();
    let extensions = match extensions.is_empty() {
        true => "no extension".to_owned(),
        false => format!("extensions {}", extensions.join(", ")),
    };
    let under =
        document.under.as_ref().map_or_else(String::new, |under| format!("{}; ", words(under)));
    let substep = match document.conditions.substep_us {
        Some(us) => format!("substep {us} us; "),
        None => String::new(),
    };
    let card = match &document.card {
        Some(card) => {
            format!("computed on {card}, so that it does not count for which policy weighs best; ")
        }
        None => String::new(),
    };
    format!(
        "Simulation: no powder was weighed. Policy {}; a balance that shows steps of {} mg; at most {} steps a dose; {} grains on \
         the spoon, {extensions}; {substep}{under}{card}seed {}.",
        document.policy,
        document.readability_mg,
        document.max_shakes,
        document.conditions.particles,
        document.seed
    )
}

fn percent(share: Option<f64>) -> String {
    share.map_or("-".to_owned(), |share| format!("{:.0} %", 100.0 * share))
}

fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:.decimals$}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    fn document(target_mg: f64) -> Document {
        let extensions: BTreeMap<String, f64> = [("rotation".to_owned(), 1.0)].into();
        let row = EvaluationRow {
            controller: "policy".into(),
            powder: "sodium_bicarbonate".into(),
            target_mg,
            n: 5,
            mae_mg: 1.25,
            sd_mg: 0.5,
            bias_mg: -0.25,
            over_share: 0.2,
            zero_share: 0.0,
            shakes_mean: 6.0,
            seconds_mean: None,
        };
        let summary = EvaluationSummary {
            controller: "policy".into(),
            mae_mg: 1.25,
            ci95: [1.0, 1.5],
            sd_trials_mg: 0.5,
            sd_within_cells_mg: 0.5,
            bias_mg: Some(-0.25),
            over_share: Some(0.2),
            zero_share: Some(0.0),
            shakes_mean: Some(6.0),
            seconds_mean: Some(41.6),
        };
        Document {
            policy: "p-1".into(),
            repeats: 5,
            readability_mg: 0.1,
            max_shakes: 30,
            conditions: Conditions::named(Some(1500), &extensions).unwrap(),
            under: None,
            card: None,
            seed: 7,
            rows: vec![row],
            summary: vec![summary],
        }
    }

    #[test]
    fn the_text_says_what_weighed_and_puts_the_published_robot_beside_it() {
        let text = text(&document(15.0));
        assert!(text.starts_with("Simulation: no powder was weighed."), "{text}");
        for said in [
            "steps of 0.1 mg",
            "at most 30 steps",
            "1500 grains",
            "extensions rotation 1",
            "seed 7",
        ] {
            assert!(text.lines().next().unwrap().contains(said), "{said} is missing in {text}");
        }
        let row = text.lines().find(|line| line.contains("sodium_bicarbonate")).unwrap();
        let cells: Vec<&str> = row.split_whitespace().collect();
        assert_eq!(
            cells[..8],
            ["policy", "sodium_bicarbonate", "15", "5", "1.25", "3.6", "0.50", "-0.25"]
        );
        // Bench time was not recorded when this row was stored.
        assert_eq!(cells.last(), Some(&"-"));
        let summary = text.lines().find(|line| line.contains("1.00 to 1.50")).unwrap();
        assert!(
            summary.contains("-0.25")
                && summary.contains("20 %")
                && summary.trim_end().ends_with("42"),
            "{summary}"
        );
        assert!(text.contains("Published, real robot: 2.12 +- 1.53 mg"), "{text}");
    }

    #[test]
    fn the_text_names_a_substep_that_is_not_the_usual_one() {
        let usual = document(15.0);
        assert!(!text(&usual).contains("substep"));
        let conditions = usual.conditions.with_substep(40).unwrap();
        let finer = text(&Document { conditions, ..usual });
        assert!(finer.lines().next().unwrap().contains("; substep 40 us; seed 7."), "{finer}");
    }

    #[test]
    fn the_text_names_the_card_that_simulated() {
        assert!(!text(&document(15.0)).contains("computed on"));
        let on_card = Document { card: Some("H200, CUDA 13.0".into()), ..document(15.0) };
        let said = text(&on_card);
        assert!(said.lines().next().unwrap().contains("; computed on H200, CUDA 13.0, "), "{said}");
    }

    #[test]
    fn what_was_not_published_is_not_compared() {
        let text = text(&document(10.0));
        assert!(!text.contains("Published, real robot"), "{text}");
        let row = text.lines().find(|line| line.contains("sodium_bicarbonate")).unwrap();
        assert_eq!(row.split_whitespace().nth(5), Some("-"));
    }
}
