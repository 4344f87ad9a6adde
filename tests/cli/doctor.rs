//! `flip doctor`.

use crate::harness::{document, expect_status, flip};
use serde_json::json;

#[test]
fn a_doctor_looks_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let looked = flip(&data, &["doctor", "--listen", "127.0.0.1:0", "--json"]);
    expect_status(&looked, 0);
    let found = document(&looked);
    let names: Vec<&str> =
        found.as_array().unwrap().iter().map(|it| it["what"].as_str().unwrap()).collect();
    assert_eq!(
        names,
        ["processor", "memory", "clock", "descriptors", "disk", "data folder", "port"]
    );
    assert!(!data.exists());
    expect_status(&flip(&data, &["jobs"]), 0);
    std::fs::write(folder.path().join("bench.toml"), "[balance]\n").unwrap();
    let bench = folder.path().join("bench.toml");
    let looked = flip(
        &data,
        &["doctor", "--listen", "127.0.0.1:0", "--bench", bench.to_str().unwrap(), "--json"],
    );
    expect_status(&looked, 1);
    let found = document(&looked);
    let of = |what: &str| {
        found.as_array().unwrap().iter().find(|it| it["what"] == what).unwrap()["verdict"].clone()
    };
    assert_eq!((of("database"), of("bench file")), (json!("ok"), json!("failed")));
}
