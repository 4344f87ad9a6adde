//! Adds the results of one channel after another to a document.

use super::side::Heard;
use crate::report::spoon::{PowderReport, SpoonCauseReport, SpoonReport};
use crate::report::{CauseReport, ParameterReport, Report, Verdict};
use crate::traces::report::TraceReport;

/// Adds the results of one more channel to a document.
pub(crate) fn add(document: &mut Report, heard: Heard) {
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
    let new =
        ambiguous_between.into_iter().filter(|cause| !document.ambiguous_between.contains(cause));
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
    document.sentence = parts
        .iter()
        .filter(|part| !part.is_empty())
        .map(String::as_str)
        .collect::<Vec<_>>()
        .join(" ");
}

/// Merges the results of two channels for one cause: the larger probability, and the numbers of
/// both.
fn add_cause(causes: &mut Vec<CauseReport>, cause: CauseReport) {
    match causes.iter_mut().find(|known| known.mechanism == cause.mechanism) {
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
pub(crate) fn add_traces(document: &mut Report, of_traces: TraceReport) {
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

/// Adds what weighings say of the simulated spoon to a document.
pub(crate) fn add_spoon(document: &mut Report, spoon: SpoonReport) {
    let verdict = spoon.powders.iter().map(|it| it.verdict).fold(Verdict::NoDiscrepancy, both);
    let told = spoon.powders.iter().filter(|it| strength(it.verdict) == strength(verdict));
    let mut causes = Vec::new();
    let mut ambiguous_between = Vec::new();
    for powder in told {
        let first = powder.causes.first().filter(|_| powder.verdict != Verdict::NoDiscrepancy);
        first.into_iter().for_each(|first| add_cause(&mut causes, of_spoon(powder, first)));
        ambiguous_between.extend(powder.ambiguous_between.iter().cloned());
    }
    document.blind_spots.extend(spoon.blind_spots.iter().cloned());
    let what = "Spoons";
    let (sentence, findings, unexplained, experiment) =
        (spoon.sentence.clone(), Vec::new(), None, None);
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
    document.simulator_runs += spoon.replays + spoon.heaps;
    document.spoon = Some(spoon);
}

/// A cause of one powder's spoonfuls: confirmed on spoonfuls left out, or not.
fn of_spoon(powder: &PowderReport, first: &SpoonCauseReport) -> CauseReport {
    let is_confirmed = powder.verdict == Verdict::Cause;
    CauseReport {
        mechanism: first.cause.name().0.to_owned(),
        family: first.family.clone(),
        inclusion_probability: first.probability,
        confidence_level: if is_confirmed { 2 } else { 1 },
        parameters: vec![ParameterReport {
            name: first.cause.name().0.to_owned(),
            value: first.amplitude,
            ci95: first.amplitude_ci95,
            unit: String::new(),
        }],
        powders: vec![powder.powder.clone()],
    }
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
mod tests {
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
