//! The investigation job: what a campaign says that the calibrated simulator does not.
//!
//! Nothing is saved on the way: judged again, a campaign gives the same report.

use super::calibrate::unless;
use super::context::{JobContext, JobError};
use super::spec::InvestigationSpec;
use crate::discover::{investigate, responses};
use std::time::Instant;

pub(super) fn perform(context: &JobContext, spec: &InvestigationSpec) -> Result<(), JobError> {
    let InvestigationSpec { campaign, settings, simulator } = spec;
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
    context.succeed(&report, async |_| Ok(()))?;
    Ok(())
}
