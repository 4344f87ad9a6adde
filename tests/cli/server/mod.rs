//! `--server`: commands that ask a running `flip serve`.

mod alike;
mod doses;
mod proxy;
mod reach;
mod refusals;

use crate::harness::Service;
use std::process::{Command, Output};

/// A command without a data folder, with a token.
pub fn command(url: &str, token: &str, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_flip"));
    command
        .args(arguments)
        .args(["--server", url])
        .env_remove("FLIP_LOG")
        .env("FLIP_TOKEN", token)
        .current_dir(std::env::temp_dir());
    command
}

pub fn ask(url: &str, token: &str, arguments: &[&str]) -> Output {
    command(url, token, arguments).output().unwrap()
}

impl Service {
    /// Runs a command against it as its first admin.
    pub fn ask(&self, arguments: &[&str]) -> Output {
        ask(&self.url(), self.token(), arguments)
    }

    pub fn url(&self) -> String {
        self.document["url"].as_str().unwrap().to_owned()
    }

    pub fn token(&self) -> &str {
        self.document["token"].as_str().unwrap()
    }
}
