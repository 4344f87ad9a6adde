//! What the order of the powders does to a training: the four published orders, several seeds each, on the surrogate spoon.
//!
//! ```text
//! for angle in 28 33 37; do flip calibrate --repose-deg $angle --method sequential --json > $angle.json; done
//! flip calibrate --powder all --json > powders.json
//! cargo run --release --example orderings -- runs.jsonl 5 4000 feed-forward 28.json 33.json 37.json powders.json
//! ```
//!
//! Bare angles are trained on, powders are weighed: on the surrogate spoon 40 doses for each powder and 10, 15 and 20 mg. The settings are those of the
//! `paper` preset, with its `recurrent` network or with a `feed-forward` one of the same width. Each run adds its line to runs.jsonl when it
//! ends; runs that are in it are not repeated, so it can be stopped and called again. Prints the table, and beside runs.jsonl it writes
//! runs.svg: the training error, mean over the seeds.

use flip::domain::bench::PitchLimits;
use flip::domain::parameters::ParameterSet;
use flip::domain::seed::derive;
use flip::policy::{self, Controller, Episode, Observation, Rules};
use flip::sim::balance;
use flip::stats::summary::{mean, sd};
use flip::train::environment::{Filling, Spoon};
use flip::train::evaluate::{Contender, Dose, Plan, Subject, evaluate};
use flip::train::{Event, Level, Network, Order, Preset, Replayed, Settings, Surrogate, train};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Mutex;

/// Doses of a policy for each powder and target.
const REPEATS: u32 = 40;
/// Targets, mg.
const TARGETS_MG: [f64; 3] = [10.0, 15.0, 20.0];
/// Episodes whose errors make one point of a curve.
const WINDOW: usize = 100;
/// The orders as they are called, with their colours.
const ORDERS: [(Order, &str, &str); 4] = [
    (Order::Curriculum, "curriculum", "#0b7a75"),
    (Order::Random, "random", "#5b6c8f"),
    (Order::DomainRandomisation, "domain-randomisation", "#c77d0a"),
    (Order::Reverse, "reverse", "#a4243b"),
];

/// What this program reads of the document of `flip calibrate`.
#[derive(Deserialize)]
struct Calibrated {
    powders: Vec<Powder>,
}

#[derive(Deserialize)]
struct Powder {
    /// Empty where an angle was calibrated, not a powder.
    powder: String,
    target_deg: f64,
    sets: Vec<Set>,
}

#[derive(Deserialize)]
struct Set {
    parameters: ParameterSet,
}

/// A training and how its policy weighs.
#[derive(Serialize, Deserialize)]
struct Run {
    order: String,
    seed: u64,
    network: String,
    episodes: u32,
    /// Mean absolute error of each [`WINDOW`] episodes, exploring, mg.
    curve_mg: Vec<f64>,
    /// Episodes at which the level changed, and why.
    switches: Vec<policy::Switch>,
    /// Mean absolute error of the policy by powder, mg.
    mae_mg: BTreeMap<String, f64>,
    /// Over all doses, mg.
    mae_all_mg: f64,
    /// Share of all doses more than 1 mg too high.
    over_share: f64,
}

/// One dose from a surrogate spoon, steps and ending as the rules have them.
fn dose(controller: &Controller, rules: &Rules, set: &ParameterSet, target_mg: f64, seed: u64) -> Dose {
    let mut spoon = Surrogate { pitch: PitchLimits::PAPER }.fill(set, seed);
    let balance = balance::Settings::default();
    let mut dosing = controller.begin(rules, balance.readability_mg);
    let (mut reading_mg, mut shakes) = (0.0, 0);
    for step in 0.. {
        let seen = Observation { reading_mg, target_mg, pitch_deg: spoon.pitch_deg() };
        if rules.after(step, &seen, balance.readability_mg) != Episode::Running {
            break;
        }
        let action = dosing.propose(&seen);
        let before_mg = spoon.vial_mg();
        spoon.step(action);
        reading_mg = balance.read(before_mg, spoon.vial_mg(), derive(seed, &[1]), step.into()).mass_mg;
        shakes += u32::from(action.executed_shake_mm() > 0.0);
    }
    Dose { dispensed_mg: spoon.vial_mg(), reading_mg, shakes, seconds: 0.0 }
}

fn run(levels: &[Level], powders: &[Subject], settings: &Settings, name: &str, network: &str) -> anyhow::Result<Run> {
    let mut errors = Vec::new();
    let trained = train(levels, settings, None, &|| ControlFlow::Continue(()), |event| {
        if let Event::Episode(episode) = event {
            errors.push(episode.final_error_mg);
        }
        ControlFlow::Continue(())
    })?;
    let weighed = policy::decode(&trained.artifact)?;
    let plan = Plan {
        contenders: vec![Contender { name: name.to_owned(), controller: weighed.controller }],
        subjects: powders.to_vec(),
        targets_mg: TARGETS_MG.to_vec(),
        repeats: REPEATS,
        seed: 1,
    };
    let rules = weighed.manifest.rules;
    let found =
        evaluate(&plan, |controller, set, target_mg, seed| anyhow::Ok(dose(controller, &rules, set, target_mg, seed)))?;
    let of = |powder: &str| {
        let rows: Vec<f64> = found.rows.iter().filter(|row| row.powder == powder).map(|row| row.mae_mg).collect();
        mean(&rows).unwrap_or(0.0)
    };
    Ok(Run {
        order: name.to_owned(),
        seed: settings.seed,
        network: network.to_owned(),
        episodes: settings.episodes,
        curve_mg: errors.chunks(WINDOW).filter_map(mean).collect(),
        switches: trained.manifest.switches,
        mae_mg: powders.iter().map(|p| (p.powder.clone(), of(&p.powder))).collect(),
        mae_all_mg: found.summary[0].mae_mg,
        over_share: found.summary[0].over_share,
    })
}

/// Mean and standard deviation over the seeds.
fn over_seeds(values: &[f64]) -> String {
    format!("{:.2} ± {:.2}", mean(values).unwrap_or(0.0), sd(values).unwrap_or(0.0))
}

fn tell(runs: &[Run]) {
    let powders: Vec<&String> =
        runs.iter().flat_map(|run| run.mae_mg.keys()).collect::<std::collections::BTreeSet<_>>().into_iter().collect();
    let names: Vec<&str> = powders.iter().map(|powder| powder.as_str()).collect();
    println!("| order | seeds | last {WINDOW} episodes mg | policy mg | {} | over % |", names.join(" | "));
    println!("|{}", "---|".repeat(5 + names.len()));
    for (_, order, _) in ORDERS {
        let of: Vec<&Run> = runs.iter().filter(|run| run.order == order).collect();
        let each = |value: &dyn Fn(&Run) -> f64| over_seeds(&of.iter().map(|run| value(run)).collect::<Vec<_>>());
        let by_powder: Vec<String> = powders.iter().map(|powder| each(&|run| run.mae_mg[*powder])).collect();
        println!(
            "| {order} | {} | {} | {} | {} | {} |",
            of.len(),
            each(&|run| run.curve_mg.last().copied().unwrap_or(0.0)),
            each(&|run| run.mae_all_mg),
            by_powder.join(" | "),
            each(&|run| 100.0 * run.over_share)
        );
    }
}

/// The training error over the episodes, mean over the seeds, as SVG.
fn picture(runs: &[Run], episodes: u32) -> String {
    let (wide, high, top_mg) = (600.0, 260.0, 12.0);
    let mut svg = "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 820 320\" font-family=\"sans-serif\" font-size=\"13\">\n\
                   <title>Training error over the episodes, mg, mean over the seeds</title>\n"
        .to_owned();
    for mg in [0, 3, 6, 9, 12] {
        let y = 20.0 + high * (1.0 - f64::from(mg) / top_mg);
        svg += &format!(
            "<path d=\"M50 {y:.1}h{wide}\" stroke=\"#ccc\"/><text x=\"42\" y=\"{:.1}\" text-anchor=\"end\">{mg}</text>\n",
            y + 4.0
        );
    }
    for (k, (_, order, colour)) in ORDERS.into_iter().enumerate() {
        let curves: Vec<&Vec<f64>> = runs.iter().filter(|run| run.order == order).map(|run| &run.curve_mg).collect();
        let points = curves.iter().map(|curve| curve.len()).min().unwrap_or(0);
        let line: Vec<String> = (0..points)
            .map(|k| {
                let mg = mean(&curves.iter().map(|curve| curve[k]).collect::<Vec<_>>()).unwrap_or(0.0);
                let x = 50.0 + wide * ((k as f64 + 0.5) * WINDOW as f64 / f64::from(episodes)).min(1.0);
                format!("{x:.1},{:.1}", 20.0 + high * (1.0 - (mg / top_mg).min(1.0)))
            })
            .collect();
        svg += &format!(
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>\n",
            line.join(" ")
        );
        svg += &format!("<text x=\"660\" y=\"{}\" fill=\"{colour}\">{order}</text>\n", 40 + 20 * k);
    }
    svg + &format!(
        "<text x=\"50\" y=\"300\">0</text><text x=\"650\" y=\"300\" text-anchor=\"end\">{episodes} episodes</text>\n<text transform=\"translate(14 150) rotate(-90)\" text-anchor=\"middle\">error mg</text>\n</svg>\n"
    )
}

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [out, seeds, episodes, network, files @ ..] = arguments.as_slice() else {
        anyhow::bail!("orderings RUNS.jsonl SEEDS EPISODES feed-forward|recurrent SETS.json…");
    };
    let (seeds, episodes): (u64, u32) = (seeds.parse()?, episodes.parse()?);
    let kind = match network.as_str() {
        "feed-forward" => Network::FeedForward,
        "recurrent" => Network::Recurrent { replayed: Replayed::StoredState },
        other => anyhow::bail!("there is no network `{other}`: feed-forward, recurrent"),
    };
    let (mut levels, mut powders) = (Vec::new(), Vec::new());
    for file in files {
        let calibrated: Calibrated = serde_json::from_slice(&std::fs::read(file)?)?;
        for found in calibrated.powders {
            let sets: Vec<ParameterSet> = found.sets.into_iter().map(|set| set.parameters).collect();
            match found.powder.as_str() {
                "" => levels.push(Level {
                    powder: format!("repose_{}", found.target_deg),
                    repose_deg: found.target_deg,
                    sets: sets[..sets.len().min(7)].to_vec(),
                }),
                _ => powders.push(Subject { powder: found.powder, sets }),
            }
        }
    }
    anyhow::ensure!(!levels.is_empty() && !powders.is_empty(), "name files with bare angles and a file with powders");
    let known = std::fs::read_to_string(out).unwrap_or_default();
    let mut runs: Vec<Run> = known.lines().map(serde_json::from_str).collect::<Result<_, _>>()?;
    runs.retain(|run| run.network == *network && run.episodes == episodes && run.seed <= seeds);
    let missing: Vec<(u64, Order, &str)> = (1..=seeds)
        .flat_map(|seed| ORDERS.map(|(order, name, _)| (seed, order, name)))
        .filter(|(seed, _, name)| !runs.iter().any(|run| run.seed == *seed && run.order == *name))
        .collect();
    let file = Mutex::new(std::fs::File::options().create(true).append(true).open(out)?);
    let new: Vec<Run> = missing
        .into_par_iter()
        .map(|(seed, order, name)| {
            let mut settings = Settings::of(Preset::Paper, order, seed);
            (settings.episodes, settings.surrogate_episodes, settings.network) = (episodes, episodes, kind);
            let run = run(&levels, &powders, &settings.checked()?, name, network)?;
            let line = serde_json::to_string(&run)?;
            writeln!(file.lock().unwrap_or_else(|broken| broken.into_inner()), "{line}")?;
            eprintln!("{name}, seed {seed}: {:.2} mg", run.mae_all_mg);
            Ok(run)
        })
        .collect::<anyhow::Result<_>>()?;
    runs.extend(new);
    tell(&runs);
    std::fs::write(Path::new(out).with_extension("svg"), picture(&runs, episodes))?;
    Ok(())
}
