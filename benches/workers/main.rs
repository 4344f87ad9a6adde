//! One calibration, one investigation of 200 rows and one evaluation on 1, 2 and 4 workers of one thread
//! each, processes of their own on a private PostgreSQL that waits for its disk: how long each takes
//! beside the ideal, whether the results are the same bytes, and what the rows of a portion cost.
//!
//! `cargo bench --bench workers -- [repeats] [size, %] [workers,workers] [job,job]`, or `make
//! bench-workers`.

use anyhow::{Context, ensure};
use flip::app::{
    App, CalibrationMethod, CalibrationRequest, EvaluationRequest, InvestigationRequest, JobState,
    Options, Storage,
};
use flip_core::domain::job::{JobKind, Subject};
use flip_core::domain::labels::Labels;
use flip_core::domain::timestamp::Timestamp;
use flip_store::ledger::Claim;
use flip_store::portions::{NewPortion, Stands};
use flip_store::{Store, now};
use flip_testing::Cluster;
use sha2::{Digest, Sha256};
use std::collections::HashMap;
use std::fmt::Write;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Portions whose rows are timed, and the size of each way, bytes: some forty heaps.
const PORTIONS: i64 = 100;
const BYTES: usize = 40_000;
/// What a portion takes, s.
const PORTION_S: f64 = 60.0;

#[tokio::main]
async fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|it| it != "--bench").collect();
    let number = |k: usize, usual: u32| arguments.get(k).map_or(Ok(usual), |text| text.parse());
    let (repeats, size) = (number(0, 1)?, f64::from(number(1, 100)?) / 100.0);
    let workers = arguments.get(2).map_or("1,2,4", String::as_str);
    let workers: Vec<usize> = workers.split(',').map(str::parse).collect::<Result<_, _>>()?;
    let named = arguments.get(3).map_or_else(|| JOBS.join(","), String::clone);
    let jobs: Vec<&str> =
        JOBS.into_iter().filter(|job| named.split(',').any(|it| it == *job)).collect();
    ensure!(!jobs.is_empty(), "jobs: any of {}", JOBS.join(", "));
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let cluster = Cluster::start(true).map_err(anyhow::Error::msg)?;
    println!("{cores} processors, repeats: {repeats}, size: {} %\n", 100.0 * size);

    let mut runs = HashMap::<(usize, &str), Vec<Run>>::new();
    for repeat in 0..repeats {
        for &many in &workers {
            eprintln!("repeat {repeat}, workers: {many}");
            for run in on_workers(&cluster, many, size, &jobs).await? {
                runs.entry((many, run.job)).or_default().push(run);
            }
        }
    }
    println!("| job | workers | wall s, median (range) | ideal s | wall / ideal | equal bytes |");
    println!("|---|---|---|---|---|---|");
    let mut all_equal = true;
    for &job in &jobs {
        let first = &runs[&(workers[0], job)];
        let alone_s = median(first.iter().map(|run| run.wall_s)) * workers[0].min(cores) as f64;
        for &many in &workers {
            let these = &runs[&(many, job)];
            let wall_s = median(these.iter().map(|run| run.wall_s));
            let [least, most] = range(these.iter().map(|run| run.wall_s));
            let ideal_s = alone_s / many.min(cores) as f64;
            let equal = these.iter().all(|run| run.result == first[0].result);
            all_equal &= equal;
            println!(
                "| {job} | {many} | {wall_s:.1} ({least:.1} to {most:.1}) | {ideal_s:.1} | {:.2} | {} |",
                wall_s / ideal_s,
                if equal { "yes" } else { "NO" }
            );
        }
    }
    let took_ms = ledger(&cluster).await?;
    let [least, most] = range(took_ms.iter().copied());
    let middle = median(took_ms.into_iter());
    println!(
        "\nrows of a portion of {BYTES} bytes: {middle:.1} ms ({least:.1} to {most:.1}), {:.3} % of {PORTION_S} s",
        middle / 10.0 / PORTION_S
    );
    ensure!(all_equal, "results differ");
    ensure!(middle / 1000.0 < 0.02 * PORTION_S, "the rows cost too much");
    Ok(())
}

const JOBS: [&str; 3] = ["calibration", "evaluation", "investigation"];

/// A job that was computed.
struct Run {
    job: &'static str,
    /// From the request to the result, s.
    wall_s: f64,
    /// The result without times of day.
    result: String,
}

impl Run {
    /// Says how long it took, as the others may take much longer, and its hash, to compare with what
    /// another machine makes.
    fn new(job: &'static str, wall_s: f64, result: String) -> Self {
        let hash = hex::encode(Sha256::digest(result.as_bytes()));
        eprintln!("  {job}: {wall_s:.1} s, SHA-256 {}", &hash[..16]);
        Self { job, wall_s, result }
    }
}

/// A process that computes; killed when it is dropped.
struct Worker(Child);

impl Drop for Worker {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn hire(url: &str, folder: &Path, name: &str) -> anyhow::Result<Worker> {
    let worker = Command::new(flip_testing::program(env!("CARGO_BIN_EXE_flip")))
        .args(["worker", "--threads", "1", "--name", name, "--data-dir"])
        .arg(folder)
        .env("FLIP_DATABASE_URL", url)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(std::fs::File::create(folder.with_extension(name))?)
        .spawn()?;
    Ok(Worker(worker))
}

/// The jobs, one after another, on so many workers and a database of their own.
async fn on_workers(
    cluster: &Cluster,
    many: usize,
    size: f64,
    jobs: &[&str],
) -> anyhow::Result<Vec<Run>> {
    let place = tempfile::tempdir()?;
    let folder = place.path().join("data");
    let url = cluster.database_of(&folder).await;
    let app = App::open(Storage::on_server(&url, &folder)?, Options::without_workers()).await?;
    let hired: Vec<Worker> =
        (0..many).map(|k| hire(&url, &folder, &format!("w{k}"))).collect::<Result<_, _>>()?;
    while app.workers().await?.len() < many {
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    let mut runs = Vec::new();
    for job in JOBS.into_iter().filter(|job| jobs.contains(job)) {
        let begun = Instant::now();
        let id = match job {
            "calibration" => app.start_calibration(calibration()).await?.0.id,
            "evaluation" => app.start_evaluation(evaluation(size)).await?.0.id,
            _ => app.start_investigation(investigation(size)).await?.0.id,
        };
        let wall_s = ends(&app, &id, begun).await?;
        let result = match job {
            "calibration" => serde_json::to_string(&app.calibration(&id).await?.result)?,
            "evaluation" => serde_json::to_string(&app.evaluation(&id).await?.result)?,
            _ => {
                let mut report =
                    app.investigation(&id).await?.report.context("it has succeeded")?;
                report.wall_s = 0.0;
                serde_json::to_string(&report)?
            }
        };
        ensure!(result != "null", "{job}: no result");
        runs.push(Run::new(job, wall_s, result));
    }
    drop(hired);
    app.shutdown().await?;
    Ok(runs)
}

fn calibration() -> CalibrationRequest {
    CalibrationRequest {
        powder: Some("sand".into()),
        method: Some(CalibrationMethod::Emulator),
        sets: Some(3),
        tolerance_deg: Some(2.0),
        // Of smaller heaps none comes within the tolerance.
        particles: Some(400),
        ..Default::default()
    }
}

/// An evaluation needs the sets of the calibration.
fn evaluation(size: f64) -> EvaluationRequest {
    EvaluationRequest {
        powders: Some(vec!["sand".into()]),
        controllers: Some(["untrained", "fixed", "dispenser", "paced"].map(String::from).to_vec()),
        targets_mg: Some(vec![5.0, 10.0]),
        repeats: Some(scaled(6.0, size, 1)),
        particles: Some(1000),
        ..Default::default()
    }
}

fn investigation(size: f64) -> InvestigationRequest {
    InvestigationRequest {
        shakes_csv: Some(shakes()),
        budget_replays: Some(scaled(200.0, size, 156)),
        seed: Some(3),
        ..Default::default()
    }
}

fn scaled(usual: f64, size: f64, least: u32) -> u32 {
    ((usual * size) as u32).max(least)
}

/// Waits until a job has succeeded, and says how long after `begun` that was, s.
async fn ends(app: &App, id: &str, begun: Instant) -> anyhow::Result<f64> {
    loop {
        let job = app.job(id).await?;
        if job.state.is_terminal() {
            ensure!(job.state == JobState::Succeeded, "{:?}: {:?}", job.kind, job.error);
            return Ok(begun.elapsed().as_secs_f64());
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

/// 200 shakes of 25 spoonfuls of sand, by a formula: more powder falls than the simulated spoon
/// releases.
fn shakes() -> String {
    let mut csv = String::from(
        "weighing,spoonful,powder,session,readability_mg,pitch_deg,shake_mm,fell_mg\n",
    );
    for spoonful in 0..25 {
        let session = format!("2026-11-{:02}", 1 + spoonful % 8);
        for step in 0..8 {
            let pitch_deg = 16.0 + 4.0 * f64::from(step);
            let shake_mm = if spoonful % 2 == 0 { 8.0 } else { 12.0 };
            let wander = f64::from((37 * spoonful + 11 * step) % 17) / 17.0 - 0.5;
            let fell_mg = (0.25 * (pitch_deg - 18.0).max(0.0) * shake_mm / 8.0
                * (1.0 + 0.3 * wander))
                .max(0.0);
            writeln!(csv, "w-{spoonful},1,sand,{session},0.1,{pitch_deg},{shake_mm},{fell_mg:.1}")
                .expect("text grows");
        }
    }
    csv
}

/// How long each portion's rows take from the cut to the drop, all of them on one connection, ms.
async fn ledger(cluster: &Cluster) -> anyhow::Result<Vec<f64>> {
    let place = tempfile::tempdir()?;
    let url = cluster.database_of(place.path()).await;
    let store = Store::open(Storage::on_server(&url, place.path())?).await?;
    let mut tx = store.write().await?;
    let (kind, labels) = (JobKind::Calibration, Labels::default());
    let spec = ("{}", &[0; 32][..]);
    tx.insert_job("j", kind, spec, &Subject::default(), (None, &labels), now()).await?;
    let until = Timestamp::from_unix_ms(now().unix_ms() + 3_600_000);
    let Claim::Granted(claimed) = tx.claim("j", "a", now(), until).await? else {
        anyhow::bail!("nobody else has it")
    };
    tx.commit().await?;
    let mut took_ms = Vec::new();
    for number in 0..PORTIONS {
        let begun = Instant::now();
        let experiments = vec![7; BYTES];
        let portion = NewPortion { id: number.to_string(), number, kind: "heap", experiments };
        let mut tx = store.write().await?;
        tx.cut_portions(&claimed.lease, &[portion]).await?;
        tx.commit().await?;
        ensure!(store.has_portion("b", &[kind], now()).await?, "it was cut");
        let mut tx = store.write().await?;
        let portion = tx.claim_portion("b", &[kind], now(), until).await?.context("it waits")?;
        tx.commit().await?;
        // A minute has some sixty looks and seven renewals.
        for _ in 0..60 {
            store.portions_of("b", now()).await?;
        }
        for _ in 0..7 {
            let mut tx = store.write().await?;
            tx.renew_portion(&portion, "b", until).await?;
            tx.commit().await?;
        }
        let mut tx = store.write().await?;
        ensure!(tx.finish_portion(&portion, "b", &[7; BYTES], now()).await?, "it counts");
        tx.commit().await?;
        let found = store.portions(&claimed.lease, now()).await?;
        ensure!(matches!(&found[..], [(_, Stands::Done(_))]), "it is done");
        let mut tx = store.write().await?;
        tx.drop_portion(&portion.id).await?;
        tx.commit().await?;
        took_ms.push(1000.0 * begun.elapsed().as_secs_f64());
    }
    store.close().await;
    Ok(took_ms)
}

fn median(of: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = of.collect();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

fn range(of: impl Iterator<Item = f64>) -> [f64; 2] {
    of.fold([f64::INFINITY, 0.0], |[least, most], it| [it.min(least), it.max(most)])
}
