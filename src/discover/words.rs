//! The report's sentences, made from its numbers.

use super::effects::{quantity, rounded};
use super::names;
use super::report::{Experiment, Finding, Gain, Report, Verdict};

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
            let how = match cause.mechanism.as_str() {
                "method_bias" | "operator" | "batch" | "base_friction" => "changes how steep",
                _ => "makes",
            };
            let body = match how {
                "makes" => format!("{name} makes {} pile {piles} than the simulation predicts", on(finding, powders)),
                _ => format!("{name} changes the angle of {} against the simulation", on(finding, powders)),
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
