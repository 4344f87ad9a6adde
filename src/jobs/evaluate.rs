//! The evaluation job: runs the weighing loop on powders that the policy has not met, and simple
//! controllers for comparison.

use super::Functions;
use super::card::{self, SideBySide};
use super::host::{Finished, JobError, JobHost, Piece, Result, go_on};
use super::runner::{DoseExperiment, DoseRunner, Run};
use super::spec::EvaluationSpec;
use flip_bench::rig::{Poured, Simulation, Task, simulate};
use flip_bench::weigh::{Accuracy, Event, Order};
use flip_core::domain::job::Progress;
use flip_core::domain::weighing::Outcome;
use flip_learn::train::evaluate::{
    Contender, Dose, Plan, Row, Subject, Summary, Weighing, evaluate,
};
use flip_policy::{
    self, Controller, Dispenser, Fuzzy, Kind, Paced, Pid, Policy, Response, Rules, Schedule,
    ScheduledStep,
};
use flip_sim::{balance, dispense};
use flip_store::evaluations::{EvaluationRow, EvaluationSummary};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// The controllers that an evaluation can compare.
pub const CONTROLLERS: [&str; 8] =
    [POLICY, "untrained", "fixed", "schedule", "dispenser", "pid", "fuzzy", "paced"];
/// The controller being evaluated.
pub const POLICY: &str = "policy";

/// One dose on the simulator, to its end.
///
/// # Errors
/// Why there is no stable reading.
pub fn simulated(task: &Task, simulation: &Simulation) -> std::result::Result<Dose, String> {
    let mut go_on = |_: &Event<'_>| ControlFlow::Continue(());
    dose_of(simulate(task, simulation, &mut go_on, &AtomicBool::new(false)))
}

/// What a simulated dose came to, or why there is no stable reading.
pub(super) fn dose_of(poured: Poured) -> std::result::Result<Dose, String> {
    match (poured.dispensed_mg, poured.reading_mg) {
        (Some(dispensed_mg), Some(reading_mg)) if poured.outcome != Outcome::NotStable => {
            Ok(Dose { dispensed_mg, reading_mg, shakes: poured.shakes, seconds: poured.seconds })
        }
        _ => Err(poured.error.unwrap_or_default()),
    }
}

/// Result of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EvaluationResult {
    /// One row for each controller, powder and target.
    pub rows: Vec<EvaluationRow>,
    /// One row for each controller.
    pub summary: Vec<EvaluationSummary>,
    /// The graphics card that it was computed on; absent for the processor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub card: Option<String>,
}

pub(super) fn perform(
    host: &dyn JobHost,
    functions: &Functions,
    spec: &EvaluationSpec,
) -> Result<()> {
    let card = card::engine_of(&*functions.card, spec.device)?;
    let weigh = match &card {
        Some(card) => Arc::new(SideBySide(card.clone())),
        None => functions.weigh.clone(),
    };
    let policy = load_policy(host, &spec.policy)?;
    let plan = plan(host, spec, &policy)?;
    let rules = Rules { steps_max: spec.max_shakes, ..policy.manifest.rules };
    // Doses of one controller and target share what is weighed: a network has many numbers.
    let mut tasks = HashMap::<(String, u64), Arc<Task>>::new();
    let found = evaluate(&plan, |weighings| {
        let experiment = |of: &Weighing<'_>| {
            let key = (of.contender.name.clone(), of.target_mg.to_bits());
            let task = tasks.entry(key).or_insert_with(|| Arc::new(task(spec, rules, of)));
            Ok(DoseExperiment { task: task.clone(), simulation: simulation(spec, of)? })
        };
        doses(host, weighings, experiment, &weigh)
    })?;
    let result = EvaluationResult {
        rows: found.rows.iter().map(row).collect(),
        summary: found.summary.iter().map(summary).collect(),
        card: card.map(|card| card.name()),
    };
    let evidence: Vec<Option<&str>> =
        result.rows.iter().map(|row| about(spec, &policy, &rules, &row.controller)).collect();
    let under = spec.under.as_ref();
    host.finish(&Finished::Evaluation { result: &result, evidence: &evidence, under })
}

/// What to weigh.
fn task(spec: &EvaluationSpec, rules: Rules, of: &Weighing<'_>) -> Task {
    Task {
        order: Order {
            target_mg: of.target_mg,
            tolerance_lower_mg: 0.0,
            tolerance_upper_mg: 0.0,
            readability_mg: spec.readability_mg,
        },
        accuracy: Accuracy::default(),
        controller: of.contender.controller.clone(),
        rules,
    }
}

/// The bench to simulate.
fn simulation(spec: &EvaluationSpec, of: &Weighing<'_>) -> Result<Simulation> {
    let patch = spec.powders.iter().find(|it| it.powder == of.subject.powder).map(|it| &it.patch);
    let patch = patch.cloned().unwrap_or_default();
    let usual = spec.conditions.spoon();
    let extensions =
        usual.extensions.patched(&patch).map_err(|error| JobError::Fail(error.to_string()))?;
    Ok(Simulation {
        set: patch.powder(of.set),
        spoon: dispense::Settings { extensions, ..usual },
        balance: balance::Settings {
            readability_mg: spec.readability_mg,
            ..balance::Settings::default()
        },
        seed: of.seed,
    })
}

/// The doses of all weighings. Each is saved as it comes, and those of earlier attempts are not
/// weighed again.
pub(super) fn doses<'a>(
    host: &dyn JobHost,
    weighings: &[Weighing<'a>],
    experiment: impl FnMut(&Weighing<'a>) -> Result<DoseExperiment>,
    weigh: &DoseRunner,
) -> Result<Vec<Dose>> {
    let known = host.doses()?;
    let mut doses: Vec<Option<Dose>> =
        weighings.iter().map(|of| known.get(&key(of)).copied()).collect();
    let places: Vec<usize> = (0..doses.len()).filter(|&place| doses[place].is_none()).collect();
    let missing: Vec<Weighing<'_>> = places.iter().map(|&place| weighings[place]).collect();
    if !missing.is_empty() && host.flow().is_break() {
        return Err(JobError::Stopped);
    }
    let experiments: Vec<DoseExperiment> = missing.iter().map(experiment).collect::<Result<_>>()?;
    let (mut done, mut unsaved) = (known.len(), None);
    weigh.run(&experiments, &mut |k, Run { outcome, .. }| {
        let dose = outcome.map_err(|cause| {
            let target_mg = missing[k].target_mg;
            JobError::Fail(format!("a weighing of {target_mg} mg was aborted: {cause}"))
        });
        let saved = dose.and_then(|dose| {
            host.save(Piece::Dose { key: &key(&missing[k]), dose: &dose })?;
            doses[places[k]] = Some(dose);
            done += 1;
            let message = format!("dose {done} of {}", weighings.len());
            let fraction = done as f64 / weighings.len() as f64;
            host.report(&Progress { fraction, message })
        });
        go_on(host, saved, &mut unsaved)
    });
    match unsaved {
        Some(error) => Err(error),
        None => doses.into_iter().collect::<Option<_>>().ok_or(JobError::Stopped),
    }
}

/// The name of a dose within its evaluation.
fn key(of: &Weighing<'_>) -> String {
    format!("{} {} {} {}", of.contender.name, of.set.id(), of.target_mg, of.seed)
}

/// The policy whose ranking a controller's errors count towards, if any: only doses like those of a
/// weighing, with its spoon, its balance and the rules that the policy was made for, are evidence
/// of which policy weighs best: under the same version of the simulator, and on the processor. A card
/// is equivalent within a margin that is wider than what policies differ by.
fn about<'a>(
    spec: &'a EvaluationSpec,
    policy: &Policy,
    rules: &Rules,
    controller: &str,
) -> Option<&'a str> {
    let usual_balance = spec.readability_mg == balance::Settings::default().readability_mg;
    // The simulated spoon pitches no further than this, whatever the rules allow.
    let pitch = dispense::Settings::default().pitch;
    let on_it = |rules: &Rules| Rules { pitch: rules.pitch.within(pitch), ..*rules };
    let usual = |of: &Policy| {
        let same_rules = on_it(rules) == on_it(&of.manifest.rules);
        spec.device.is_cpu() && spec.conditions.are_usual() && usual_balance && same_rules
    };
    let is_rival = |kind: &Kind| kind.name() == controller && spec.rivals.contains(kind);
    match controller {
        POLICY => usual(policy).then_some(spec.policy.as_str()),
        _ => flip_policy::all_shipped()
            .into_iter()
            .find(|it| is_rival(&it.policy.manifest.kind) && usual(&it.policy))
            .map(|it| it.id.as_str()),
    }
}

pub(super) fn load_policy(host: &dyn JobHost, id: &str) -> Result<Policy> {
    let bytes = host.policy(id)?;
    let bytes = bytes.ok_or_else(|| JobError::Fail(format!("there is no policy `{id}`")))?;
    flip_policy::decode(&bytes).map_err(|error| JobError::Fail(error.to_string()))
}

fn plan(host: &dyn JobHost, spec: &EvaluationSpec, policy: &Policy) -> Result<Plan> {
    let contender = |name: &String| {
        let controller = match name.as_str() {
            POLICY => policy.controller.clone(),
            "untrained" => Controller::untrained(spec.seed),
            "fixed" => Controller::Fixed(ScheduledStep::FIXED),
            "schedule" => Controller::Schedule(spec.schedule.clone()),
            other => match spec
                .rivals
                .iter()
                .find(|kind| kind.name() == other)
                .cloned()
                .or_else(|| rival(other))
            {
                Some(Kind::Dispenser { response }) => {
                    Controller::Dispenser(Dispenser::new(response))
                }
                Some(Kind::Pid { gains }) => Controller::Pid(gains),
                Some(Kind::Fuzzy { fuzzy }) => Controller::Fuzzy(fuzzy),
                Some(Kind::Paced { paced }) => Controller::Paced(paced),
                _ => return Err(JobError::Fail(format!("there is no controller `{other}`"))),
            },
        };
        Ok(Contender { name: name.clone(), controller })
    };
    let mut subjects = Vec::new();
    for powder in &spec.powders {
        let mut sets = Vec::new();
        for id in &powder.sets {
            let set = host.parameter_set(id)?;
            sets.push(
                set.ok_or_else(|| JobError::Fail(format!("there is no parameter set `{id}`")))?,
            );
        }
        subjects.push(Subject { powder: powder.powder.clone(), sets });
    }
    Ok(Plan {
        contenders: spec.controllers.iter().map(contender).collect::<Result<_>>()?,
        subjects,
        targets_mg: spec.targets_mg.clone(),
        repeats: spec.repeats,
        seed: spec.seed,
    })
}

/// Definition of a rival in this version of the program: its numbers are part of what an evaluation
/// depends on.
pub fn rival(name: &str) -> Option<Kind> {
    match name {
        "dispenser" => Some(Kind::Dispenser { response: Response::FITTED }),
        "pid" => Some(Kind::Pid { gains: Pid::CHOSEN }),
        "fuzzy" => Some(Kind::Fuzzy { fuzzy: Fuzzy::CHOSEN }),
        "paced" => Some(Kind::Paced { paced: Paced::CHOSEN }),
        _ => None,
    }
}

/// The open-loop rival: found by `cargo experiment tune_schedule` with its defaults, on all five powders
/// and for 15 and 20 mg (1840 pours). Pitches in degrees and shakes in mm.
pub fn tuned_schedule() -> Schedule {
    const STEPS: [(f64, f64); 10] = [
        (6.5, 3.7),
        (11.1, 3.9),
        (15.7, 4.2),
        (20.3, 4.4),
        (24.9, 4.6),
        (29.5, 4.9),
        (34.1, 5.1),
        (38.7, 5.4),
        (43.3, 5.6),
        (47.9, 5.8),
    ];
    Schedule {
        steps: STEPS.map(|(pitch_deg, shake_mm)| ScheduledStep { pitch_deg, shake_mm }).to_vec(),
    }
}

fn row(row: &Row) -> EvaluationRow {
    EvaluationRow {
        controller: row.controller.clone(),
        powder: row.powder.clone(),
        target_mg: row.target_mg,
        n: row.n,
        mae_mg: row.mae_mg,
        sd_mg: row.sd_mg,
        bias_mg: row.bias_mg,
        over_share: row.over_share,
        zero_share: row.zero_share,
        shakes_mean: row.shakes_mean,
        seconds_mean: Some(row.seconds_mean),
    }
}

fn summary(summary: &Summary) -> EvaluationSummary {
    EvaluationSummary {
        controller: summary.controller.clone(),
        mae_mg: summary.mae_mg,
        ci95: summary.ci95,
        sd_trials_mg: summary.sd_trials_mg,
        sd_within_cells_mg: summary.sd_within_cells_mg,
        bias_mg: Some(summary.bias_mg),
        over_share: Some(summary.over_share),
        zero_share: Some(summary.zero_share),
        shakes_mean: Some(summary.shakes_mean),
        seconds_mean: Some(summary.seconds_mean),
    }
}
