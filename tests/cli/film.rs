//! `flip film`.

use crate::characterise::calibrated;
use crate::harness::{document, expect_status, flip, stderr};
use flip_core::domain::parameters::ParameterSet;
use serde_json::{Value, json};

#[test]
fn what_callers_write_on_doses_and_jobs_is_kept_and_found() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    calibrated(data);
    let weigh = ["weigh", "--powder", "salt", "--target-mg", "8", "--label"];
    let labelled = |labels: &[&str]| flip(data, &[&weigh[..], labels].concat());
    expect_status(&labelled(&["study:X: 2", "--label", "plate:A7"]), 0);
    for (wrong, told) in [
        (&["study"][..], "must be a key and its value, as `plate:A7`, got `study`"),
        (&["plate:A7", "--label", "plate:B1"][..], "label: `plate` has two values"),
    ] {
        let refused = labelled(wrong);
        expect_status(&refused, 2);
        assert!(stderr(&refused).contains(told), "{}", stderr(&refused));
    }
    let intents = data.join("intents.json");
    let export = ["audit", "export", "--kind", "intent", "--out", intents.to_str().unwrap()];
    expect_status(&flip(data, &export), 0);
    let intents: Value = serde_json::from_slice(&std::fs::read(intents).unwrap()).unwrap();
    let kept: Vec<&Value> =
        intents.as_array().unwrap().iter().map(|it| &it["body"]["labels"]).collect();
    assert_eq!(kept, [&json!({ "plate": "A7", "study": "X: 2" })]);
    expect_status(&flip(data, &["film", "--label", "plate:A7"]), 0);
    let films = |label: &str| {
        let found = document(&flip(data, &["jobs", "--label", label, "--json"]));
        found["items"].as_array().unwrap().len()
    };
    assert_eq!((films("plate:A7"), films("plate:A8"), films("study:X: 2")), (1, 0, 0));
}

#[test]
fn a_dose_is_filmed_into_a_file_and_made_only_once() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    calibrated(data);
    let early = flip(data, &["film"]);
    expect_status(&early, 2);
    assert!(stderr(&early).contains("weighing: there is none yet"), "{}", stderr(&early));
    let weighed = flip(data, &["weigh", "--powder", "salt", "--target-mg", "8", "--json"]);
    expect_status(&weighed, 0);
    let weighed = document(&weighed);
    let file = data.join("dose.flipfilm");
    let film = ["film", "--out", file.to_str().unwrap()];
    let made = flip(data, &[&film[..], &["--json"]].concat());
    expect_status(&made, 0);
    let made = document(&made);
    assert_eq!(made["head"]["vial_mg"], weighed["dispensed_mg"], "the dose that was poured");
    assert_eq!((&made["spoonful"], &made["bench"]), (&json!(1), &json!("simulated")));
    let bytes = std::fs::read(&file).unwrap();
    assert_eq!((&bytes[..8], &made["size_bytes"]), (&b"FLIPFILM"[..], &json!(bytes.len())));
    let again = flip(data, &film);
    expect_status(&again, 0);
    let text = String::from_utf8(again.stdout).unwrap();
    assert!(text.contains("level") && text.contains("made again"), "{text}");
    let films = document(&flip(data, &["jobs", "--kind", "film", "--json"]));
    assert_eq!(films["items"].as_array().unwrap().len(), 1);
    let heap = ["film", "--set", &ParameterSet::default().id(), "--seed", "3"];
    let poured = flip(data, &[&heap[..], &["--json"]].concat());
    expect_status(&poured, 0);
    let poured = document(&poured);
    assert_eq!((&poured["seed"], &poured["heap"]["grains"]), (&json!(3), &json!(2000)), "{poured}");
    let text = String::from_utf8(flip(data, &heap).stdout).unwrap();
    assert!(text.contains("angle of repose") && text.contains("seed 3"), "{text}");
    let id = made["weighing"].as_str().unwrap();
    for (more, named) in [
        (&["--set", "ps-none"][..], "set: there is no parameter set `ps-none`"),
        (&["--set", "ps-none", "--weighing", id][..], "set: must be left out with `weighing`"),
        (&["--weighing", "none"][..], "weighing: there is no weighing `none`"),
        (&["--weighing", id, "--spoonful", "9"][..], "spoonful: must be from 1 to 1, got 9"),
        (&["--weighing", id, "--out", "/nowhere/a.flipfilm"][..], "out: "),
    ] {
        let refused = flip(data, &[&["film"], more].concat());
        expect_status(&refused, 2);
        assert!(stderr(&refused).contains(named), "{}", stderr(&refused));
    }
}
