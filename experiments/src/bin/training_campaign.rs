//! Trains and weighs from one JSON file, without database or service: for experiments, also on
//! other machines.
//!
//! ```text
//! cargo experiment training_campaign -- powders.json settings.json [policy.safetensors] > result.json
//! ```
//!
//! `powders.json` is a list of `{"powder", "repose_deg", "sets": [...nine parameters each],
//! "train": true|false}`; all of them are weighed, those marked `train` are trained on.
//! `settings.json` overrides fields of `train::Settings`, plus `preset`, `order`, `save`, and
//! `targets_mg`, `repeats`, `max_steps`, `rivals` (names), `response` (of the dispenser), `fuzzy`
//! and `paced` (rules), `evaluation_seed`, `trace` of the evaluation. With a third argument that
//! policy is weighed instead of a new one, with `"learn": false` none. With `checkpoint`, a file,
//! and `seconds` a training stops in time and the program exits with status 3; called again it
//! continues from that file. Progress goes to stderr.

use flip_bench::rig::{Poured, Simulation, Task, simulate};
use flip_bench::weigh::{Accuracy, Order};
use flip_core::domain::weighing::Outcome;
use flip_learn::train::evaluate::{Contender, Dose, Evaluation, Plan, Subject, Weighing, evaluate};
use flip_learn::train::{Event, Level, Preset, Settings, Start, TrainError, train};
use flip_policy::{
    self as policy, Controller, Dispenser, Fuzzy, Paced, Response, Rules, ScheduledStep,
};
use rayon::prelude::*;
use serde::Deserialize;
use serde_json::{Value, json};
use std::fmt::Write;
use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

#[derive(Deserialize)]
struct Powder {
    train: bool,
    #[serde(flatten)]
    level: Level,
}

/// Settings of the preset, with the fields in the file overridden.
fn settings(overrides: &Value) -> anyhow::Result<Settings> {
    let preset: Preset =
        serde_json::from_value(overrides.get("preset").cloned().unwrap_or(json!("flip")))?;
    let order: flip_learn::train::Order =
        serde_json::from_value(overrides.get("order").cloned().unwrap_or(json!("curriculum")))?;
    let mut value = serde_json::to_value(Settings::of(preset, order, 1))?;
    for (key, new) in overrides.as_object().into_iter().flatten() {
        if let Some(old) = value.get_mut(key) {
            *old = new.clone();
        }
    }
    // Omitted from the text at their default values.
    for key in ["surrogate_episodes", "surrogate_updates_per_step", "box_share"] {
        if let Some(new) = overrides.get(key) {
            value[key] = new.clone();
        }
    }
    Ok(serde_json::from_value::<Settings>(value)?.checked()?)
}

/// The dispenser's prior, with the fields in the file overridden.
fn response(overrides: &Value) -> anyhow::Result<Response> {
    let mut value = serde_json::to_value(Response::FITTED)?;
    for (key, new) in overrides.get("response").and_then(Value::as_object).into_iter().flatten() {
        value[key] = new.clone();
    }
    Ok(serde_json::from_value::<Response>(value)?.checked()?)
}

/// The fuzzy rules, with the fields in the file overridden.
fn fuzzy(overrides: &Value) -> anyhow::Result<Fuzzy> {
    let mut value = serde_json::to_value(Fuzzy::CHOSEN)?;
    for (key, new) in overrides.get("fuzzy").and_then(Value::as_object).into_iter().flatten() {
        value[key] = new.clone();
    }
    Ok(serde_json::from_value::<Fuzzy>(value)?.checked()?)
}

/// The paced rules, with the fields in the file overridden.
fn paced(overrides: &Value) -> anyhow::Result<Paced> {
    let mut value = serde_json::to_value(Paced::CHOSEN)?;
    for (key, new) in overrides.get("paced").and_then(Value::as_object).into_iter().flatten() {
        value[key] = new.clone();
    }
    Ok(serde_json::from_value::<Paced>(value)?.checked()?)
}

/// Trains on these levels and reports each episode; returns the policy's bytes, or none if the time
/// was up first.
fn learn(
    levels: &[Level],
    settings: &Settings,
    overrides: &Value,
) -> anyhow::Result<Option<Vec<u8>>> {
    let started = Instant::now();
    let path = overrides.get("checkpoint").and_then(Value::as_str);
    let seconds = overrides.get("seconds").and_then(Value::as_f64).unwrap_or(f64::INFINITY);
    let resume = path
        .filter(|path| std::fs::exists(path).unwrap_or(false))
        .map(std::fs::read)
        .transpose()?;
    let flow = || match started.elapsed().as_secs_f64() < seconds {
        true => ControlFlow::Continue(()),
        false => ControlFlow::Break(()),
    };
    let trained = train(
        levels,
        settings,
        resume.as_deref().map_or(Start::Nothing, Start::Checkpoint),
        &flow,
        |event| {
            if let Event::Episode(e) = event {
                let alpha = e.losses.map_or(f64::NAN, |l| l.alpha);
                let (s, error_mg) = (started.elapsed().as_secs_f64(), e.dispensed_mg - e.target_mg);
                let (index, powder, target_mg, steps) = (e.index, e.powder, e.target_mg, e.steps);
                eprintln!(
                    "{s:7.1}s {index:4} {powder:8} target {target_mg:5.2} error {error_mg:6.2} steps {steps:2} alpha {alpha:.4}"
                );
            }
            ControlFlow::Continue(())
        },
    );
    match (trained, path) {
        (Err(TrainError::Stopped { checkpoint }), Some(path)) => {
            std::fs::write(path, checkpoint)?;
            Ok(None)
        }
        (trained, _) => Ok(Some(trained?.artifact)),
    }
}

/// One dose by the loop used in real weighings.
fn weigh(task: &Task, simulation: &Simulation, trace: bool) -> anyhow::Result<Dose> {
    let mut go_on = |_: &flip_bench::weigh::Event<'_>| ControlFlow::Continue(());
    let poured = simulate(task, simulation, &mut go_on, &AtomicBool::new(false));
    let dispensed_mg = match (poured.dispensed_mg, poured.outcome) {
        (Some(mg), outcome) if outcome != Outcome::Aborted => mg,
        _ => anyhow::bail!("a weighing was aborted: {}", poured.error.unwrap_or_default()),
    };
    if trace {
        let mut told = String::new();
        for tick in &poured.ticks {
            let shake_mm = tick.action.executed_shake_mm();
            write!(
                told,
                " {:.0} deg {shake_mm:.0} mm {:.1} mg;",
                tick.pitch_deg, tick.reading.mass_mg
            )?;
        }
        eprintln!("target {} mg, dispensed {:.2} mg:{told}", task.order.target_mg, dispensed_mg);
    }
    let Poured { reading_mg, shakes, seconds, .. } = poured;
    let reading_mg = reading_mg.ok_or_else(|| anyhow::anyhow!("a dose without a reading"))?;
    Ok(Dose { dispensed_mg, reading_mg, shakes, seconds })
}

fn tell(evaluation: &Evaluation) {
    for row in &evaluation.rows {
        let (over, zero) = (100.0 * row.over_share, 100.0 * row.zero_share);
        eprintln!(
            "{:18} {:18} {:4.1} mg: mae {:5.2} bias {:+5.2} over {over:3.0} % zero {zero:3.0} % shakes {:.1}",
            row.controller, row.powder, row.target_mg, row.mae_mg, row.bias_mg, row.shakes_mean,
        );
    }
    for s in &evaluation.summary {
        eprintln!(
            "{:18} mae {:.3} [{:.2}, {:.2}] sd {:.2}",
            s.controller, s.mae_mg, s.ci95[0], s.ci95[1], s.sd_trials_mg
        );
    }
}

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [powders, overrides, rest @ ..] = arguments.as_slice() else {
        anyhow::bail!("training_campaign POWDERS.json SETTINGS.json [POLICY.safetensors]");
    };
    let powders: Vec<Powder> = serde_json::from_slice(&std::fs::read(powders)?)?;
    let overrides: Value = serde_json::from_slice(&std::fs::read(overrides)?)?;
    let settings = settings(&overrides)?;
    let levels: Vec<Level> = powders.iter().filter(|p| p.train).map(|p| p.level.clone()).collect();

    let started = Instant::now();
    let artifact = match rest.first() {
        Some(path) => Some(std::fs::read(path)?),
        None if overrides.get("learn") == Some(&json!(false)) => None,
        None => match learn(&levels, &settings, &overrides)? {
            Some(artifact) => Some(artifact),
            None => std::process::exit(3),
        },
    };
    let train_s = started.elapsed().as_secs_f64();
    if let (Some(path), Some(bytes)) = (overrides.get("save").and_then(Value::as_str), &artifact) {
        std::fs::write(path, bytes)?;
    }
    let policy = artifact
        .as_ref()
        .map(|bytes| anyhow::Ok((policy::id(bytes), policy::decode(bytes)?)))
        .transpose()?;
    let pitch =
        policy.as_ref().map_or(settings.rules.pitch, |(_, policy)| policy.manifest.rules.pitch);
    let number = |key: &str, default: u64| {
        overrides.get(key).and_then(Value::as_u64).unwrap_or(default) as u32
    };
    let flag = |key: &str| overrides.get(key) == Some(&json!(true));
    let rules = Rules { steps_max: number("max_steps", 10), pitch, ..Rules::FLIP };
    let learnt = policy.map(|(name, policy)| Contender { name, controller: policy.controller });
    let mut contenders: Vec<Contender> = learnt.into_iter().collect();
    let rivals: Vec<String> =
        overrides.get("rivals").cloned().map_or(Ok(Vec::new()), serde_json::from_value)?;
    for name in rivals {
        let controller = match name.as_str() {
            "untrained" => Controller::untrained(1),
            "fixed" => Controller::Fixed(ScheduledStep::FIXED),
            "dispenser" => Controller::Dispenser(Dispenser::new(response(&overrides)?)),
            "fuzzy" => Controller::Fuzzy(fuzzy(&overrides)?),
            "paced" => Controller::Paced(paced(&overrides)?),
            other => anyhow::bail!(
                "there is no rival `{other}`: untrained, fixed, dispenser, fuzzy, paced"
            ),
        };
        contenders.push(Contender { name, controller });
    }
    let targets = overrides.get("targets_mg").cloned().unwrap_or(json!([15.0, 20.0]));
    let plan = Plan {
        contenders,
        subjects: powders
            .into_iter()
            .map(|p| Subject { powder: p.level.powder, sets: p.level.sets })
            .collect(),
        targets_mg: serde_json::from_value(targets)?,
        repeats: number("repeats", 5),
        seed: overrides.get("evaluation_seed").and_then(Value::as_u64).unwrap_or(777),
    };
    let trace = flag("trace");
    let once = |of: &Weighing<'_>| {
        let order = Order {
            target_mg: of.target_mg,
            tolerance_lower_mg: 0.0,
            tolerance_upper_mg: 0.0,
            readability_mg: settings.balance.readability_mg,
        };
        let (accuracy, controller) = (Accuracy::default(), of.contender.controller.clone());
        let (set, spoon, balance, seed) = (*of.set, settings.spoon, settings.balance, of.seed);
        weigh(
            &Task { order, accuracy, controller, rules },
            &Simulation { set, spoon, balance, seed },
            trace,
        )
    };
    let evaluation = evaluate(&plan, |weighings| weighings.par_iter().map(once).collect())?;
    tell(&evaluation);
    let timing = json!({ "train_s": train_s, "all_s": started.elapsed().as_secs_f64() });
    let result = json!({ "settings": settings, "rows": evaluation.rows, "summary": evaluation.summary, "timing": timing });
    println!("{}", serde_json::to_string(&result)?);
    Ok(())
}
