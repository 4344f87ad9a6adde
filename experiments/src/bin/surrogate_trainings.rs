//! The effect of a setting on a training: several seeds of each on the surrogate spoon, where four
//! thousand episodes take minutes.
//!
//! ```text
//! for angle in 28 33 37; do flip calibrate --repose-deg $angle --method sequential --json > $angle.json; done
//! flip calibrate --powder all --json > powders.json
//! cargo experiment surrogate_trainings -- orders runs.jsonl 5 4000 28.json 33.json 37.json powders.json
//! ```
//!
//! `STUDY:NAME,NAME` runs only those trainings of it. Studies: `orders`, the four published orders
//! with the settings of the `paper` preset; `orders-feed-forward`, the same with a feed-forward
//! network of the same width; `orders-one-spoonful`, that again with identical spoonfuls of a
//! powder; `gains`, our own settings, and each of them reverted alone.
//!
//! Orders are trained on bare angles, gains on sand, sugar and salt. All powders are weighed, with
//! parameter sets that no training saw: on the surrogate spoon, 40 doses for each powder and
//! target. Each run appends its line to runs.jsonl when it ends; runs already in it are not
//! repeated, so the example can be stopped and restarted. Prints the table, and writes runs.svg
//! next to runs.jsonl: the training error, mean over the seeds.

use flip_core::domain::bench::Action;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_experiments::orders::{Run, TARGETS_MG, Weighed, of_all_orders, picture, read, tell};
use flip_learn::train::environment::{Filling, Spoon, play};
use flip_learn::train::evaluate::{Contender, Dose, Evaluation, Plan, Weighing, evaluate};
use flip_learn::train::{
    Event, Level, Network, Order, Preset, Replayed, Settings, Start, Surrogate, train_on,
};
use flip_policy::{
    self as policy, Actor, Carried, Controller, Dispenser, Encoding, Paced, Response, Rules,
};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Mutex;
use std::time::Instant;

/// Doses of a policy for each powder and target.
const REPEATS: u32 = 40;
/// Powders in our own trainings.
const POWDERS: [&str; 3] = ["sand", "sugar", "salt"];

/// A comparison: named settings, each trained with several seeds.
struct Study {
    trainings: Vec<(String, Settings)>,
    /// How much spoonfuls of one powder differ: 1 as much as simulated ones, 0 not at all.
    spread: f64,
    /// Trained on bare angles; otherwise on powders.
    on_angles: bool,
}

/// The settings that a study compares.
fn study(name: &str, episodes: u32, seed: u64) -> anyhow::Result<Study> {
    let orders = |preset, change: fn(&mut Settings)| {
        let mut all = of_all_orders(preset, episodes, seed);
        all.iter_mut().for_each(|(_, settings)| change(settings));
        all
    };
    let feed_forward: fn(&mut Settings) = |settings| settings.network = Network::FeedForward;
    let spread = if name == "orders-one-spoonful" { 0.0 } else { 1.0 };
    let trainings = match name {
        "orders" => orders(Preset::Paper, |_| ()),
        "orders-feed-forward" | "orders-one-spoonful" => orders(Preset::Paper, feed_forward),
        "orders-ours" => orders(Preset::Flip, |_| ()),
        "gains" => {
            let ours = Settings::of(Preset::Flip, Order::Curriculum, seed);
            let updates_per_step = ours.surrogate_updates_per_step;
            gains(&Settings { episodes, updates_per_step, box_share: 0.0, ..ours })
        }
        other => anyhow::bail!(
            "there is no study `{other}`: orders, orders-feed-forward, orders-one-spoonful, orders-ours, gains"
        ),
    };
    // A fresh spoonful for each episode, as on a robot.
    let fresh = |(name, settings)| (name, Settings { fills_per_set: 1000, ..settings });
    let trainings = trainings.into_iter().map(fresh).collect();
    Ok(Study { trainings, spread, on_angles: name.starts_with("orders") })
}

/// These settings, and each of them changed alone.
fn gains(base: &Settings) -> Vec<(String, Settings)> {
    let recurrent = |replayed, relabel_share| Settings {
        network: Network::Recurrent { replayed },
        batch: 16,
        relabel_share,
        ..base.clone()
    };
    let with = |change: &dyn Fn(&mut Settings)| {
        let mut settings = base.clone();
        change(&mut settings);
        settings
    };
    let all = [
        ("ours", base.clone()),
        ("at most 30 steps", with(&|s| s.rules.steps_max = 30)),
        ("pitch up to 36 deg", with(&|s| s.rules.pitch = Rules::PAPER.pitch)),
        ("without the last fall", with(&|s| s.encoding = Encoding::Missing)),
        ("with the angle of repose", with(&|s| s.encoding = Encoding::FallAndRepose)),
        ("batches of 16", with(&|s| s.batch = 16)),
        ("four times the updates", with(&|s| s.updates_per_step *= 4.0)),
        ("one episode at a time", with(&|s| s.episodes_per_round = 1)),
        ("an overdose counts once", with(&|s| s.overdose_factor = 1.0)),
        ("an overdose counts four times", with(&|s| s.overdose_factor = 4.0)),
        ("without hindsight", with(&|s| s.relabel_share = 0.0)),
        ("an ending counts as one step", with(&|s| s.absorbing_ending = false)),
        ("discount 0.99", with(&|s| s.gamma = 0.99)),
        ("learning rate 1e-3", with(&|s| s.learning_rate = 1e-3)),
        ("learning rate 1e-4", with(&|s| s.learning_rate = 1e-4)),
        ("a quarter of the episodes from the box", with(&|s| s.box_share = 0.25)),
        ("random order", with(&|s| s.order = Order::Random)),
        ("recurrent, whole episodes", recurrent(Replayed::Episodes, base.relabel_share)),
        ("recurrent, whole episodes, without hindsight", recurrent(Replayed::Episodes, 0.0)),
        ("recurrent, stored states, without hindsight", recurrent(Replayed::StoredState, 0.0)),
    ];
    all.into_iter().map(|(name, settings)| (name.to_owned(), settings)).collect()
}

/// A weighing by the mean of a policy, or by actions sampled from it.
enum Weigher<'a> {
    Centre(&'a Controller),
    Drawn(&'a Actor),
}

/// One dose from a surrogate spoon, with steps and ending by the rules.
fn dose(
    weigher: &Weigher<'_>,
    settings: &Settings,
    spoon: &mut impl Spoon,
    repose_deg: f64,
    target_mg: f64,
    seed: u64,
) -> Dose {
    let (rules, readability_mg) = (&settings.rules, settings.balance.readability_mg);
    let mut shakes = 0;
    let mut count = |unit: [f32; 2]| {
        shakes += u32::from(Action::from_unit(unit.map(f64::from)).executed_shake_mm() > 0.0);
        unit
    };
    let played = match weigher {
        Weigher::Centre(controller) => {
            let mut dosing = controller.begin(rules, readability_mg).knowing(Some(repose_deg));
            play(spoon, rules, &settings.balance, target_mg, seed, |seen| {
                count(dosing.propose(seen).to_unit().map(|x| x as f32))
            })
        }
        Weigher::Drawn(actor) => {
            let mut carried = Carried { repose_deg: Some(repose_deg), ..actor.begin() };
            let mut rng = Pcg64Mcg::seed_from_u64(derive(seed, &[2]));
            play(spoon, rules, &settings.balance, target_mg, seed, |seen| {
                count(actor.sample(seen, &mut carried, &mut rng))
            })
        }
    };
    Dose { dispensed_mg: played.dispensed_mg, reading_mg: played.reading_mg, shakes, seconds: 0.0 }
}

/// Evaluates a controller on these powders; `drawn` with sampled actions, if it is learned.
fn weigh(
    controller: &Controller,
    powders: &[Weighed],
    settings: &Settings,
    spread: f64,
    drawn: bool,
) -> anyhow::Result<Evaluation> {
    let filling = Surrogate { spread, ..Surrogate::new(settings.rules.pitch) };
    let plan = Plan {
        contenders: vec![Contender { name: String::new(), controller: controller.clone() }],
        subjects: powders.iter().map(|powder| powder.subject.clone()).collect(),
        targets_mg: TARGETS_MG.to_vec(),
        repeats: REPEATS,
        seed: 1,
    };
    let repose_deg = |set: &ParameterSet| {
        let powder = powders.iter().find(|powder| powder.subject.sets.contains(set));
        powder.map_or(0.0, |powder| powder.repose_deg)
    };
    let weigher = match controller {
        Controller::Learned(actor) if drawn => Weigher::Drawn(actor),
        _ => Weigher::Centre(controller),
    };
    let once = |&Weighing { set, target_mg, seed, .. }: &Weighing<'_>| {
        let spoon = &mut filling.fill(set, seed);
        dose(&weigher, settings, spoon, repose_deg(set), target_mg, seed)
    };
    evaluate(&plan, |weighings| Ok(weighings.par_iter().map(once).collect()))
}

/// Trains with these settings, and weighs.
fn run(
    levels: &[Level],
    powders: &[Weighed],
    settings: &Settings,
    spread: f64,
) -> anyhow::Result<Run> {
    let started = Instant::now();
    let mut errors = Vec::new();
    let filling = Surrogate { spread, ..Surrogate::new(settings.rules.pitch) };
    let trained = train_on(
        &filling,
        levels,
        settings,
        Start::Nothing,
        &|| ControlFlow::Continue(()),
        |event| {
            if let Event::Episode(episode) = event {
                errors.push(episode.final_error_mg);
            }
            ControlFlow::Continue(())
        },
    )?;
    let seconds = started.elapsed().as_secs_f64();
    let controller = policy::decode(&trained.artifact)?.controller;
    let found = weigh(&controller, powders, settings, spread, false)?;
    let drawn = weigh(&controller, powders, settings, spread, true)?;
    Ok(Run {
        curve_mg: Run::curve(&errors),
        switches: trained.manifest.switches,
        drawn_mg: drawn.summary[0].mae_mg,
        seconds,
        ..Run::of(&found, "")
    })
}

/// The rules and the dispenser, which do not learn, on the doses of our trainings.
fn references(powders: &[Weighed], settings: &Settings) -> anyhow::Result<Vec<Run>> {
    let all = [
        ("the shipped rules", Controller::Paced(Paced::CHOSEN)),
        ("the dispenser", Controller::Dispenser(Dispenser::new(Response::FITTED))),
    ];
    let weighed = |(name, controller): &(&str, Controller)| {
        let found = weigh(controller, powders, settings, 1.0, false)?;
        let drawn_mg = found.summary[0].mae_mg;
        Ok(Run { name: (*name).to_owned(), drawn_mg, ..Run::of(&found, "") })
    };
    all.iter().map(weighed).collect()
}

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [name, out, seeds, episodes, files @ ..] = arguments.as_slice() else {
        anyhow::bail!("surrogate_trainings STUDY RUNS.jsonl SEEDS EPISODES SETS.json…");
    };
    let (seeds, episodes): (u64, u32) = (seeds.parse()?, episodes.parse()?);
    let (name, only) =
        name.split_once(':').map_or((name.as_str(), None), |(name, only)| (name, Some(only)));
    let on_powders = (!study(name, episodes, 1)?.on_angles).then_some(&POWDERS[..]);
    let (levels, powders) = read(files, on_powders)?;
    let known = std::fs::read_to_string(out).unwrap_or_default();
    let mut runs: Vec<Run> = known.lines().map(serde_json::from_str).collect::<Result<_, _>>()?;
    runs.retain(|run| run.study == name && run.episodes == episodes && run.seed <= seeds);
    let mut missing = Vec::new();
    for seed in 1..=seeds {
        let Study { trainings, spread, .. } = study(name, episodes, seed)?;
        let is_new = |training: &(String, Settings)| {
            !runs.iter().any(|run| run.seed == seed && run.name == training.0)
        };
        let is_asked = |training: &(String, Settings)| {
            only.is_none_or(|only| only.split(',').any(|name| name == training.0))
        };
        let trainings = trainings.into_iter().filter(is_new).filter(is_asked);
        missing.extend(trainings.map(|(training, settings)| (training, settings, spread)));
    }
    let file = Mutex::new(std::fs::File::options().create(true).append(true).open(out)?);
    let new: Vec<Run> = missing
        .into_par_iter()
        .map(|(training, settings, spread)| {
            let settings = settings.checked()?;
            let found = run(&levels, &powders, &settings, spread)?;
            let run = Run {
                study: name.to_owned(),
                name: training,
                seed: settings.seed,
                episodes,
                ..found
            };
            let line = serde_json::to_string(&run)?;
            writeln!(file.lock().unwrap_or_else(|broken| broken.into_inner()), "{line}")?;
            eprintln!(
                "{}, seed {}: {:.2} mg in {:.0} s",
                run.name, run.seed, run.mae_all_mg, run.seconds
            );
            Ok(run)
        })
        .collect::<anyhow::Result<_>>()?;
    runs.extend(new);
    let Study { trainings, on_angles, .. } = study(name, episodes, 1)?;
    let mut names: Vec<String> = trainings.iter().map(|(training, _)| training.clone()).collect();
    if on_angles {
        std::fs::write(Path::new(out).with_extension("svg"), picture(&names, &runs, episodes))?;
    } else {
        let others = references(&powders, &trainings[0].1)?;
        names.extend(others.iter().map(|run| run.name.clone()));
        runs.extend(others);
    }
    tell(&names, &runs);
    Ok(())
}
