//! `flip train`.

use crate::harness::{document, expect_status, flip};

#[test]
fn several_seeds_are_several_trainings() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path();
    let quick =
        ["--method", "sequential", "--sets", "2", "--tolerance-deg", "5", "--particles", "400"];
    expect_status(&flip(data, &[&["calibrate", "--powder", "sand"], &quick[..]].concat()), 0);
    let train = |seeds: &[&str]| {
        let small = [
            "train",
            "--powders",
            "sand",
            "--episodes",
            "4",
            "--surrogate-episodes",
            "4",
            "--json",
        ];
        let output = flip(data, &[&small[..], seeds].concat());
        expect_status(&output, 0);
        document(&output)
    };
    let both = train(&["--seeds", "3,4"]);
    assert_eq!((&both[0]["seed"], &both[1]["seed"]), (&3.into(), &4.into()));
    assert_ne!(both[0]["policy"], both[1]["policy"]);
    assert_eq!(train(&["--seed", "4"])["policy"], both[1]["policy"]);
}
