//! `flip validate`: does the simulator obey the laws of nature? Experiments run in parallel; the
//! document contains no times.

use super::failure::Failure;
use super::table::table;
use super::{Common, parameters};
use crate::telemetry;
use flip_core::domain::FieldError;
use flip_sim as sim;
use flip_sim::mechanisms::Extensions;
use flip_sim::validate::{Check, Experiment, Suite, experiments};
use rayon::prelude::*;
use serde::Serialize;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Arguments of `flip validate`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Run one check, or all checks of one experiment, by name; may be repeated.
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// Run the experiments with a mechanism missing from the base simulator, as in `rotation=1`;
    /// may be repeated.
    #[arg(long, value_name = "NAME=AMPLITUDE")]
    extension: Vec<String>,
}

/// The document of `flip validate`.
#[derive(Debug, Serialize)]
struct Document {
    simulator: &'static str,
    #[serde(skip_serializing_if = "Extensions::is_none")]
    extensions: Extensions,
    passed: usize,
    known_deviations: usize,
    failed: usize,
    checks: Vec<Check>,
}

/// Runs the suite and prints the measurements; an undocumented deviation is a failure.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let chosen = choose(&arguments.only)?;
    let extensions = parameters::extensions(&arguments.extension)?;
    let mut checks = measure(&chosen, &Suite::extended(extensions));
    // A check requested by name is reported without the other checks of its experiment.
    let is_asked = |check: &Check| {
        arguments.only.is_empty() || arguments.only.iter().any(|name| name == check.name)
    };
    let is_whole = |check: &Check| {
        chosen.iter().any(|e| {
            e.checks.contains(&check.name) && arguments.only.iter().any(|name| name == e.name)
        })
    };
    checks.retain(|check| is_asked(check) || is_whole(check));
    let passed = checks.iter().filter(|check| check.passed).count();
    let accounted = checks.iter().filter(|check| check.is_accounted_for()).count();
    let failed = checks.len() - accounted;
    let simulator = sim::VERSION;
    let document = Document {
        simulator,
        extensions,
        passed,
        known_deviations: accounted - passed,
        failed,
        checks,
    };
    common.print(&document, || text(&document))?;
    match failed {
        0 => Ok(()),
        _ => Err(Failure::Found(format!("{failed} of {} checks failed", document.checks.len()))),
    }
}

/// The experiments that contain a check or have a name in `only`; all if it is empty.
fn choose(only: &[String]) -> Result<Vec<Experiment>, FieldError> {
    let all = experiments();
    let holds = |experiment: &Experiment, name: &str| {
        experiment.name == name || experiment.checks.contains(&name)
    };
    if let Some(unknown) =
        only.iter().find(|name| !all.iter().any(|experiment| holds(experiment, name)))
    {
        let names: Vec<&str> =
            all.iter().flat_map(|experiment| experiment.checks.iter().copied()).collect();
        return Err(FieldError::new(
            "only",
            format!("there is no check `{unknown}`; there are {}", names.join(", ")),
        ));
    }
    let is_chosen = |experiment: &Experiment| {
        only.is_empty() || only.iter().any(|name| holds(experiment, name))
    };
    Ok(all.into_iter().filter(is_chosen).collect())
}

/// Runs every experiment separately; `collect` keeps their order, so the number of threads does not
/// affect the result.
fn measure(chosen: &[Experiment], suite: &Suite) -> Vec<Check> {
    let done = AtomicUsize::new(0);
    let run = |experiment: &Experiment| {
        let checks = experiment.run(suite);
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        telemetry::say(format_args!("[{done}/{}] {}", chosen.len(), experiment.name));
        checks
    };
    // One experiment at a time: their durations differ by orders of magnitude.
    chosen.par_iter().with_max_len(1).map(run).flatten().collect()
}

fn text(document: &Document) -> String {
    let rows: Vec<Vec<String>> = document.checks.iter().map(row).collect();
    let mut text =
        table(&["check", "measured", "expected", "+-", "unit", "result", "source"], &rows);
    text.push_str(&format!(
        "\n\n{} passed, {} known deviations, {} failed",
        document.passed, document.known_deviations, document.failed
    ));
    for check in &document.checks {
        if let Some(known) = check.known_deviation {
            text.push_str(&format!(
                "\n{}: off by {} {}: {}",
                check.name,
                short(check.miss()),
                check.unit,
                known.reason
            ));
        }
    }
    text
}

fn row(check: &Check) -> Vec<String> {
    let result = match (check.passed, check.known_deviation.is_some()) {
        (true, _) => "passed",
        (false, true) => "known deviation",
        (false, false) => "FAILED",
    };
    vec![
        check.name.to_owned(),
        short(check.measured),
        short(check.expected),
        short(check.tolerance),
        check.unit.to_owned(),
        result.to_owned(),
        check.source.to_owned(),
    ]
}

/// Four significant digits.
fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let digits = 3 - value.abs().log10().floor() as i32;
    match digits {
        ..=5 => format!("{value:.*}", digits.max(0) as usize),
        _ => format!("{value:.1e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_check_is_found_by_its_name_and_by_its_experiment() {
        let names = |only: &[&str]| -> Result<Vec<&str>, FieldError> {
            let only: Vec<String> = only.iter().map(|name| (*name).to_owned()).collect();
            Ok(choose(&only)?.iter().map(|experiment| experiment.name).collect())
        };
        assert_eq!(names(&["incline_threshold"]).unwrap(), ["incline"]);
        assert_eq!(names(&["incline", "free_fall"]).unwrap().len(), 2);
        assert_eq!(names(&[]).unwrap().len(), experiments().len());
        assert!(names(&["inclin"]).unwrap_err().message.contains("incline_threshold"));
    }

    #[test]
    fn numbers_have_four_significant_digits() {
        assert_eq!(
            [short(19.4712), short(0.0), short(0.16667), short(2.5e-7)],
            ["19.47", "0", "0.1667", "2.5e-7"]
        );
    }
}
