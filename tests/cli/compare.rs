//! `flip compare`.

use crate::harness::{document, expect_status, flip};

#[test]
fn two_calibrations_are_compared_by_the_ids_that_jobs_lists() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    for seed in ["1", "2"] {
        let quick =
            ["--method", "sequential", "--sets", "2", "--tolerance-deg", "5", "--particles", "400"];
        let arguments =
            [&["calibrate", "--powder", "sand", "--seed", seed, "--json"], &quick[..]].concat();
        expect_status(&flip(data, &arguments), 0);
    }
    let jobs = document(&flip(data, &["jobs", "--json"]));
    let ids: Vec<&str> =
        jobs["items"].as_array().unwrap().iter().map(|job| job["id"].as_str().unwrap()).collect();
    let compared = document(&flip(data, &["compare", ids[0], ids[1], "--json"]));
    assert_eq!(
        (&compared["calibration"]["id"], &compared["with"]["id"]),
        (&ids[0].into(), &ids[1].into())
    );
    assert_eq!(compared["with"]["parameters"].as_array().unwrap().len(), 9);
    let text = flip(data, &["compare", ids[0], ids[1]]);
    expect_status(&text, 0);
    let text = String::from_utf8(text.stdout).unwrap();
    assert!(text.contains("friction") && text.contains("mean angles differ by"), "{text}");
    expect_status(&flip(data, &["compare", ids[0], "none"]), 2);
}
