//! Updates per second of the learner on one thread, by libtorch and by our own gradients, beside
//! Stable-Baselines3 and JAX: `make bench-learner`.
//!
//! `cargo bench --bench learner [-- --json]`. An update draws its batch from the replay memory and
//! steps critics, actor, temperature and targets. All take turns window by window and are timed in
//! processor time, so other load on the machine affects all; one that `benches/learner/run.sh
//! setup` has not installed is left out, with the reason. The recurrent networks are those of the
//! `paper` preset, whose batch consists of whole episodes of 10 steps; they have no peer.

use flip_core::domain::bench::PitchLimits;
use flip_core::domain::parameters::{COUNT, ParameterSet};
use flip_learn::train::environment::{Filling, play};
use flip_learn::train::episodes::Episode;
use flip_learn::train::formula::Formula;
use flip_learn::train::replay::{Memory, Replay};
use flip_learn::train::sac::Learner;
use flip_learn::train::{Gradients, Network, Order, Preset, Replayed, Settings};
use flip_policy::{OUTPUTS, Rules, normal};
use flip_sim::balance;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rustix::time::{ClockId, clock_gettime};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

/// Units in each of the two hidden layers, and transitions in a batch.
const CASES: [(u32, u32); 5] = [(64, 16), (64, 256), (128, 256), (256, 16), (256, 256)];
/// Words of `run.sh` for the peers, and their names in the document.
const PEERS: [(&str, &str); 2] = [("one", "stable_baselines3"), ("jax", "jax")];
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

/// A peer in a separate process, with a line-based request and reply protocol.
struct Peer {
    process: Child,
    ask: ChildStdin,
    answers: BufReader<ChildStdout>,
    version: String,
}

impl Peer {
    /// The peer, if it is installed: its stderr reports what is missing.
    fn start(word: &str) -> Option<Self> {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/learner/run.sh");
        let mut command = Command::new("bash");
        command.args([script, word]).stdin(Stdio::piped()).stdout(Stdio::piped());
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
    let mut peers = PEERS.map(|(word, _)| Peer::start(word));
    let versions = peers.each_ref().map(|peer| peer.as_ref().map(|peer| peer.version.clone()));
    let mut cases = Vec::new();
    for (hidden, batch) in CASES {
        let settings =
            Settings { hidden, batch, ..Settings::of(Preset::Flip, Order::Curriculum, 1) };
        let inputs = settings.encoding.width();
        // A peer builds its learner at the first request: that window is warm-up, not measured. JAX
        // compiles for a number of updates.
        for peer in &mut peers {
            let warm = |peer: &mut Peer| peer.window((hidden, batch), inputs, UPDATES);
            if peer.as_mut().and_then(warm).is_none() {
                *peer = None;
            }
        }
        cases.push(measured(&format!("{hidden} units"), &settings, UPDATES, &mut peers));
    }
    for (name, replayed) in
        [("stored state", Replayed::StoredState), ("episodes", Replayed::Episodes)]
    {
        let paper = Settings::of(Preset::Paper, Order::Curriculum, 1);
        let settings = Settings { network: Network::Recurrent { replayed }, ..paper };
        cases.push(measured(&format!("recurrent, {name}"), &settings, UPDATES / 5, &mut []));
    }
    peers.into_iter().flatten().for_each(Peer::end);
    let mut document =
        json!({ "windows": WINDOWS, "updates": UPDATES, "updates_per_core_s": cases });
    for ((_, name), version) in PEERS.iter().zip(versions) {
        document[name] = json!(version);
    }
    match as_json {
        true => println!("{document:#}"),
        false => print(&document),
    }
}

/// One line of the table: both of ours and the peers, taking turns.
fn measured(network: &str, settings: &Settings, updates: u32, peers: &mut [Option<Peer>]) -> Value {
    let with = |gradients| Ours::new(Settings { gradients, ..settings.clone() });
    let mut ours = [Gradients::Libtorch, Gradients::Fused].map(with);
    let inputs = settings.encoding.width();
    let size = (settings.hidden, settings.batch);
    let mut costs_s = vec![Vec::new(); ours.len() + peers.len()];
    for _ in 0..WINDOWS {
        let (own, theirs) = costs_s.split_at_mut(ours.len());
        for (ours, costs_s) in ours.iter_mut().zip(own) {
            costs_s.push(ours.window(updates));
        }
        for (peer, costs_s) in peers.iter_mut().zip(theirs) {
            costs_s.extend(peer.as_mut().and_then(|peer| peer.window(size, inputs, updates)));
        }
    }
    let mut case = json!({ "network": network, "batch": settings.batch });
    let names = ["flip", "flip_fused"].into_iter().chain(PEERS.map(|(_, name)| name));
    for (name, costs_s) in names.zip(&costs_s) {
        case[name] = rates(costs_s);
    }
    let median = |who: &str| case[who]["median"].as_f64();
    let over = |who: &str| Some(median("flip_fused")? / median(who)?);
    case["fused_over"] = json!({
        "flip": over("flip"),
        "stable_baselines3": over("stable_baselines3"),
        "jax": over("jax"),
    });
    case
}

/// Columns of the table: a word of the document, and what it is called.
const COLUMNS: [(&str, &str); 4] = [
    ("flip", "libtorch"),
    ("flip_fused", "own gradients"),
    ("stable_baselines3", "stable-baselines3"),
    ("jax", "jax"),
];

fn print(document: &Value) {
    let version = |name: &str| document[name].as_str().unwrap_or("not measured").to_owned();
    println!("updates per core-second, {WINDOWS} windows of {UPDATES}: median (least to most)");
    println!("Stable-Baselines3: {}; {}", version("stable_baselines3"), version("jax"));
    let line = |network: &str, batch: &str, cells: [String; 4], ratio: &str| {
        let cells = cells.map(|cell| format!("{cell:>22}")).join(" ");
        println!("{network:>24} {batch:>6} {cells} {ratio:>8}");
    };
    line("network", "batch", COLUMNS.map(|(_, name)| name.to_owned()), "own/lib.");
    for case in document["updates_per_core_s"].as_array().into_iter().flatten() {
        let number = |of: &Value| of.as_f64().unwrap_or(f64::NAN);
        let rates = |(who, _): (&str, &str)| match case[who]["median"].as_f64() {
            Some(median) => format!(
                "{median:.0} ({:.0} to {:.0})",
                number(&case[who]["min"]),
                number(&case[who]["max"])
            ),
            None => "-".to_owned(),
        };
        line(
            case["network"].as_str().unwrap_or_default(),
            &case["batch"].to_string(),
            COLUMNS.map(rates),
            &format!("{:.2}", number(&case["fused_over"]["flip"])),
        );
    }
}
