//! Three servers and two workers, processes of their own, and callers that do not wait for each other.

use super::quantile;
use anyhow::{Context, ensure};
use flip_core::domain::timestamp::Timestamp;
use flip_store::now;
use flip_testing::Cluster;
use reqwest::Client;
use serde_json::{Value, json};
use sqlx::{AssertSqlSafe, PgPool};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval, sleep};

const SERVERS: usize = 3;
const WORKERS: usize = 2;
/// How often something is looked for.
const LOOK: Duration = Duration::from_millis(20);
/// How many jobs are asked for side by side.
const AT_ONCE: usize = 8;

/// What a dose of the emulated bench writes.
#[derive(Debug, Clone, Copy)]
pub struct Dose {
    pub records: u64,
    pub commits: u64,
    pub seconds: f64,
}

/// A process; killed when it is dropped.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn start(url: &str, folder: &Path, name: &str, words: &[&str]) -> anyhow::Result<Process> {
    let child = Command::new(flip_testing::program(env!("CARGO_BIN_EXE_flip")))
        .args(words)
        .arg("--data-dir")
        .arg(folder)
        .env("FLIP_DATABASE_URL", url)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(std::fs::File::create(folder.with_extension(name))?)
        .spawn()?;
    Ok(Process(child))
}

/// Where a server listens, and the token of the first start if it made one.
fn serve(url: &str, folder: &Path, bench: &str) -> anyhow::Result<(Process, String, Value)> {
    let words = ["serve", "--json", "--listen", "127.0.0.1:0", "--bench", "emulated"];
    let mut server = start(url, folder, bench, &[&words[..], &["--bench-name", bench]].concat())?;
    let out = server.0.stdout.take().context("its output")?;
    let said = serde_json::Deserializer::from_reader(out).into_iter::<Value>().next();
    let said = said.context("the server says nothing")??;
    let address = said["url"].as_str().context("its address")?.to_owned();
    Ok((server, address, said["token"].clone()))
}

/// Calls that write, so far.
static CALLS: AtomicU64 = AtomicU64::new(0);

/// Callers of the servers, in turn.
#[derive(Clone)]
struct Callers {
    client: Client,
    addresses: Vec<String>,
    token: String,
}

impl Callers {
    async fn call(&self, k: usize, path: &str, body: Option<&Value>) -> anyhow::Result<Value> {
        let url = format!("{}{path}", self.addresses[k % self.addresses.len()]);
        let call = match body {
            Some(body) => {
                let key = CALLS.fetch_add(1, Ordering::Relaxed);
                self.client.post(url).header("Idempotency-Key", format!("call-{key}")).json(body)
            }
            None => self.client.get(url),
        };
        let answer = call.bearer_auth(&self.token).send().await?;
        let (status, said) = (answer.status(), answer.text().await?);
        ensure!(status.is_success(), "{path}: {status} {said}");
        Ok(serde_json::from_str(&said)?)
    }

    async fn ends(&self, id: &str) -> anyhow::Result<Value> {
        loop {
            let job = self.call(0, &format!("/v1/jobs/{id}"), None).await?;
            match job["state"].as_str() {
                Some("succeeded") => return Ok(job),
                Some("queued" | "running") => sleep(LOOK).await,
                _ => anyhow::bail!("{job}"),
            }
        }
    }
}

/// A calibration of a second or less.
fn small(seed: u64) -> Value {
    json!({ "powder": "sand", "method": "sequential", "sets": 2, "tolerance_deg": 5, "trials_max": 60, "particles": 400, "seed": seed })
}

/// One dose on the emulated bench of a server with this database alone.
pub async fn dose(cluster: &Cluster) -> anyhow::Result<Dose> {
    flip_testing::speak_tls();
    let place = tempfile::tempdir()?;
    let folder = place.path().join("data");
    let url = cluster.database_of(&folder).await;
    let (_server, address, token) = serve(&url, &folder, "hall-1")?;
    let token = token.as_str().context("the first token")?.to_owned();
    let callers = Callers { client: Client::new(), addresses: vec![address], token };
    let job = callers.call(0, "/v1/calibrations", Some(&small(1))).await?;
    callers.ends(job["id"].as_str().context("its id")?).await?;
    let pool = PgPool::connect(&url).await?;
    let counts = async || -> anyhow::Result<(i64, i64)> {
        // Statistics arrive within a second or two.
        sleep(Duration::from_secs(2)).await;
        let records = sqlx::query_scalar("SELECT count(*) FROM audit").fetch_one(&pool).await?;
        let commits = "SELECT xact_commit FROM pg_stat_database WHERE datname = current_database()";
        Ok((records, sqlx::query_scalar(commits).fetch_one(&pool).await?))
    };
    // What an idle service and this program commit is taken off.
    let (_, first) = counts().await?;
    let begun = Instant::now();
    sleep(Duration::from_secs(10)).await;
    let (records, second) = counts().await?;
    let idle = (second - first) as f64 / begun.elapsed().as_secs_f64();

    let mg = |value: f64| json!({ "value": value, "unit": "mg" });
    let asked = json!({ "powder": "sand", "target": mg(10.0), "tolerance": { "lower": 1, "upper": 1, "unit": "mg" }, "seed": 1, "vial_check": "skip" });
    let begun = Instant::now();
    let dose = callers.call(0, "/v1/weighings", Some(&asked)).await?;
    let path = format!("/v1/weighings/{}", dose["id"].as_str().context("its id")?);
    loop {
        let dose = callers.call(0, &path, None).await?;
        let state = dose["weighing"]["state"].as_str().unwrap_or_default().to_owned();
        match &*state {
            "done" => break,
            "unknown" | "refused" => anyhow::bail!("{dose}"),
            _ => sleep(Duration::from_millis(500)).await,
        }
    }
    let seconds = begun.elapsed().as_secs_f64();
    let (all, third) = counts().await?;
    let commits = (third - second) as f64 - idle * (seconds + 2.0) - 2.0 * seconds;
    Ok(Dose { records: (all - records) as u64, commits: commits.max(1.0) as u64, seconds })
}

/// Times of answers and of starts, with few and with many jobs in the queue.
pub async fn print(
    cluster: &Cluster,
    lasting: Duration,
    rate: u64,
    queued: u64,
) -> anyhow::Result<()> {
    let place = tempfile::tempdir()?;
    let folder = place.path().join("data");
    let url = cluster.database_of(&folder).await;
    let (mut servers, mut addresses, mut token) = (Vec::new(), Vec::new(), Value::Null);
    for k in 0..SERVERS {
        let (server, address, said) = serve(&url, &folder, &format!("hall-{k}"))?;
        servers.push(server);
        addresses.push(address);
        token = if token.is_null() { said } else { token };
    }
    let workers: Vec<Process> = (0..WORKERS)
        .map(|k| start(&url, &folder, &format!("w{k}"), &["worker", "--threads", "1"]))
        .collect::<Result<_, _>>()?;
    let token = token.as_str().context("the first token")?.to_owned();
    let client = Client::builder().timeout(Duration::from_secs(30)).build()?;
    let callers = Callers { client, addresses, token };
    let first = callers.call(0, "/v1/calibrations", Some(&small(1))).await?;
    let known = first["id"].as_str().context("its id")?.to_owned();
    callers.ends(&known).await?;

    println!("\n{SERVERS} servers, {WORKERS} workers that compute, {rate} requests a second\n");
    println!(
        "| queued | requests | median ms | 99 % ms | most ms | jobs | end to next start, median ms | 99 % |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let pool = PgPool::connect(&url).await?;
    let mut made = 1;
    for jobs in [20, queued] {
        let since = now();
        let feeding = feed(&callers, &pool, jobs, &mut made);
        let measured = async {
            while waiting(&pool).await? < jobs {
                sleep(LOOK).await;
            }
            load(&callers, &known, lasting, rate).await
        };
        let took_ms = tokio::select! {
            failed = feeding => return failed,
            took_ms = measured => took_ms?,
        };
        let gaps_ms = gaps(&pool, since).await?;
        println!(
            "| {jobs} | {} | {:.1} | {:.1} | {:.1} | {} | {:.0} | {:.0} |",
            took_ms.len(),
            quantile(&took_ms, 0.5),
            quantile(&took_ms, 0.99),
            quantile(&took_ms, 1.0),
            gaps_ms.len(),
            quantile(&gaps_ms, 0.5),
            quantile(&gaps_ms, 0.99)
        );
    }
    drop((workers, servers));
    Ok(())
}

/// Keeps this many jobs waiting.
async fn feed(callers: &Callers, pool: &PgPool, jobs: u64, made: &mut u64) -> anyhow::Result<()> {
    let mut clock = interval(Duration::from_secs(1));
    loop {
        clock.tick().await;
        let mut asked = JoinSet::new();
        for _ in waiting(pool).await?..jobs {
            *made += 1;
            let (callers, seed) = (callers.clone(), *made);
            asked.spawn(async move {
                callers.call(seed as usize, "/v1/calibrations", Some(&small(seed))).await
            });
            if asked.len() >= AT_ONCE
                && let Some(answer) = asked.join_next().await
            {
                answer??;
            }
        }
        while let Some(answer) = asked.join_next().await {
            answer??;
        }
    }
}

/// Number of jobs that wait.
async fn waiting(pool: &PgPool) -> anyhow::Result<u64> {
    let sql = "SELECT count(*) FROM job WHERE state = 'queued'";
    Ok(sqlx::query_scalar::<_, i64>(sql).fetch_one(pool).await?.cast_unsigned())
}

/// How long after a job's end the next one began, sorted, ms: the n-th end since then makes room for
/// the n-th start after those that ran when the first ended.
async fn gaps(pool: &PgPool, since: Timestamp) -> anyhow::Result<Vec<f64>> {
    let all = async |column: &str| {
        let sql =
            format!("SELECT {column} FROM job WHERE {column} >= $1 AND attempts = 1 ORDER BY 1");
        let rows = sqlx::query_scalar::<_, i64>(AssertSqlSafe(sql)).bind(since.unix_ms());
        rows.fetch_all(pool).await
    };
    let (starts, ends) = (all("started_at").await?, all("finished_at").await?);
    let first = ends.first().context("no job has ended")?;
    let later = starts.iter().filter(|start| *start >= first);
    let mut gaps: Vec<f64> = later.zip(&ends).map(|(start, end)| (start - end) as f64).collect();
    gaps.sort_by(f64::total_cmp);
    Ok(gaps)
}

/// Requests at a steady rate, whether or not earlier ones were answered: how long each took from when
/// it was due, sorted, ms. One of ten writes.
async fn load(
    callers: &Callers,
    known: &str,
    lasting: Duration,
    rate: u64,
) -> anyhow::Result<Vec<f64>> {
    let mut clock = interval(Duration::from_secs_f64(1.0 / rate as f64));
    clock.set_missed_tick_behavior(MissedTickBehavior::Burst);
    let (begun, mut asked) = (Instant::now(), 0);
    let mut all = JoinSet::new();
    while begun.elapsed() < lasting {
        let due = clock.tick().await;
        let (callers, k) = (callers.clone(), asked);
        let path = match k % 10 {
            0..4 => format!("/v1/jobs/{known}"),
            4 | 5 => "/v1/jobs?limit=20".to_owned(),
            6 => "/v1/bench".to_owned(),
            7 => "/v1/weighings?limit=20&powder=sand".to_owned(),
            8 => "/v1/powders".to_owned(),
            _ => "/v1/powders/sand/measurements".to_owned(),
        };
        all.spawn(async move {
            let measured = json!({ "method": "automated", "repose_deg": 20.0 + k as f64 / 1e4 });
            callers.call(k, &path, path.ends_with("measurements").then_some(&measured)).await?;
            anyhow::Ok(1000.0 * due.elapsed().as_secs_f64())
        });
        asked += 1;
    }
    let mut took_ms = Vec::new();
    while let Some(done) = all.join_next().await {
        took_ms.push(done??);
    }
    took_ms.sort_by(f64::total_cmp);
    Ok(took_ms)
}
