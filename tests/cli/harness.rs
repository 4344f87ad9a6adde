//! The binary, its exit status and its document.

use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

/// Runs the binary on a data folder.
pub fn flip(data_dir: &Path, arguments: &[&str]) -> Output {
    command(data_dir, arguments).output().unwrap()
}

pub fn command(data_dir: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_flip"));
    command
        .args(arguments)
        .arg("--data-dir")
        .arg(data_dir)
        .env_remove("FLIP_LOG")
        .env_remove("FLIP_TOKEN");
    command
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// The single document on stdout; anything in addition to it does not parse.
pub fn document(output: &Output) -> Value {
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    serde_json::from_str(&text)
        .unwrap_or_else(|e| panic!("{e}: stdout {text:?}, stderr {:?}", stderr(output)))
}

pub fn expect_status(output: &Output, status: i32) {
    assert_eq!(output.status.code(), Some(status), "stderr: {}", stderr(output));
}

/// Sends a signal, by its name, to a process.
pub fn signal(process: &Child, name: &str) {
    let kill = format!("kill -{name} {}", process.id());
    assert!(Command::new("sh").args(["-c", &kill]).status().unwrap().success());
}

/// A running `flip serve`, killed when the test ends.
pub struct Service {
    process: Child,
    pub document: Value,
}

impl Service {
    pub fn start(data_dir: &Path) -> Self {
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

    pub fn address(&self) -> String {
        self.document["url"].as_str().unwrap().trim_start_matches("http://").to_owned()
    }

    /// Sends SIGTERM, as systemd and Docker do, and returns its exit status.
    pub fn terminate(mut self) -> Option<i32> {
        signal(&self.process, "TERM");
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
