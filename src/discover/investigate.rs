//! The whole of an investigation: from a campaign to a report.

use super::campaign::Campaign;
use super::hypothesis::{Cause, Responses};
use super::posterior::Posterior;
use super::report::{
    CauseReport, Evidence, NullCheck, Report, Row, SCHEMA_VERSION, SimulatorVersions, UntestableReport, Verdict,
};
use super::screen::{Prepared, Screening, Settings, screen_prepared};
use crate::domain::FieldError;
use crate::domain::job::Progress;
use std::ops::ControlFlow;

/// Chance of a false alarm that is accepted.
pub(super) const SIGNIFICANCE: f64 = 0.05;
/// Inclusion probability from which a cause is claimed.
pub(super) const CLAIM: f64 = 0.8;

/// Investigate a campaign.
///
/// | argument | meaning |
/// |----------|---------|
/// | `responses` | what a simulator says of how much each mechanism moves each powder |
/// | `base` | version of the simulator that is judged |
/// | `on_progress` | hears what is being done; `Break` stops, and there is no report |
///
/// # Errors
/// A setting out of bounds; a campaign whose runs say nothing of their noise.
pub fn investigate(
    campaign: &Campaign,
    responses: &Responses,
    base: &str,
    settings: &Settings,
    mut on_progress: impl FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Option<Report>, FieldError> {
    let mut step =
        |fraction: f64, message: &str| on_progress(&Progress { fraction, message: message.to_owned() }).is_break();
    if step(0.0, "judging every cause, here and where nothing is wrong") {
        return Ok(None);
    }
    let settings = settings.checked()?;
    let prepared = Prepared::new(campaign, responses)?;
    let screening = screen_prepared(&prepared, campaign, &settings);
    let posterior = Posterior::new(&prepared);
    let mut report = blank(&screening, base);
    report.rows = rows(campaign, &posterior);
    report.causes = causes(&prepared, &posterior);
    Ok(Some(report))
}

fn blank(screening: &Screening, base: &str) -> Report {
    let untestable = |it: &super::Untestable| UntestableReport {
        mechanism: it.mechanism.name().0.to_owned(),
        reason: it.reason.clone(),
    };
    Report {
        schema_version: SCHEMA_VERSION,
        sentence: String::new(),
        verdict: Verdict::NoDiscrepancy,
        p_value: screening.p_value,
        findings: Vec::new(),
        causes: Vec::new(),
        ambiguous_between: Vec::new(),
        unexplained: None,
        suggested_experiment: None,
        simulator_version: SimulatorVersions { base: base.to_owned(), extended: None, verified: false },
        gain: None,
        minimum_detectable: Vec::new(),
        blind_spots: Vec::new(),
        evidence: Vec::<Evidence>::new(),
        untestable: screening.untestable.iter().map(untestable).collect(),
        null_check: NullCheck {
            campaigns: screening.null.len() as u32,
            statistic: screening.statistic,
            threshold95: screening.null[(0.95 * screening.null.len() as f64) as usize],
        },
        rows: Vec::new(),
        curves: Vec::new(),
        simulator_runs: 0,
        wall_s: 0.0,
    }
}

/// Every row of the file, before and after; repeats of a summary are one row.
fn rows(campaign: &Campaign, posterior: &Posterior<'_>) -> Vec<Row> {
    let predicted = posterior.predict(campaign);
    let mut rows: Vec<Row> = Vec::new();
    for (run, [before, after]) in campaign.runs.iter().zip(predicted) {
        if rows.last().is_some_and(|last| last.row == run.row) {
            continue;
        }
        let known = |mean: f64| mean.is_finite().then_some(mean);
        let repeats = campaign.runs.iter().filter(|other| other.row == run.row);
        let angles: Vec<f64> = repeats.filter_map(|run| run.repose_deg).collect();
        rows.push(Row {
            row: run.row,
            powder: campaign.powders[run.powder].clone(),
            measured_deg: crate::stats::summary::mean(&angles),
            before_deg: known(before.mean_deg),
            before_sd_deg: before.sd_deg,
            after_deg: known(after.mean_deg),
            after_sd_deg: after.sd_deg,
        });
    }
    rows
}

fn causes(prepared: &Prepared, posterior: &Posterior<'_>) -> Vec<CauseReport> {
    let mut causes: Vec<CauseReport> = prepared
        .hypotheses
        .iter()
        .zip(&posterior.inclusion)
        .filter_map(|(it, &inclusion_probability)| {
            let Cause::Known(mechanism) = it.cause else { return None };
            let (name, family) = mechanism.name();
            Some(CauseReport {
                mechanism: name.to_owned(),
                family: family.to_owned(),
                inclusion_probability,
                confidence_level: 1,
                parameters: Vec::new(),
                powders: Vec::new(),
            })
        })
        .collect();
    causes.sort_by(|a, b| b.inclusion_probability.total_cmp(&a.inclusion_probability));
    causes
}
