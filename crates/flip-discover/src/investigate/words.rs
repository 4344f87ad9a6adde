//! The report's sentences, made from its numbers.

use crate::causes::hypothesis::Cause;
use crate::data::campaign::Quantity;
use crate::judge::claim::{Claim, Told};
use crate::report::names;
use crate::report::names::{quantity, rounded};
use crate::report::sizes::{ANGLES, FLOW, moved, size, sizes, whom};
use crate::report::{ColumnLeftOut, Experiment, Finding, Gain, Report, Verdict};
use crate::thresholds::WANDER_SESSIONS_MIN;

/// The summary sentence that a reader sees first.
pub(crate) fn sentence(report: &Report, claim: &Claim, law: Option<&str>) -> String {
    let first = match report.verdict {
        Verdict::NoDiscrepancy => nothing(report, claim.passing.as_ref()),
        Verdict::Cause => cause(report, claim, law),
        Verdict::Hint => hint(report, claim),
        Verdict::Ambiguous => ambiguous(report),
        Verdict::Unexplained => unexplained(report),
    };
    let gain = report.gain.as_ref().map_or(String::new(), gain);
    let next = report
        .suggested_experiment
        .as_ref()
        .map_or(String::new(), |experiment| next(experiment, report.verdict));
    [first, gain, next]
        .iter()
        .filter(|text| !text.is_empty())
        .map(String::as_str)
        .collect::<Vec<_>>()
        .join(" ")
}

fn nothing(report: &Report, passing: Option<&Finding>) -> String {
    let smallest =
        report.minimum_detectable.iter().min_by(|a, b| a.effect_deg.total_cmp(&b.effect_deg));
    let would = smallest.map_or(String::new(), |effect| {
        format!(
            " This design would have shown an effect of {}° by {} in four of five campaigns; smaller effects cannot be ruled out.",
            rounded(effect.effect_deg),
            names::lower(&names::cause(&effect.mechanism))
        )
    });
    format!(
        "No discrepancy is shown: evidence as strong arises by chance in {} % of such campaigns{}.{would}",
        percent(report.p_value),
        passing.map_or(String::new(), passing_by)
    )
}

/// A cause that the evidence favoured but that amounts to nothing.
fn passing_by(finding: &Finding) -> String {
    let with = finding.covariate.as_deref().map_or("something".to_owned(), |name| quantity(name).0);
    format!(
        ", but what it points at, {with}, has no effect that is told from zero, and days left out are not predicted better by it"
    )
}

/// Why angles of this many sessions, with no varying covariate recorded, cannot be judged, and what
/// it would take.
pub(crate) fn unjudged(sessions: usize) -> String {
    let days = match sessions {
        0..WANDER_SESSIONS_MIN => format!(
            "{sessions} of the {WANDER_SESSIONS_MIN} sessions that it takes to tell a change over time from days that differ"
        ),
        _ => "no powder that was measured on days enough to tell a change over time from days that differ".to_owned(),
    };
    format!(
        "nothing that was recorded beside them differed between the runs of a powder, and the file has {days}. It takes runs of the same powders on \
         {WANDER_SESSIONS_MIN} days or more (column session), or a column of what differed between runs, such as relative_humidity_pct, operator or batch"
    )
}

fn percent(share: f64) -> String {
    rounded(100.0 * share)
}

fn cause(report: &Report, claim: &Claim, law: Option<&str>) -> String {
    let told = claim.told.iter().filter_map(|told| caused(told, report, "makes", "changes"));
    let told = told.collect::<Vec<_>>().join("; and ");
    let law = law.filter(|law| !law.starts_with("one number for each"));
    let finding = report.findings.first();
    let covariates = finding.and_then(|finding| finding.covariate.as_deref()).unwrap_or_default();
    let law = law.map_or(String::new(), |law| {
        format!(" It grows most probably with {law}{}.", letters(covariates, law))
    });
    format!("{told}.{law}")
}

/// `Humidity makes salt pile steeper than the simulation predicts: salt +2.2° [1.5, 3.0] from 30 to
/// 70 % relative humidity (probability 93 %)`
fn caused(told: &Told, report: &Report, makes: &str, changes: &str) -> Option<String> {
    let finding = told.finding.as_ref()?;
    let Cause::Known(_) = &told.cause else {
        let with =
            finding.covariate.as_deref().map_or("something".to_owned(), |name| quantity(name).0);
        return Some(format!("the angle also goes with {with}: {}", sizes(finding)));
    };
    let mechanism = told.cause.name().0;
    let known = report.causes.iter().find(|cause| cause.mechanism == mechanism)?;
    let name = names::cause(&mechanism);
    let body = match is_of_levels(&mechanism) {
        false => format!("{name} {makes} {}", moved(finding, &ANGLES)),
        true => {
            let whom = whom(finding);
            format!(
                "{name} {changes} the angle of {whom} against the simulation: {}",
                sizes(finding)
            )
        }
    };
    Some(format!("{body} (probability {:.0} %)", 100.0 * known.inclusion_probability))
}

/// A candidate cause that is not established, and what it lacks.
fn hint(report: &Report, claim: &Claim) -> String {
    let lacks = match &report.gain {
        _ if claim.told.iter().all(|told| told.finding.as_ref().and_then(size).is_none()) => {
            "its effect is not told from zero"
        }
        Some(_) => "days left out are not predicted better by it",
        None => "there are too few days to leave any out",
    };
    let told = claim.told.iter().filter_map(|told| caused(told, report, "may make", "may change"));
    format!(
        "A hint, and no cause yet, for {lacks}: {}.",
        told.map(|cause| names::lower(&cause)).collect::<Vec<_>>().join("; and ")
    )
}

/// The legend for the letters of a law: `, where h is the relative humidity`.
///
/// `covariates`: the finding's, joined by " and " if there are two.
fn letters(covariates: &str, law: &str) -> String {
    let stands = |name: &str| {
        let letter = names::symbol(name)?;
        // The "a" of "a rise around 7 d" is the article.
        let formula = law.replace("a rise around", "");
        let mut words = formula.split(|c: char| !c.is_alphanumeric());
        words.any(|word| word == letter).then(|| format!("{letter} is the {}", quantity(name).0))
    };
    let stand: Vec<String> = covariates.split(" and ").filter_map(stands).collect();
    if stand.is_empty() { String::new() } else { format!(", where {}", stand.join(" and ")) }
}

fn ambiguous(report: &Report) -> String {
    let names: Vec<String> =
        report.ambiguous_between.iter().map(|cause| names::lower(&names::cause(cause))).collect();
    let size =
        report.findings.iter().find_map(size).map_or(String::new(), |size| format!(": {size}"));
    format!(
        "Something makes powders pile differently than the simulation predicts{size}, and these data cannot tell which of {} it is.",
        names.join(" or ")
    )
}

fn unexplained(report: &Report) -> String {
    let Some(departure) = &report.unexplained else { return String::new() };
    match &departure.covariate {
        None => "Something that nobody recorded moves the angle of repose over the sessions; nothing that was recorded explains it."
            .to_owned(),
        Some(covariate) => {
            let size = report.findings.first().and_then(size).map_or(String::new(), |size| format!(" ({size})"));
            format!(
                "The angle of repose depends on {}{size}, which no cause of the catalogue explains; its law: {}.",
                quantity(covariate).0,
                departure.law
            )
        }
    }
}

fn gain(gain: &Gain) -> String {
    let errors = &gain.held_out;
    let verdict = if gain.accepted { "" } else { ", which is not enough to accept it" };
    format!(
        "On days left out the extension changes the error from {:.2}° to {:.2}° [gain {:.2} to {:.2}]{verdict}.",
        errors.rmse_before, errors.rmse_after, errors.ci95[0], errors.ci95[1]
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

/// What the quantities measured alongside the angle show by themselves; nothing for repeats that
/// scatter alike. `probability` is a cause's.
pub(crate) fn beside(
    measured: Quantity,
    claim: &Claim,
    probability: impl Fn(&Cause) -> f64,
    ambiguous_between: &[String],
    p_value: f64,
) -> String {
    let finding = claim.told.iter().find_map(|told| told.finding.as_ref());
    let size = finding.and_then(size).map_or(String::new(), |size| format!(": {size}"));
    let with = finding
        .and_then(|finding| finding.covariate.as_deref())
        .map_or("something".to_owned(), |name| quantity(name).0);
    match (measured, claim.verdict) {
        (Quantity::Scatter, Verdict::NoDiscrepancy) => String::new(),
        (Quantity::Scatter, _) => match finding {
            Some(_) => format!(
                "Repeats scatter differently with {with}{size}; evidence as strong arises by chance in {} % of such campaigns.",
                percent(p_value)
            ),
            None => {
                "How far repeats scatter wanders over the sessions, with nothing that was recorded."
                    .to_owned()
            }
        },
        (_, Verdict::NoDiscrepancy) => format!(
            "Flow times show no discrepancy: evidence as strong arises by chance in {} % of such campaigns{}.",
            percent(p_value),
            claim.passing.as_ref().map_or(String::new(), passing_by)
        ),
        (_, Verdict::Cause | Verdict::Hint) => {
            let told =
                claim.told.iter().filter_map(|told| flows(told, claim.verdict, &probability));
            let told = told.collect::<Vec<_>>().join("; and ");
            match claim.verdict {
                Verdict::Cause => format!("{told}."),
                _ => format!("Flow times give a hint, and no cause yet: {}.", names::lower(&told)),
            }
        }
        (_, Verdict::Ambiguous) => {
            let names: Vec<String> =
                ambiguous_between.iter().map(|cause| names::lower(&names::cause(cause))).collect();
            format!(
                "Something changes how long powders take to flow out{size}, and their flow times cannot tell which of {} it is.",
                names.join(" or ")
            )
        }
        (_, Verdict::Unexplained) => match finding {
            Some(_) => format!(
                "The time of flow depends on {with}{size}, which no cause of the catalogue explains."
            ),
            None => {
                "Flow times wander over the sessions, with nothing that was recorded.".to_owned()
            }
        },
    }
}

/// The effect of a cause on flow times.
fn flows(told: &Told, verdict: Verdict, probability: impl Fn(&Cause) -> f64) -> Option<String> {
    let finding = told.finding.as_ref()?;
    let mechanism = told.cause.name().0;
    let may =
        if verdict == Verdict::Cause { ["makes", "changes"] } else { ["may make", "may change"] };
    let name = names::cause(&mechanism);
    let body = match is_of_levels(&mechanism) {
        true => format!(
            "{name} {} how long {} take to flow out: {}",
            may[1],
            whom(finding),
            sizes(finding)
        ),
        false => format!("{name} {} {}", may[0], moved(finding, &FLOW)),
    };
    Some(format!("{body} (probability {:.0} %)", 100.0 * probability(&told.cause)))
}

/// For a campaign with too few repeats.
pub(crate) const NO_SCATTER: &str = "Whether repeats scatter more in some conditions than in others: too few powders were measured more than once on a day.";

/// Whether a cause is a difference between names, which by itself makes nothing steeper or slower.
fn is_of_levels(mechanism: &str) -> bool {
    ["method_bias", "operator", "batch", "base_friction"].contains(&mechanism)
}

/// Which columns were left out; nothing if none were.
pub(crate) fn left_out(columns: &[ColumnLeftOut]) -> String {
    let names: Vec<String> = columns.iter().map(|column| quantity(&column.column).0).collect();
    match names.as_slice() {
        [] => String::new(),
        [one] => {
            format!("Left out, for it follows from what was measured and is no condition: {one}.")
        }
        all => format!(
            "Left out, for they follow from what was measured and are no conditions: {}.",
            all.join(", ")
        ),
    }
}

/// What cannot be seen with this data.
pub(crate) fn blind_spots(
    absorbed: usize,
    has_sessions: bool,
    correlated: &[(String, String, f64)],
) -> Vec<String> {
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

#[cfg(test)]
mod tests {
    use super::letters;

    #[test]
    fn the_letters_of_a_law_are_explained_and_its_article_is_not() {
        let age = ", where a is the time since opening";
        assert_eq!(letters("container_age_d", "1 - exp(-a / 3 d)"), age);
        assert_eq!(letters("container_age_d", "a rise around 7 d"), "");
        let humidity = ", where h is the relative humidity";
        assert_eq!(letters("relative_humidity_pct", "h^2"), humidity);
        let both = format!("{humidity} and t is the time at rest");
        assert_eq!(
            letters("relative_humidity_pct and rest_min", "h^4 (1 - exp(-t / 20 min))"),
            both
        );
        assert_eq!(letters("operator", "one value per operator"), "");
    }
}
