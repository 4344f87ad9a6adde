//! Mixed jobs while servers, workers and the database are killed, restarted and stopped at random,
//! their network is cut, their disk fills up and their clocks are set: nothing is lost, nothing
//! doubled, and every result is that of one undisturbed process.

use super::clocks::Clocks;
use super::process::{Flip, LOOK, Process, Server};
use anyhow::{Context, Result, bail, ensure};
use flip_testing::Cluster;
use flip_testing::cable::Cable;
use flip_testing::disk::Disk;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use reqwest::Client;
use serde_json::{Value, json};
use std::collections::{BTreeMap, HashSet};
use std::path::Path;
use std::time::{Duration, Instant};
use tokio::time::sleep;

/// What is done to a part, and how often in the whole campaign.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Fault {
    KillWorker,
    KillServer,
    StopWorker,
    RestartDatabase,
    CrashDatabase,
    CutNetwork,
    FillDisk,
    SetClock,
}

const ALL: [(Fault, &str, u32); 8] = [
    (Fault::KillWorker, "kill -9 of a worker", 700),
    (Fault::KillServer, "kill -9 of a server", 300),
    (Fault::StopWorker, "a worker stopped for 60 s, which then goes on", 100),
    (Fault::RestartDatabase, "PostgreSQL restarted", 100),
    (Fault::CrashDatabase, "PostgreSQL killed", 20),
    (Fault::CutNetwork, "the network to a server or the workers cut for 5 to 60 s", 100),
    (Fault::FillDisk, "the disk of the artifacts full for 5 to 60 s", 100),
    (Fault::SetClock, "the clock of a server or a worker set 10 or 20 minutes ahead or back", 100),
];

/// How long a stopped worker stands still.
const STOPPED: Duration = Duration::from_secs(60);
/// How far clocks are from the right time, s: the machines of two such faults are up to 20 minutes
/// apart.
const OFF_S: [i64; 3] = [-600, 0, 600];
/// The benches of the servers, and the names of their machines.
const SERVERS: [&str; 2] = ["north", "south"];
/// Jobs that are kept waiting or running.
const OPEN: usize = 4;
/// How long the last jobs may take to end, and how long a request is tried.
const END: Duration = Duration::from_secs(900);
const TRY: Duration = Duration::from_secs(120);

pub(super) async fn run(
    flip: &Flip,
    cluster: &Cluster,
    folder: &Path,
    arguments: &[String],
) -> Result<()> {
    let number = |k: usize, usual: u64| arguments.get(k).map_or(Ok(usual), |text| text.parse());
    let (share, seed) = (number(0, 100)? as f64 / 100.0, number(1, 1)?);
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let artifacts = folder.join("artifacts");
    let mut left_out = BTreeMap::new();
    let disk = Disk::mounted(&artifacts);
    let disk = disk.map_err(|why| left_out.insert(Fault::FillDisk, why)).ok();
    let clocks = Clocks::in_folder(folder.join("clocks"));
    let clocks = clocks.map_err(|why| left_out.insert(Fault::SetClock, why.to_string())).ok();
    let artifacts = disk.is_some().then_some(artifacts);
    let flip = &Flip { artifacts, clocks, ..flip.clone() };
    let times = |many: u32| (f64::from(many) * share).ceil() as usize;
    let possible = ALL.iter().filter(|(fault, ..)| !left_out.contains_key(fault));
    let mut faults: Vec<Fault> =
        possible.flat_map(|&(fault, _, many)| vec![fault; times(many)]).collect();
    faults.shuffle(&mut rng);
    println!("{} faults, seed {seed}", faults.len());

    flip_testing::speak_tls();
    let began = Instant::now();
    let client = Client::builder().timeout(Duration::from_secs(5)).build()?;
    let cables = [cluster.cable(), cluster.cable(), cluster.cable()];
    let mut site = Site::start(flip, client, Vec::from(cables));
    site.disk = disk;
    site.prepare().await?;
    let mut done = BTreeMap::<Fault, u32>::new();
    for (k, &fault) in faults.iter().enumerate() {
        site.mend()?;
        let last = || format!("after the faults {:?}", &faults[k.saturating_sub(12)..k]);
        site.feed().await.with_context(last)?;
        sleep(Duration::from_millis(rng.random_range(100..1500))).await;
        site.inflict(fault, cluster, &mut rng)?;
        *done.entry(fault).or_default() += 1;
        if k % 50 == 49 {
            let (asked, seconds) = (site.asked.len(), began.elapsed().as_secs());
            eprintln!("{} faults, {asked} jobs, {seconds} s", k + 1);
        }
    }
    site.settle().await?;
    let results = site.results().await?;
    let asked = std::mem::take(&mut site.asked);
    site.end()?;
    let found = flip.asked(&["doctor", "--thorough"])?.context("flip doctor is not content")?;
    ensure!(!found.to_string().contains("\"lost\":[{"), "artifacts are lost: {found}");
    let alone = alone(flip, folder, &asked).await?;

    println!("| fault | how often |\n|---|---|");
    for (fault, name, _) in ALL {
        match left_out.get(&fault) {
            Some(why) => println!("| {name} | left out: {why} |"),
            None => println!("| {name} | {} |", done.get(&fault).unwrap_or(&0)),
        }
    }
    let equal = results.iter().zip(&alone).filter(|(here, there)| here == there).count();
    let seconds = began.elapsed().as_secs();
    println!(
        "\n{} jobs in {seconds} s: all succeeded, {equal} with the result of one undisturbed process; flip doctor is content; {} jobs waited for room on the disk",
        asked.len(),
        site.waited.len()
    );
    ensure!(equal == asked.len(), "results differ");
    Ok(())
}

/// A job as it was asked for.
struct Asked {
    path: &'static str,
    body: Value,
    id: String,
}

/// A network between some processes and the database, and until when it is cut.
struct Line {
    cable: Option<Cable>,
    flip: Flip,
    mended: Option<Instant>,
}

impl Line {
    fn of(flip: &Flip, cable: Option<Cable>) -> Self {
        let mut flip = flip.clone();
        if let Some(cable) = &cable {
            flip.url = cable.address(&flip.url);
        }
        Self { cable, flip, mended: None }
    }
}

/// All processes, and what was asked of them.
struct Site {
    /// Of each server, and of the workers.
    lines: [Line; 3],
    client: Client,
    servers: Vec<Server>,
    workers: Vec<(Process, Option<Instant>)>,
    started: u32,
    token: String,
    policy: String,
    /// A parameter set.
    set: String,
    asked: Vec<Asked>,
    /// Where artifacts are, if it is a disk of its own.
    disk: Option<Disk>,
    /// Until when it stays full.
    full: Option<Instant>,
    /// Jobs that were seen to wait for room on it.
    waited: HashSet<String>,
}

impl Site {
    fn start(flip: &Flip, client: Client, cables: Vec<Cable>) -> Self {
        let mut cables = cables.into_iter();
        let lines = std::array::from_fn(|_| Line::of(flip, cables.next()));
        let (servers, workers) = (Vec::new(), Vec::new());
        let (token, policy, set) = Default::default();
        let (asked, disk, full, waited) = (Vec::new(), None, None, HashSet::new());
        Self {
            lines,
            client,
            servers,
            workers,
            started: 0,
            token,
            policy,
            set,
            asked,
            disk,
            full,
            waited,
        }
    }

    /// Starts everything, and makes what the jobs need.
    async fn prepare(&mut self) -> Result<()> {
        self.servers.push(Server::of(self.lines[0].flip.server(SERVERS[0])?));
        while self.servers[0].said().is_none() {
            ensure!(!self.servers[0].has_ended()?, "the first server did not start");
            sleep(LOOK).await;
        }
        let said = self.servers[0].said().context("what the first server said")?;
        self.token = said["token"].as_str().context("the first token")?.to_owned();
        self.servers.push(Server::of(self.lines[1].flip.server(SERVERS[1])?));
        self.mend()?;
        let policies = self.get("/v1/policies").await?;
        self.policy = policies["items"][0]["id"].as_str().context("a policy")?.to_owned();
        let (path, body) = sand();
        self.ask(path, body).await?;
        self.settle().await?;
        let sets = self.get("/v1/parameter-sets?powder=sand").await?;
        self.set = sets["items"][0]["id"].as_str().context("a parameter set")?.to_owned();
        Ok(())
    }

    /// Starts again what has ended, and lets those go on that have stood still for long enough.
    fn mend(&mut self) -> Result<()> {
        for line in &mut self.lines {
            if line.mended.is_some_and(|then| then < Instant::now()) {
                line.cable.iter().for_each(Cable::mend);
                line.mended = None;
            }
        }
        if let Some(disk) = &mut self.disk {
            match self.full {
                Some(until) if until > Instant::now() => disk.fill()?,
                _ => disk.make_room()?,
            }
        }
        self.full = self.full.filter(|&until| until > Instant::now());
        for ((server, bench), line) in self.servers.iter_mut().zip(SERVERS).zip(&self.lines) {
            if server.has_ended()? {
                *server = Server::of(line.flip.server(bench)?);
            }
        }
        for (worker, stopped) in &mut self.workers {
            if stopped.is_some_and(|since| since.elapsed() > STOPPED) {
                worker.signal("CONT")?;
                *stopped = None;
            }
        }
        let mut there = Vec::new();
        for (mut worker, stopped) in self.workers.drain(..) {
            if worker.child.try_wait()?.is_none() {
                there.push((worker, stopped));
            }
        }
        self.workers = there;
        while self.workers.iter().filter(|it| it.1.is_none()).count() < 3 {
            self.started += 1;
            self.workers
                .push((self.lines[2].flip.worker(&format!("worker-{}", self.started))?, None));
        }
        Ok(())
    }

    /// Keeps a few jobs open.
    async fn feed(&mut self) -> Result<()> {
        for _ in self.open().await?..OPEN {
            let (path, body) = self.next();
            self.ask(path, body).await?;
        }
        Ok(())
    }

    /// The next job: none depends on one before.
    fn next(&self) -> (&'static str, Value) {
        let k = self.asked.len();
        match k % 4 {
            0 => {
                let (path, mut body) = sand();
                let object = body.as_object_mut().expect("an object");
                object.remove("powder");
                object.insert("repose_deg".into(), json!(27.0 + (k % 7) as f64 / 2.0));
                object.insert("seed".into(), json!(k));
                (path, body)
            }
            1 => (
                "evaluations",
                json!({ "policy": self.policy, "controllers": ["fixed"], "powders": ["sand"], "targets_mg": [10], "repeats": 4, "particles": 1000, "seed": k }),
            ),
            // A film is a file.
            2 => ("films", json!({ "set": self.set, "seed": k })),
            _ => ("trainings", json!({ "episodes": 4, "powders": ["sand"], "seed": k })),
        }
    }

    async fn ask(&mut self, path: &'static str, body: Value) -> Result<()> {
        let job = self.called(&format!("/v1/{path}"), Some(&body)).await?;
        let id = job["id"].as_str().context("the id of a job")?.to_owned();
        ensure!(self.asked.iter().all(|it| it.id != id), "job {id} twice");
        self.asked.push(Asked { path, body, id });
        Ok(())
    }

    async fn get(&self, path: &str) -> Result<Value> {
        self.called(path, None).await
    }

    /// One call, of whichever server answers: asking for a job twice gives the same job.
    async fn called(&self, path: &str, body: Option<&Value>) -> Result<Value> {
        let began = Instant::now();
        loop {
            let urls =
                self.servers.iter().filter_map(|it| it.said()?["url"].as_str().map(str::to_owned));
            for url in urls.collect::<Vec<_>>() {
                let url = format!("{url}{path}");
                let call = match body {
                    Some(body) => self.client.post(url).json(body),
                    None => self.client.get(url),
                };
                let Ok(answer) = call.bearer_auth(&self.token).send().await else { continue };
                let status = answer.status();
                if status.is_server_error() {
                    continue;
                }
                let Ok(said) = answer.text().await else { continue };
                ensure!(status.is_success(), "{path}: {status} {said}");
                return Ok(serde_json::from_str(&said)?);
            }
            ensure!(
                began.elapsed() < TRY,
                "{path}: no server answers\n{}",
                self.lines[0].flip.last_said(&SERVERS)
            );
            sleep(LOOK).await;
        }
    }

    /// Number of jobs that have not ended.
    async fn open(&mut self) -> Result<usize> {
        let mut open = 0;
        for state in ["queued", "running"] {
            let jobs = self.get(&format!("/v1/jobs?state={state}&limit=200")).await?;
            for job in jobs["items"].as_array().into_iter().flatten() {
                open += 1;
                let message = job["progress"]["message"].as_str().unwrap_or_default();
                if message.starts_with("waits: ") {
                    self.waited.insert(job["id"].as_str().unwrap_or_default().to_owned());
                }
            }
        }
        Ok(open)
    }

    fn inflict(&mut self, fault: Fault, cluster: &Cluster, rng: &mut Pcg64Mcg) -> Result<()> {
        match fault {
            Fault::KillWorker => {
                let going: Vec<usize> =
                    (0..self.workers.len()).filter(|&k| self.workers[k].1.is_none()).collect();
                let one = going[rng.random_range(0..going.len())];
                self.workers.remove(one).0.kill()
            }
            Fault::KillServer => {
                let one = rng.random_range(0..self.servers.len());
                self.servers[one].kill()
            }
            Fault::StopWorker => {
                let one = self.workers.iter_mut().find(|it| it.1.is_none());
                let (worker, stopped) = one.context("a worker")?;
                *stopped = Some(Instant::now());
                worker.signal("STOP")
            }
            Fault::FillDisk => {
                let disk = self.disk.as_mut().context("a disk")?;
                self.full = Some(Instant::now() + Duration::from_secs(rng.random_range(5..=60)));
                Ok(disk.fill()?)
            }
            Fault::SetClock => {
                let names = SERVERS.map(str::to_owned).into_iter();
                let going = self.workers.iter().filter(|it| it.1.is_none());
                let names: Vec<String> =
                    names.chain(going.map(|it| it.0.machine.clone())).collect();
                let machine = &names[rng.random_range(0..names.len())];
                let clocks = self.lines[2].flip.clocks.as_ref().context("clocks")?;
                let now_s = clocks.ahead_s(machine)?;
                let others: Vec<i64> = OFF_S.into_iter().filter(|&it| it != now_s).collect();
                clocks.set(machine, others[rng.random_range(0..others.len())])
            }
            Fault::RestartDatabase => {
                cluster.restart();
                Ok(())
            }
            Fault::CrashDatabase => {
                cluster.crash();
                Ok(())
            }
            Fault::CutNetwork => {
                // One server always has its database.
                let line = &mut self.lines[[0, 2][rng.random_range(0..2)]];
                line.cable.iter().for_each(Cable::cut);
                line.mended = Some(Instant::now() + Duration::from_secs(rng.random_range(5..=60)));
                Ok(())
            }
        }
    }

    /// Waits until every job has ended.
    async fn settle(&mut self) -> Result<()> {
        let began = Instant::now();
        let waits = |site: &Self| {
            site.workers.iter().any(|it| it.1.is_some())
                || site.lines.iter().any(|line| line.mended.is_some())
                || site.full.is_some()
        };
        while self.open().await? > 0 || waits(self) {
            if began.elapsed() > END {
                bail!("jobs do not end: {}", self.get("/v1/jobs?limit=20").await?);
            }
            self.mend()?;
            sleep(LOOK).await;
        }
        Ok(())
    }

    /// The result of every job, in the order in which they were asked for.
    async fn results(&self) -> Result<Vec<Value>> {
        let mut results = Vec::new();
        for asked in &self.asked {
            let job = self.get(&format!("/v1/{}/{}", asked.path, asked.id)).await?;
            ensure!(job["job"]["state"] == "succeeded", "{job}");
            results.push(job["result"].clone());
        }
        Ok(results)
    }

    fn end(&mut self) -> Result<()> {
        for (worker, _) in &mut self.workers {
            worker.end()?;
        }
        self.servers.iter_mut().try_for_each(Server::end)
    }
}

/// The calibration that all others need.
fn sand() -> (&'static str, Value) {
    let body = json!({ "powder": "sand", "method": "sequential", "sets": 2, "tolerance_deg": 5, "trials_max": 60, "particles": 400 });
    ("calibrations", body)
}

/// The results of the same jobs in one process with a data folder.
async fn alone(flip: &Flip, folder: &Path, asked: &[Asked]) -> Result<Vec<Value>> {
    let client = Client::builder().timeout(Duration::from_secs(60)).build()?;
    let mut site = Site::start(flip, client, Vec::new());
    site.servers.push(Server::of(flip.alone_server(&folder.join("alone"))?));
    while site.servers[0].said().is_none() {
        sleep(LOOK).await;
    }
    let said = site.servers[0].said().context("what it said")?;
    site.token = said["token"].as_str().context("its token")?.to_owned();
    for (k, job) in asked.iter().enumerate() {
        site.ask(job.path, job.body.clone()).await?;
        // The first makes what the others need.
        while k == 0 && site.open().await? > 0 {
            sleep(LOOK).await;
        }
    }
    while site.open().await? > 0 {
        sleep(LOOK).await;
    }
    let results = site.results().await?;
    site.end()?;
    Ok(results)
}
