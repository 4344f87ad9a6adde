//! The published experiment whole, in the simulator: four orders of the powders, several seeds of
//! each, all trainings side by side on one graphics card.
//!
//! ```text
//! for angle in 28 33 37; do flip calibrate --repose-deg $angle --method sequential --json > $angle.json; done
//! flip calibrate --powder all --method sequential --json > powders.json
//! CUDA_DEVICE_MAX_CONNECTIONS=32 cargo experiment published_experiment -- published runs 5 4000 28.json 33.json 37.json powders.json seconds=600
//! ```
//!
//! (`make published-experiment`. With fewer connections than trainings, some wait for others' spoons.)
//!
//! `published` is the `paper` preset with its recurrent network, `feed-forward` the same with a
//! feed-forward network of the same width, `ours` our own preset without its surrogate. The spoons of
//! a training's round are simulated on the card, those of all trainings at once; each training makes
//! one update for each step as published (`ours` ten), with FLIP's own gradients: of a recurrent network
//! on one core, of another on the card. A round has `round=32` episodes, where the publication has one:
//! that is the difference.
//!
//! Trainings stop after `seconds`, and go on from the folder `runs` when called again. Once all have
//! ended, their policies weigh all powders on the card, `repeats=20` doses for each powder and target,
//! with parameter sets that no training saw. Prints the table, and writes runs/STUDY.svg: the
//! training error, mean and standard deviation over the seeds.

use flip_bench::rig::{Simulation, Task, simulate_from};
use flip_bench::weigh::{Accuracy, Order};
use flip_core::domain::seed::derive;
use flip_core::stats::summary::mean;
use flip_cuda::Card;
use flip_experiments::orders::{
    Run, TARGETS_MG, Weighed, of_all_orders, picture, read, tell, tell_differences,
};
use flip_learn::train::evaluate::{Contender, Dose, Plan, Weighing, evaluate};
use flip_learn::train::{
    Event, Gradients, Level, Network, Preset, Settings, Start, TrainError, train_beside,
};
use flip_policy::{self as policy, Controller, Paced};
use flip_sim::batch::{Engine, Failed, Place, side_by_side};
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::Instant;

/// Other spoonfuls that are tried for a dose whose own breaks down.
const SPOONFULS: u64 = 3;

/// The trainings that a study compares, by name.
fn study(name: &str, episodes: u32, seed: u64, round: u32) -> anyhow::Result<Vec<Training>> {
    let preset = match name {
        "published" | "feed-forward" => Preset::Paper,
        "ours" => Preset::Flip,
        other => anyhow::bail!("there is no study `{other}`: published, feed-forward, ours"),
    };
    let training = |(order, settings): (String, Settings)| {
        let network = if name == "feed-forward" { Network::FeedForward } else { settings.network };
        let settings = Settings {
            network,
            gradients: Gradients::Fused,
            episodes_per_round: round,
            rounds_per_checkpoint: 8,
            ..settings
        };
        Ok(Training { order, seed, settings: settings.checked()? })
    };
    of_all_orders(preset, episodes, seed).into_iter().map(training).collect()
}

/// One of them.
struct Training {
    order: String,
    seed: u64,
    settings: Settings,
}

/// What is known of a training that has not ended, beside its checkpoint.
#[derive(Default, Serialize, Deserialize)]
struct Course {
    /// Absolute error of each episode, mg.
    errors_mg: Vec<f64>,
    /// Time that it took, s.
    seconds: f64,
}

impl Training {
    fn file(&self, folder: &Path, ending: &str) -> PathBuf {
        folder.join(format!("{}-{}.{ending}", self.order, self.seed))
    }

    /// Trains until the end or until the time is up; whether it has ended.
    fn go_on(&self, levels: &[Level], folder: &Path, until: Instant) -> anyhow::Result<bool> {
        let [policy, checkpoint, course] =
            ["safetensors", "checkpoint", "json"].map(|ending| self.file(folder, ending));
        if policy.exists() {
            return Ok(true);
        }
        let known = checkpoint.exists().then(|| std::fs::read(&checkpoint)).transpose()?;
        let mut so_far: Course = match known.is_some() {
            true => serde_json::from_slice(&std::fs::read(&course)?)?,
            false => Course::default(),
        };
        let (began, before_s) = (Instant::now(), so_far.seconds);
        let card = Card::open(0)?;
        let keep = |so_far: &Course, bytes: &[u8]| -> anyhow::Result<()> {
            let seconds = before_s + began.elapsed().as_secs_f64();
            let errors_mg = so_far.errors_mg.clone();
            whole(&course, &serde_json::to_vec(&Course { errors_mg, seconds })?)?;
            whole(&checkpoint, bytes)
        };
        let mut kept = Ok(());
        let trained = train_beside(
            &card,
            levels,
            &self.settings,
            known.as_deref().map_or(Start::Nothing, Start::Checkpoint),
            &|| ControlFlow::Continue(()),
            |event| {
                match event {
                    Event::Episode(episode) => {
                        // Those since the checkpoint are played again.
                        so_far.errors_mg.truncate(episode.index as usize);
                        so_far.errors_mg.push(episode.final_error_mg);
                    }
                    Event::Checkpoint(bytes) => {
                        kept = keep(&so_far, &bytes);
                        self.say(&so_far);
                    }
                    Event::Kept { .. } => (),
                }
                // At the end of a round, so that none is lost.
                match Instant::now() < until && kept.is_ok() {
                    true => ControlFlow::Continue(()),
                    false => ControlFlow::Break(()),
                }
            },
        );
        match trained {
            Ok(trained) => {
                so_far.seconds = before_s + began.elapsed().as_secs_f64();
                whole(&course, &serde_json::to_vec(&so_far)?)?;
                whole(&policy, &trained.artifact)?;
                self.say(&so_far);
                Ok(true)
            }
            Err(TrainError::Stopped { checkpoint }) => {
                kept?;
                keep(&so_far, &checkpoint)?;
                self.say(&so_far);
                Ok(false)
            }
            Err(error) => Err(error.into()),
        }
    }

    fn say(&self, so_far: &Course) {
        let played = so_far.errors_mg.len();
        let last = mean(&so_far.errors_mg[played.saturating_sub(100)..]).unwrap_or(f64::NAN);
        eprintln!(
            "{}, seed {}: {played} episodes, the last 100 err by {last:.2} mg",
            self.order, self.seed
        );
    }

    /// What it found, once it has ended; its weighings are filled in by an evaluation.
    fn run(&self, folder: &Path, weighed: Run, study: &str) -> anyhow::Result<Run> {
        let course: Course = serde_json::from_slice(&std::fs::read(self.file(folder, "json"))?)?;
        let artifact = std::fs::read(self.file(folder, "safetensors"))?;
        Ok(Run {
            study: study.to_owned(),
            name: self.order.clone(),
            seed: self.seed,
            episodes: self.settings.episodes,
            curve_mg: Run::curve(&course.errors_mg),
            switches: policy::decode(&artifact)?.manifest.switches,
            seconds: course.seconds,
            ..weighed
        })
    }
}

/// Writes a file so that it is there whole or not at all.
fn whole(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let beside = path.with_extension("new");
    std::fs::write(&beside, bytes)?;
    Ok(std::fs::rename(beside, path)?)
}

/// The name of a training's policy in an evaluation.
fn contender(training: &Training) -> String {
    format!("{} {}", training.order, training.seed)
}

/// Weighs with all policies, and with the shipped rules, side by side on a card.
fn weigh(
    trainings: &[Training],
    powders: &[Weighed],
    folder: &Path,
    repeats: u32,
) -> anyhow::Result<Vec<Run>> {
    let Some(Training { settings, .. }) = trainings.first() else { return Ok(Vec::new()) };
    let mut contenders = Vec::new();
    for training in trainings {
        let artifact = std::fs::read(training.file(folder, "safetensors"))?;
        let controller = policy::decode(&artifact)?.controller;
        contenders.push(Contender { name: contender(training), controller });
    }
    let rules = "the shipped rules".to_owned();
    contenders
        .push(Contender { name: rules.clone(), controller: Controller::Paced(Paced::CHOSEN) });
    let plan = Plan {
        contenders,
        subjects: powders.iter().map(|powder| powder.subject.clone()).collect(),
        targets_mg: TARGETS_MG.to_vec(),
        repeats,
        seed: 1,
    };
    let card = Card::open(0)?;
    let dose = |of: &Weighing<'_>, seed: u64, place: &mut Place| -> Result<Dose, String> {
        let readability_mg = settings.balance.readability_mg;
        let task = Task {
            order: Order {
                target_mg: of.target_mg,
                tolerance_lower_mg: 0.0,
                tolerance_upper_mg: 0.0,
                readability_mg,
            },
            accuracy: Accuracy::default(),
            controller: of.contender.controller.clone(),
            rules: settings.rules,
        };
        let (spoon, balance) = (settings.spoon, settings.balance);
        let simulation = Simulation { set: *of.set, spoon, balance, seed };
        let seat = place.settle(simulation.loose(&task.rules)).map_err(|Failed(why)| why)?;
        let mut go_on = |_: &flip_bench::weigh::Event<'_>| ControlFlow::Continue(());
        let poured = simulate_from(seat, &task, &simulation, &mut go_on, &AtomicBool::new(false));
        let why = || poured.error.clone().unwrap_or_default();
        Ok(Dose {
            dispensed_mg: poured.dispensed_mg.ok_or_else(why)?,
            reading_mg: poured.reading_mg.ok_or_else(why)?,
            shakes: poured.shakes,
            seconds: poured.seconds,
        })
    };
    // Of a powder at the edge of what the simulator can compute, now and then a spoonful breaks down.
    let again = AtomicU32::new(0);
    let dose = |of: &Weighing<'_>, place: &mut Place| {
        let mut found = dose(of, of.seed, place);
        for other in 1..=SPOONFULS {
            let Err(why) = &found else { break };
            let set = of.set.id();
            eprintln!(
                "{}, {} mg of {} ({set}): {why}",
                of.contender.name, of.target_mg, of.subject.powder
            );
            again.fetch_add(1, Ordering::Relaxed);
            found = dose(of, derive(of.seed, &[other]), place);
        }
        found
    };
    let found = evaluate(&plan, |weighings| {
        let mut batch = card.batch(card.places().min(weighings.len()))?;
        let mut doses = vec![None; weighings.len()];
        let procedure = |k: usize, place: &mut Place| dose(&weighings[k], place);
        let mut each = |k: usize, found| {
            doses[k] = Some(found);
            ControlFlow::Continue(())
        };
        side_by_side(&mut *batch, weighings.len(), procedure, &mut each)?;
        let all = doses.into_iter().map(|dose| dose.unwrap_or(Err("not weighed".to_owned())));
        all.collect::<Result<Vec<Dose>, String>>().map_err(anyhow::Error::msg)
    })?;
    let (again, all) = (again.into_inner(), found.trials.len());
    println!(
        "{again} of {all} doses were weighed with another spoonful, because the first broke down"
    );
    let run = |training: &Training| Run::of(&found, &contender(training));
    let mut runs: Vec<Run> = trainings.iter().map(run).collect();
    runs.push(Run { name: rules.clone(), ..Run::of(&found, &rules) });
    Ok(runs)
}

fn main() -> anyhow::Result<()> {
    let (options, arguments): (Vec<String>, Vec<String>) =
        std::env::args().skip(1).partition(|it| it.contains('='));
    let [name, folder, seeds, episodes, files @ ..] = arguments.as_slice() else {
        anyhow::bail!(
            "published_experiment STUDY FOLDER SEEDS EPISODES SETS.json… [seconds=600] [round=32] [repeats=20]"
        );
    };
    let option = |name: &str, default: u32| -> anyhow::Result<u32> {
        let given = options.iter().find_map(|it| it.strip_prefix(name)?.strip_prefix('='));
        given.map_or(Ok(default), |number| Ok(number.parse()?))
    };
    let (seeds, episodes): (u64, u32) = (seeds.parse()?, episodes.parse()?);
    let (seconds, round) = (option("seconds", u32::MAX)?, option("round", 32)?);
    let repeats = option("repeats", 20)?;
    if let Err(reason) = flip_cuda::find(0) {
        println!("skipped: {reason}");
        return Ok(());
    }
    let until = Instant::now() + std::time::Duration::from_secs(seconds.into());
    let folder = Path::new(folder);
    std::fs::create_dir_all(folder)?;
    let on_powders = (name == "ours").then_some(&["sand", "sugar", "salt"][..]);
    let (levels, powders) = read(files, on_powders)?;
    let mut trainings = Vec::new();
    for seed in 1..=seeds {
        trainings.extend(study(name, episodes, seed, round)?);
    }
    let (began, levels) = (Instant::now(), Arc::new(levels));
    let ended: Vec<anyhow::Result<bool>> = std::thread::scope(|scope| {
        let go_on = |training| {
            let levels = levels.clone();
            scope.spawn(move || Training::go_on(training, &levels, folder, until))
        };
        let threads: Vec<_> = trainings.iter().map(go_on).collect();
        let join = |thread: std::thread::ScopedJoinHandle<'_, _>| {
            thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
        };
        threads.into_iter().map(join).collect()
    });
    let ended = ended.into_iter().collect::<anyhow::Result<Vec<bool>>>()?;
    println!("{:.0} s of training in this piece", began.elapsed().as_secs_f64());
    let missing = ended.iter().filter(|ended| !**ended).count();
    if missing > 0 {
        println!("{missing} of {} trainings go on when this is called again", ended.len());
        return Ok(());
    }
    let began = Instant::now();
    let mut weighed = weigh(&trainings, &powders, folder, repeats)?;
    println!("{:.0} s of weighing", began.elapsed().as_secs_f64());
    let rules = weighed.pop();
    let mut runs = Vec::new();
    for (training, weighed) in trainings.iter().zip(weighed) {
        runs.push(training.run(folder, weighed, name)?);
    }
    let orders = of_all_orders(Preset::Paper, episodes, 1);
    let mut names: Vec<String> = orders.into_iter().map(|(order, _)| order).collect();
    whole(&folder.join(format!("{name}.svg")), picture(&names, &runs, episodes).as_bytes())?;
    let lines: Result<Vec<String>, _> = runs.iter().map(serde_json::to_string).collect();
    whole(&folder.join(format!("{name}.jsonl")), (lines?.join("\n") + "\n").as_bytes())?;
    if let Some(rules) = rules {
        names.push(rules.name.clone());
        runs.push(rules);
    }
    tell(&names, &runs);
    tell_differences(&names, &runs);
    let total: f64 = runs.iter().map(|run| run.seconds).sum();
    println!("{total:.0} s of all trainings, one after the other");
    Ok(())
}
