//! A service in a separate process.

use serde_json::Value;
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// A service in a separate process, killed when dropped.
pub struct Service {
    process: Child,
    pub url: String,
    /// The token printed on first start.
    pub token: Option<String>,
    pub client: reqwest::Client,
}

impl Service {
    /// Starts it on a data folder, and waits until it listens.
    pub fn start(folder: &Path) -> Self {
        let mut process = Command::new(env!("CARGO_BIN_EXE_flip"))
            .args(["serve", "--json", "--listen", "127.0.0.1:0", "--data-dir"])
            .arg(folder)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let stdout = process.stdout.take().unwrap();
        let said = serde_json::Deserializer::from_reader(stdout).into_iter::<Value>().next();
        let said = said.expect("the service says where it listens").unwrap();
        let url = said["url"].as_str().unwrap().to_owned();
        let token = said["token"].as_str().map(str::to_owned);
        flip_testing::speak_tls();
        Self { process, url, token, client: reqwest::Client::new() }
    }

    /// Process id.
    pub fn id(&self) -> u32 {
        self.process.id()
    }

    /// SIGKILL: no destructor, no final output.
    pub fn kill(self) {
        drop(self);
    }

    pub async fn get(&self, path: &str) -> Value {
        let response = self.client.get(format!("{}{path}", self.url)).send().await.unwrap();
        assert!(response.status().is_success(), "{path}: {}", response.status());
        response.json().await.unwrap()
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
