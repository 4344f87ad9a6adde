//! `flip bench check`: a dry test of every device of a bench file.

use super::super::Common;
use super::super::benches::read;
use super::super::failure::Failure;
use super::super::session::with_writer;
use flip_bench::hardware::bench_file::BenchFile;
use flip_bench::hardware::clock::Clock;
use flip_bench::hardware::conformance::{Bounds, Check, Looked, Report, Verdict, check};
use flip_bench::hardware::wire::Tap;
use serde::Serialize;
use std::path::PathBuf;

/// Arguments of `flip bench check`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Bench file listing the devices.
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
    /// Name of the person who checked spoon, vial and funnel.
    #[arg(long, value_name = "NAME", default_value = "")]
    by: String,
    /// Confirm that the spoon holds no powder, the vial is empty or removed and the arm's path is
    /// clear: the arm may move. Without it nothing moves.
    #[arg(long, requires = "by")]
    spoon_empty: bool,
    /// Confirm that the funnel is empty: the gate may open.
    #[arg(long, requires = "by")]
    funnel_empty: bool,
    /// Store the result in the data folder.
    #[arg(long)]
    keep: bool,
}

/// The document of `flip bench check`, as printed and stored.
#[derive(Debug, Serialize)]
struct Document {
    bench: BenchFile,
    #[serde(flatten)]
    report: Report,
}

/// Tests every device, and prints what is wrong. Exit status 1 if something is.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let bench = read("config", &arguments.config)?;
    let looked = Looked::by(&arguments.by, arguments.spoon_empty, arguments.funnel_empty)?;
    let report = check(&bench, &looked, &Bounds::CONTRACT, &Clock::wall(), &Tap::none());
    let document = Document { bench, report };
    common.print(&document, || text(&document.report))?;
    if arguments.keep {
        with_writer(common, async |lab| {
            lab.here()?.keep_conformance(&document).await?;
            Ok(())
        })?;
    }
    match document.report.count(Verdict::Failed) {
        0 => Ok(()),
        n => Err(Failure::Found(format!("{n} of {} checks failed", document.report.checks.len()))),
    }
}

fn text(report: &Report) -> String {
    let mut lines: Vec<String> = report.checks.iter().map(line).collect();
    let count = |verdict| report.count(verdict);
    lines.push(format!(
        "{} ok, {} warnings, {} failed, {} skipped",
        count(Verdict::Ok),
        count(Verdict::Warning),
        count(Verdict::Failed),
        count(Verdict::Skipped)
    ));
    lines.join("\n")
}

fn line(check: &Check) -> String {
    let verdict = match check.verdict {
        Verdict::Ok => "ok",
        Verdict::Warning => "warning",
        Verdict::Failed => "FAILED",
        Verdict::Skipped => "skipped",
    };
    let advice =
        check.advice.as_ref().map_or_else(String::new, |advice| format!("\n{:26}-> {advice}", ""));
    format!("{verdict:<8} {:<8} {:<18} {}{advice}", check.device, check.name, check.came)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_says_what_to_do_on_a_line_of_its_own() {
        let check = |verdict, advice: Option<&str>| Check {
            device: "arm",
            name: "stop",
            asked: "Stop".to_owned(),
            came: "stood after 80 ms".to_owned(),
            verdict,
            advice: advice.map(str::to_owned),
        };
        let checks = vec![check(Verdict::Failed, Some("be quicker")), check(Verdict::Ok, None)];
        let text = text(&Report { passed: false, checks });
        let lines: Vec<&str> = text.lines().collect();
        assert!(
            lines[0].starts_with("FAILED   arm      stop")
                && lines[0].ends_with("stood after 80 ms"),
            "{text}"
        );
        assert_eq!(lines[1].trim(), "-> be quicker");
        assert_eq!(lines[3], "1 ok, 0 warnings, 1 failed, 0 skipped");
    }
}
