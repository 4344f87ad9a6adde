//! `flip train`.

use crate::harness::{Service, document, expect_status, flip, stderr};

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
    assert_eq!(train(&["--seed", "4", "--gradients", "libtorch"])["policy"], both[1]["policy"]);
    let ours = train(&["--seed", "4", "--gradients", "fused"]);
    assert_ne!(ours["policy"], both[1]["policy"]);
    let refused = flip(data, &["train", "--gradients", "by-hand"]);
    expect_status(&refused, 2);
    assert!(
        stderr(&refused).contains("[possible values: libtorch, fused]"),
        "{}",
        stderr(&refused)
    );
}

#[test]
fn a_card_that_is_not_there_is_refused_before_anything_is_calibrated_here_and_by_a_server() {
    if let Ok(card) = flip_cuda::find(0) {
        println!("skipped: there is {card}");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let refused = |data: &std::path::Path, arguments: &[&str]| {
        let output = flip(data, arguments);
        expect_status(&output, 2);
        let said = stderr(&output);
        assert!(said.contains("device") && said.contains("use the CPU"), "{said}");
        assert!(!said.contains("calibrat"), "{said}");
    };
    for command in ["train", "evaluate"] {
        refused(folder.path(), &[command, "--device", "cuda"]);
    }
    let demonstration = ["demo", "--exit", "--listen", "127.0.0.1:0", "--device", "cuda"];
    refused(folder.path(), &demonstration);
    expect_status(&flip(folder.path(), &["evaluate", "--device", "abacus"]), 2);
    let service = Service::start(folder.path());
    for command in ["train", "evaluate"] {
        let asked = service.ask(&[command, "--device", "cuda"]);
        expect_status(&asked, 2);
        let said = stderr(&asked);
        assert!(said.contains("device") && said.contains("use the CPU"), "{said}");
    }
}
