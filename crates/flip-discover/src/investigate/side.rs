//! Quantities measured alongside the angle and judged the same way: the time a powder takes to flow
//! out (`flow.rs`), and how much repeats scatter (`scatter.rs`).
//!
//! Both are logarithms ([`percent`](crate::data::campaign::percent)), so a cause multiplies; a powder's
//! own time and scatter are its means, which are not judged. How much a cause of the catalogue
//! changes the flow of each powder is unknown, so signs and responses are left open.

use super::channel::{Channel, Conclusion};
use super::steps::Halt;
use super::words;
use crate::causes::hypothesis::Cause;
use crate::judge::claim::Proposal;
use crate::judge::screen::Settings;
use crate::report::{
    CauseReport, Experiment, Finding, ParameterReport, SideChannel, Unexplained, Verdict,
};
use crate::worth::experiment::experiment;
use std::ops::ControlFlow;

/// The results of one more channel, to be added to a document.
pub(crate) struct Heard {
    /// What was measured, as the beginning of a sentence.
    pub what: &'static str,
    pub verdict: Verdict,
    pub sentence: String,
    pub findings: Vec<Finding>,
    pub causes: Vec<CauseReport>,
    pub ambiguous_between: Vec<String>,
    pub unexplained: Option<Unexplained>,
    pub experiment: Option<Experiment>,
}

/// A channel's results; `p_value` is corrected for the other channels judged.
///
/// # Errors
/// A campaign whose runs carry no information about their noise.
pub(crate) fn heard(
    channel: &Channel<'_>,
    p_value: f64,
    settings: &Settings,
) -> Result<(Heard, SideChannel), Halt> {
    let is_asked = |proposal| proposal == Proposal::Cause;
    let nobody_stops = |_| ControlFlow::Continue(());
    let Conclusion { judgement, claim, gain } =
        channel.concluded(p_value, settings, is_asked, nobody_stops)?;
    let causes = claim
        .told
        .iter()
        .filter_map(|told| cause(channel, &told.cause, told.finding.as_ref()?))
        .collect();
    let verdict = claim.verdict;
    let experiment = match (verdict, judgement.to_tell_apart()) {
        (Verdict::Ambiguous, Some(causes)) => {
            experiment(channel.campaign, channel.responses, &causes, false, settings)?.map(timed)
        }
        _ => None,
    };
    let ambiguous_between = judgement.ambiguous_between();
    let quantity = channel.campaign.quantity;
    let probability = |cause: &Cause| channel.inclusion_of(cause);
    let sentence = words::beside(quantity, &claim, probability, &ambiguous_between, p_value);
    let side = SideChannel {
        channel: quantity.channel(),
        verdict,
        p_value: channel.screening.p_value,
        n: channel.prepared.measured.len() as u32,
        sentence: sentence.clone(),
        evidence: channel.evidence(),
        null_check: channel.null_check(),
        gain,
    };
    let heard = Heard {
        what: quantity.name(),
        verdict,
        sentence,
        findings: claim.findings(),
        causes,
        ambiguous_between,
        unexplained: channel.unexplained(&judgement),
        experiment,
    };
    Ok((heard, side))
}

fn cause(channel: &Channel<'_>, cause: &Cause, finding: &Finding) -> Option<CauseReport> {
    let Cause::Known(mechanism) = cause else { return None };
    let (name, family) = mechanism.name();
    let effect = ParameterReport {
        name: "flow_effect_5_95".to_owned(),
        value: finding.effect,
        ci95: finding.ci95,
        unit: finding.unit.clone(),
    };
    Some(CauseReport {
        mechanism: name.to_owned(),
        family: family.to_owned(),
        inclusion_probability: channel.inclusion_of(cause),
        confidence_level: 1,
        parameters: vec![effect],
        powders: finding.powders.clone(),
    })
}

/// The same runs with flow time as the measured quantity.
fn timed(it: Experiment) -> Experiment {
    Experiment {
        what: format!("{}, and of each the time that the powder takes to flow out", it.what),
        ..it
    }
}
