//! The report's sentences, made from its numbers.

use super::campaign::Quantity;
use super::effects::{quantity, rounded};
use super::names;
use super::report::{CauseReport, Experiment, Finding, Gain, Report, Verdict};

/// The one sentence that a reader sees first.
pub(super) fn sentence(report: &Report, law: Option<&str>) -> String {
    let first = match report.verdict {
        Verdict::NoDiscrepancy => nothing(report),
        Verdict::Cause => cause(report, law),
        Verdict::Ambiguous => ambiguous(report),
        Verdict::Unexplained => unexplained(report),
    };
    let gain = report.gain.as_ref().map_or(String::new(), gain);
    let next = report.suggested_experiment.as_ref().map_or(String::new(), |it| next(it, report.verdict));
    [first, gain, next].iter().filter(|text| !text.is_empty()).map(String::as_str).collect::<Vec<_>>().join(" ")
}

fn nothing(report: &Report) -> String {
    let smallest = report.minimum_detectable.iter().min_by(|a, b| a.effect_deg.total_cmp(&b.effect_deg));
    let would = smallest.map_or(String::new(), |it| {
        format!(
            " This design would have shown an effect of {}° by {} in four of five campaigns; smaller effects cannot be ruled out.",
            rounded(it.effect_deg),
            names::lower(&names::cause(&it.mechanism))
        )
    });
    format!(
        "No discrepancy is shown: evidence as strong arises by chance in {} % of such campaigns.{would}",
        percent(report.p_value)
    )
}

fn percent(share: f64) -> String {
    rounded(100.0 * share)
}

/// `+2.4° [1.6, 3.1]`
fn sized(finding: &Finding) -> String {
    let [low, high] = finding.ci95;
    format!("{:+.1}° [{low:.1}, {high:.1}] {}", finding.effect, finding.span)
}

fn on(finding: &Finding, powders: usize) -> String {
    let names: Vec<String> = finding.powders.iter().map(|it| it.replace('_', " ")).collect();
    match names.as_slice() {
        [] => "powders".to_owned(),
        names if names.len() == powders => "all powders".to_owned(),
        [one] => one.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

fn cause(report: &Report, law: Option<&str>) -> String {
    let claimed = report.causes.iter().filter(|it| it.inclusion_probability >= super::investigate::CLAIM);
    let told: Vec<String> = claimed
        .zip(&report.findings)
        .map(|(cause, finding)| {
            let powders = finding.by_powder.len();
            let piles = if finding.effect > 0.0 { "steeper" } else { "flatter" };
            let name = names::cause(&cause.mechanism);
            let body = match is_of_levels(&cause.mechanism) {
                false => format!("{name} makes {} pile {piles} than the simulation predicts", on(finding, powders)),
                true => format!("{name} changes the angle of {} against the simulation", on(finding, powders)),
            };
            format!("{body}: {} (probability {:.0} %)", sized(finding), 100.0 * cause.inclusion_probability)
        })
        .collect();
    let law = law.filter(|law| !law.starts_with("one number for each"));
    let law = law.map_or(String::new(), |law| format!(" It grows most probably with {law}{}.", letters(report, law)));
    format!("{}.{law}", told.join("; and "))
}

/// What the letters of a law stand for: `, where h is the relative humidity`.
fn letters(report: &Report, law: &str) -> String {
    let covariates = report.findings.first().and_then(|finding| finding.covariate.as_deref()).unwrap_or_default();
    let stands = |name: &str| {
        let letter = names::symbol(name)?;
        let mut words = law.split(|c: char| !c.is_alphanumeric());
        words.any(|word| word == letter).then(|| format!("{letter} is the {}", quantity(name).0))
    };
    let stand: Vec<String> = covariates.split(" and ").filter_map(stands).collect();
    if stand.is_empty() { String::new() } else { format!(", where {}", stand.join(" and ")) }
}

fn ambiguous(report: &Report) -> String {
    let names: Vec<String> = report.ambiguous_between.iter().map(|it| names::lower(&names::cause(it))).collect();
    let size = report.findings.first().map_or(String::new(), |it| format!(": {}", sized(it)));
    format!(
        "Something makes powders pile differently than the simulation predicts{size}, and these data cannot tell which of {} it is.",
        names.join(" or ")
    )
}

fn unexplained(report: &Report) -> String {
    let Some(it) = &report.unexplained else { return String::new() };
    match &it.covariate {
        None => "Something that nobody recorded moves the angle of repose over the sessions; nothing that was recorded explains it."
            .to_owned(),
        Some(covariate) => {
            let size = report.findings.first().map_or(String::new(), |it| format!(" ({})", sized(it)));
            format!(
                "The angle of repose depends on {}{size}, which no cause of the catalogue explains; its law: {}.",
                quantity(covariate).0,
                it.law
            )
        }
    }
}

fn gain(gain: &Gain) -> String {
    let it = &gain.held_out;
    let verdict = if gain.accepted { "" } else { ", which is not enough to accept it" };
    format!(
        "On days left out the extension changes the error from {:.2}° to {:.2}° [gain {:.2} to {:.2}]{verdict}.",
        it.rmse_before, it.rmse_after, it.ci95[0], it.ci95[1]
    )
}

fn next(experiment: &Experiment, verdict: Verdict) -> String {
    let opening = match verdict {
        Verdict::Ambiguous => "What would tell them apart",
        Verdict::NoDiscrepancy => "What would tell more",
        _ => "What would prove it",
    };
    format!("{opening}: {} ({:.0} minutes).", experiment.what, experiment.minutes)
}

/// `+12 % [8, 16] from 30 to 70 % relative humidity`, of what is told in percent.
fn in_percent(finding: &Finding) -> String {
    let [low, high] = finding.ci95;
    format!("{:+.0} % [{low:.0}, {high:.0}] {}", finding.effect, finding.span)
}

/// What was measured beside the angle says, by itself; nothing of repeats that scatter alike.
pub(super) fn beside(
    measured: Quantity,
    verdict: Verdict,
    causes: &[CauseReport],
    findings: &[Finding],
    ambiguous_between: &[String],
    p_value: f64,
) -> String {
    let finding = findings.first();
    let size = finding.map_or(String::new(), |it| format!(": {}", in_percent(it)));
    let with = finding.and_then(|it| it.covariate.as_deref()).map_or("something".to_owned(), |name| quantity(name).0);
    match (measured, verdict) {
        (Quantity::Scatter, Verdict::NoDiscrepancy) => String::new(),
        (Quantity::Scatter, _) => match finding {
            Some(_) => format!(
                "Repeats scatter differently with {with}{size}; evidence as strong arises by chance in {} % of such campaigns.",
                percent(p_value)
            ),
            None => "How far repeats scatter wanders over the sessions, with nothing that was recorded.".to_owned(),
        },
        (_, Verdict::NoDiscrepancy) => format!(
            "Flow times show no discrepancy: evidence as strong arises by chance in {} % of such campaigns.",
            percent(p_value)
        ),
        (_, Verdict::Cause) => {
            let claimed = causes.iter().filter(|it| it.inclusion_probability >= super::investigate::CLAIM);
            let told = claimed.filter_map(|cause| {
                let of = |it: &&Finding| cause.parameters.iter().any(|p| p.value == it.effect);
                let finding = findings.iter().find(of)?;
                let name = names::cause(&cause.mechanism);
                let (powders, size) = (on(finding, finding.by_powder.len()), in_percent(finding));
                let flow = if finding.effect > 0.0 { "more slowly" } else { "more quickly" };
                let body = match is_of_levels(&cause.mechanism) {
                    true => format!("{name} changes how long {powders} take to flow out"),
                    false => format!("{name} makes {powders} flow out {flow} than usual"),
                };
                Some(format!("{body}: {size} (probability {:.0} %)", 100.0 * cause.inclusion_probability))
            });
            format!("{}.", told.collect::<Vec<_>>().join("; and "))
        }
        (_, Verdict::Ambiguous) => {
            let names: Vec<String> = ambiguous_between.iter().map(|it| names::lower(&names::cause(it))).collect();
            format!(
                "Something changes how long powders take to flow out{size}, and their flow times cannot tell which of {} it is.",
                names.join(" or ")
            )
        }
        (_, Verdict::Unexplained) => match finding {
            Some(_) => format!("The time of flow depends on {with}{size}, which no cause of the catalogue explains."),
            None => "Flow times wander over the sessions, with nothing that was recorded.".to_owned(),
        },
    }
}

/// Of a campaign that has too few repeats.
pub(super) const NO_SCATTER: &str = "Whether repeats scatter more in some conditions than in others: too few powders were measured more than once on a day.";

/// Whether a cause is a difference between names, which makes nothing steeper or slower by itself.
fn is_of_levels(mechanism: &str) -> bool {
    ["method_bias", "operator", "batch", "base_friction"].contains(&mechanism)
}

/// What cannot be seen with this data.
pub(super) fn blind_spots(absorbed: usize, has_sessions: bool, correlated: &[(String, String, f64)]) -> Vec<String> {
    let mut spots = vec![format!(
        "A constant error of a powder's angle: calibration makes the simulator meet each of the {absorbed} powders' means, so whatever moves \
         all its runs alike is absorbed there."
    )];
    if !has_sessions {
        spots.push(
            "What changes from day to day: no sessions were recorded, so a day's own deviation may pass for an effect of whatever else differed \
             between days."
                .to_owned(),
        );
    }
    spots.extend(correlated.iter().map(|(a, b, r)| {
        format!(
            "{} and {} moved together (correlation {r:.2}): an effect of one may be one of the other.",
            quantity(a).0,
            quantity(b).0
        )
    }));
    spots
}
