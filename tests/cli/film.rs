//! `flip film`.

use crate::characterise::calibrated;
use crate::harness::{document, expect_status, flip, stderr};
use flip_core::domain::parameters::ParameterSet;
use serde_json::json;

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
