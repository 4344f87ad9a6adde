//! What an accepted version of the simulator is worth on the balance: `make weighing-gain`.
//!
//! A simulated laboratory whose powder consolidates at rest measures angles of repose for twenty
//! days, after minutes and after hours of rest. The command reads the file, names the cause and
//! makes a version of the simulator; a policy trained without it, for as long as policies are, is
//! then trained further on different simulators (`flip train --from`), and all weigh on the
//! laboratory's own bench, after a night of rest:
//!
//! | arm | goes on in |
//! |---|---|
//! | old | nothing: the policy as it was |
//! | sham | the base simulator: the same episodes, and nothing new in them |
//! | extended | the version, after as long a rest as the bench's |
//! | oracle | the truth itself, which no laboratory has |
//!
//! The truth shares nothing with the catalogue except contacts that gain strength: how much in
//! which time follows another formula ([`consolidation`]), and the powders on the bench are
//! parameter sets seen in no training and no fit. The air's humidity is recorded and has no effect.
//! Completed work is found again in the folder `DATA`; the output depends on the code alone. With
//! `DEVICE=cuda` calibrations, trainings and doses are computed on a graphics card, and the output is
//! another one.

use anyhow::{Context, bail, ensure};
use flip::app::{local_engine, report_html};
use flip_core::domain::bench::{INCLINE_CHANGE_DEG_MAX, SHAKE_MM_MAX};
use flip_core::domain::conditions::{Patch, Under};
use flip_core::domain::device::Device;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_core::stats::summary::{mean, sd};
use flip_discover::Report;
use flip_discover::report::WeighingGain;
use flip_learn::train::environment::{Filling, Simulated, Spoon, play};
use flip_learn::train::{
    Event, Extended, Gradients, Level, Order, Preset, Settings, Start, train, train_beside,
};
use flip_policy::{Controller, Observation, Rules, decode, id, normal};
use flip_sim::batch::{Engine, Failed, Place, side_by_side};
use flip_sim::mechanisms::Extensions;
use flip_sim::repose::{self, repose};
use flip_sim::{balance, dispense};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use serde_json::Value;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

/// Powders the policy is trained on.
const POWDERS: [&str; 3] = ["sand", "sugar", "salt"];
/// Sets of a calibration used in trainings; the others are the laboratory's powders.
const TRAINED: usize = 7;
/// Days, and runs of each powder on each.
const DAYS: usize = 20;
const RUNS: usize = 3;
/// SD of day effects, and of day effects by powder, deg: those of the hidden-effect suite.
const DAY_DEG: [f64; 2] = [0.5, 0.4];
/// Times at rest before the laboratory's measurements, min, and that of the powder on the bench.
const REST_MIN: [f64; 6] = [2.0, 10.0, 30.0, 60.0, 240.0, 720.0];
const BENCH_MIN: f64 = 720.0;
/// Doses: masses, and how many of each powder and mass.
const TARGETS_MG: [f64; 3] = [5.0, 10.0, 15.0];
const REPEATS: u64 = 6;
/// Maximum number of oracles: they only show how wide the gap is.
const ORACLES: u64 = 3;

/// Episodes of a round, as a training plays them on a card.
const ROUND_ON_CARD: u32 = 32;

/// Seed indices.
const CAMPAIGN: u64 = 1;
const DOSES: u64 = 2;

/// Bond number of the contacts in the truth after this rest: a stretched exponential, typical of
/// relaxation over many time scales.
fn consolidation(rest_min: f64) -> f64 {
    4.0 * (1.0 - (-(rest_min / 90.0).powf(0.7)).exp())
}

fn rested(rest_min: f64) -> Patch {
    Patch {
        amplitudes: [("consolidation".to_owned(), consolidation(rest_min))].into(),
        ..Patch::default()
    }
}

/// A policy by its content.
type Named = (String, Controller);

/// The command and its working folders.
struct Flip {
    program: PathBuf,
    folder: PathBuf,
    /// Data folder, within the other.
    data: &'static str,
    /// The card, if one is asked for.
    card: Option<Arc<dyn Engine>>,
    seed: u64,
}

impl Flip {
    fn ask(&self, arguments: &[&str]) -> anyhow::Result<Value> {
        eprintln!("flip {}", arguments.join(" "));
        let data = self.folder.join(self.data);
        let output = Command::new(&self.program)
            .arg("--data-dir")
            .arg(data)
            .args(arguments)
            .arg("--json")
            .output()?;
        let errors = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "flip {}: {errors}", arguments.join(" "));
        Ok(serde_json::from_slice(&output.stdout)?)
    }

    /// These arguments, and the device to compute on.
    fn on_device<'a>(&self, arguments: &[&[&'a str]]) -> Vec<&'a str> {
        let device: &[&str] = if self.card.is_some() { &["--device", "cuda"] } else { &[] };
        [arguments, &[device]].concat().concat()
    }

    fn path(&self, name: &str) -> String {
        self.folder.join(name).display().to_string()
    }

    /// The same on a copy of its data, made once: two processes cannot share one.
    fn beside(&self, data: &'static str) -> anyhow::Result<Self> {
        let (from, to) = (self.folder.join(self.data), self.folder.join(data));
        if !to.exists() {
            let half_made = self.folder.join(format!("{data}.part"));
            let _ = std::fs::remove_dir_all(&half_made);
            copy(&from, &half_made)?;
            std::fs::rename(&half_made, &to)?;
        }
        Ok(Self {
            program: self.program.clone(),
            folder: self.folder.clone(),
            data,
            card: self.card.clone(),
            seed: self.seed,
        })
    }

    /// Angle and sets of each powder, under a version or the base.
    fn calibrated(&self, simulator: Option<&str>) -> anyhow::Result<Vec<(f64, Vec<ParameterSet>)>> {
        let seed = self.seed.to_string();
        let of = |powder: &&str| {
            let under = simulator.map_or_else(Vec::new, |version| vec!["--simulator", version]);
            let asked = ["calibrate", "--powder", powder, "--seed", &seed];
            let found = self.ask(&self.on_device(&[&asked, &under]))?;
            let powder = &found["powders"][0];
            let sets = powder["sets"].as_array().context("a calibration has sets")?;
            let sets =
                sets.iter().map(|set| Ok(serde_json::from_value(set["parameters"].clone())?));
            let angle = powder["target_deg"].as_f64().context("a calibration has a target")?;
            Ok((angle, sets.collect::<anyhow::Result<_>>()?))
        };
        POWDERS.iter().map(of).collect()
    }

    /// The policies of these trainings, one for each seed, as controllers.
    fn trained(
        &self,
        seeds: std::ops::RangeInclusive<u64>,
        arguments: &[&str],
    ) -> anyhow::Result<Vec<Named>> {
        let seeds = seeds.map(|seed| seed.to_string()).collect::<Vec<_>>().join(",");
        let trained = self.ask(&self.on_device(&[&["train", "--seeds", &seeds], arguments]))?;
        let all = trained.as_array().map_or_else(|| vec![&trained], |all| all.iter().collect());
        let policy = |trained: &Value| {
            let policy = trained["policy"].as_str().context("a training has a policy")?.to_owned();
            let file = self.path(&format!("{policy}.safetensors"));
            if !Path::new(&file).exists() {
                self.ask(&["policy", "export", "--policy", &policy, "--out", &file])?;
            }
            Ok((policy, decode(&std::fs::read(file)?)?.controller))
        };
        all.into_iter().map(policy).collect()
    }
}

/// A folder and all in it.
fn copy(from: &Path, to: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(to)?;
    for entry in std::fs::read_dir(from)? {
        let entry = entry?;
        let (path, to) = (entry.path(), to.join(entry.file_name()));
        if path.is_dir() {
            copy(&path, &to)?;
        } else {
            std::fs::copy(&path, &to)?;
        }
    }
    Ok(())
}

/// The laboratory's angles, as the file it uploads.
fn campaign(powders: &[Vec<ParameterSet>], seed: u64) -> anyhow::Result<String> {
    let mut rng = Pcg64Mcg::seed_from_u64(derive(seed, &[CAMPAIGN]));
    let mut runs = Vec::new();
    for day in 0..DAYS {
        let humidity: f64 = rng.random_range(25.0..70.0);
        let [of_day, of_both] = DAY_DEG;
        let shift = of_day * f64::from(normal(&mut rng));
        for (p, sets) in powders.iter().enumerate() {
            let shift = shift + of_both * f64::from(normal(&mut rng));
            for run in 0..RUNS {
                let rest = REST_MIN[rng.random_range(0..REST_MIN.len() as u32) as usize];
                runs.push((
                    day,
                    humidity,
                    rest,
                    p,
                    sets[(day + run) % sets.len()],
                    shift,
                    rng.random(),
                ));
            }
        }
    }
    let poured = runs.par_iter().map(|&(day, humidity, rest, p, set, shift, seed)| {
        let extensions = Extensions::default().patched(&rested(rest))?;
        let settings = repose::Settings { extensions, ..repose::Settings::default() };
        // A heap that cakes may not cover its base: it has no angle, and nothing is written down.
        let Ok(heap) = repose(&set, &settings, seed) else { return Ok(String::new()) };
        Ok(format!("{},{:.1},{},{rest},{humidity:.1}\n", POWDERS[p], heap.tip_deg + shift, day + 1))
    });
    let rows: Vec<String> = poured.collect::<anyhow::Result<_>>()?;
    Ok(format!("powder,repose_deg,session,rest_min,relative_humidity_pct\n{}", rows.concat()))
}

/// Write a file whole or not at all.
fn write(file: &str, bytes: &[u8]) -> std::io::Result<()> {
    let part = format!("{file}.part");
    std::fs::write(&part, bytes)?;
    std::fs::rename(part, file)
}

/// A policy trained further on the truth, kept as a file.
fn oracle(flip: &Flip, old: &Named, truth: &[Level], seed: u64) -> anyhow::Result<Named> {
    let file = flip.path(&format!("oracle-{seed}.safetensors"));
    if let Ok(bytes) = std::fs::read(&file) {
        return Ok((id(&bytes), decode(&bytes)?.controller));
    }
    let under_way = flip.path(&format!("oracle-{seed}.checkpoint"));
    let (before, Controller::Learned(actor)) = old else { bail!("the old policy has no network") };
    let under = Under { simulator: "the truth".to_owned(), conditions: BTreeMap::new() };
    let extended = Extended { under, days: vec![rested(BENCH_MIN)], powders: BTreeMap::new() };
    let settings =
        Settings::of(Preset::Flip, Order::Curriculum, seed).going_on_from(before.clone());
    let settings = Settings { extended: Some(extended), ..settings };
    let checkpoint = std::fs::read(&under_way).ok();
    let start = checkpoint.as_deref().map_or(Start::Policy(actor), Start::Checkpoint);
    eprintln!("oracle {seed}");
    let keep = |event| match event {
        Event::Checkpoint(bytes) if write(&under_way, &bytes).is_err() => ControlFlow::Break(()),
        _ => ControlFlow::Continue(()),
    };
    let go_on = || ControlFlow::Continue(());
    let trained = match &flip.card {
        None => train(truth, &settings, start, &go_on, keep)?,
        Some(card) => {
            let (episodes_per_round, gradients) = (ROUND_ON_CARD, Gradients::Fused);
            let settings = Settings { episodes_per_round, gradients, ..settings };
            train_beside(&**card, truth, &settings, start, &go_on, keep)?
        }
    };
    write(&file, &trained.artifact)?;
    Ok((id(&trained.artifact), decode(&trained.artifact)?.controller))
}

/// The laboratory's bench.
struct Bench {
    rules: Rules,
    filling: Simulated,
    balance: balance::Settings,
}

impl Bench {
    fn new() -> Self {
        let rules = Rules::FLIP;
        let settings = dispense::Settings { pitch: rules.pitch, ..dispense::Settings::default() };
        let (filling, balance) = (Simulated { settings }, balance::Settings::default());
        Self { rules, filling, balance }
    }

    /// What a policy errs by in a dose from this spoon, mg.
    fn error(&self, spoon: &mut impl Spoon, controller: &Controller, mg: f64, seed: u64) -> f64 {
        let Self { rules, balance, .. } = self;
        let mut dosing = controller.begin(rules, balance.readability_mg);
        let propose = |seen: &Observation| {
            let action = dosing.propose(seen);
            let incline = action.incline_change_deg / INCLINE_CHANGE_DEG_MAX;
            [incline as f32, (2.0 * action.shake_mm / SHAKE_MM_MAX - 1.0) as f32]
        };
        play(spoon, rules, balance, mg, seed, propose).dispensed_mg - mg
    }

    /// The same of each dose by each of these policies, side by side on a card: `[doses][policies]`.
    fn errors_on(
        &self,
        card: &dyn Engine,
        doses: &[(ParameterSet, f64, u64)],
        policies: &[&Named],
    ) -> anyhow::Result<Vec<Vec<f64>>> {
        let many = doses.len() * policies.len();
        let mut found = vec![Err("it was not weighed".to_owned()); many];
        let procedure = |k: usize, place: &mut Place| -> Result<f64, String> {
            let (set, target_mg, seed) = doses[k / policies.len()];
            let heap = self.filling.loose(&set, &rested(BENCH_MIN), seed);
            let mut seat = place.settle(heap).map_err(|Failed(why)| why)?;
            Ok(self.error(&mut seat, &policies[k % policies.len()].1, target_mg, seed))
        };
        let mut each = |k: usize, error| {
            found[k] = error;
            ControlFlow::Continue(())
        };
        let mut batch = card.batch(card.places().min(many))?;
        side_by_side(&mut *batch, many, procedure, &mut each)?;
        let found = found.into_iter().collect::<Result<Vec<f64>, String>>();
        let found = found.map_err(anyhow::Error::msg)?;
        Ok(found.chunks(policies.len()).map(<[f64]>::to_vec).collect())
    }
}

/// Errors of each of these policies over the same doses on the laboratory's bench, mg:
/// `[policies][doses]`. On the cores each dose is a file in `kept`.
fn weigh(
    policies: &[Named],
    powders: &[Vec<ParameterSet>],
    flip: &Flip,
    kept: &Path,
) -> anyhow::Result<Vec<Vec<f64>>> {
    std::fs::create_dir_all(kept)?;
    let (bench, seed) = (Bench::new(), flip.seed);
    let mut doses = Vec::new();
    for (p, sets) in powders.iter().enumerate() {
        for (t, target_mg) in TARGETS_MG.into_iter().enumerate() {
            let seed = |repeat: u64| derive(seed, &[DOSES, p as u64, t as u64, repeat]);
            doses.extend((0..REPEATS).map(|r| (sets[r as usize % sets.len()], target_mg, seed(r))));
        }
    }
    if let Some(card) = &flip.card {
        let all: Vec<&Named> = policies.iter().collect();
        let errors = bench.errors_on(&**card, &doses, &all)?;
        return Ok(by_policy(&errors, policies.len()));
    }
    let errors = doses.par_iter().enumerate().map(|(dose, (set, target_mg, seed))| {
        let file = kept.join(format!("dose-{dose}.json"));
        let mut errors: BTreeMap<String, f64> = match std::fs::read(&file) {
            Ok(bytes) => serde_json::from_slice(&bytes)?,
            Err(_) => BTreeMap::new(),
        };
        let missing: Vec<&Named> =
            policies.iter().filter(|(id, _)| !errors.contains_key(id)).collect();
        if !missing.is_empty() {
            let filled = bench.filling.fill_under(set, &rested(BENCH_MIN), *seed);
            for (id, controller) in missing {
                let error = bench.error(&mut filled.clone(), controller, *target_mg, *seed);
                errors.insert(id.clone(), error);
            }
            write(&file.display().to_string(), &serde_json::to_vec(&errors)?)?;
        }
        Ok(policies.iter().map(|(id, _)| errors[id]).collect())
    });
    let errors: Vec<Vec<f64>> = errors.collect::<anyhow::Result<_>>()?;
    Ok(by_policy(&errors, policies.len()))
}

/// `[doses][policies]` the other way round.
fn by_policy(errors: &[Vec<f64>], policies: usize) -> Vec<Vec<f64>> {
    (0..policies).map(|c| errors.iter().map(|of_dose| of_dose[c]).collect()).collect()
}

/// 95 % interval of the mean of these differences, one for each training seed: Student's t.
fn interval(differences: &[f64]) -> anyhow::Result<[f64; 2]> {
    use statrs::distribution::{ContinuousCDF, StudentsT};
    let n = differences.len() as f64;
    let t = StudentsT::new(0.0, 1.0, n - 1.0)?.inverse_cdf(0.975);
    let error = t * sd(differences).context("at least two seeds")? / n.sqrt();
    let middle = mean(differences).context("at least two seeds")?;
    Ok([middle - error, middle + error])
}

fn main() -> anyhow::Result<()> {
    let seeds: u64 = std::env::var("SEEDS").map_or(Ok(6), |text| text.parse())?;
    ensure!(seeds >= 2, "SEEDS must be at least 2: the interval is over them");
    let program = std::env::var_os("FLIP_BIN").context("FLIP_BIN names the program")?.into();
    let device = match std::env::var("DEVICE").as_deref() {
        Err(_) | Ok("" | "cpu") => Device::Cpu,
        Ok("cuda") => Device::Cuda,
        Ok(other) => bail!("DEVICE must be cpu or cuda, not {other}"),
    };
    let card = local_engine(device)?;
    let name = if card.is_some() { "weighing-gain-cuda" } else { "weighing-gain" };
    let target = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target");
    let folder = std::env::var_os("DATA").map_or_else(|| target.join(name), PathBuf::from);
    std::fs::create_dir_all(&folder)?;
    let flip = Flip { program, folder: folder.clone(), data: "data", card, seed: 1 };

    let base = flip.calibrated(None)?;
    let old = flip.trained(1..=1, &[])?.remove(0);
    let of_laboratory: Vec<Vec<ParameterSet>> =
        base.iter().map(|(_, sets)| sets[TRAINED..].to_vec()).collect();
    let file = flip.path("campaign.csv");
    std::fs::write(&file, campaign(&of_laboratory, flip.seed)?)?;
    let report = flip.ask(&[
        "discover",
        "--measurements",
        &file,
        "--out",
        &flip.path("report"),
        "--seed",
        "1",
    ])?;
    println!("{}\n", report["sentence"].as_str().unwrap_or_default());
    let Some(version) = report["simulator_version"]["extended"].as_str() else {
        bail!("no version was accepted: see {}", flip.path("report/report.html"));
    };
    flip.calibrated(Some(version))?;

    let condition = format!("rest_min={BENCH_MIN}");
    let truth: Vec<Level> = POWDERS
        .iter()
        .zip(&base)
        .map(|(powder, (repose_deg, sets))| Level {
            powder: (*powder).to_owned(),
            repose_deg: *repose_deg,
            sets: sets[..TRAINED].to_vec(),
        })
        .collect();
    let from = ["--from", &old.0];
    let under = [&from[..], &["--simulator", version, "--condition", &condition]].concat();
    // All in parallel: the steps of one training are sequential.
    let beside = flip.beside("data-sham")?;
    let (sham, extended, best) = std::thread::scope(|scope| {
        let sham = scope.spawn(|| beside.trained(1..=seeds, &from));
        let extended = scope.spawn(|| flip.trained(1..=seeds, &under));
        let best =
            (1..=seeds.min(ORACLES)).into_par_iter().map(|seed| oracle(&flip, &old, &truth, seed));
        let best = best.collect::<anyhow::Result<_>>();
        (sham.join().expect("does not panic"), extended.join().expect("does not panic"), best)
    });
    let (sham, extended, best) = (sham?, extended?, best?);
    let arms: [(&str, Vec<Named>); 4] =
        [("old", vec![old]), ("sham", sham), ("extended", extended), ("oracle", best)];
    let all: Vec<Named> = arms.iter().flat_map(|(_, of)| of.clone()).collect();
    let errors = weigh(&all, &of_laboratory, &flip, &folder.join("weighed"))?;
    let doses = errors[0].len();
    println!(
        "| policy | trainings | mean absolute error mg, {doses} doses each | SD over trainings | more than 1 mg over | more than 1 mg short |"
    );
    println!("|---|---|---|---|---|---|");
    let mut left = errors.as_slice();
    let mut of_arms: Vec<(&str, Vec<f64>)> = Vec::new();
    for (name, of) in &arms {
        let (own, others) = left.split_at(of.len());
        left = others;
        let absolute =
            |of: &Vec<f64>| of.iter().map(|error| error.abs()).sum::<f64>() / doses as f64;
        let means: Vec<f64> = own.iter().map(absolute).collect();
        let spread = sd(&means).map_or_else(|| "-".to_owned(), |sd| format!("{sd:.2}"));
        let share = |is: fn(f64) -> bool| {
            100.0 * own.iter().flatten().filter(|error| is(**error)).count() as f64
                / (own.len() * doses) as f64
        };
        let (over, short) = (share(|error| error > 1.0), share(|error| error < -1.0));
        let mean = mean(&means).unwrap_or(f64::NAN);
        println!("| {name} | {} | {mean:.2} | {spread} | {over:.0} % | {short:.0} % |", own.len());
        of_arms.push((name, means));
    }
    let [(_, old), (_, sham), (_, extended), (_, best)] = of_arms.as_slice() else {
        bail!("four arms")
    };
    let less = |than: &dyn Fn(usize) -> f64| {
        extended.iter().enumerate().map(|(k, it)| than(k) - it).collect::<Vec<_>>()
    };
    let over_old = less(&|_| old[0]);
    let ci95 = interval(&over_old)?;
    for (name, gains) in [("old", over_old), ("sham", less(&|k| sham[k]))] {
        let [low, high] = interval(&gains)?;
        println!(
            "\nextended is better than {name} by {:.2} mg [{low:.2}, {high:.2}] (95 %, over trainings)",
            mean(&gains).unwrap_or(0.0)
        );
    }
    let [before, from, reached, to] = [old, sham, extended, best].map(|of| mean(of).unwrap_or(0.0));
    // If even the truth teaches nothing there is no gap, and no share of it.
    match from > to {
        true => println!(
            "\nM14 share of the gap from sham to oracle that it closes: {:.0} %  target >= 50 %",
            100.0 * (from - reached) / (from - to)
        ),
        false => println!(
            "\nM14 has no share: policies that went on in the truth weigh no better than the sham's"
        ),
    }
    told(&flip, WeighingGain { before, after: reached, sham: from, oracle: Some(to), ci95 })
}

/// Adds the results on the balance to the investigation's documents.
fn told(flip: &Flip, measured: WeighingGain) -> anyhow::Result<()> {
    let file = flip.path("report/report.json");
    let mut report: Report = serde_json::from_slice(&std::fs::read(&file)?)?;
    let gain = report.gain.as_mut().context("a version was accepted")?;
    gain.weighing_error_mg = Some(measured);
    std::fs::write(flip.path("report/report.html"), report_html::html(&report))?;
    std::fs::write(&file, serde_json::to_vec_pretty(&report)?)?;
    Ok(())
}
