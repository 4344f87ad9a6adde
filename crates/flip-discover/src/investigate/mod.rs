//! Judges angles of repose, flow times and balance readings together: each channel by itself, with
//! p-values corrected for multiple channels.
//!
//! ```text
//! p_1 <= .. <= p_k     of the channels, each against its own simulated nulls
//! p_i becomes          the largest over j <= i of min(1, (k - j + 1) p_j)         Holm, Scand. J. Statist. 6 (1979) 65
//! ```
//!
//! With nothing wrong in any channel, one is found in at most 5 % of investigations; a finding in
//! one does not cost the others their level again. Scatter of repeats is reported alongside and
//! decides nothing: the simulator makes no prediction of it, and under the null it may take any
//! form.

pub(crate) mod angles;
mod holm;
pub mod numerics;
mod scatter;
mod side;
mod words;

use crate::causes::follows;
use crate::causes::response::{Responses, responses};
use crate::data::campaign::Campaign;
use crate::data::flow::flow_times;
use crate::judge::posterior::Posterior;
use crate::judge::prepared::Prepared;
use crate::judge::screen::{Settings, screen_prepared};
use crate::report::{CauseReport, NullCheck, Report, Verdict};
use crate::traces::report::{TraceReport, report};
use crate::traces::{self, Traces, screen_traces};
use angles::angles;
use flip_core::domain::FieldError;
use flip_core::domain::job::Progress;
use holm::{holm, without};
use side::{Beside, Heard};
use std::ops::ControlFlow;

/// Share of the work spent on balance readings, and share of the rest spent on flow times.
const TRACES_SHARE: f64 = 0.3;
const FLOW_SHARE: f64 = 0.2;

/// Investigates a campaign of angles, balance readings of weighings, or both.
///
/// | argument | meaning |
/// |----------|---------|
/// | `base` | version of the simulator that is judged |
/// | `on_progress` | receives progress; `Break` stops, and there is no report |
///
/// # Errors
/// A setting out of bounds; a campaign whose runs, or traces whose readings, cannot be judged;
/// neither of them given.
pub fn investigate(
    campaign: Option<&Campaign>,
    traces: Option<&Traces>,
    base: &str,
    settings: &Settings,
    mut on_progress: impl FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Option<Report>, FieldError> {
    let Settings { seed, simulations } = settings.checked()?;
    let mut step = |fraction: f64, message: &str| {
        on_progress(&Progress { fraction, message: message.to_owned() }).is_break()
    };
    let mut done = 0.0;
    let mut screened = None;
    if let Some(traces) = traces {
        if step(0.0, "judging balance readings, here and where nothing is wrong") {
            return Ok(None);
        }
        screened = Some((traces, screen_traces(traces, &traces::Settings { seed, simulations })?));
        done = TRACES_SHARE;
    }
    // Readings of which nothing was judged cost the other channels nothing.
    let trace_p = screened
        .as_ref()
        .filter(|(_, it)| !it.judged.is_empty())
        .map(|(_, screening)| screening.p_value);
    let Some(campaign) = campaign else {
        let Some((traces, screening)) = screened else {
            return Err(FieldError::new(
                "measurements",
                "or traces are needed: there is nothing to judge",
            ));
        };
        let mut document = Report::blank(
            base,
            screening.p_value,
            NullCheck::of(&screening.null, screening.statistic),
        );
        add_traces(&mut document, report(traces, &screening, screening.p_value));
        return Ok(Some(document));
    };
    let (campaign, mut left_out) = follows::without(campaign);
    let campaign = &campaign;
    // Flow times that cannot be judged are no reason to refuse the angles.
    let flow = flow_times(campaign).map(|flow| -> Result<_, FieldError> {
        let (flow, of_flow) = follows::without(&flow?);
        left_out.extend(of_flow);
        let prepared = Prepared::new(&flow, &Responses::new())?;
        match prepared.hypotheses.is_empty() {
            true => Err(FieldError::new("flow_time_s", words::unjudged(flow.sessions()))),
            false => Ok((prepared, flow)),
        }
    });
    let (flow, silent) = match flow {
        Some(Ok(flow)) => (Some(flow), None),
        Some(Err(error)) => (None, Some(error)),
        None => (None, None),
    };
    let mut timed = None;
    if let Some((prepared, flow)) = &flow {
        if step(done, "judging flow times, here and where nothing is wrong") {
            return Ok(None);
        }
        let posterior = Posterior::new(prepared);
        let go_on = |_| ControlFlow::Continue(());
        let screening = screen_prepared(prepared, flow, &posterior.shifts(), settings, go_on);
        let Some(screening) = screening else { return Ok(None) };
        timed = Some(Beside { campaign: flow, prepared, posterior, screening });
        done += (1.0 - done) * FLOW_SHARE;
    }
    let flow_p = timed.as_ref().map(|it| it.screening.p_value);
    let later = |progress: &Progress| {
        let fraction = done + (1.0 - done) * progress.fraction;
        on_progress(&Progress { fraction, message: progress.message.clone() })
    };
    let others: Vec<f64> = trace_p.into_iter().chain(flow_p).collect();
    let found =
        angles(campaign, &responses(campaign), base, settings, |p| holm(p, &others), later)?;
    let Some(mut document) = found else { return Ok(None) };
    document.left_out = left_out;
    // Nor do angles of which nothing was judged.
    let own = Some(document.p_value).filter(|_| document.null_check.is_judged());
    let all: Vec<f64> = own.into_iter().chain(others).collect();
    document.p_value = all.iter().map(|&p| holm(p, &without(&all, p))).fold(1.0, f64::min);
    let corrected = |p: f64| holm(p, &without(&all, p));
    if let Some(timed) = timed {
        let (heard, side) = timed.heard(corrected(timed.screening.p_value), settings)?;
        add(&mut document, heard);
        document.beside.push(side);
    }
    if let Some(error) = silent {
        document.blind_spots.push(format!("Flow times: {}.", error.message));
    }
    if let Some((traces, screening)) = screened {
        add_traces(&mut document, report(traces, &screening, corrected(screening.p_value)));
    }
    let left_out = words::left_out(&document.left_out);
    document.sentence = [document.sentence, left_out].join(" ").trim_end().to_owned();
    Ok(Some(document))
}

/// Adds the results of one more channel to a document.
fn add(document: &mut Report, heard: Heard) {
    let Heard {
        what,
        verdict,
        sentence,
        findings,
        causes,
        ambiguous_between,
        unexplained,
        experiment,
    } = heard;
    let leads = strength(verdict) > strength(document.verdict);
    // A claim must belong to a channel in which it was found, and a claim drops any hint.
    if leads {
        document.causes.clear();
        document.findings.clear();
    }
    let no_more = |what: &str| format!("{what} show no more than a hint.");
    let mut sentence = sentence;
    if leads && document.verdict == Verdict::Hint {
        document.gain = None;
        document.sentence = no_more("Angles of repose");
    } else if verdict == Verdict::Hint && !leads && document.verdict != Verdict::Hint {
        sentence = no_more(what);
    }
    if strength(verdict) >= strength(document.verdict) {
        causes.into_iter().for_each(|cause| add_cause(&mut document.causes, cause));
        document.findings.extend(findings);
    }
    document.causes.sort_by(|a, b| b.inclusion_probability.total_cmp(&a.inclusion_probability));
    let new = ambiguous_between.into_iter().filter(|it| !document.ambiguous_between.contains(it));
    let new: Vec<String> = new.collect();
    document.ambiguous_between.extend(new);
    document.unexplained = document.unexplained.take().or(unexplained);
    // The document has one experiment: for what is open, else for what was found, else for what
    // came first.
    let decides = match (document.verdict, verdict) {
        (Verdict::Ambiguous, _) => false,
        (_, Verdict::Ambiguous) => true,
        _ => leads,
    };
    if decides || document.suggested_experiment.is_none() {
        document.suggested_experiment = experiment;
    }
    document.verdict = both(document.verdict, verdict);
    let mut parts = [std::mem::take(&mut document.sentence), sentence];
    if leads {
        parts.reverse();
    }
    document.sentence =
        parts.iter().filter(|it| !it.is_empty()).map(String::as_str).collect::<Vec<_>>().join(" ");
}

/// Merges the results of two channels for one cause: the larger probability, and the numbers of
/// both.
fn add_cause(causes: &mut Vec<CauseReport>, cause: CauseReport) {
    match causes.iter_mut().find(|it| it.mechanism == cause.mechanism) {
        None => causes.push(cause),
        Some(known) => {
            known.inclusion_probability =
                known.inclusion_probability.max(cause.inclusion_probability);
            known.parameters.extend(cause.parameters);
            let new = cause.powders.into_iter().filter(|powder| !known.powders.contains(powder));
            let new: Vec<String> = new.collect();
            known.powders.extend(new);
        }
    }
}

/// Adds the results of the balance readings to a document.
fn add_traces(document: &mut Report, of_traces: TraceReport) {
    let TraceReport { channel, sentence, findings, causes, ambiguous_between, unexplained, .. } =
        of_traces;
    let leads = strength(channel.verdict) > strength(document.verdict);
    // Findings come first, within each channel from its most probable cause on.
    match leads {
        true => document.evidence.splice(..0, of_traces.evidence).for_each(drop),
        false => document.evidence.extend(of_traces.evidence),
    }
    document.blind_spots.extend(of_traces.blind_spots);
    document.untestable.extend(of_traces.untestable);
    let experiment = channel.suggested_experiment.clone();
    let verdict = channel.verdict;
    let what = "Balance readings";
    add(
        document,
        Heard {
            what,
            verdict,
            sentence,
            findings,
            causes,
            ambiguous_between,
            unexplained,
            experiment,
        },
    );
    document.traces = Some(channel);
}

/// Nothing, a hint, or something.
fn strength(verdict: Verdict) -> u8 {
    match verdict {
        Verdict::NoDiscrepancy => 0,
        Verdict::Hint => 1,
        Verdict::Cause | Verdict::Ambiguous | Verdict::Unexplained => 2,
    }
}

/// The verdict over two channels: open if either is open, named if either is named.
fn both(one: Verdict, other: Verdict) -> Verdict {
    use Verdict::{Ambiguous, Cause, Hint, NoDiscrepancy, Unexplained};
    match [one, other] {
        of if of.contains(&Ambiguous) => Ambiguous,
        of if of.contains(&Cause) => Cause,
        of if of.contains(&Unexplained) => Unexplained,
        of if of.contains(&Hint) => Hint,
        _ => NoDiscrepancy,
    }
}

#[cfg(test)]
mod verdict_tests {
    use super::*;

    #[test]
    fn what_is_open_in_one_channel_is_open() {
        use Verdict::{Ambiguous, Cause, Hint, NoDiscrepancy, Unexplained};
        for (one, other, expected) in [
            (NoDiscrepancy, NoDiscrepancy, NoDiscrepancy),
            (NoDiscrepancy, Cause, Cause),
            (Ambiguous, Cause, Ambiguous),
            (Unexplained, Cause, Cause),
            (Unexplained, NoDiscrepancy, Unexplained),
            (Hint, NoDiscrepancy, Hint),
            (Hint, Cause, Cause),
        ] {
            assert_eq!((both(one, other), both(other, one)), (expected, expected));
        }
    }
}

#[cfg(test)]
mod tests;
