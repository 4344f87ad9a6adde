//! Investigations: what measured angles say that the calibrated simulator does not.

use super::check::Check;
use super::jobs::{corrupt, stored};
use super::{App, Error, Result, campaign_csv};
use crate::discover::report::{Report, Row, Verdict};
use crate::discover::{self, Settings};
use crate::domain::job::JobKind;
use crate::domain::powder::Method;
use crate::jobs::{InvestigationSpec, JobSpec, SIMULATOR};
use crate::store::jobs::{Job, JobRow};
use crate::store::page::{Page, PageQuery};
use crate::store::powders::Measurement;
use serde::{Deserialize, Serialize};

/// Columns without which a row is no run.
const REQUIRED: [&str; 2] = ["powder", "repose_deg"];
/// Campaigns in which nothing is wrong that are simulated when no number is named: p-values down to 0.002.
const SIMULATIONS: u32 = 499;

/// What to investigate. Everything has a default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct InvestigationRequest {
    /// The runs as CSV text, one a row; default every stored measurement of an angle of repose.
    ///
    /// Columns: `powder` and `repose_deg`, with `repose_sd_deg` and `n` a summary of n runs; of what was recorded, `session` (the day),
    /// `order_in_session`, `method` (camera, manual), `operator`, `batch`, `plate`, `relative_humidity_pct`, `temperature_c`, `rest_min`,
    /// `container_age_d`, `funnel_height_mm`, `base_diameter_mm`, `poured_mass_g`, `flow_time_s`, `vibration_rms_m_s2`, `ioniser_on`, and any
    /// other column. An empty cell is a missing value. A refusal names the cell, such as `row[2].repose_deg`; the header is row 1.
    pub measurements_csv: Option<String>,
    /// Campaigns in which nothing is wrong to compare with, 99 to 9999; default 499.
    pub simulations: Option<u32>,
    /// Seed; default 1.
    pub seed: Option<u64>,
}

/// An investigation: its job, what it looks at, and once it has succeeded what it found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Investigation {
    /// The job; the investigation has the same id.
    pub job: Job,
    /// Powder ids, in the order of the file.
    pub powders: Vec<String>,
    /// Runs, the repeats behind summaries counted.
    pub runs: u32,
    /// Days.
    pub sessions: u32,
    /// What was recorded and is looked at; a column of names that hardly repeat is not.
    pub covariates: Vec<String>,
    /// Campaigns in which nothing is wrong that it compares with.
    pub simulations: u32,
    /// Seed.
    pub seed: u64,
    /// Version of the simulator that is judged.
    pub simulator: String,
    /// Whether anything is wrong, and whether it has a name; absent until it has succeeded, like what follows.
    pub verdict: Option<Verdict>,
    /// Chance of evidence as strong for any cause if nothing is wrong.
    pub p_value: Option<f64>,
    /// What was found, in plain words.
    pub sentence: Option<String>,
    /// Everything that was found; absent from lists too.
    pub report: Option<Report>,
}

impl App {
    /// Queue an investigation. `false`: the same one was asked for before, and this is its job.
    ///
    /// # Errors
    /// `Invalid`: a file by row and column, runs that say nothing, a setting out of bounds. Nothing is stored then.
    pub async fn start_investigation(&self, request: InvestigationRequest) -> Result<(Job, bool)> {
        let mut check = Check::default();
        let simulations = request.simulations.unwrap_or(SIMULATIONS);
        let settings = check.keep(Settings { seed: request.seed.unwrap_or(1), simulations }.checked());
        check.done()?;
        let Some(settings) = settings else { unreachable!("checked above") };
        let csv = match request.measurements_csv {
            Some(csv) => csv,
            None => as_runs(&self.store().all_measurements(None).await?),
        };
        let campaign = campaign_csv::read(&csv, &REQUIRED)?.checked()?;
        let spec = InvestigationSpec { campaign, settings, method: discover::VERSION, simulator: SIMULATOR.to_owned() };
        Ok(self.jobs_or_refuse()?.enqueue(&JobSpec::Investigation(spec)).await?)
    }

    /// One investigation.
    pub async fn investigation(&self, id: &str) -> Result<Investigation> {
        let row = self.store().job(id).await?.filter(|row| row.job.kind == JobKind::Investigation);
        let row = row.ok_or_else(|| Error::not_found("investigation", id))?;
        let report = row.result.as_deref().map(stored).transpose()?;
        Ok(Investigation { report, ..without_report(row)? })
    }

    /// Investigations, newest first, without their reports.
    pub async fn investigations(&self, page: PageQuery) -> Result<Page<Investigation>> {
        self.jobs_as(JobKind::Investigation, page, without_report).await
    }

    /// Every row of the file of an investigation as CSV, as [`predictions_csv`] writes it.
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
            let advice = format!("investigation {id} has no report: only those that have succeeded have one");
            Error::conflict("investigation_unfinished", advice)
        })
    }
}

/// The angle of every row, by the simulator as it was and by the extended one, as CSV; empty where nothing is known of a powder.
pub fn predictions_csv(rows: &[Row]) -> String {
    let mut text = String::from("row,powder,before_deg,before_sd_deg,after_deg,after_sd_deg\n");
    let cell = |mean: Option<f64>| mean.map_or_else(String::new, |mean| mean.to_string());
    for row in rows {
        let Row { row, powder, before_deg, before_sd_deg, after_deg, after_sd_deg, .. } = row;
        let (before, after) = (cell(*before_deg), cell(*after_deg));
        // Numbers and powder ids: there is nothing to quote.
        text += &format!("{row},{powder},{before},{before_sd_deg},{after},{after_sd_deg}\n");
    }
    text
}

/// Stored measurements as a campaign's file: nobody recorded their days.
fn as_runs(measurements: &[Measurement]) -> String {
    let mut text = String::from("powder,method,repose_deg,repose_sd_deg,n\n");
    for Measurement { powder, method, repose_deg, sd_deg, n, .. } in measurements {
        let method = match method {
            Method::Automated => "camera",
            Method::Manual => "manual",
        };
        text += &format!("{powder},{method},{repose_deg},{sd_deg},{}\n", (*n).min(campaign_csv::REPEATS_MAX));
    }
    text
}

/// The part of a report that lists have.
#[derive(Deserialize)]
struct Glance {
    verdict: Verdict,
    p_value: f64,
    sentence: String,
}

fn without_report(row: JobRow) -> Result<Investigation> {
    let JobSpec::Investigation(spec) = stored(&row.spec)? else {
        return Err(corrupt("an investigation's specification"));
    };
    let found: Option<Glance> = row.result.as_deref().map(stored).transpose()?;
    let InvestigationSpec { campaign, settings, simulator, .. } = spec;
    Ok(Investigation {
        job: row.job,
        runs: campaign.runs.len() as u32,
        sessions: campaign.sessions() as u32,
        covariates: campaign.covariates.into_iter().map(|covariate| covariate.name).collect(),
        powders: campaign.powders,
        simulations: settings.simulations,
        seed: settings.seed,
        simulator,
        verdict: found.as_ref().map(|found| found.verdict),
        p_value: found.as_ref().map(|found| found.p_value),
        sentence: found.map(|found| found.sentence),
        report: None,
    })
}
