//! `flip policy`, and commands that name one.

use crate::harness::{command, document, expect_status, flip, stderr};
use flip_policy::{
    self as policy, Controller, Done, Gains, Kind, Manifest, Observation, Pid, Policy, Rules,
};
use serde_json::{Value, json};
use std::io::Write;
use std::path::Path;
use std::process::Stdio;

/// A policy file with a PID rule in which only the sum tilts and only the error shakes: its answers
/// can be computed by hand.
fn policy_file(folder: &Path) -> String {
    let gains = |p, i| Gains { p, i, d: 0.0 };
    let pid = Pid { incline: gains(0.0, 0.01), shake: gains(0.05, 0.0) };
    let manifest = Manifest::of_untrained(Kind::Pid { gains: pid }, Rules::FLIP, 0);
    let file = folder.join("pid.safetensors");
    std::fs::write(&file, policy::encode(&Policy { manifest, controller: Controller::Pid(pid) }))
        .unwrap();
    file.to_str().unwrap().to_owned()
}

#[test]
fn a_policy_out_of_a_file_answers_once_with_its_history_or_line_by_line() {
    let folder = tempfile::tempdir().unwrap();
    let file = policy_file(folder.path());
    let seen =
        |reading_mg: f64, pitch_deg: f64| Observation { reading_mg, target_mg: 10.0, pitch_deg };
    let infer = |more: &[&str]| {
        let asked = [
            "policy",
            "infer",
            "--file",
            &file,
            "--target-mg",
            "10",
            "--pitch-deg",
            "0.8",
            "--reading-mg",
            "4",
        ];
        flip(folder.path(), &[&asked[..], more].concat())
    };
    let expect = |answer: &Value, incline_change_deg: f64, shake_mm: f64, episode: &str| {
        assert!(
            (answer["incline_change_deg"].as_f64().unwrap() - incline_change_deg).abs() < 1e-9,
            "{answer}"
        );
        assert!((answer["shake_mm"].as_f64().unwrap() - shake_mm).abs() < 1e-9, "{answer}");
        assert_eq!(answer["episode"], episode);
    };
    // The sum needs the previously missing mass.
    let alone = infer(&["--json"]);
    expect_status(&alone, 2);
    assert!(
        stderr(&alone).contains("reading_mg: must be within 1 mg of the tare"),
        "{}",
        stderr(&alone)
    );
    // With the 10 mg missing before, the sum is 16.
    let action = flip_core::domain::bench::Action::once(0.8, 8.0);
    let history = folder.path().join("history.json");
    let steps = [Done { before: seen(0.0, 0.0), action, after: seen(4.0, 0.8) }];
    std::fs::write(&history, serde_json::to_string(&steps).unwrap()).unwrap();
    let remembered = infer(&["--json", "--history", history.to_str().unwrap()]);
    expect_status(&remembered, 0);
    expect(&document(&remembered), 1.28, 4.8, "running");
    assert!(
        String::from_utf8(infer(&["--history", history.to_str().unwrap()]).stdout)
            .unwrap()
            .contains("shake 4.80 mm")
    );
    let late = [Done { before: seen(3.0, 0.0), action, after: seen(4.0, 0.8) }];
    std::fs::write(&history, serde_json::to_string(&late).unwrap()).unwrap();
    assert!(
        stderr(&infer(&["--history", history.to_str().unwrap()]))
            .contains("history[0].before.reading_mg")
    );

    let lines = |lines: &[Value]| {
        let mut command = command(folder.path(), &["policy", "infer", "--file", &file, "--stdin"]);
        let mut process = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut stdin = process.stdin.take().unwrap();
        lines.iter().for_each(|line| writeln!(stdin, "{line}").unwrap());
        drop(stdin);
        process.wait_with_output().unwrap()
    };
    let course = [seen(0.0, 0.0), seen(4.0, 0.8), seen(9.5, 2.08)].map(|seen| json!(seen));
    let output = lines(&course);
    expect_status(&output, 0);
    let text = String::from_utf8(output.stdout).unwrap();
    let answers: Vec<Value> =
        text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(answers.len(), 3);
    expect(&answers[0], 0.8, 8.0, "running");
    expect(&answers[1], 1.28, 4.8, "running");
    expect(&answers[2], 1.32, 0.4, "terminated");
    let other_target = json!({ "reading_mg": 4.0, "target_mg": 12.0, "pitch_deg": 0.0 });
    for (line, named) in
        [(other_target, "target_mg: must stay 10 mg"), (json!({ "reading_mg": 4.0 }), "stdin[2]")]
    {
        let refused = lines(&[course[0].clone(), line]);
        expect_status(&refused, 2);
        assert!(stderr(&refused).contains(named), "{}", stderr(&refused));
    }
}

#[test]
fn a_policy_trained_elsewhere_is_imported_once() {
    let (folder, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let file = policy_file(elsewhere.path());
    let import = || flip(folder.path(), &["policy", "import", "--file", &file, "--json"]);
    let policy = document(&import());
    let id = policy["id"].as_str().unwrap();
    assert_eq!((&policy["kind"], &policy["training"]), (&json!("pid"), &Value::Null));
    assert_eq!(document(&import()), policy);
    let out = folder.path().join("out.safetensors");
    let export = ["policy", "export", "--policy", id, "--out", out.to_str().unwrap()];
    expect_status(&flip(folder.path(), &export), 0);
    assert_eq!(std::fs::read(&out).unwrap(), std::fs::read(&file).unwrap());
    let record = folder.path().join("record.json");
    let asked = ["audit", "export", "--out", record.to_str().unwrap()];
    expect_status(&flip(folder.path(), &asked), 0);
    let deeds = std::fs::read_to_string(record).unwrap();
    assert_eq!(deeds.matches("policy imported").count(), 1, "{deeds}");

    let text = folder.path().join("text.safetensors");
    std::fs::write(&text, "no policy").unwrap();
    let refused = flip(folder.path(), &["policy", "import", "--file", text.to_str().unwrap()]);
    expect_status(&refused, 2);
    assert!(stderr(&refused).contains("file: this is not a safetensors file"));
}

#[test]
fn bytes_that_are_no_policy_and_numbers_that_no_bench_shows_are_refused_by_field() {
    let folder = tempfile::tempdir().unwrap();
    let file = policy_file(folder.path());
    let text = folder.path().join("text.safetensors");
    std::fs::write(&text, "no policy").unwrap();
    let steps = json!([{ "before": { "reading_mg": 0.0, "target_mg": 10.0, "pitch_deg": 0.0 },
        "action": { "incline_change_deg": 0.0, "shake_mm": -1.0 }, "after": { "reading_mg": 0.0, "target_mg": 10.0, "pitch_deg": 0.0 } }]);
    let history = folder.path().join("history.json");
    std::fs::write(&history, steps.to_string()).unwrap();
    let infer = |file: &str, pitch: &str, more: &[&str]| {
        let asked = [
            "policy",
            "infer",
            "--file",
            file,
            "--target-mg",
            "10",
            "--reading-mg",
            "4",
            "--pitch-deg",
            pitch,
        ];
        let output = flip(folder.path(), &[&asked[..], more].concat());
        expect_status(&output, 2);
        stderr(&output)
    };
    assert!(
        infer(text.to_str().unwrap(), "0", &[]).contains("file: this is not a safetensors file")
    );
    assert!(infer(&file, "91", &[]).contains("pitch_deg: must be a number from -90 to 90"));
    let refused = infer(&file, "0", &["--history", history.to_str().unwrap()]);
    assert!(refused.contains("history[0].action.shake_mm"), "{refused}");
}

#[test]
fn a_policy_that_does_not_exist_exits_2_before_anything_is_calibrated() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [&["weigh", "--powder", "salt", "--target-mg", "15"] as &[&str], &["evaluate"]]
    {
        let output = flip(folder.path(), &[arguments, &["--policy", "p-0"]].concat());
        expect_status(&output, 2);
        assert!(
            stderr(&output).contains("there is no policy `p-0`"),
            "{arguments:?}: {}",
            stderr(&output)
        );
    }
}
