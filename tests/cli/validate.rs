//! `flip validate`, and what it and `flip observe` compute on a card.

use crate::harness::{document, expect_status, flip, stderr};

#[test]
fn validate_prints_what_it_measured_and_knows_its_checks_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let both = "free_fall,incline_threshold";
    let output = flip(folder.path(), &["validate", "--only", both, "--json"]);
    expect_status(&output, 0);
    let document = document(&output);
    let names: Vec<&str> = document["checks"]
        .as_array()
        .unwrap()
        .iter()
        .map(|c| c["name"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["free_fall", "incline_threshold"]);
    for check in document["checks"].as_array().unwrap() {
        assert_eq!(check["passed"], true, "{check}");
        for key in ["measured", "expected", "tolerance"] {
            assert!(check[key].is_f64(), "{key} of {check}");
        }
        assert!(check["unit"].is_string() && !check["source"].as_str().unwrap().is_empty());
    }
    let unknown = flip(folder.path(), &["validate", "--only", "antigravity"]);
    expect_status(&unknown, 2);
    assert!(
        stderr(&unknown).contains("only") && stderr(&unknown).contains("free_fall"),
        "{}",
        stderr(&unknown)
    );
}

#[test]
fn what_a_card_cannot_compute_is_refused_by_name_and_without_a_card_it_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |arguments: &[&str], said: &[&str]| {
        let output = flip(folder.path(), &[arguments, &["--device", "cuda"]].concat());
        expect_status(&output, 2);
        let error = stderr(&output);
        assert!(said.iter().all(|it| error.contains(it)), "{error}");
    };
    refused(
        &["validate", "--only", "free_fall"],
        &["only: `cuda` cannot compute `free_fall`", "leave it or"],
    );
    refused(
        &["observe", "shake_mass:pitch_deg=30,shake_mm=4", "drained_angle"],
        &["experiments: `cuda` cannot simulate `drained_angle`", "leave it or"],
    );
    if flip_cuda::find_all().is_err() {
        let said = ["device: no graphics card", "leaving this field out"];
        refused(&["validate", "--only", "rest_creep"], &said);
        refused(&["validate", "--extension", "rotation=1,rolling_friction=0.5"], &said);
        refused(&["observe", "shake_mass:pitch_deg=30,shake_mm=4"], &said);
    }
}
