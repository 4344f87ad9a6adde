//! Updates per second of the learner on one thread, compared with Stable-Baselines3: `make
//! bench-learner`.
//!
//! `cargo bench --bench learner [-- --json]`. An update draws its batch from the replay memory and
//! steps critics, actor, temperature and targets. Both take turns window by window and are timed in
//! processor time, so other load on the machine affects both; one that `benches/learner/run.sh
//! setup` has not installed is left out, with the reason. The recurrent networks are those of the
//! `paper` preset, whose batch consists of whole episodes of 10 steps; they have no peer.

use flip_core::domain::bench::PitchLimits;
use flip_core::domain::parameters::{COUNT, ParameterSet};
use flip_learn::train::environment::{Filling, play};
use flip_learn::train::episodes::Episode;
use flip_learn::train::formula::Formula;
use flip_learn::train::replay::{Memory, Replay};
use flip_learn::train::sac::Learner;
use flip_learn::train::{Network, Order, Preset, Replayed, Settings};
use flip_policy::{OUTPUTS, Rules, normal};
use flip_sim::balance;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rustix::time::{ClockId, clock_gettime};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

/// Units in each of the two hidden layers, and transitions in a batch.
const CASES: [(u32, u32); 4] = [(64, 16), (64, 256), (256, 16), (256, 256)];
const WINDOWS: usize = 9;
/// Updates in a window.
const UPDATES: u32 = 100;

/// Steps of random actions on the formula spoon.
fn remembered(settings: &Settings, rng: &mut Pcg64Mcg) -> Replay {
    let mut replay = Replay::new(settings);
    let formula = Formula { pitch: PitchLimits::WIDE };
    for seed in 0..200 {
        let mut spoon = formula.fill(&ParameterSet::default(), seed);
        let played =
            play(&mut spoon, &Rules::PAPER, &balance::Settings::default(), 12.0, seed, |_| {
                [rng.random::<f32>(), 2.0 * rng.random::<f32>() - 1.0]
            });
        let steps = played.steps.into_iter().map(|step| Memory {
            step,
            target_mg: 12.0,
            repose_deg: 0.0,
            parameters: [0.5; COUNT],
        });
        let state = if settings.stores_states() {
            vec![0.1; 2 * settings.hidden as usize]
        } else {
            Vec::new()
        };
        replay.push(Episode { steps: steps.collect(), state });
    }
    replay
}

/// Processor time of this process so far, s.
fn processor_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// FLIP's learner under test.
struct Ours {
    learner: Learner,
    settings: Settings,
    replay: Replay,
    rng: Pcg64Mcg,
}

impl Ours {
    fn new(settings: Settings) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let replay = remembered(&settings, &mut rng);
        let mut ours = Self { learner: Learner::new(&settings, &mut rng), settings, replay, rng };
        ours.window(20);
        ours
    }

    /// Processor seconds per update, over `updates` of them.
    fn window(&mut self, updates: u32) -> f64 {
        let before = processor_s();
        for _ in 0..updates {
            let drawn = self.replay.draw(&self.settings, &mut self.rng);
            let noise: Vec<f32> =
                (0..4 * drawn.reward.len()).map(|_| normal(&mut self.rng)).collect();
            self.learner.update(&drawn, &noise, &self.settings);
        }
        (processor_s() - before) / f64::from(updates)
    }
}

/// Stable-Baselines3 in a separate process, with a line-based request and reply protocol.
struct Peer {
    process: Child,
    ask: ChildStdin,
    answers: BufReader<ChildStdout>,
    version: String,
}

impl Peer {
    /// The peer, if it is installed: its stderr reports what is missing.
    fn start() -> Option<Self> {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/learner/run.sh");
        let mut command = Command::new("bash");
        command.args([script, "one"]).stdin(Stdio::piped()).stdout(Stdio::piped());
        // It comes with its own libtorch.
        let mut process = command.env_remove("LD_LIBRARY_PATH").spawn().ok()?;
        let (ask, answers) = (process.stdin.take()?, BufReader::new(process.stdout.take()?));
        let mut peer = Self { process, ask, answers, version: String::new() };
        peer.version = peer.answer()?;
        Some(peer)
    }

    fn answer(&mut self) -> Option<String> {
        let mut line = String::new();
        self.answers.read_line(&mut line).ok().filter(|&bytes| bytes > 0)?;
        Some(line.trim_end().to_owned())
    }

    fn window(&mut self, (hidden, batch): (u32, u32), inputs: usize, updates: u32) -> Option<f64> {
        writeln!(self.ask, "{hidden} {batch} {updates} {inputs} {OUTPUTS}").ok()?;
        self.answer()?.parse().ok()
    }

    fn end(self) {
        drop(self.ask);
        let mut process = self.process;
        let _ = process.wait();
    }
}

/// Median, least and most of updates per second, from seconds per update; null if nothing was
/// measured.
fn rates(costs_s: &[f64]) -> Value {
    let mut rates: Vec<f64> = costs_s.iter().map(|cost| 1.0 / cost).collect();
    rates.sort_unstable_by(f64::total_cmp);
    match rates.len() {
        0 => Value::Null,
        n => json!({ "median": rates[n / 2], "min": rates[0], "max": rates[n - 1] }),
    }
}

fn main() {
    let as_json = std::env::args().any(|argument| argument == "--json");
    let mut peer = Peer::start();
    let mut cases = Vec::new();
    for (hidden, batch) in CASES {
        let mut ours = Ours::new(Settings {
            hidden,
            batch,
            ..Settings::of(Preset::Flip, Order::Curriculum, 1)
        });
        let inputs = ours.settings.encoding.width();
        // The peer builds its learner at the first request: that window is warm-up, not measured.
        peer = peer.and_then(|mut peer| peer.window((hidden, batch), inputs, 1).map(|_| peer));
        let (mut own, mut theirs) = (Vec::new(), Vec::new());
        for _ in 0..WINDOWS {
            own.push(ours.window(UPDATES));
            theirs.extend(
                peer.as_mut().and_then(|peer| peer.window((hidden, batch), inputs, UPDATES)),
            );
        }
        let (flip, sb3) = (rates(&own), rates(&theirs));
        let ratio =
            sb3["median"].as_f64().and_then(|theirs| Some(flip["median"].as_f64()? / theirs));
        let network = format!("{hidden} units");
        cases.push(
            json!({ "network": network, "batch": batch, "flip": flip, "stable_baselines3": sb3, "ratio": ratio }),
        );
    }
    for (name, replayed) in
        [("stored state", Replayed::StoredState), ("episodes", Replayed::Episodes)]
    {
        let paper = Settings::of(Preset::Paper, Order::Curriculum, 1);
        let mut ours = Ours::new(Settings { network: Network::Recurrent { replayed }, ..paper });
        let costs_s: Vec<f64> = (0..WINDOWS).map(|_| ours.window(UPDATES / 5)).collect();
        let network = format!("recurrent, {name}");
        cases.push(
            json!({ "network": network, "batch": ours.settings.batch, "flip": rates(&costs_s) }),
        );
    }
    let version = peer.as_ref().map(|peer| peer.version.clone());
    peer.into_iter().for_each(Peer::end);
    let document = json!({ "windows": WINDOWS, "updates": UPDATES, "stable_baselines3": version, "updates_per_core_s": cases });
    match as_json {
        true => println!("{document:#}"),
        false => print(&document),
    }
}

fn print(document: &Value) {
    let version = document["stable_baselines3"].as_str().unwrap_or("not measured");
    println!("updates per core-second, {WINDOWS} windows of {UPDATES}: median (least to most)");
    println!("Stable-Baselines3: {version}");
    println!(
        "{:>24} {:>6} {:>22} {:>22} {:>6}",
        "network", "batch", "flip", "stable-baselines3", "ratio"
    );
    for case in document["updates_per_core_s"].as_array().into_iter().flatten() {
        let rates = |who: &str| match case[who]["median"].as_f64() {
            Some(median) => format!(
                "{median:.0} ({:.0} to {:.0})",
                case[who]["min"].as_f64().unwrap_or(f64::NAN),
                case[who]["max"].as_f64().unwrap_or(f64::NAN)
            ),
            None => "-".to_owned(),
        };
        let ratio = case["ratio"].as_f64().map_or("-".to_owned(), |ratio| format!("{ratio:.2}"));
        println!(
            "{:>24} {:>6} {:>22} {:>22} {ratio:>6}",
            case["network"].as_str().unwrap_or_default(),
            case["batch"].to_string(),
            rates("flip"),
            rates("stable_baselines3")
        );
    }
}
