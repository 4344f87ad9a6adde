//! The emulated laboratory that goes on whatever happens to its service, and the motions of its arm.

use serde::Deserialize;
use serde_json::Value;
use std::cell::{RefCell, RefMut};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Bench seconds per wall-clock second.
const SPEED: &str = "20";

/// A process that is killed when it is dropped.
pub struct Process(pub Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts `flip` and reads the first document it prints.
pub fn started(arguments: &[&str]) -> (Process, Value) {
    let mut process = Command::new(flip_testing::program(env!("CARGO_BIN_EXE_flip")))
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

/// One motion of the arm, complete or not.
#[derive(Debug, Clone, Deserialize)]
pub struct Motion {
    pub motion: String,
    /// Pitch at its end, deg.
    pub pitch_deg: f64,
    /// Mass that fell during it, mg.
    pub poured_mg: f64,
    /// Powder in the vial when it was recorded, mg.
    pub vial_mg: f64,
}

impl Motion {
    /// The requested amplitude, if it is a shake, mm.
    pub fn shake_mm(&self) -> Option<f64> {
        Some(self.motion.strip_prefix("Shake(")?.strip_suffix(')')?.parse().expect("an amplitude"))
    }
}

/// The arm's motions, read on from where the last read ended: the file grows by every motion of
/// every dose.
pub struct Motions {
    file: BufReader<File>,
    unfinished: String,
    pub made: Vec<Motion>,
}

impl Motions {
    fn open(path: &Path) -> Self {
        let file = File::options().create(true).append(true).read(true).open(path).unwrap();
        Self { file: BufReader::new(file), unfinished: String::new(), made: Vec::new() }
    }

    fn read_on(&mut self) {
        while self.file.read_line(&mut self.unfinished).unwrap() > 0
            && self.unfinished.ends_with('\n')
        {
            self.made.push(serde_json::from_str(&self.unfinished).unwrap());
            self.unfinished.clear();
        }
    }
}

/// The emulated laboratory: its bench file and its arm's motions.
pub struct Laboratory {
    _process: Process,
    pub bench: PathBuf,
    motions: RefCell<Motions>,
}

impl Laboratory {
    pub fn start(folder: &Path) -> Self {
        let (bench, motions) = (folder.join("bench.toml"), folder.join("motions.jsonl"));
        let out = [bench.to_str().unwrap(), motions.to_str().unwrap()];
        let lab =
            ["emulate", "lab", "--formula", "--speed", SPEED, "--out", out[0], "--motions", out[1]];
        let (process, _) = started(&lab);
        Self { _process: process, bench, motions: RefCell::new(Motions::open(&motions)) }
    }

    /// Every motion recorded so far.
    pub fn motions(&self) -> RefMut<'_, Motions> {
        let mut motions = self.motions.borrow_mut();
        motions.read_on();
        motions
    }

    /// Pitch of the spoon, deg.
    pub fn pitch_deg(&self) -> f64 {
        self.motions().made.last().map_or(0.0, |motion| motion.pitch_deg)
    }

    /// Number of shakes from this motion on.
    pub fn shakes_since(&self, first: usize) -> usize {
        self.motions().made[first..].iter().filter_map(Motion::shake_mm).count()
    }

    /// Powder in the vial, mg.
    pub fn vial_mg(&self) -> f64 {
        self.motions().made.last().map_or(0.0, |motion| motion.vial_mg)
    }

    /// Waits until nothing has moved for the time that the dead-man and the way back take; returns
    /// the number of motions made by then.
    pub fn wait_until_still(&self) -> usize {
        let mut count = self.motions().made.len();
        let mut since = Instant::now();
        while since.elapsed() < Duration::from_millis(1200) {
            std::thread::sleep(Duration::from_millis(20));
            let now = self.motions().made.len();
            if now != count {
                (count, since) = (now, Instant::now());
            }
        }
        count
    }
}
