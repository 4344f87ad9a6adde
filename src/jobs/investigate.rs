//! The investigation job: what a campaign says that the calibrated simulator does not.
//!
//! Nothing is saved on the way: judged again, a campaign gives the same report.

use super::calibrate::unless;
use super::context::{JobContext, JobError};
use super::spec::InvestigationSpec;
use crate::discover::report::{CauseReport, Gain, Report, Unexplained};
use crate::discover::{investigate, responses};
use serde::Serialize;
use std::time::Instant;

pub(super) fn perform(context: &JobContext, spec: &InvestigationSpec) -> Result<(), JobError> {
    let InvestigationSpec { campaign, settings, simulator, .. } = spec;
    let began = Instant::now();
    let mut unsaved = None;
    let report = investigate(campaign, &responses(campaign), simulator, settings, |progress| {
        unless(context.report(progress), &mut unsaved, context)
    });
    if let Some(error) = unsaved {
        return Err(error.into());
    }
    let mut report = report.map_err(|error| JobError::Fail(error.to_string()))?.ok_or(JobError::Stopped)?;
    report.wall_s = began.elapsed().as_secs_f64();
    let accepted = report.gain.as_ref().is_some_and(|gain| gain.accepted);
    let version = accepted.then(|| spec.version());
    report.simulator_version.extended.clone_from(&version);
    let body = serde_json::to_string(&Extension::of(&report)).map_err(|error| JobError::Fail(error.to_string()))?;
    context.succeed(&report, async |tx| match &version {
        Some(version) => tx.insert_simulator(version, simulator, context.id(), &body).await,
        None => Ok(()),
    })?;
    Ok(())
}

/// What a version of the simulator says of itself.
#[derive(Serialize)]
struct Extension<'a> {
    sentence: &'a str,
    /// The causes that were claimed; empty where the law of an unknown extends the simulator.
    causes: Vec<&'a CauseReport>,
    unexplained: &'a Option<Unexplained>,
    gain: &'a Option<Gain>,
    verified: bool,
}

impl<'a> Extension<'a> {
    fn of(report: &'a Report) -> Self {
        let Report { sentence, causes, unexplained, gain, .. } = report;
        let causes = causes.iter().filter(|cause| cause.confidence_level > 1).collect();
        Self { sentence, causes, unexplained, gain, verified: report.simulator_version.verified }
    }
}
