//! `flip serve`, and commands on the folder that it holds.

use crate::harness::{command, document, expect_status, flip, stderr};
use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// A running `flip serve`, killed when the test ends.
struct Service {
    process: Child,
    document: Value,
}

impl Service {
    fn start(data_dir: &Path) -> Self {
        let mut command = command(data_dir, &["serve", "--listen", "127.0.0.1:0", "--json"]);
        let mut process = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut text = String::new();
        // The document is printed once the service listens, and ends with the brace in the first
        // column.
        for line in BufReader::new(process.stdout.take().unwrap()).lines() {
            let line = line.unwrap();
            text.push_str(&line);
            if line == "}" {
                break;
            }
        }
        let document = serde_json::from_str(&text).unwrap_or_else(|e| panic!("{e}: {text:?}"));
        Self { process, document }
    }

    fn address(&self) -> String {
        self.document["url"].as_str().unwrap().trim_start_matches("http://").to_owned()
    }

    /// Sends SIGTERM, as systemd and Docker do, and returns its exit status.
    fn terminate(mut self) -> Option<i32> {
        let kill = format!("kill -TERM {}", self.process.id());
        assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
        self.process.wait().unwrap().code()
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        // Already ended in most tests; then there is nothing to kill.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

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
