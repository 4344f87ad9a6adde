//! How soon a stop that arrives makes the arm stand still, while a hundred clients poll: `cargo bench --bench stop_latency -- [stops] [clients] [laboratories]`.
//!
//! The service is a process of its own, as in a laboratory; the emulated laboratory lives in this one and tells when its arm was stopped. Measured is from
//! before the request is sent until the motion has ended, so connection, queueing and the arm's call are in it. Only stops that ended a motion count.
//!
//! A balance is watched for three seconds of the room before each dose, so a thousand stops take an hour; several laboratories side by side, each with a service
//! and clients of its own, share them and the machine.

use flip::emulate::arm::{End, Flow, FormulaSpoon};
use flip::emulate::lab::{Laboratory, Settings};
use flip::hardware::clock::Clock;
use serde_json::{Value, json};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Bench seconds in a second of the room: so that a scoop of eight seconds does not take eight seconds.
const SPEED: f64 = 40.0;
/// A stop comes at any time from the first motion up to here, bench s.
const LATEST_S: f64 = 7.0;

struct Service {
    process: Child,
    url: String,
    token: String,
    client: reqwest::Client,
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Service {
    fn start(folder: &std::path::Path, bench: &std::path::Path) -> anyhow::Result<Self> {
        let mut process = Command::new(env!("CARGO_BIN_EXE_flip"))
            .args(["serve", "--json", "--listen", "127.0.0.1:0", "--data-dir"])
            .arg(folder.join("data"))
            .arg("--bench")
            .arg(bench)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        let stdout = process.stdout.take().ok_or_else(|| anyhow::anyhow!("no output"))?;
        let said = serde_json::Deserializer::from_reader(stdout).into_iter::<Value>().next();
        let said = said.ok_or_else(|| anyhow::anyhow!("the service says nothing"))??;
        let text = |key: &str| said[key].as_str().unwrap_or_default().to_owned();
        Ok(Self { process, url: text("url"), token: text("token"), client: reqwest::Client::new() })
    }

    async fn get(&self, path: &str) -> anyhow::Result<Value> {
        Ok(self.client.get(format!("{}{path}", self.url)).send().await?.json().await?)
    }

    async fn post(&self, path: &str, key: Option<String>, body: &Value) -> anyhow::Result<Value> {
        let request = self.client.post(format!("{}{path}", self.url)).bearer_auth(&self.token).json(body);
        let request = key.into_iter().fold(request, |request, key| request.header("Idempotency-Key", key));
        Ok(request.send().await?.json().await?)
    }
}

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let numbers: Vec<u64> = std::env::args().skip(1).filter_map(|text| text.parse().ok()).collect();
    let number = |k: usize, default: u64| numbers.get(k).copied().unwrap_or(default);
    let (stops, clients, laboratories) = (number(0, 200), number(1, 100), number(2, 1).max(1));
    let all = (0..laboratories).map(|first| {
        let stops = (first..stops).step_by(laboratories as usize).collect();
        tokio::spawn(async move { in_laboratory(stops, clients).await })
    });
    let (mut latencies_ms, mut idle, mut rate) = (Vec::new(), 0, 0.0);
    for laboratory in all.collect::<Vec<_>>() {
        let stopped = laboratory.await??;
        latencies_ms.extend(stopped.latencies_ms);
        idle += stopped.idle;
        rate += stopped.rate;
    }
    latencies_ms.sort_by(f64::total_cmp);
    let at = |share: f64| {
        latencies_ms[((latencies_ms.len() as f64 * share).ceil() as usize).clamp(1, latencies_ms.len()) - 1]
    };
    anyhow::ensure!(!latencies_ms.is_empty(), "no stop ended a motion");
    println!(
        "{} stops that ended a motion ({idle} came between two), {laboratories} laboratories with {clients} clients each, {rate:.0} requests a second in all",
        latencies_ms.len()
    );
    println!("| median ms | p90 | p99 | p99.9 | most |\n|---|---|---|---|---|");
    println!("| {:.1} | {:.1} | {:.1} | {:.1} | {:.1} |", at(0.5), at(0.9), at(0.99), at(0.999), at(1.0));
    Ok(())
}

struct Stopped {
    latencies_ms: Vec<f64>,
    /// Stops that found nothing moving.
    idle: u64,
    /// Requests that were answered in a second.
    rate: f64,
}

async fn in_laboratory(stops: Vec<u64>, clients: u64) -> anyhow::Result<Stopped> {
    let folder = tempfile::tempdir()?;
    let clock = Clock::fast(SPEED);
    let spoon = || Box::new(FormulaSpoon::new(Flow { level_mg: 0.05, ..Flow::default() }, 1));
    let laboratory = Laboratory::start(Settings::default(), clock.clone(), spoon())?;
    let bench = folder.path().join("bench.toml");
    std::fs::write(&bench, toml::to_string(&laboratory.file())?)?;
    let service = Arc::new(Service::start(folder.path(), &bench)?);
    calibrate(&service).await?;

    let (done, polls) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
    let pollers: Vec<_> = (0..clients)
        .map(|k| {
            let (service, done, polls) = (service.clone(), done.clone(), polls.clone());
            tokio::spawn(async move {
                let path = ["/v1/weighings", "/v1/bench", "/v1/powders", "/v1/audit"][k as usize % 4];
                while !done.load(Ordering::Relaxed) {
                    let _ = service.get(path).await;
                    polls.fetch_add(1, Ordering::Relaxed);
                    tokio::time::sleep(Duration::from_millis(100)).await;
                }
            })
        })
        .collect();

    let (began, mut latencies_ms, mut idle) = (Instant::now(), Vec::new(), 0);
    for stop in stops {
        match one_stop(&service, &laboratory, &clock, stop).await? {
            Some(ms) => latencies_ms.push(ms),
            None => idle += 1,
        }
    }
    let rate = polls.load(Ordering::Relaxed) as f64 / began.elapsed().as_secs_f64();
    done.store(true, Ordering::Relaxed);
    for poller in pollers {
        poller.await?;
    }
    Ok(Stopped { latencies_ms, idle, rate })
}

async fn calibrate(service: &Service) -> anyhow::Result<()> {
    let request = json!({"powder": "sand", "method": "sequential", "sets": 2, "seed": 3});
    let job = service.post("/v1/calibrations", None, &request).await?;
    let id = job["id"].as_str().unwrap_or_default().to_owned();
    while service.get(&format!("/v1/jobs/{id}")).await?["state"] != "succeeded" {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    Ok(())
}

/// Begin a dose, stop it somewhere, and say how long that took, ms; `None` if nothing moved just then.
async fn one_stop(service: &Service, laboratory: &Laboratory, clock: &Clock, stop: u64) -> anyhow::Result<Option<f64>> {
    let mg = |value: f64| json!({"value": value, "unit": "mg"});
    let tolerance = json!({"lower": 1.0, "upper": 1.0, "unit": "mg"});
    let body = json!({"powder": "sand", "target": mg(15.0), "tolerance": tolerance, "vial_check": "skip"});
    let weighing = service.post("/v1/weighings", Some(format!("stop-{stop}")), &body).await?;
    let id = weighing["id"].as_str().ok_or_else(|| anyhow::anyhow!("{weighing}"))?.to_owned();
    while !laboratory.arm.is_moving() {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    let share = (flip::domain::seed::derive(7, &[stop]) % 1000) as f64 / 1000.0;
    tokio::time::sleep(Duration::from_secs_f64(share * LATEST_S / SPEED)).await;
    let seen = laboratory.arm.log().len();
    let sent_s = clock.now_s();
    service.post(&format!("/v1/weighings/{id}/stop"), None, &json!({})).await?;
    while service.get(&format!("/v1/weighings/{id}")).await?["weighing"]["outcome"].is_null() {
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    // A stop holds the bench.
    service.post("/v1/bench/resume", None, &json!({"by": "the bench of stops"})).await?;
    let log = laboratory.arm.log();
    let stopped = log[seen..].iter().find(|event| event.ended == Some(End::Stopped));
    Ok(stopped.map(|event| (event.at_s - sent_s) / SPEED * 1000.0))
}
