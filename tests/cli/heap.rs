//! `flip heap`.

use crate::harness::{command, document, expect_status, flip, stderr};
use serde_json::Value;

#[test]
fn repose_gives_the_same_bytes_twice_on_any_number_of_threads_and_on_every_path() {
    let folder = tempfile::tempdir().unwrap();
    let arguments =
        ["heap", "--friction", "0.3", "--cohesion", "0", "--repeats", "3", "--seed", "1", "--json"];
    let with = |name: &str, value: &str| {
        let output = command(folder.path(), &arguments).env(name, value).output().unwrap();
        expect_status(&output, 0);
        output.stdout
    };
    let one = with("RAYON_NUM_THREADS", "1");
    assert_eq!(one, with("RAYON_NUM_THREADS", "1"));
    assert_eq!(one, with("RAYON_NUM_THREADS", "2"));
    // A processor without AVX2 runs the portable path three times.
    assert_eq!(one, with("FLIP_SIMD", "portable"));
    assert_eq!(one, with("FLIP_SIMD", "avx2"));
    let document: Value = serde_json::from_slice(&one).unwrap();
    for key in ["repose_deg", "cone_deg", "repose_sd_deg", "particles", "creep_deg_per_s"] {
        assert!(document[key].is_number(), "{key} is not a number in {document}");
    }
    assert!(document["settings"].is_object());
    assert_eq!(document["parameters"]["friction"], 0.3);
}

#[test]
fn a_heap_says_whose_semantics_poured_it() {
    let folder = tempfile::tempdir().unwrap();
    let heap = |flags: &[&str]| {
        let arguments = [&["heap", "--particles", "300", "--seed", "1", "--json"], flags].concat();
        document(&flip(folder.path(), &arguments))
    };
    let (own, published) = (heap(&[]), heap(&["--compat", "physx"]));
    assert_eq!(own["settings"]["compat"], "physical");
    assert_eq!(published["settings"]["compat"], "physx");
    assert_eq!(own, heap(&["--compat", "physical"]));
    assert_ne!(own["repose_deg"], published["repose_deg"]);
}

#[test]
fn the_old_name_of_heap_still_pours_one_and_says_the_new_name() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["--particles", "300", "--seed", "1", "--json"];
    let new = flip(folder.path(), &[&["heap"], &arguments[..]].concat());
    let old = flip(folder.path(), &[&["repose"], &arguments[..]].concat());
    expect_status(&old, 0);
    assert_eq!(old.stdout, new.stdout);
    assert!(stderr(&old).contains("`flip repose` is now `flip heap`"), "{}", stderr(&old));
    assert!(!stderr(&new).contains("now"), "{}", stderr(&new));
}
