//! `flip discover`: what measured angles and balance readings reveal that the simulator does not
//! reproduce.

use super::Common;
use super::failure::Failure;
use super::lab::Lab;
use super::labels::LabelArguments;
use super::measurements::read;
use super::session::{with_app, with_reader};
use super::shakes::Bench;
use super::table::table;
use super::watch::Watch;
use crate::app::{
    CURRENT, ChosenSimulator, ColumnRead, CurrentSimulator, DateOrder, FileRead,
    InvestigationRequest, Report, SimulatorVersion, StoredShakes, names, predictions_csv,
    report_html,
};
use anyhow::Context;
use flip_core::domain::FieldError;
use serde::Serialize;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Number of causes listed in the text; the document has all.
const CAUSES_SHOWN: usize = 5;
/// Number of left-out rows listed in the text; the document has all.
const ROWS_SHOWN: usize = 20;

/// Arguments of `flip discover`.
#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub(super) struct Arguments {
    #[command(subcommand)]
    action: Option<Action>,
    #[command(flatten)]
    campaign: CampaignArguments,
}

#[derive(Debug, clap::Subcommand)]
enum Action {
    /// Predict the angles of new rows with an extended simulator, as CSV on standard output.
    Predict {
        /// Simulator version, `sv-…`, made by an investigation; if omitted, the current one.
        #[arg(long, value_name = "VERSION", default_value = CURRENT)]
        simulator: String,
        /// CSV file of the rows to predict: powder, and the columns through which the version's
        /// causes act.
        #[arg(long, value_name = "FILE")]
        measurements: PathBuf,
    },
    /// List the simulator's versions, newest first, and show which one is current.
    Versions,
    /// Make a version current (used where none is named), or roll back to another one or to the
    /// base.
    Use {
        /// Version, `sv-…`, or `base`.
        #[arg(value_name = "VERSION")]
        simulator: String,
        /// Why, for the record.
        #[arg(long, value_name = "TEXT")]
        reason: Option<String>,
    },
}

/// What to investigate.
#[derive(Debug, clap::Args)]
struct CampaignArguments {
    /// Angles of repose as a CSV file, one run per row, with the conditions recorded for each.
    ///
    /// Columns: powder and repose_deg; with repose_sd_deg and n, the row is a summary of n runs.
    /// Conditions: session (the day), order_in_session, method (camera, manual), operator, batch,
    /// plate, relative_humidity_pct, temperature_c, rest_min, container_age_d, funnel_height_mm,
    /// base_diameter_mm, poured_mass_g, flow_time_s, vibration_rms_m_s2, ioniser_on, and any other
    /// column. An empty cell is a missing value.
    #[arg(long, value_name = "FILE", required_unless_present_any = ["traces", "shakes"])]
    measurements: Option<PathBuf>,
    /// Balance readings of weighings as a CSV file, one reading per row; with or without angles of
    /// repose.
    ///
    /// Columns: weighing_id, t_s and balance_mg. Conditions: stable, powder, session (the day),
    /// shake_index (shakes so far), shake_mm, spoon_pitch_deg, spoon_fill_mg, target_mg,
    /// relative_humidity_pct, vibration_rms_m_s2, and kind: dose, or for a control log zero (empty
    /// pan) or standard (a standard mass). An empty cell is a missing value.
    #[arg(long, value_name = "FILE")]
    traces: Option<PathBuf>,
    /// Shakes of weighings: those that are stored, or those of a CSV file as `flip shakes export`
    /// prints it. They are compared with what the calibrated simulator lets fall in the same steps.
    #[arg(long, value_name = "FILE", num_args = 0..=1)]
    shakes: Option<Option<PathBuf>>,
    /// Judge only stored shakes of this powder.
    #[arg(long, value_name = "ID", requires = "shakes")]
    powder: Option<String>,
    /// Judge only stored shakes of this lot.
    #[arg(long, requires = "shakes")]
    lot: Option<String>,
    /// Judge only stored shakes of weighings on this kind of bench, and imported ones.
    #[arg(long, value_enum, requires = "shakes")]
    shaken_on: Option<Bench>,
    /// Maximum spoonfuls of each powder to replay: about 4 s of a processor each.
    ///
    /// Where nothing is wrong a third of them are.
    #[arg(long, value_name = "N", default_value_t = 600)]
    budget_replays: u32,
    /// Order of dates such as 2/3/2026 and 26/02/21; needed where the column is ambiguous.
    #[arg(long, value_name = "ORDER")]
    dates: Option<Dates>,
    /// Maximum heaps to simulate, 0 to 10000.
    ///
    /// They check the simulator's own numerics, and find and verify the amplitude of an accepted
    /// extension. With 0 the amplitude is read from a table and not verified.
    #[arg(long, value_name = "N", default_value_t = 60, allow_negative_numbers = true)]
    budget_runs: u32,
    /// Null campaigns, in which nothing is wrong, to compare with, 99 to 9999.
    #[arg(long, value_name = "N", default_value_t = 499, allow_negative_numbers = true)]
    simulations: u32,
    /// Folder for report.html, report.json and predict.csv; created if missing.
    #[arg(long, value_name = "DIR", required = true)]
    out: Option<PathBuf>,
    #[command(flatten)]
    labels: LabelArguments,
}

impl CampaignArguments {
    /// The stored shakes to judge, if no file is given.
    fn stored_shakes(&self) -> Result<Option<StoredShakes>, FieldError> {
        let of_stored = [
            ("powder", self.powder.is_some()),
            ("lot", self.lot.is_some()),
            ("shaken-on", self.shaken_on.is_some()),
        ];
        match (&self.shakes, of_stored.iter().find(|(_, given)| *given)) {
            (Some(Some(_)), Some((option, _))) => {
                let advice = "is for stored shakes: leave the file of --shakes out, or this option";
                Err(FieldError::new(*option, advice))
            }
            (Some(None), _) => Ok(Some(StoredShakes {
                powder: self.powder.clone(),
                lot: self.lot.clone(),
                bench: self.shaken_on.map(Bench::kind),
            })),
            _ => Ok(None),
        }
    }
}

/// Order of day, month and year in a date.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
enum Dates {
    /// 2/3/2026 is 2 March.
    #[value(name = "day-first")]
    Day,
    /// 2/3/2026 is 3 February.
    #[value(name = "month-first")]
    Month,
    /// 26/02/21 is 21 February 2026.
    #[value(name = "year-first")]
    Year,
}

impl From<Dates> for DateOrder {
    fn from(dates: Dates) -> Self {
        match dates {
            Dates::Day => Self::DayFirst,
            Dates::Month => Self::MonthFirst,
            Dates::Year => Self::YearFirst,
        }
    }
}

/// Investigates, writes the files and prints the report: a success whatever the verdict. Or queries
/// a version.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.action {
        None => discover(common, &arguments.campaign),
        Some(Action::Predict { simulator, measurements }) => {
            let csv = read("measurements", measurements)?;
            let rows = with_app(common, async |lab| Ok(lab.predict(simulator, &csv).await?))?;
            common.print(&rows, || predictions_csv(&rows))
        }
        Some(Action::Versions) => {
            let (versions, current) = with_reader(common, async |lab| {
                Ok((lab.simulators().await?, lab.current_simulator().await?))
            })?;
            common.print(&versions, || {
                format!("{}\n\n{}", versions_text(&versions), current_text(&current))
            })
        }
        Some(Action::Use { simulator, reason }) => {
            let chosen = ChosenSimulator { simulator: simulator.clone(), reason: reason.clone() };
            let current = with_app(common, async |lab| Ok(lab.choose_simulator(&chosen).await?))?;
            common.print(&current, || current_text(&current))
        }
    }
}

fn versions_text(versions: &[SimulatorVersion]) -> String {
    let row = |version: &SimulatorVersion| {
        let sentence = version.body["sentence"].as_str().unwrap_or_default().to_owned();
        vec![version.id.clone(), version.base.clone(), version.created_at.to_string(), sentence]
    };
    match versions {
        [] => "no version: `flip discover` makes one where an extension predicts days that it has not seen".to_owned(),
        versions => table(&["version", "extends", "made", "by"], &versions.iter().map(row).collect::<Vec<_>>()),
    }
}

fn current_text(current: &CurrentSimulator) -> String {
    let CurrentSimulator { simulator, chosen_at, before, .. } = current;
    let since = chosen_at.map_or_else(String::new, |at| format!(" since {at}"));
    let before =
        before.as_ref().map_or_else(String::new, |before| format!(", before that {before}"));
    format!("current: {simulator}{since}{before}")
}

fn discover(common: &Common, arguments: &CampaignArguments) -> Result<(), Failure> {
    let Some(out) = &arguments.out else {
        return Err(FieldError::new("out", "is required").into());
    };
    let text_of =
        |name, path: &Option<PathBuf>| path.as_ref().map(|path| read(name, path)).transpose();
    let request = InvestigationRequest {
        measurements_csv: text_of("measurements", &arguments.measurements)?,
        traces_csv: text_of("traces", &arguments.traces)?,
        shakes_csv: text_of("shakes", &arguments.shakes.clone().flatten())?,
        shakes: arguments.stored_shakes()?,
        budget_replays: Some(arguments.budget_replays),
        dates: arguments.dates.map(Into::into),
        simulations: Some(arguments.simulations),
        budget_runs: Some(arguments.budget_runs),
        seed: Some(common.seed),
        labels: arguments.labels.all()?,
    };
    let report = with_app(common, async |lab| investigate(lab, request, out).await)?;
    let json = serde_json::to_string_pretty(&report)? + "\n";
    let files = [
        ("report.json", json),
        ("report.html", report_html::html(&report)),
        ("predict.csv", predictions_csv(&report.rows)),
    ];
    write_all(out, &files)?;
    common.print(&report, || text(&report, out))
}

async fn investigate(
    lab: &Lab,
    request: InvestigationRequest,
    out: &Path,
) -> Result<Report, Failure> {
    let (job, _) = lab.start_investigation(request).await?;
    // Before the work, which would be lost if the folder cannot be created.
    let refused =
        |error| FieldError::new("out", format!("{} cannot be made: {error}", out.display()));
    fs::create_dir_all(out).map_err(refused)?;
    Watch::new().job(lab, &job.id, "discover").await?;
    let report = lab.investigation(&job.id).await?.report;
    Ok(report.ok_or_else(|| anyhow::anyhow!("investigation {} has no report", job.id))?)
}

/// Writes files so that each is complete whenever it exists: all are first written under other
/// names.
fn write_all(folder: &Path, files: &[(&str, String)]) -> Result<(), Failure> {
    let part = |name: &str| folder.join(format!("{name}.part"));
    let write = |(name, text): &(&str, String)| {
        let mut file = File::create(part(name))?;
        file.write_all(text.as_bytes())?;
        file.sync_all()
    };
    let written = files.iter().try_for_each(write);
    let whole = written.and_then(|()| {
        files.iter().try_for_each(|(name, _)| fs::rename(part(name), folder.join(name)))
    });
    Ok(whole.with_context(|| format!("cannot write into {}", folder.display()))?)
}

fn text(report: &Report, out: &Path) -> String {
    let decision = match (report.null_check.is_judged(), &report.spoon) {
        (false, Some(spoon)) => format!(
            "verdict {}, p = {:.3} among {} replays of these spoonfuls by the calibrated simulator",
            word(&report.verdict),
            report.p_value,
            spoon.campaigns
        ),
        (true, _) => format!(
            "verdict {}, p = {:.3} among {} campaigns of this design in which nothing is wrong",
            word(&report.verdict),
            report.p_value,
            report.null_check.campaigns
        ),
        (false, None) => {
            format!("angles not judged; verdict of the rest {}", word(&report.verdict))
        }
    };
    let causes = report.causes.iter().take(CAUSES_SHOWN).map(|cause| {
        let probability = format!("{:.2}", cause.inclusion_probability);
        vec![
            names::cause(&cause.mechanism),
            cause.family.clone(),
            probability,
            list(&cause.powders),
        ]
    });
    let findings = report.findings.iter().map(|finding| {
        let [lower, upper] = finding.ci95;
        vec![
            word(&finding.channel),
            finding.covariate.clone().unwrap_or_else(|| "not recorded".to_owned()),
            names::with_unit(&format!("{:+.2}", finding.effect), &finding.unit),
            format!("{lower:+.2} to {upper:+.2}"),
            finding.span.clone(),
            list(&finding.powders),
        ]
    });
    let untestable =
        report.untestable.iter().map(|it| vec![names::cause(&it.mechanism), it.reason.clone()]);
    let files = report.files.iter().flat_map(read_as);
    let left_out = report.left_out.iter().map(|it| vec![it.column.clone(), it.reason.clone()]);
    let parts = [
        report.sentence.clone(),
        decision,
        section(&["cause", "family", "probability, if any", "powders"], causes.collect()),
        section(
            &["departs", "with", "effect", "95 % interval", "from - to", "powders"],
            findings.collect(),
        ),
        section(&["cannot be told", "because"], untestable.collect()),
        files.collect::<Vec<_>>().join("\n\n"),
        section(&["column left out", "because it"], left_out.collect()),
        format!("report.html, report.json and predict.csv are in {}", out.display()),
    ];
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join("\n\n")
}

/// How a file was read: its columns, and what was left out.
fn read_as(file: &FileRead) -> Vec<String> {
    let column = |it: &ColumnRead| {
        vec![
            it.column.clone(),
            word(&it.taken_as),
            it.filled.to_string(),
            it.missing.to_string(),
            it.note.clone(),
        ]
    };
    let header = format!("column of {}", file.file);
    let columns = section(
        &[&header, "taken as", "filled", "missing", ""],
        file.columns.iter().map(column).collect(),
    );
    let left_out =
        file.left_out.iter().map(|it| format!("left out: rows {}: {}", rows(&it.rows), it.reason));
    let powders = file.powders.iter().map(|it| format!("powder `{}` is {}", it.name, it.id));
    [columns].into_iter().chain(left_out).chain(file.notes.iter().cloned()).chain(powders).collect()
}

/// Row numbers, only the first of them if there are many.
fn rows(rows: &[u32]) -> String {
    let named: Vec<String> = rows.iter().take(ROWS_SHOWN).map(u32::to_string).collect();
    let more = rows.len().saturating_sub(ROWS_SHOWN);
    named.join(", ") + &if more > 0 { format!(" and {more} more") } else { String::new() }
}

/// A table; empty if it has no rows.
fn section(header: &[&str], rows: Vec<Vec<String>>) -> String {
    if rows.is_empty() { String::new() } else { table(header, &rows) }
}

fn list(powders: &[String]) -> String {
    if powders.is_empty() { "-".to_owned() } else { powders.join(", ") }
}

/// Its name in the document.
fn word(value: &impl Serialize) -> String {
    serde_json::to_value(value)
        .ok()
        .and_then(|value| value.as_str().map(str::to_owned))
        .unwrap_or_default()
}
