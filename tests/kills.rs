//! `flip serve` is killed at random moments of doses on an emulated laboratory that lives on: nothing is poured twice, nothing goes on by itself.
//!
//! The laboratory is a process of its own, so that its arm, vial and balance see what a real bench would see: the driver's renewals end, its
//! dead-man levels and retracts the spoon. `FLIP_KILLS` says how often (`make reliability`: 300).

use serde_json::{Value, json};
use std::cell::{RefCell, RefMut};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Kills in `make test`.
const KILLS: u64 = 30;
/// Laboratories whose services are killed side by side: a dose is mostly waiting.
const LABORATORIES: u64 = 8;
/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(120);
/// Bench seconds in a second of the room.
const SPEED: &str = "20";
const TARGET_MG: f64 = 12.0;
const TOLERANCE_MG: f64 = 1.0;
/// What a dose's own display may be off by without anything being wrong, mg: four standard deviations of the difference of two readings of a balance that
/// wanders by 0.5 mg, as the emulated one does, and half a step. A dose that is poured twice has the target too much.
const DISPLAY_MG: f64 = 4.0 * std::f64::consts::SQRT_2 * 0.5 + 0.5;
/// Shakes that may be written down after a kill: one that was under way, and one that had just ended.
const LAST_SHAKES: usize = 2;

/// A process that is killed when it is dropped.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Start `flip` and read the first document that it prints.
fn started(arguments: &[&str]) -> (Process, Value) {
    let mut process = Command::new(env!("CARGO_BIN_EXE_flip"))
        .args(arguments)
        .arg("--json")
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let stdout = process.stdout.take().unwrap();
    let said = serde_json::Deserializer::from_reader(stdout).into_iter::<Value>().next();
    (Process(process), said.expect("it says where it is").unwrap())
}

/// What the arm did, read on from where the last look ended: the file grows by every motion of every dose.
struct Motions {
    file: BufReader<File>,
    unfinished: String,
    count: usize,
    shakes: usize,
    /// The newest motion; null before the first.
    last: Value,
}

impl Motions {
    fn open(path: &Path) -> Self {
        let file = File::options().create(true).append(true).read(true).open(path).unwrap();
        Self { file: BufReader::new(file), unfinished: String::new(), count: 0, shakes: 0, last: Value::Null }
    }

    fn read_on(&mut self) {
        while self.file.read_line(&mut self.unfinished).unwrap() > 0 && self.unfinished.ends_with('\n') {
            self.last = serde_json::from_str(&self.unfinished).unwrap();
            self.count += 1;
            self.shakes += usize::from(self.last["motion"].as_str().expect("motion").starts_with("Shake"));
            self.unfinished.clear();
        }
    }
}

/// The emulated laboratory: its bench file and what its arm did.
struct Laboratory {
    _process: Process,
    bench: PathBuf,
    motions: RefCell<Motions>,
}

impl Laboratory {
    fn start(folder: &Path) -> Self {
        let (bench, motions) = (folder.join("bench.toml"), folder.join("motions.jsonl"));
        let out = [bench.to_str().unwrap(), motions.to_str().unwrap()];
        let lab = ["emulate", "lab", "--formula", "--speed", SPEED, "--out", out[0], "--motions", out[1]];
        let (process, _) = started(&lab);
        Self { _process: process, bench, motions: RefCell::new(Motions::open(&motions)) }
    }

    /// Every motion that was written down so far.
    fn motions(&self) -> RefMut<'_, Motions> {
        let mut motions = self.motions.borrow_mut();
        motions.read_on();
        motions
    }

    /// A number of the newest motion; 0 before the first.
    fn newest(&self, key: &str) -> f64 {
        let motions = self.motions();
        if motions.last.is_null() { 0.0 } else { motions.last[key].as_f64().expect(key) }
    }

    /// Powder in the vial, mg.
    fn vial_mg(&self) -> f64 {
        self.newest("vial_mg")
    }

    /// Nothing has moved for as long as the dead-man and the way back take.
    fn wait_until_still(&self) {
        let mut count = self.motions().count;
        let mut since = Instant::now();
        while since.elapsed() < Duration::from_millis(1200) {
            std::thread::sleep(Duration::from_millis(20));
            let now = self.motions().count;
            if now != count {
                (count, since) = (now, Instant::now());
            }
        }
    }
}

/// The service, which dies and comes back.
struct Service {
    process: Process,
    url: String,
    client: reqwest::Client,
    token: String,
}

impl Service {
    fn start(folder: &Path, laboratory: &Laboratory, token: Option<String>) -> Self {
        let data = folder.join("data");
        let bench = laboratory.bench.to_str().unwrap();
        let serve = ["serve", "--listen", "127.0.0.1:0", "--bench", bench, "--data-dir", data.to_str().unwrap()];
        let (process, said) = started(&serve);
        let url = said["url"].as_str().unwrap().to_owned();
        let token = token.or_else(|| said["token"].as_str().map(str::to_owned)).expect("a token");
        Self { process, url, client: reqwest::Client::new(), token }
    }

    /// SIGKILL: no destructor, no last word.
    fn kill(mut self) -> String {
        self.process.0.kill().unwrap();
        self.process.0.wait().unwrap();
        self.token
    }

    async fn get(&self, path: &str) -> Value {
        self.client.get(format!("{}{path}", self.url)).send().await.unwrap().json().await.unwrap()
    }

    async fn post(&self, path: &str, key: Option<&str>, body: &Value) -> (u16, Value) {
        let request = self.client.post(format!("{}{path}", self.url)).bearer_auth(&self.token).json(body);
        let request = key.into_iter().fold(request, |request, key| request.header("Idempotency-Key", key));
        let response = request.send().await.unwrap();
        (response.status().as_u16(), response.json().await.unwrap())
    }

    async fn weigh(&self, key: &str) -> (u16, Value) {
        let mg = |value: f64| json!({"value": value, "unit": "mg"});
        let tolerance = json!({"lower": TOLERANCE_MG, "upper": TOLERANCE_MG, "unit": "mg"});
        self.post(
            "/v1/weighings",
            Some(key),
            &json!({"powder": "sand", "target": mg(TARGET_MG), "tolerance": tolerance}),
        )
        .await
    }

    async fn state(&self, id: &str) -> String {
        self.get(&format!("/v1/weighings/{id}")).await["weighing"]["state"].as_str().unwrap().to_owned()
    }

    async fn has_ended(&self, id: &str) -> bool {
        ["done", "aborted", "unknown"].contains(&self.state(id).await.as_str())
    }

    async fn clear(&self) {
        let said = json!({"by": "the test", "note": "vial looked at", "looked": true, "vial_ready": true});
        let (status, body) = self.post("/v1/bench/clear", None, &said).await;
        assert_eq!(status, 200, "{body}");
    }

    async fn wait_for(&self, what: &str, id: &str, states: &[&str]) -> String {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let state = self.state(id).await;
            if states.contains(&state.as_str()) {
                return state;
            }
            assert!(Instant::now() < deadline, "{what}: {state}");
            tokio::time::sleep(Duration::from_millis(3)).await;
        }
    }
}

/// A powder with sets, from small heaps.
async fn calibrate(service: &Service) {
    let heaps = json!({"powder": "sand", "method": "sequential", "sets": 2, "seed": 3, "tolerance_deg": 5, "trials_max": 60, "particles": 400});
    let (_, job) = service.post("/v1/calibrations", None, &heaps).await;
    let (id, deadline) = (job["id"].as_str().unwrap().to_owned(), Instant::now() + PATIENCE);
    while service.get(&format!("/v1/jobs/{id}")).await["state"] != "succeeded" {
        assert!(Instant::now() < deadline, "the calibration does not end");
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

/// What became of the doses that were killed.
#[derive(Default)]
struct Tally {
    unknown: u64,
    ended: u64,
    /// What each kill left in its vial, mg.
    poured_mg: Vec<f64>,
}

/// The service of one laboratory, killed in each of these doses.
async fn kill_all(kills: impl Iterator<Item = u64>) -> Tally {
    let folder = TempDir::new().unwrap();
    let laboratory = Laboratory::start(folder.path());
    let mut service = Service::start(folder.path(), &laboratory, None);
    calibrate(&service).await;
    let mut tally = Tally::default();
    for kill in kills {
        let before_mg = laboratory.vial_mg();
        let key = format!("vial-{kill}");
        let (status, weighing) = service.weigh(&key).await;
        assert_eq!(status, 202, "{weighing}");
        let id = weighing["id"].as_str().unwrap().to_owned();
        service.wait_for("the bench does not move", &id, &["armed", "dosing", "settling", "done"]).await;
        let drawn = flip::domain::seed::derive(20_261_124, &[kill]);
        let share = (drawn % 1000) as f64 / 1000.0;
        // Every third at any time from the beginning, before powder falls too; the others when that share of the target lies in the vial, and a little later.
        let later_ms = match kill % 3 {
            0 => drawn % 8000,
            _ => {
                while laboratory.vial_mg() - before_mg < share * TARGET_MG && !service.has_ended(&id).await {
                    tokio::time::sleep(Duration::from_millis(15)).await;
                }
                drawn / 1000 % 200
            }
        };
        tokio::time::sleep(Duration::from_millis(later_ms)).await;
        let token = service.kill();
        let shakes = laboratory.motions().shakes;
        laboratory.wait_until_still();
        let shakes = laboratory.motions().shakes - shakes;
        assert!(shakes <= LAST_SHAKES, "kill {kill}: {shakes} shakes after it");
        let after_kill_mg = laboratory.vial_mg();
        assert_eq!(laboratory.newest("pitch_deg"), 0.0, "kill {kill}: the spoon is not level");

        service = Service::start(folder.path(), &laboratory, Some(token));
        let state = service.state(&id).await;
        let latched = !service.get("/v1/bench").await["latch"].is_null();
        match state.as_str() {
            "unknown" => {
                tally.unknown += 1;
                assert!(latched, "kill {kill}: an interrupted dose leaves the bench latched");
                let (status, refused) = service.weigh(&format!("another-{kill}")).await;
                let latched = (409, Some("urn:flip:problem:bench-latched"));
                assert_eq!((status, refused["type"].as_str()), latched, "{refused}");
            }
            "done" | "aborted" => tally.ended += 1,
            other => panic!("kill {kill}: {other}"),
        }
        // The same request again finds the same weighing, and pours nothing.
        let (_, again) = service.weigh(&key).await;
        assert_eq!(again["id"].as_str(), Some(id.as_str()), "{again}");
        tokio::time::sleep(Duration::from_millis(150)).await;
        assert_eq!(laboratory.vial_mg(), after_kill_mg, "kill {kill}: something was poured after the restart");
        tally.poured_mg.push(after_kill_mg - before_mg);
        if latched {
            service.clear().await;
        }
    }
    let verified = service.get("/v1/audit/verification").await;
    assert!(verified["broken"].is_null() && verified["records"].as_i64().unwrap() > 0, "{verified}");
    tally
}

#[test]
fn killed_at_any_moment_of_a_dose_nothing_is_poured_twice_and_the_bench_waits_for_a_person() {
    let kills = std::env::var("FLIP_KILLS").map_or(KILLS, |text| text.parse().unwrap());
    let (mut unknown, mut ended, mut poured_mg) = (0, 0, Vec::new());
    let in_laboratory = |first: u64| {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        runtime.block_on(kill_all((first..kills).step_by(LABORATORIES as usize)))
    };
    std::thread::scope(|scope| {
        let all: Vec<_> = (0..LABORATORIES.min(kills)).map(|first| scope.spawn(move || in_laboratory(first))).collect();
        for laboratory in all {
            let tally = laboratory.join().expect("a laboratory has failed");
            unknown += tally.unknown;
            ended += tally.ended;
            poured_mg.extend(tally.poured_mg);
        }
    });
    poured_mg.sort_by(f64::total_cmp);
    let quartiles: Vec<String> = (0..=4).map(|q| format!("{:.1}", poured_mg[q * (poured_mg.len() - 1) / 4])).collect();
    let quartiles = quartiles.join(", ");
    println!(
        "{kills} kills: {unknown} doses unknown and latched, {ended} had ended; in the vials (quartiles) {quartiles} mg of {TARGET_MG}"
    );
    let most_mg = TARGET_MG + TOLERANCE_MG + DISPLAY_MG;
    assert!(
        poured_mg[poured_mg.len() - 1] <= most_mg,
        "an overdose: {quartiles}, and at most {most_mg:.1} were expected"
    );
    assert!(unknown * 2 >= kills, "most kills hit a dose: {unknown} of {kills}");
}
