//! The binary, its exit status and its document.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

/// Runs the binary on a data folder.
pub fn flip(data_dir: &Path, arguments: &[&str]) -> Output {
    command(data_dir, arguments).output().unwrap()
}

pub fn command(data_dir: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_flip"));
    command.args(arguments).arg("--data-dir").arg(data_dir).env_remove("FLIP_LOG");
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
