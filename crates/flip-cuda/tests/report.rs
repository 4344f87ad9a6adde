//! `make gpu-report` in pieces, with programs that only say that they were called.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

/// Every program of the report. While `broken` exists heaps fail, and trainings end before they are whole.
const PROGRAM: &str = r#"#!/bin/bash
name="${0##*/} $1"
echo "$name" >> "$HERE/calls"
case "$name" in
    "gpu_report card") echo "${FOUND:-A card, 4 multiprocessors; 16 CPU cores}" ;;
    "gpu_report heaps") [ ! -e "$HERE/broken" ] || exit 1; echo "240 heaps" ;;
    published_experiment*) mkdir -p "$2"; echo round >> "$2/rounds"; [ ! -e "$HERE/broken" ] || exit 1; echo "$(wc -l < "$2/rounds") rounds" ;;
    *) echo "$name" ;;
esac
"#;

struct Report {
    here: tempfile::TempDir,
}

impl Report {
    fn new() -> Self {
        let report = Self { here: tempfile::tempdir().unwrap() };
        std::fs::create_dir(report.here.path().join("examples")).unwrap();
        let examples = ["examples/gpu_report", "examples/learner_report"];
        for name in ["flip", "emulator_rounds", "published_experiment", "weighing_gain"]
            .iter()
            .chain(&examples)
        {
            let path = report.here.path().join(name);
            std::fs::write(&path, PROGRAM).unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        }
        report
    }

    fn breaks(&self, broken: bool) {
        let file = self.here.path().join("broken");
        if broken { std::fs::write(file, "").unwrap() } else { std::fs::remove_file(file).unwrap() }
    }

    /// What it prints for three parts, whether it succeeds, and which programs it called.
    fn call(&self, found: Option<&str>) -> (String, bool, Vec<String>) {
        let (here, calls) = (self.here.path(), self.here.path().join("calls"));
        std::fs::write(&calls, "").unwrap();
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../.ci/gpu_report.py");
        let mut command = Command::new("python3");
        command.arg(script).arg(here).args(["speed", "heaps", "published"]);
        command.env("HERE", here).env("DATA", here.join("data"));
        let output = command.envs(found.map(|found| ("FOUND", found))).output().unwrap();
        let printed = String::from_utf8(output.stdout).unwrap();
        let calls = std::fs::read_to_string(calls).unwrap();
        let measured = calls.lines().filter(|call| *call != "gpu_report card").map(str::to_owned);
        (printed, output.status.success(), measured.collect())
    }
}

#[test]
fn a_report_goes_on_where_it_was_stopped_and_repeats_what_it_knows() {
    let report = Report::new();
    report.breaks(true);
    let (printed, whole, _) = report.call(None);
    assert!(!whole && printed.contains("\ngpu_report speed\n"), "{printed}");
    assert_eq!(printed.matches("failed: ").count(), 2, "{printed}");

    report.breaks(false);
    let (printed, whole, measured) = report.call(None);
    assert!(
        whole && printed.contains("\n240 heaps\n") && printed.contains("\n2 rounds\n"),
        "{printed}"
    );
    assert!(printed.contains("s, after a call that was stopped\n"), "{printed}");
    assert_eq!(measured, ["gpu_report heaps", "published_experiment published"]);

    assert_eq!(report.call(None), (printed, true, Vec::new()));
}

#[test]
fn another_program_or_card_is_measured_anew() {
    let report = Report::new();
    let (first, whole, measured) = report.call(None);
    assert!(whole && measured.contains(&"gpu_report speed".to_owned()), "{first}");
    let (_, _, again) = report.call(Some("Another card, 4 multiprocessors"));
    assert!(again.contains(&"gpu_report speed".to_owned()));
    assert!(!again.contains(&"flip calibrate".to_owned()), "calibrations are the processor's");

    std::fs::write(report.here.path().join("weighing_gain"), PROGRAM.to_owned() + "#\n").unwrap();
    let (printed, whole, anew) = report.call(None);
    assert!(whole && printed.contains("\n1 rounds\n"), "{printed}");
    assert_eq!(anew, measured);
}

#[test]
fn without_a_card_it_says_why_nothing_is_measured() {
    let said = "skipped: there is no NVIDIA driver on this machine";
    assert_eq!(Report::new().call(Some(said)), (format!("{said}\n"), true, Vec::new()));
}
