//! The log of a service in its own process, while nobody reads it.

use serde_json::Value;
use std::io::{PipeWriter, Read, Write, pipe};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::channel;
use std::time::Duration;
use tempfile::TempDir;

/// Much longer than an answer takes on a busy machine.
const SOON: Duration = Duration::from_secs(20);
/// Capacity of a pipe on Linux, bytes.
const PIPE_BYTES: usize = 64 * 1024;

/// Killed when dropped.
struct Logging {
    process: Child,
    url: String,
    _folder: TempDir,
}

impl Drop for Logging {
    fn drop(&mut self) {
        let _ended = self.process.kill();
        let _status = self.process.wait();
    }
}

impl Logging {
    /// Logs everything to this pipe.
    fn to(stderr: PipeWriter) -> Self {
        let folder = TempDir::new().unwrap();
        let process = Command::new(env!("CARGO_BIN_EXE_flip"))
            .args(["serve", "--json", "--listen", "127.0.0.1:0", "--data-dir"])
            .arg(folder.path())
            .env("FLIP_LOG", "trace")
            .stdout(Stdio::piped())
            .stderr(stderr)
            .spawn()
            .unwrap();
        let mut service = Self { process, url: String::new(), _folder: folder };
        let (stdout, (say, hear)) = (service.process.stdout.take().unwrap(), channel());
        std::thread::spawn(move || {
            let said = serde_json::Deserializer::from_reader(stdout).into_iter::<Value>().next();
            say.send(said.unwrap().unwrap()).unwrap();
        });
        let said = hear.recv_timeout(SOON).expect("the service says soon where it is");
        service.url = said["url"].as_str().unwrap().to_owned();
        service
    }

    async fn ask(&self) {
        flip_testing::speak_tls();
        let client = reqwest::Client::builder().timeout(SOON).build().unwrap();
        for _ in 0..20 {
            let answer = client.get(format!("{}/v1/powders", self.url)).send().await;
            assert_eq!(answer.expect("a request is answered soon").status(), 200);
        }
    }

    async fn terminate(&mut self) -> ExitStatus {
        let terminated = Command::new("kill").arg(self.process.id().to_string()).status().unwrap();
        assert!(terminated.success());
        let ended = async {
            loop {
                if let Some(status) = self.process.try_wait().unwrap() {
                    return status;
                }
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        tokio::time::timeout(SOON, ended).await.expect("the service ends")
    }
}

#[tokio::test]
async fn a_broken_pipe_for_the_log_ends_neither_an_answer_nor_the_service_before_its_time() {
    let (reader, writer) = pipe().unwrap();
    drop(reader);
    let mut service = Logging::to(writer);
    service.ask().await;
    assert!(service.terminate().await.success());
}

#[tokio::test]
async fn a_full_pipe_for_the_log_hangs_neither_an_answer_nor_the_end_of_the_service() {
    let (_reader, mut writer) = pipe().unwrap();
    writer.write_all(&[b'\n'; PIPE_BYTES]).unwrap();
    let mut service = Logging::to(writer);
    service.ask().await;
    assert!(service.terminate().await.success());
}

#[tokio::test]
async fn a_log_that_is_read_has_the_last_line() {
    let (mut reader, writer) = pipe().unwrap();
    let mut service = Logging::to(writer);
    let log = std::thread::spawn(move || {
        let mut log = String::new();
        reader.read_to_string(&mut log).map(|_| log)
    });
    assert!(service.terminate().await.success());
    let log = log.join().unwrap().unwrap();
    assert!(log.contains("shutting down"), "{log}");
}
