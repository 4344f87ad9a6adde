//! What a certificate says of a dose in words.

use flip_core::domain::bench::BenchKind;
use flip_core::domain::weighing::Outcome;
use flip_store::weighings::Weighing;

/// Where no real powder was weighed: the word to print across the page, and what it means.
pub(super) fn not_real(bench: Option<BenchKind>) -> Option<(&'static str, &'static str)> {
    match bench? {
        BenchKind::Simulated => Some((
            "Simulated",
            "Simulated: no real powder was weighed. The bench, its balance and the powder are computed.",
        )),
        BenchKind::Emulated => Some((
            "Emulated",
            "Emulated: no real powder was weighed. Emulated devices answered, with a computed powder behind them.",
        )),
        BenchKind::Devices => None,
    }
}

/// The net mass with its uncertainty, or a statement that there is none.
pub(super) fn result(weighing: &Weighing) -> String {
    let powder = &weighing.powder;
    match (&weighing.measured, weighing.reading_mg) {
        (Some(measured), _) => {
            format!(
                "{} mg ± {} mg of {powder}",
                digits(measured.net_mg),
                digits(measured.uncertainty_mg)
            )
        }
        (None, Some(reading_mg)) => {
            format!("{} mg of {powder}, by the final reading", digits(reading_mg))
        }
        (None, None) => format!("no mass of {powder} was measured"),
    }
}

/// Warnings about the dose.
pub(super) fn warnings(weighing: &Weighing) -> Vec<String> {
    let mut all = Vec::new();
    let told = |outcome: Outcome| match outcome {
        Outcome::Within | Outcome::Probed => None,
        Outcome::Under => Some("The dose is below the target by more than the tolerance."),
        Outcome::Over => Some("The dose is above the target by more than the tolerance."),
        Outcome::NotStable => Some("The balance did not settle: do not rely on the mass."),
        Outcome::Blocked => Some("No more powder left the spoon."),
        Outcome::Stopped => Some("The weighing was stopped."),
        Outcome::Aborted => Some("The weighing was aborted."),
        Outcome::Unknown => {
            Some("The process ended during the weighing: the content of the vial is not known.")
        }
    };
    all.extend(weighing.outcome.and_then(told).map(str::to_owned));
    all.extend(weighing.error.clone());
    if let Some(measured) = &weighing.measured {
        if measured.proven == Some(false) {
            all.push(format!(
                "Not proven: with its uncertainty of {} mg, the net mass may lie on either side of a tolerance limit.",
                digits(measured.uncertainty_mg)
            ));
        }
        match (measured.below_minimum_weight, measured.minimum_mg) {
            (Some(true), Some(minimum)) => all.push(format!(
                "Below the minimum weight of this balance, {} mg at the required accuracy: not accurately weighed in the sense of USP <41>.",
                digits(minimum)
            )),
            (None, _) => all.push("The balance's repeatability was not checked, so its minimum weight is not known.".to_owned()),
            _ => {}
        }
        if !(measured.stable_by_balance && measured.stable_by_window) {
            all.push(
                "The last reading was not stable by both the balance's flag and FLIP's own window."
                    .to_owned(),
            );
        }
    }
    all
}

fn word(outcome: Outcome) -> String {
    serde_json::to_value(outcome)
        .ok()
        .and_then(|value| value.as_str().map(|word| word.replace('_', " ")))
        .unwrap_or_default()
}

/// The outcome; within tolerance by less than the uncertainty, that it is not proven.
pub(super) fn outcome(weighing: &Weighing) -> String {
    let outcome = weighing.outcome.map(word).unwrap_or_default();
    let is_proven = weighing.measured.as_ref().and_then(|measured| measured.proven);
    let is_within = weighing.outcome == Some(Outcome::Within);
    if is_within && is_proven == Some(false) { format!("{outcome}, not proven") } else { outcome }
}

pub(super) fn yes(is: bool) -> &'static str {
    if is { "yes" } else { "no" }
}

/// Rounded to a hundredth, without trailing zeros.
pub(super) fn digits(value: f64) -> String {
    let text = format!("{value:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}
