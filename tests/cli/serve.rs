//! `flip serve`, and commands on the folder that it holds.

use crate::harness::{Service, document, expect_status, flip, stderr};
use serde_json::Value;

#[test]
fn while_a_server_holds_the_database_writers_exit_2_and_readers_read() {
    let folder = tempfile::tempdir().unwrap();
    let service = Service::start(folder.path());
    for arguments in
        [&["calibrate", "--powder", "salt"] as &[&str], &["serve", "--listen", "127.0.0.1:0"]]
    {
        let output = flip(folder.path(), arguments);
        expect_status(&output, 2);
        assert!(
            stderr(&output).contains("holds this database"),
            "{arguments:?}: {}",
            stderr(&output)
        );
    }
    let refused = flip(folder.path(), &["calibrate", "--powder", "salt"]);
    assert!(stderr(&refused).contains("--server http://ADDRESS"), "{}", stderr(&refused));
    let jobs = flip(folder.path(), &["jobs", "--json"]);
    expect_status(&jobs, 0);
    assert!(document(&jobs)["items"].is_array());
    let health = flip(folder.path(), &["health", "--listen", &service.address()]);
    expect_status(&health, 0);
    assert_eq!(service.terminate(), Some(0));
}

#[test]
fn the_first_start_shows_a_token_and_later_ones_none() {
    let folder = tempfile::tempdir().unwrap();
    let first = Service::start(folder.path());
    assert!(first.document["token"].as_str().unwrap().starts_with("flip_"));
    assert_eq!(first.terminate(), Some(0));
    let second = Service::start(folder.path());
    assert_eq!(second.document["token"], Value::Null);
    assert_eq!(second.terminate(), Some(0));
}
