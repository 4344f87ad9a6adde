//! Angles of repose and balance readings, judged together: each channel by itself, with p-values that are corrected for there being two.
//!
//! ```text
//! p_a, p_t          of angles and of traces, each against its own simulated nulls
//! smaller of both   min(1, 2 p)
//! larger of both    max(p, what the smaller became)            Holm, Scand. J. Statist. 6 (1979) 65
//! ```
//!
//! With nothing wrong in either, one of them is found in at most 5 % of investigations; what is found in one does not cost the other its level twice.

use super::campaign::Campaign;
use super::investigate::angles;
use super::report::{NullCheck, Report, SCHEMA_VERSION, SimulatorVersions, Verdict};
use super::response::responses;
use super::screen::Settings;
use super::traces::report::{TraceReport, report};
use super::traces::{self, TraceScreening, Traces, screen_traces};
use crate::domain::FieldError;
use crate::domain::job::Progress;
use std::ops::ControlFlow;

/// Share of the work that balance readings are.
const TRACES_SHARE: f64 = 0.3;

/// Investigate a campaign of angles, balance readings of weighings, or both.
///
/// | argument | meaning |
/// |----------|---------|
/// | `base` | version of the simulator that is judged |
/// | `on_progress` | hears what is being done; `Break` stops, and there is no report |
///
/// # Errors
/// A setting out of bounds; a campaign whose runs, or traces whose readings, say nothing; neither of them.
pub fn investigate(
    campaign: Option<&Campaign>,
    traces: Option<&Traces>,
    base: &str,
    settings: &Settings,
    mut on_progress: impl FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Option<Report>, FieldError> {
    let Settings { seed, simulations } = settings.checked()?;
    let mut screened = None;
    if let Some(traces) = traces {
        let message = "judging balance readings, here and where nothing is wrong".to_owned();
        if on_progress(&Progress { fraction: 0.0, message }).is_break() {
            return Ok(None);
        }
        screened = Some((traces, screen_traces(traces, &traces::Settings { seed, simulations })?));
    }
    let from = if screened.is_some() { TRACES_SHARE } else { 0.0 };
    let trace_p = screened.as_ref().map(|(_, screening)| screening.p_value);
    let (mut report, angle_p) = match campaign {
        Some(campaign) => {
            let later = |progress: &Progress| {
                let fraction = from + (1.0 - from) * progress.fraction;
                on_progress(&Progress { fraction, message: progress.message.clone() })
            };
            let found = angles(campaign, &responses(campaign), base, settings, |p| holm(p, trace_p), later)?;
            let Some(report) = found else { return Ok(None) };
            let p = report.p_value;
            (report, Some(p))
        }
        None => match &screened {
            Some((_, screening)) => (without_angles(screening, base), None),
            None => return Err(FieldError::new("measurements", "or traces are needed: there is nothing to judge")),
        },
    };
    if let Some((traces, screening)) = screened {
        let of_traces = self::report(traces, &screening, holm(screening.p_value, angle_p));
        add(&mut report, of_traces, angle_p);
    }
    Ok(Some(report))
}

/// The p-value of one channel, corrected for another.
fn holm(p: f64, other: Option<f64>) -> f64 {
    match other {
        None => p,
        Some(other) if p <= other => (2.0 * p).min(1.0),
        Some(other) => p.max((2.0 * other).min(1.0)),
    }
}

/// The document of balance readings alone, before they are added.
fn without_angles(screening: &TraceScreening, base: &str) -> Report {
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
        evidence: Vec::new(),
        untestable: Vec::new(),
        null_check: NullCheck { campaigns: 0, statistic: 0.0, threshold95: 0.0 },
        numerics: None,
        traces: None,
        rows: Vec::new(),
        curves: Vec::new(),
        simulator_runs: 0,
        wall_s: 0.0,
    }
}

/// Add what balance readings say to a document; `angle_p` is none where it has no angles.
fn add(report: &mut Report, of_traces: TraceReport, angle_p: Option<f64>) {
    let TraceReport { channel, sentence, findings, causes, ambiguous_between, unexplained, .. } = of_traces;
    let (angles_are_found, traces_are_found) =
        (report.verdict != Verdict::NoDiscrepancy, channel.verdict != Verdict::NoDiscrepancy);
    // A cause that was claimed must be of a channel in which something was found.
    if traces_are_found && !angles_are_found {
        report.causes.clear();
    }
    if traces_are_found || !angles_are_found {
        report.causes.extend(causes);
    }
    report.causes.sort_by(|a, b| b.inclusion_probability.total_cmp(&a.inclusion_probability));
    // What was found comes first, each channel from its most probable cause on.
    match traces_are_found && !angles_are_found {
        true => report.evidence.splice(..0, of_traces.evidence).for_each(drop),
        false => report.evidence.extend(of_traces.evidence),
    }
    report.findings.extend(findings);
    report.ambiguous_between.extend(ambiguous_between);
    report.unexplained = report.unexplained.take().or(unexplained);
    report.blind_spots.extend(of_traces.blind_spots);
    report.untestable.extend(of_traces.untestable);
    // One experiment is the document's: that of what is open, else of what was found, else of angles.
    let is_of_traces = match (report.verdict, channel.verdict) {
        (Verdict::Ambiguous, _) => false,
        (_, Verdict::Ambiguous) => true,
        _ => traces_are_found && !angles_are_found,
    };
    if is_of_traces || report.suggested_experiment.is_none() {
        report.suggested_experiment.clone_from(&channel.suggested_experiment);
    }
    report.verdict = both(report.verdict, channel.verdict);
    match angle_p {
        None => {
            report.sentence = sentence;
            report.null_check = channel.null_check.clone();
        }
        Some(p) => {
            report.p_value = holm(p, Some(channel.p_value)).min(holm(channel.p_value, Some(p)));
            let parts = match traces_are_found && !angles_are_found {
                true => [sentence.as_str(), report.sentence.as_str()],
                false => [report.sentence.as_str(), sentence.as_str()],
            };
            report.sentence = parts.join(" ");
        }
    }
    report.traces = Some(channel);
}

/// The verdict over two channels: what is open in one is open, and what has a name in one has it.
fn both(one: Verdict, other: Verdict) -> Verdict {
    use Verdict::{Ambiguous, Cause, NoDiscrepancy, Unexplained};
    match [one, other] {
        of if of.contains(&Ambiguous) => Ambiguous,
        of if of.contains(&Cause) => Cause,
        of if of.contains(&Unexplained) => Unexplained,
        _ => NoDiscrepancy,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_channels_cost_each_other_no_more_than_holm_says() {
        // Holm's example of two hypotheses: 0.01 and 0.04 become 0.02 and 0.04, 0.03 and 0.04 both 0.06.
        let both = |a: f64, b: f64| [holm(a, Some(b)), holm(b, Some(a))];
        assert_eq!((both(0.01, 0.04), both(0.03, 0.04)), ([0.02, 0.04], [0.06, 0.06]));
        assert_eq!((both(0.7, 0.9), both(0.03, 0.03), holm(0.03, None)), ([1.0, 1.0], [0.06, 0.06], 0.03));
        // Nothing wrong, each p uniform: one of them is found in 5 % of investigations and a little less, 1 - (1 - 0.025)^2.
        let grid = || (0..400).map(|k| (f64::from(k) + 0.5) / 400.0);
        let alarms =
            grid().flat_map(|a| grid().map(move |b| (a, b))).filter(|&(a, b)| both(a, b).iter().any(|p| *p <= 0.05));
        let share = alarms.count() as f64 / 160_000.0;
        assert!((share - 0.049_375).abs() < 1e-4, "{share}");
    }

    #[test]
    fn what_is_open_in_one_channel_is_open() {
        use Verdict::{Ambiguous, Cause, NoDiscrepancy, Unexplained};
        for (one, other, expected) in [
            (NoDiscrepancy, NoDiscrepancy, NoDiscrepancy),
            (NoDiscrepancy, Cause, Cause),
            (Ambiguous, Cause, Ambiguous),
            (Unexplained, Cause, Cause),
            (Unexplained, NoDiscrepancy, Unexplained),
        ] {
            assert_eq!((both(one, other), both(other, one)), (expected, expected));
        }
    }
}
