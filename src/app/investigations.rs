//! Investigations: what measured angles and balance readings reveal that the calibrated simulator
//! does not reproduce.

use super::campaign_csv::{self, CampaignRead};
use super::check::Check;
use super::csv_file::date::DateOrder;
use super::jobs::{corrupt, specification, stored};
use super::judged_shakes::{AskedOfSpoons, StoredShakes};
use super::trace_csv::{self, TracesRead};
use super::{App, Error, Result, report_html};
use crate::jobs::{Heaps, InvestigationSpec, JobSpec, SIMULATOR};
use flip_core::domain::FieldError;
use flip_core::domain::job::JobKind;
use flip_core::domain::labels::Labels;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::powder::Method;
use flip_discover::report::{Report, Row, Verdict};
use flip_discover::{self as discover, Campaign, FitSet, Measured, Settings};
use flip_store::jobs::{Job, JobRow};
use flip_store::page::{LIST_LIMIT_MAX, Page, PageQuery};
use flip_store::parameter_sets::CalibratedSet;
use flip_store::powders::Measurement;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Columns without which a row is not a run.
const REQUIRED: [&str; 2] = ["powder", "repose_deg"];
/// Default number of null campaigns, in which nothing is wrong: p-values down to 0.002.
const SIMULATIONS: u32 = 499;
/// Default number of simulated heaps: a minute or two.
const BUDGET_RUNS: u32 = 60;
/// Maximum number of heaps.
const BUDGET_RUNS_MAX: u32 = 10_000;
/// Frictions that give these angles with a cohesion of 0.3, for powders without a calibration;
/// `docs/repose_grid.csv`.
const UNCALIBRATED: [[f64; 2]; 7] = [
    [0.163, 27.8],
    [0.325, 30.2],
    [0.488, 32.5],
    [0.65, 36.1],
    [0.812, 38.7],
    [0.975, 41.6],
    [1.137, 43.8],
];

/// What to investigate. Everything has a default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InvestigationRequest {
    /// The runs as CSV text, one per row (docs/reference/csv.md); default every stored measurement
    /// of an angle of repose, or none if `traces_csv` or shakes are given.
    pub measurements_csv: Option<String>,
    /// Balance readings of weighings as CSV text, one per row (docs/reference/csv.md); default none.
    pub traces_csv: Option<String>,
    /// Shakes of weighings as CSV text, one per row (docs/reference/csv.md); default none.
    pub shakes_csv: Option<String>,
    /// Stored shakes of weighings in place of a file; default none.
    pub shakes: Option<StoredShakes>,
    /// Maximum spoonfuls of each powder to replay, default 600. Where nothing is wrong a third of
    /// them are.
    pub budget_replays: Option<u32>,
    /// Order of dates such as 2/3/2026 and 26/02/21, `day_first`, `month_first` or `year_first`;
    /// needed where the column is ambiguous.
    pub dates: Option<DateOrder>,
    /// Null campaigns, in which nothing is wrong, to compare with, 99 to 9999; default 499.
    pub simulations: Option<u32>,
    /// Maximum heaps to simulate, 0 to 10000; default 60. They check the simulator's own numerics
    /// and, if an extension is accepted, find and verify its amplitude; with 0 the amplitude is
    /// read from a table and not verified.
    pub budget_runs: Option<u32>,
    /// Seed; default 1.
    pub seed: Option<u64>,
    /// What the caller writes on it, to find it again.
    #[serde(default, skip_serializing_if = "Labels::is_empty")]
    pub labels: Labels,
}

/// An investigation: its job, its data, and its findings once it has succeeded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Investigation {
    /// The job; the investigation has the same id.
    pub job: Job,
    /// Powder ids, in the order of the files.
    pub powders: Vec<String>,
    /// Number of runs, including the repeats behind summaries.
    pub runs: u32,
    /// Number of days on which runs were made.
    pub sessions: u32,
    /// Weighings whose balance readings it uses, including controls.
    #[serde(default)]
    pub weighings: u32,
    /// Spoonfuls whose shakes it judges.
    #[serde(default)]
    pub spoonfuls: u32,
    /// Recorded conditions. The report's `files` lists the columns left out, and why.
    pub covariates: Vec<String>,
    /// Number of null campaigns, in which nothing is wrong, that it compares with.
    pub simulations: u32,
    /// Maximum heaps it may simulate.
    pub budget_runs: u32,
    /// Seed.
    pub seed: u64,
    /// Simulator version under test.
    pub simulator: String,
    /// Whether anything is wrong, and whether its cause can be named; absent until it has
    /// succeeded, like the following fields.
    pub verdict: Option<Verdict>,
    /// Probability of equally strong evidence for any cause if nothing is wrong.
    pub p_value: Option<f64>,
    /// The finding, in plain words.
    pub sentence: Option<String>,
    /// The full report; also absent from lists.
    pub report: Option<Report>,
}

impl InvestigationRequest {
    fn asks_spoons(&self) -> bool {
        self.shakes.is_some() || self.shakes_csv.is_some()
    }
}

impl App {
    /// Queues an investigation. `false`: the same one was requested before, and this is its job.
    ///
    /// # Errors
    /// `Invalid`: errors in a file by row and column, uninformative runs, a setting out of bounds.
    /// Nothing is stored then.
    pub async fn start_investigation(&self, request: InvestigationRequest) -> Result<(Job, bool)> {
        let mut check = Check::default();
        let simulations = request.simulations.unwrap_or(SIMULATIONS);
        let settings =
            check.keep(Settings { seed: request.seed.unwrap_or(1), simulations }.checked());
        let budget_runs = request.budget_runs.unwrap_or(BUDGET_RUNS);
        check.count("budget_runs", budget_runs, 0, BUDGET_RUNS_MAX);
        check.done()?;
        let Some(settings) = settings else { unreachable!("checked above") };
        let csv = match request.measurements_csv {
            None if request.traces_csv.is_none() && !request.asks_spoons() => {
                Some(as_runs(&self.store().all_measurements(None).await?))
            }
            csv => csv,
        };
        let mut files = Vec::new();
        let campaign = match csv {
            Some(csv) => {
                let CampaignRead { mut campaign, read } =
                    campaign_csv::read(&csv, &REQUIRED, request.dates)?;
                files.push(read);
                let mut said = self.store().said_of_solubility().await?;
                said.retain(|(id, _)| campaign.powders.contains(id));
                campaign.soluble = said.into_iter().collect();
                Some(campaign.checked()?)
            }
            None => None,
        };
        let traces = match request.traces_csv {
            Some(csv) => {
                let TracesRead { traces, read } = trace_csv::read(&csv).map_err(of_traces)?;
                files.push(read);
                Some(traces)
            }
            None => None,
        };
        let measured =
            Measured { campaign: campaign.as_ref(), traces: traces.as_ref(), spoon: None };
        let asked = AskedOfSpoons {
            csv: request.shakes_csv.as_deref(),
            stored: request.shakes.as_ref(),
            budget_replays: request.budget_replays,
            beside: measured.channels(),
            seed: settings.seed,
        };
        let shakes = self.spoon_spec(asked).await?;
        let heaps = match (&campaign, budget_runs) {
            (Some(campaign), 1..) => {
                Some(Heaps { budget_runs, sets: self.stand_ins(campaign).await? })
            }
            _ => None,
        };
        let (method, simulator) = (discover::VERSION, SIMULATOR.to_owned());
        let spec = InvestigationSpec {
            campaign,
            traces,
            shakes,
            settings,
            heaps,
            files,
            method,
            simulator,
        };
        self.queue(JobSpec::Investigation(spec), request.labels).await
    }

    /// A parameter set for each measured powder: its own, else that of the calibrated powder with
    /// the nearest angle, else an uncalibrated one.
    async fn stand_ins(&self, campaign: &Campaign) -> Result<Vec<(FitSet, ParameterSet)>> {
        let mut known: Vec<(String, CalibratedSet)> = Vec::new();
        let every = PageQuery::first(LIST_LIMIT_MAX).window(LIST_LIMIT_MAX)?;
        for powder in self.store().powders(every).await?.items {
            let sets = self.calibrated_sets(Some(&powder.id), 0.0, None).await?.unwrap_or_default();
            known.extend(sets.into_iter().next().map(|set| (powder.id, set)));
        }
        let mut stands = Vec::new();
        for (k, powder) in campaign.powders.iter().enumerate() {
            let angles =
                campaign.runs.iter().filter(|run| run.powder == k).filter_map(|run| run.value);
            let (sum, count) =
                angles.fold((0.0, 0), |(sum, count), angle| (sum + angle, count + 1));
            if count == 0 {
                continue;
            }
            let distance = |deg: f64| (deg - sum / f64::from(count)).abs();
            let own = known.iter().find(|it| it.0 == *powder);
            let nearest = || {
                known
                    .iter()
                    .min_by(|a, b| distance(a.1.repose_deg).total_cmp(&distance(b.1.repose_deg)))
            };
            let (parameters, source) = match own.or_else(nearest) {
                Some((of, set)) => (set.parameters, format!("calibrated for {of}")),
                None => {
                    let by =
                        |a: &&[f64; 2], b: &&[f64; 2]| distance(a[1]).total_cmp(&distance(b[1]));
                    let [friction, deg] =
                        *UNCALIBRATED.iter().min_by(by).unwrap_or(&UNCALIBRATED[0]);
                    let set = ParameterSet::default()
                        .with("friction", friction)?
                        .with("cohesion", 0.3)?;
                    (set, format!("uncalibrated, of about {deg} deg"))
                }
            };
            stands.push((
                FitSet { powder: powder.clone(), set: parameters.id(), source },
                parameters,
            ));
        }
        Ok(stands)
    }

    /// One investigation.
    pub async fn investigation(&self, id: &str) -> Result<Investigation> {
        let row = self.store().job(id).await?.filter(|row| row.job.kind == JobKind::Investigation);
        let row = self.placed(row.ok_or_else(|| Error::not_found("investigation", id))?).await?;
        let report = row.result.as_deref().map(stored).transpose()?;
        Ok(Investigation { report, ..without_report(row)? })
    }

    /// Investigations, newest first, without their reports.
    pub async fn investigations(&self, page: PageQuery) -> Result<Page<Investigation>> {
        self.jobs_as(JobKind::Investigation, page, without_report).await
    }

    /// Every row of an investigation's file as CSV, in the format of [`predictions_csv`].
    ///
    /// # Errors
    /// `NotFound`; `Conflict` (`investigation_unfinished`) while there is no report.
    pub async fn predictions(&self, id: &str) -> Result<String> {
        Ok(predictions_csv(&self.report(id).await?.rows))
    }

    /// The report of an investigation.
    ///
    /// # Errors
    /// As [`Self::predictions`].
    pub async fn report(&self, id: &str) -> Result<Report> {
        self.investigation(id).await?.report.ok_or_else(|| {
            let advice = format!(
                "investigation {id} has no report: only those that have succeeded have one"
            );
            Error::conflict("investigation_unfinished", advice)
        })
    }

    /// The report's sections as HTML, with the registered names of powders.
    ///
    /// # Errors
    /// As [`Self::predictions`].
    pub async fn report_fragment(&self, id: &str) -> Result<String> {
        let report = self.report(id).await?;
        let powders = self.store().powder_names().await?.into_iter().collect();
        Ok(report_html::fragment(&report, &powders))
    }
}

/// The angle of every row, by the original simulator and by the extended one, as CSV; empty for an
/// unknown powder.
pub fn predictions_csv(rows: &[Row]) -> String {
    let mut text = String::from("row,powder,before_deg,before_sd_deg,after_deg,after_sd_deg\n");
    let cell = |mean: Option<f64>| mean.map_or_else(String::new, |mean| mean.to_string());
    for row in rows {
        let Row { row, powder, before_deg, before_sd_deg, after_deg, after_sd_deg, .. } = row;
        let (before, after) = (cell(*before_deg), cell(*after_deg));
        // Numbers and powder ids: nothing needs quoting.
        text += &format!("{row},{powder},{before},{before_sd_deg},{after},{after_sd_deg}\n");
    }
    text
}

/// The rows that [`predictions_csv`] wrote; `None` if it did not write this.
pub fn predictions_of_csv(text: &str) -> Option<Vec<Row>> {
    text.lines().skip(1).map(prediction).collect()
}

fn prediction(line: &str) -> Option<Row> {
    let cells: Vec<&str> = line.split(',').collect();
    let [row, powder, before, before_sd, after, after_sd] = cells[..] else { return None };
    let mean = |cell: &str| match cell {
        "" => Some(None),
        cell => cell.parse().ok().map(Some),
    };
    Some(Row {
        row: row.parse().ok()?,
        powder: powder.to_owned(),
        measured_deg: None,
        before_deg: mean(before)?,
        before_sd_deg: before_sd.parse().ok()?,
        after_deg: mean(after)?,
        after_sd_deg: after_sd.parse().ok()?,
    })
}

/// Marks errors as those of the traces file: the file of angles may have the same rows and columns.
fn of_traces(error: Error) -> Error {
    let named = |it: FieldError| match it.field.as_str() {
        "traces" => it,
        field => FieldError::new(format!("traces.{field}"), it.message),
    };
    match error {
        Error::Invalid(all) => Error::Invalid(all.into_iter().map(named).collect()),
        error => error,
    }
}

/// Stored measurements in the format of a campaign's file: their days were not recorded.
fn as_runs(measurements: &[Measurement]) -> String {
    let mut text = String::from("powder,method,repose_deg,repose_sd_deg,n\n");
    for Measurement { powder, method, repose_deg, sd_deg, n, .. } in measurements {
        let method = match method {
            Method::Automated => "camera",
            Method::Manual => "manual",
        };
        text += &format!(
            "{powder},{method},{repose_deg},{sd_deg},{}\n",
            (*n).min(campaign_csv::REPEATS_MAX)
        );
    }
    text
}

/// The part of a report that is included in lists.
#[derive(Deserialize)]
struct Glance {
    verdict: Verdict,
    p_value: f64,
    sentence: String,
}

fn without_report(row: JobRow) -> Result<Investigation> {
    let JobSpec::Investigation(spec) = specification(&row)? else {
        return Err(corrupt("an investigation's specification"));
    };
    let found: Option<Glance> = row.result.as_deref().map(stored).transpose()?;
    let InvestigationSpec { campaign, traces, shakes, settings, heaps, simulator, .. } = spec;
    let (campaign, weighings) =
        (campaign.unwrap_or_default(), traces.map_or(Vec::new(), |traces| traces.weighings));
    let mut powders = campaign.powders;
    let sessions = campaign.runs.iter().map(|run| run.session).collect::<BTreeSet<_>>().len();
    let weighed = weighings.iter().filter_map(|weighing| weighing.powder.as_ref());
    let spoonfuls = shakes.map_or(Vec::new(), |shakes| shakes.spoonfuls);
    let shaken = spoonfuls.iter().map(|spoonful| &spoonful.powder);
    for powder in weighed.chain(shaken) {
        powders.extend((!powders.contains(powder)).then(|| powder.clone()));
    }
    Ok(Investigation {
        job: row.job,
        runs: campaign.runs.len() as u32,
        sessions: sessions as u32,
        weighings: weighings.len() as u32,
        spoonfuls: spoonfuls.len() as u32,
        covariates: campaign.covariates.into_iter().map(|covariate| covariate.name).collect(),
        powders,
        simulations: settings.simulations,
        budget_runs: heaps.map_or(0, |heaps| heaps.budget_runs),
        seed: settings.seed,
        simulator,
        verdict: found.as_ref().map(|found| found.verdict),
        p_value: found.as_ref().map(|found| found.p_value),
        sentence: found.map(|found| found.sentence),
        report: None,
    })
}
