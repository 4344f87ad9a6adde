//! `flip validate`: does the simulator obey the laws of nature? Experiments run in parallel; the
//! document contains no times.

use super::device::DeviceArguments;
use super::failure::Failure;
use super::table::table;
use super::{Common, parameters};
use crate::app::local_engine;
use crate::telemetry;
use flip_core::domain::FieldError;
use flip_sim as sim;
use flip_sim::mechanisms::Extensions;
use flip_sim::validate::{Check, Convergence, Experiment, Suite, Verdict, experiments};
use rayon::prelude::*;
use serde::Serialize;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Arguments of `flip validate`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Run these checks, or all checks of these experiments, by name.
    #[arg(long, value_name = "NAME,…", value_delimiter = ',')]
    only: Vec<String>,
    /// Run the experiments with mechanisms missing from the base simulator, as in
    /// `rotation=1,rolling_friction=0.5`.
    #[arg(long, value_name = "NAME=AMPLITUDE,…", value_delimiter = ',')]
    extension: Vec<String>,
    #[command(flatten)]
    device: DeviceArguments,
}

/// The document of `flip validate`.
#[derive(Debug, Serialize)]
struct Document {
    simulator: &'static str,
    /// The card, if one simulated.
    #[serde(skip_serializing_if = "Option::is_none")]
    card: Option<String>,
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
    let device = arguments.device.device();
    if !device.is_cpu() {
        refuse_on_a_card(&chosen, &arguments.only)?;
    }
    let suite = Suite::extended(extensions);
    let engine = local_engine(device)?;
    let card = engine.as_ref().map(|engine| engine.name());
    let mut checks = match engine {
        None => measure(&chosen, &suite),
        Some(engine) => measure_on(&chosen, &suite.on(engine))?,
    };
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
        card,
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

/// What a card cannot compute of what was asked for by name.
fn refuse_on_a_card(chosen: &[Experiment], only: &[String]) -> Result<(), FieldError> {
    let off = chosen.iter().find(|experiment| !experiment.is_on_engines());
    match off.filter(|_| !only.is_empty()) {
        None => Ok(()),
        Some(off) => {
            let advice = format!(
                "`cuda` cannot compute `{}`, only heaps of up to 2560 grains and doses of spoons: leave it or `device` out",
                off.name
            );
            Err(FieldError::new("only", advice))
        }
    }
}

/// The same on an engine, as far as it can. Batches fill it, so that one experiment follows another.
fn measure_on(chosen: &[Experiment], suite: &Suite) -> Result<Vec<Check>, Failure> {
    let (on, off): (Vec<&Experiment>, Vec<&Experiment>) =
        chosen.iter().partition(|experiment| experiment.is_on_engines());
    if !off.is_empty() {
        let names: Vec<&str> = off.iter().map(|experiment| experiment.name).collect();
        telemetry::say(format_args!("not on a card, left out: {}", names.join(", ")));
    }
    let mut checks = Vec::new();
    for (k, experiment) in on.iter().enumerate() {
        checks.extend(experiment.run(suite));
        if let Some(why) = suite.failed() {
            return Err(anyhow::anyhow!("{}: {why}", experiment.name).into());
        }
        telemetry::say(format_args!("[{}/{}] {}", k + 1, on.len(), experiment.name));
    }
    Ok(checks)
}

fn text(document: &Document) -> String {
    let rows: Vec<Vec<String>> = document.checks.iter().map(row).collect();
    let mut text =
        table(&["check", "measured", "expected", "+-", "unit", "result", "source"], &rows);
    text.push_str(&format!(
        "\n\n{} passed, {} known deviations, {} failed",
        document.passed, document.known_deviations, document.failed
    ));
    if document.checks.iter().any(|check| check.measured.is_nan()) {
        text.push_str(
            "\nNaN: there was nothing to measure, as when grains roll away and leave no heap",
        );
    }
    let doses: Vec<(&Check, &Convergence)> = document
        .checks
        .iter()
        .filter_map(|check| Some((check, check.convergence.as_ref()?)))
        .collect();
    if !doses.is_empty() {
        text.push_str(&format!("\n\n{}", over_substeps(&doses)));
    }
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

/// What each probe of a dose gave at each substep, and what of it meets the goal.
fn over_substeps(doses: &[(&Check, &Convergence)]) -> String {
    let rows: Vec<Vec<String>> = doses
        .iter()
        .flat_map(|(check, of)| of.substeps.iter().enumerate().map(|(k, _)| level(check, of, k)))
        .collect();
    let header =
        ["dose", "substep us", "mg", "+-", "from finest mg", "95 % interval", "goal mg", "verdict"];
    let met = |k: usize| {
        let is_met = |of: &Convergence| of.differences[k].verdict == Verdict::Met;
        doses.iter().filter(|(_, of)| is_met(of)).count()
    };
    let first = doses[0].1;
    let counts: Vec<String> = (0..first.differences.len())
        .map(|k| {
            let us = first.differences[k].substep_us;
            format!("{} of {} at {us} us", met(k), doses.len())
        })
        .collect();
    let spoons = first.spoons;
    format!(
        "{}\n\nDoses over the substep, {spoons} spoons each: the goal, 3 % or 0.1 mg from the finest, is met by {}.",
        table(&header, &rows),
        counts.join(", ")
    )
}

/// One substep of a probe.
fn level(check: &Check, of: &Convergence, k: usize) -> Vec<String> {
    let at = &of.substeps[k];
    let name = if k == 0 { check.name } else { "" };
    let mut row = vec![
        name.to_owned(),
        at.substep_us.to_string(),
        format!("{:.3}", at.mean_mg),
        format!("{:.3}", at.error_mg),
    ];
    row.extend(of.differences.get(k).map_or_else(
        || ["-"; 4].map(str::to_owned),
        |difference| {
            let [low, high] = difference.interval_mg;
            [
                format!("{:+.3}", difference.mean_mg),
                format!("{low:+.3} to {high:+.3}"),
                format!("{:.3}", of.goal_mg),
                verdict(difference.verdict).to_owned(),
            ]
        },
    ));
    row
}

fn verdict(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Met => "met",
        Verdict::Missed => "MISSED",
        Verdict::Undecided => "undecided",
    }
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
    use flip_sim::validate::{Difference, KnownDeviation, Level};

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
    fn a_dose_over_the_substep_shows_every_substep_and_how_many_meet_the_goal() {
        let level = |substep_us, mean_mg| Level { substep_us, mean_mg, error_mg: 0.05 };
        let difference = |substep_us, mean_mg: f64, verdict| {
            let interval_mg = [mean_mg - 0.1, mean_mg + 0.1];
            Difference { substep_us, mean_mg, interval_mg, verdict }
        };
        let convergence = Convergence {
            spoons: 8,
            substeps: vec![level(80, 11.0), level(40, 10.1), level(20, 10.0)],
            differences: vec![
                difference(80, 1.0, Verdict::Missed),
                difference(40, 0.1, Verdict::Met),
            ],
            goal_mg: 0.3,
        };
        let check = Check {
            name: "dose_frictional_4mm",
            measured: 1.1,
            expected: 0.0,
            tolerance: 0.3,
            unit: "mg",
            passed: false,
            known_deviation: Some(KnownDeviation { miss: 0.8, reason: "the substep" }),
            source: "",
            convergence: Some(convergence),
        };
        let document = Document {
            simulator: "pbd",
            card: None,
            extensions: Extensions::default(),
            passed: 0,
            known_deviations: 1,
            failed: 0,
            checks: vec![check],
        };
        let text = text(&document);
        assert!(text.contains("is met by 0 of 1 at 80 us, 1 of 1 at 40 us."), "{text}");
        let cells = |us: &str| -> Vec<String> {
            let row = text.lines().find(|line| line.contains(us)).unwrap();
            row.split_whitespace().map(str::to_owned).collect()
        };
        assert_eq!(
            cells("11.000"),
            [
                "dose_frictional_4mm",
                "80",
                "11.000",
                "0.050",
                "+1.000",
                "+0.900",
                "to",
                "+1.100",
                "0.300",
                "MISSED"
            ]
        );
        assert_eq!(cells("10.100").last().map(String::as_str), Some("met"));
        assert_eq!(cells("10.000").last().map(String::as_str), Some("-"));
        assert!(text.contains("dose_frictional_4mm: off by 0.8000 mg: the substep"), "{text}");
        assert!(serde_json::to_string(&document).unwrap().contains("\"verdict\":\"missed\""));
    }

    #[test]
    fn what_could_not_be_measured_fails_and_is_explained() {
        let measured = |measured| {
            let check = Check {
                name: "repose_funnel",
                measured,
                expected: 0.0,
                tolerance: 0.3,
                unit: "deg",
                passed: false,
                known_deviation: None,
                source: "",
                convergence: None,
            };
            text(&Document {
                simulator: "pbd",
                card: None,
                extensions: Extensions::default(),
                passed: 0,
                known_deviations: 0,
                failed: 1,
                checks: vec![check],
            })
        };
        assert!(measured(f64::NAN).ends_with("roll away and leave no heap"));
        assert!(!measured(1.0).contains("NaN"));
    }

    #[test]
    fn numbers_have_four_significant_digits() {
        assert_eq!(
            [short(19.4712), short(0.0), short(0.16667), short(2.5e-7)],
            ["19.47", "0", "0.1667", "2.5e-7"]
        );
    }
}
