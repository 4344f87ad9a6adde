//! What holds for all commands: help, completions, the data folder, refusals.

use crate::harness::{document, expect_status, flip, stderr};
use serde_json::Value;

const COMMANDS: [&str; 28] = [
    "serve",
    "worker",
    "demo",
    "heap",
    "validate",
    "bench",
    "calibrate",
    "compare",
    "observe",
    "measurements",
    "shakes",
    "train",
    "evaluate",
    "discover",
    "policy",
    "weigh",
    "characterise",
    "film",
    "jobs",
    "token",
    "export",
    "backup",
    "restore",
    "migrate",
    "doctor",
    "config",
    "completions",
    "man",
];

#[test]
fn help_lists_every_command_and_every_command_has_help() {
    let folder = tempfile::tempdir().unwrap();
    let help = flip(folder.path(), &["--help"]);
    expect_status(&help, 0);
    let text = String::from_utf8(help.stdout).unwrap();
    for name in COMMANDS {
        assert!(
            text.lines().any(|line| line.trim_start().starts_with(name)),
            "{name} is missing in:\n{text}"
        );
        let help = flip(folder.path(), &[name, "--help"]);
        expect_status(&help, 0);
        let text = String::from_utf8(help.stdout).unwrap();
        for flag in ["--data-dir", "--seed", "--json", "--server"] {
            assert!(text.contains(flag), "{name} --help does not name {flag}");
        }
    }
}

#[test]
fn shells_and_man_know_every_command() {
    let folder = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish"] {
        let script = flip(folder.path(), &["completions", shell]);
        expect_status(&script, 0);
        let script = String::from_utf8(script.stdout).unwrap();
        assert!(COMMANDS.iter().all(|name| script.contains(name)), "{shell}");
    }
    let pages = folder.path().join("man1");
    expect_status(&flip(folder.path(), &["man", pages.to_str().unwrap()]), 0);
    for name in COMMANDS {
        let page = std::fs::read_to_string(pages.join(format!("flip-{name}.1"))).unwrap();
        assert!(page.contains("\\-\\-data\\-dir") || page.contains("data"), "{name}");
    }
}

#[test]
fn a_fresh_data_folder_is_made_and_seeded_by_whatever_comes_first() {
    let folder = tempfile::tempdir().unwrap();
    let fresh = folder.path().join("a").join("b");
    let output = flip(&fresh, &["jobs", "--json"]);
    expect_status(&output, 0);
    assert_eq!(document(&output)["items"], Value::Array(vec![]));
    let databases = std::fs::read_dir(&fresh).unwrap().filter(|entry| {
        let name = entry.as_ref().unwrap().file_name();
        name.to_string_lossy().ends_with(".db")
    });
    assert_eq!(databases.count(), 1);
}

#[test]
fn bad_input_exits_2_and_names_the_field() {
    let folder = tempfile::tempdir().unwrap();
    let cases: [(&[&str], &str); 39] = [
        (&["heap", "--friction", "1.31"], "friction: must be a number from 0 to 1.3"),
        (&["heap", "--cohesion", "NaN"], "cohesion: must be a number from 0 to 1.2"),
        (&["heap", "--particle-diameter-mm", "-1"], "particle_diameter_mm"),
        (&["heap", "--damping", "soft"], "--damping"),
        (&["heap", "--repeats", "0"], "repeats"),
        (&["heap", "--readings", "65"], "readings: must be from 1 to 64"),
        (&["heap", "--particles", "199"], "particles: must be from 200 to 20000"),
        (&["heap", "--weight", "3"], "--weight"),
        (&["heap", "--compat", "flex"], "--compat"),
        (&["bench", "sim", "--windows", "0"], "windows: must be from 1 to 100"),
        (&["bench", "sim", "--sizes", "2000,99"], "sizes: must be from 100 to 200000"),
        (
            &["bench", "bed", "--particles", "99", "bed.csv"],
            "particles: must be from 100 to 200000",
        ),
        (&["calibrate", "--powder", "chalk"], "powder"),
        (&["calibrate", "--powder", "salt", "--sets", "0"], "sets"),
        (&["calibrate", "--powder", "salt", "--tolerance-deg", "inf"], "tolerance_deg"),
        (&["calibrate", "--repose-deg", "90"], "repose_deg"),
        (&["calibrate", "--repose-deg", "30", "--sd-deg", "2", "--n", "0"], "n: must be from 1"),
        (&["calibrate", "--powder", "salt", "--repose-deg", "30"], "--repose-deg"),
        (&["measurements", "import", "nowhere.csv"], "file: nowhere.csv cannot be read"),
        (&["measurements", "export", "--powder", "chalk"], "powder"),
        (&["train", "--order", "sideways"], "--order"),
        (&["train", "--episodes", "0"], "episodes"),
        (
            &["train", "--order", "curriculum", "--episodes", "20", "--surrogate-episodes", "21"],
            "surrogate_episodes",
        ),
        (&["weigh", "--powder", "salt", "--target-mg", "-5"], "target_mg"),
        (&["weigh", "--powder", "chalk", "--target-mg", "5"], "powder"),
        (&["weigh", "--powder", "salt"], "--target-mg"),
        (&["weigh", "--list", "nowhere.csv"], "list: nowhere.csv cannot be read"),
        (&["weigh", "--list", "x.csv", "--powder", "salt"], "--powder"),
        (&["serve", "--listen", "0.0.0.0:0"], "listen: 0.0.0.0:0"),
        (&["policy", "show", "--policy", "p-0"], "policy: there is no policy"),
        (&["policy", "infer", "--file", "gone.safetensors", "--stdin"], "file: gone.safetensors"),
        (
            &["discover", "--measurements", "nowhere.csv", "--out", "found"],
            "measurements: nowhere.csv cannot be read",
        ),
        (&["discover", "--measurements", "m.csv"], "--out"),
        (
            &["discover", "--traces", "nowhere.csv", "--out", "found"],
            "traces: nowhere.csv cannot be read",
        ),
        (&["discover", "--out", "found"], "--measurements"),
        (
            &["evaluate", "--extension", "rotation"],
            "extension: must be a name, an equals sign and a number",
        ),
        // Of a list with commas each is read for itself.
        (&["evaluate", "--extension", "rotation=1,rolling"], "got `rolling`"),
        (&["heap", "--extension", "rotation=1,rolling"], "got `rolling`"),
        (&["calibrate", "--powder", "salt", "--fix", "gravity_scale=1,cohesion"], "got `cohesion`"),
    ];
    for (arguments, named) in cases {
        let output = flip(folder.path(), arguments);
        expect_status(&output, 2);
        assert!(
            stderr(&output).contains(named),
            "{arguments:?} does not name {named}: {}",
            stderr(&output)
        );
        let output = flip(folder.path(), &[arguments, &["--json"]].concat());
        expect_status(&output, 2);
        assert_eq!(document(&output)["error"]["kind"], "bad_input", "{arguments:?}");
    }
}
