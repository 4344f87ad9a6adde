//! How soon an arriving stop brings the arm to a standstill, under attack: `cargo bench --bench
//! stop_latency -- [stops] [clients] [laboratories] [attack …]`.
//!
//! The service is a separate process, as in a laboratory; the emulated laboratory lives in this one
//! and reports when its arm was stopped. The time runs from before the request is sent until the
//! motion has ended, so it includes connection, queueing and the arm's call; every stop comes on
//! its own connection. Only stops that ended a motion count. `attacks.rs` describes the attacks;
//! each named one is measured by itself, `all` is all of them at once.
//!
//! A balance is watched for three wall-clock seconds before each dose, so a thousand stops take an
//! hour; several laboratories in parallel, each with its own service, clients and attackers, share
//! them and the machine.

mod attacks;

use attacks::Attack;
use flip_bench::emulate::arm::{Asked, End, Flow, FormulaSpoon};
use flip_bench::emulate::lab::{Laboratory, Settings};
use flip_bench::hardware::clock::Clock;
use serde_json::{Value, json};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Bench seconds per wall-clock second, so that a scoop of eight seconds does not take eight
/// seconds.
const SPEED: f64 = 40.0;
/// A stop comes at any time from the first motion up to here, bench s.
const LATEST_S: f64 = 7.0;

/// A service under attack.
pub struct Service {
    process: Child,
    /// Its address.
    pub url: String,
    token: String,
    /// The folder of its database.
    pub data: std::path::PathBuf,
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
        let data = folder.join("data");
        let mut process = Command::new(env!("CARGO_BIN_EXE_flip"))
            .args(["serve", "--json", "--listen", "127.0.0.1:0", "--data-dir"])
            .arg(&data)
            .arg("--bench")
            .arg(bench)
            .stdout(Stdio::piped())
            .stderr(std::fs::File::create(folder.join("log"))?)
            .spawn()?;
        let stdout = process.stdout.take().ok_or_else(|| anyhow::anyhow!("no output"))?;
        let said = serde_json::Deserializer::from_reader(stdout).into_iter::<Value>().next();
        let said = said.ok_or_else(|| anyhow::anyhow!("the service says nothing"))??;
        let text = |key: &str| said[key].as_str().unwrap_or_default().to_owned();
        flip_testing::speak_tls();
        let client = reqwest::Client::builder().pool_max_idle_per_host(0).build()?;
        Ok(Self { process, url: text("url"), token: text("token"), data, client })
    }

    async fn get(&self, path: &str) -> anyhow::Result<Value> {
        let request = self.client.get(format!("{}{path}", self.url)).bearer_auth(&self.token);
        Ok(request.send().await?.json().await?)
    }

    async fn post(
        &self,
        path: &str,
        key: Option<String>,
        body: &Value,
    ) -> anyhow::Result<(u16, Value)> {
        let request =
            self.client.post(format!("{}{path}", self.url)).bearer_auth(&self.token).json(body);
        let request =
            key.into_iter().fold(request, |request, key| request.header("Idempotency-Key", key));
        let response = request.send().await?;
        Ok((response.status().as_u16(), response.json().await?))
    }
}

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let words: Vec<String> =
        std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let numbers: Vec<u64> = words.iter().filter_map(|text| text.parse().ok()).collect();
    let number = |k: usize, default: u64| numbers.get(k).copied().unwrap_or(default);
    let (stops, clients, laboratories) = (number(0, 200), number(1, 100), number(2, 1).max(1));
    let named =
        words.iter().filter(|word| word.parse::<u64>().is_err()).map(|word| Attack::named(word));
    let mut rows: Vec<Vec<Attack>> = named.collect::<anyhow::Result<_>>()?;
    if rows.is_empty() {
        rows = vec![Vec::new(), Attack::ALL.to_vec()];
    }
    attacks::raise_the_limit_of_files()?;
    println!("{stops} stops a row, {laboratories} laboratories with {clients} clients each");
    println!(
        "| attack | ended a motion | between two | refused | median ms | p90 | p99 | p99.9 | most | shakes afterwards | answers a second |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for attack in rows {
        row(&attack, stops, clients, laboratories).await?;
    }
    Ok(())
}

/// One line of the table.
async fn row(attack: &[Attack], stops: u64, clients: u64, laboratories: u64) -> anyhow::Result<()> {
    let all = (0..laboratories).map(|first| {
        let (stops, attack) =
            ((first..stops).step_by(laboratories as usize).collect(), attack.to_vec());
        tokio::spawn(async move { in_laboratory(stops, clients, &attack).await })
    });
    let mut sum = Stopped::default();
    for laboratory in all.collect::<Vec<_>>() {
        let stopped = laboratory.await??;
        sum.latencies_ms.extend(stopped.latencies_ms);
        sum.idle += stopped.idle;
        sum.refused += stopped.refused;
        sum.shakes_after += stopped.shakes_after;
        sum.rate += stopped.rate;
    }
    sum.latencies_ms.sort_by(f64::total_cmp);
    let n = sum.latencies_ms.len();
    anyhow::ensure!(n > 0, "no stop ended a motion");
    let at = |share: f64| sum.latencies_ms[((n as f64 * share).ceil() as usize).clamp(1, n) - 1];
    let names: Vec<_> = attack.iter().map(|it| it.name()).collect();
    let name = if names.is_empty() { "none".to_owned() } else { names.join(", ") };
    println!(
        "| {name} | {n} | {} | {} | {:.1} | {:.1} | {:.1} | {:.1} | {:.1} | {} | {:.0} |",
        sum.idle,
        sum.refused,
        at(0.5),
        at(0.9),
        at(0.99),
        at(0.999),
        at(1.0),
        sum.shakes_after,
        sum.rate
    );
    Ok(())
}

#[derive(Default)]
struct Stopped {
    latencies_ms: Vec<f64>,
    /// Stops that found nothing moving.
    idle: u64,
    /// Stops answered with anything but success.
    refused: u64,
    /// Shakes completed although a stop had been sent.
    shakes_after: u64,
    /// Client requests answered per second.
    rate: f64,
}

async fn in_laboratory(
    stops: Vec<u64>,
    clients: u64,
    attack: &[Attack],
) -> anyhow::Result<Stopped> {
    let folder = tempfile::tempdir()?;
    let clock = Clock::fast(SPEED);
    let spoon = || Box::new(FormulaSpoon::new(Flow { level_mg: 0.05, ..Flow::default() }, 1));
    let laboratory = Laboratory::start(Settings::default(), clock.clone(), spoon())?;
    let bench = folder.path().join("bench.toml");
    std::fs::write(&bench, toml::to_string(&laboratory.file())?)?;
    let service = Arc::new(Service::start(folder.path(), &bench)?);
    calibrate(&service).await?;

    let (done, polls) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
    let machines = attacks::elsewhere()?;
    let pollers: Vec<_> = (0..clients)
        .map(|k| machines.spawn(poll(service.clone(), done.clone(), polls.clone(), k)))
        .collect();
    let attackers = attacks::begin(attack, &service).await?;
    let (began, mut stopped) = (Instant::now(), Stopped::default());
    let all = async {
        for stop in stops {
            one_stop(&service, &laboratory, &clock, stop, &mut stopped).await?;
        }
        anyhow::Ok(())
    };
    let ended = all.await;
    stopped.rate = polls.load(Ordering::Relaxed) as f64 / began.elapsed().as_secs_f64();
    done.store(true, Ordering::Relaxed);
    attackers.shutdown_background();
    for poller in pollers {
        poller.await?;
    }
    machines.shutdown_background();
    ended.map(|()| stopped)
}

/// An honest client.
async fn poll(service: Arc<Service>, done: Arc<AtomicBool>, polls: Arc<AtomicU64>, k: u64) {
    let (client, path) = (
        reqwest::Client::new(),
        ["/v1/weighings", "/v1/bench", "/v1/powders", "/v1/audit"][k as usize % 4],
    );
    while !done.load(Ordering::Relaxed) {
        if let Ok(response) = client.get(format!("{}{path}", service.url)).send().await {
            let answered = response.status().is_success() && response.bytes().await.is_ok();
            polls.fetch_add(u64::from(answered), Ordering::Relaxed);
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

async fn calibrate(service: &Service) -> anyhow::Result<()> {
    let request = json!({"powder": "sand", "method": "sequential", "sets": 2, "seed": 3});
    let (_, job) = service.post("/v1/calibrations", None, &request).await?;
    let id = job["id"].as_str().unwrap_or_default().to_owned();
    while service.get(&format!("/v1/jobs/{id}")).await?["state"] != "succeeded" {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    Ok(())
}

/// Sends a request of the operator that is not itself measured, and retries until it succeeds.
async fn insist(
    service: &Service,
    path: &str,
    key: Option<String>,
    body: &Value,
) -> anyhow::Result<Value> {
    for _ in 0..600 {
        match service.post(path, key.clone(), body).await {
            // 409: a stop that came between two motions may have found nothing to hold.
            Ok((200..=299 | 409, answer)) => return Ok(answer),
            Ok((503, _)) | Err(_) => tokio::time::sleep(Duration::from_millis(100)).await,
            Ok((status, answer)) => anyhow::bail!("{path}: {status} {answer}"),
        }
    }
    anyhow::bail!("{path} is not answered")
}

/// Begins a dose, stops it at some point, and returns how long that took, ms.
async fn one_stop(
    service: &Service,
    laboratory: &Laboratory,
    clock: &Clock,
    stop: u64,
    stopped: &mut Stopped,
) -> anyhow::Result<()> {
    let mg = |value: f64| json!({"value": value, "unit": "mg"});
    let tolerance = json!({"lower": 1.0, "upper": 1.0, "unit": "mg"});
    let body =
        json!({"powder": "sand", "target": mg(15.0), "tolerance": tolerance, "vial_check": "skip"});
    let weighing = insist(service, "/v1/weighings", Some(format!("stop-{stop}")), &body).await?;
    let id = weighing["id"].as_str().ok_or_else(|| anyhow::anyhow!("{weighing}"))?.to_owned();
    while !laboratory.arm.is_moving() {
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    let share = (flip_core::domain::seed::derive(7, &[stop]) % 1000) as f64 / 1000.0;
    tokio::time::sleep(Duration::from_secs_f64(share * LATEST_S / SPEED)).await;
    let seen = laboratory.arm.log().len();
    let sent_s = clock.now_s();
    let path = format!("/v1/weighings/{id}/stop");
    if !matches!(service.post(&path, None, &json!({})).await, Ok((200..=299, _))) {
        stopped.refused += 1;
        insist(service, &path, None, &json!({})).await?;
    }
    while service
        .get(&format!("/v1/weighings/{id}"))
        .await
        .is_ok_and(|it| it["weighing"]["outcome"].is_null())
    {
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    // A stop holds the bench.
    insist(service, "/v1/bench/resume", None, &json!({"by": "the bench of stops"})).await?;
    let log = laboratory.arm.log();
    let shaken = |event: &&flip_bench::emulate::arm::Event| {
        matches!(event.motion, Asked::Shake(_)) && event.ended.is_none()
    };
    stopped.shakes_after +=
        log[seen..].iter().filter(shaken).filter(|event| event.at_s > sent_s).count() as u64;
    match log[seen..].iter().find(|event| event.ended == Some(End::Stopped)) {
        Some(event) => stopped.latencies_ms.push((event.at_s - sent_s) / SPEED * 1000.0),
        None => stopped.idle += 1,
    }
    Ok(())
}
