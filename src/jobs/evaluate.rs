//! The evaluation job: runs the weighing loop on powders that the policy has not met, and simple
//! controllers for comparison.

use super::context::{JobContext, JobError};
use super::spec::EvaluationSpec;
use flip_bench::rig::{Simulation, Task, simulate};
use flip_bench::weigh::{Accuracy, Event, Order};
use flip_core::domain::job::Progress;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::weighing::Outcome;
use flip_learn::train::evaluate::{Contender, Dose, Plan, Row, Subject, Summary, evaluate};
use flip_policy::{
    self, Controller, Dispenser, Fuzzy, Kind, Paced, Pid, Policy, Response, Rules, Schedule,
    ScheduledStep,
};
use flip_sim::{balance, dispense};
use flip_store as store;
use flip_store::evaluations::{EvaluationRow, EvaluationSummary};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// The controllers that an evaluation can compare.
pub const CONTROLLERS: [&str; 8] =
    [POLICY, "untrained", "fixed", "schedule", "dispenser", "pid", "fuzzy", "paced"];
/// The controller being evaluated.
pub const POLICY: &str = "policy";

/// One dose on the simulator: [`simulated`] in the product, a formula in tests. The error is why it
/// has no result.
pub type Weigh = Arc<dyn Fn(&Task, &Simulation) -> Result<Dose, String> + Send + Sync>;

/// One dose on the simulator, to its end.
///
/// # Errors
/// Why there is no stable reading.
pub fn simulated(task: &Task, simulation: &Simulation) -> Result<Dose, String> {
    let mut go_on = |_: &Event<'_>| ControlFlow::Continue(());
    let poured = simulate(task, simulation, &mut go_on, &AtomicBool::new(false));
    match (poured.dispensed_mg, poured.reading_mg) {
        (Some(dispensed_mg), Some(reading_mg)) if poured.outcome != Outcome::NotStable => {
            Ok(Dose { dispensed_mg, reading_mg, shakes: poured.shakes, seconds: poured.seconds })
        }
        _ => Err(poured.error.unwrap_or_default()),
    }
}

/// Result of an evaluation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct EvaluationResult {
    /// One row for each controller, powder and target.
    pub rows: Vec<EvaluationRow>,
    /// One row for each controller.
    pub summary: Vec<EvaluationSummary>,
}

pub(super) fn perform(context: &JobContext, spec: &EvaluationSpec) -> Result<(), JobError> {
    let policy = load_policy(context, &spec.policy)?;
    let plan = plan(context, spec, &policy)?;
    let rules = Rules { steps_max: spec.max_shakes, ..policy.manifest.rules };
    let doses = Doses::resume(context, &plan)?;
    let weigh_once = |controller: &Controller,
                      subject: &Subject,
                      set: &ParameterSet,
                      target_mg: f64,
                      seed: u64| {
        doses.known_or(controller, set, target_mg, seed, || {
            let patch =
                spec.powders.iter().find(|it| it.powder == subject.powder).map(|it| &it.patch);
            let patch = patch.cloned().unwrap_or_default();
            let usual = spec.conditions.spoon();
            let extensions = usual
                .extensions
                .patched(&patch)
                .map_err(|error| JobError::Fail(error.to_string()))?;
            let task = Task {
                order: Order {
                    target_mg,
                    tolerance_lower_mg: 0.0,
                    tolerance_upper_mg: 0.0,
                    readability_mg: spec.readability_mg,
                },
                accuracy: Accuracy::default(),
                controller: controller.clone(),
                rules,
            };
            let simulation = Simulation {
                set: patch.powder(set),
                spoon: dispense::Settings { extensions, ..usual },
                balance: balance::Settings {
                    readability_mg: spec.readability_mg,
                    ..balance::Settings::default()
                },
                seed,
            };
            (context.functions.weigh)(&task, &simulation).map_err(|cause| {
                JobError::Fail(format!("a weighing of {target_mg} mg was aborted: {cause}"))
            })
        })
    };
    let found = evaluate(&plan, weigh_once)?;
    let result = EvaluationResult {
        rows: found.rows.iter().map(row).collect(),
        summary: found.summary.iter().map(summary).collect(),
    };
    context.succeed(&result, async |tx| {
        for (position, row) in (0..).zip(&result.rows) {
            let about = about(spec, &policy, &rules, &row.controller);
            tx.insert_evaluation_row(context.id(), position, about, row).await?;
        }
        Ok(())
    })?;
    Ok(())
}

/// The policy whose ranking a controller's errors count towards, if any: only doses like those of a
/// weighing, with its spoon, its balance and the rules that the policy was made for, are evidence
/// of which policy weighs best.
fn about<'a>(
    spec: &'a EvaluationSpec,
    policy: &Policy,
    rules: &Rules,
    controller: &str,
) -> Option<&'a str> {
    let usual_balance = spec.readability_mg == balance::Settings::default().readability_mg;
    let is_base = spec.under.is_none();
    let usual = |of: &Policy| {
        is_base && spec.conditions.are_usual() && usual_balance && *rules == of.manifest.rules
    };
    let shipped = flip_policy::shipped();
    match controller {
        POLICY => usual(policy).then_some(spec.policy.as_str()),
        name => {
            let is_shipped = spec
                .rivals
                .iter()
                .any(|kind| kind.name() == name && *kind == shipped.policy.manifest.kind);
            (is_shipped && usual(&shipped.policy)).then_some(shipped.id.as_str())
        }
    }
}

pub(super) fn load_policy(context: &JobContext, id: &str) -> Result<Policy, JobError> {
    let bytes = context.read(context.store.policy_bytes(id))?;
    let bytes = bytes.ok_or_else(|| JobError::Fail(format!("there is no policy `{id}`")))?;
    flip_policy::decode(&bytes).map_err(|error| JobError::Fail(error.to_string()))
}

fn plan(context: &JobContext, spec: &EvaluationSpec, policy: &Policy) -> Result<Plan, JobError> {
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
            let set = context.read(context.store.parameter_set(id))?;
            sets.push(
                set.ok_or_else(|| JobError::Fail(format!("there is no parameter set `{id}`")))?
                    .parameters,
            );
        }
        subjects.push(Subject { powder: powder.powder.clone(), sets });
    }
    Ok(Plan {
        contenders: spec.controllers.iter().map(contender).collect::<Result<_, _>>()?,
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

/// Doses that are stored as they complete, so that an evaluation that was killed does not repeat
/// them.
struct Doses<'a> {
    context: &'a JobContext,
    plan: &'a Plan,
    known: HashMap<String, Dose>,
    done: AtomicUsize,
    all: usize,
}

impl<'a> Doses<'a> {
    fn resume(context: &'a JobContext, plan: &'a Plan) -> store::Result<Self> {
        let known = context.read(context.store.doses(context.id()))?;
        let cells = plan.contenders.len() * plan.subjects.len() * plan.targets_mg.len();
        let all = cells * plan.repeats as usize;
        Ok(Self { context, plan, done: AtomicUsize::new(known.len()), known, all })
    }

    fn known_or(
        &self,
        controller: &Controller,
        set: &ParameterSet,
        target_mg: f64,
        seed: u64,
        weigh: impl FnOnce() -> Result<Dose, JobError>,
    ) -> Result<Dose, JobError> {
        let contender =
            self.plan.contenders.iter().find(|c| std::ptr::eq(&c.controller, controller));
        let name = contender.map_or("", |c| c.name.as_str());
        let key = format!("{name} {} {target_mg} {seed}", set.id());
        if let Some(dose) = self.known.get(&key) {
            return Ok(*dose);
        }
        if self.context.flow().is_break() {
            return Err(JobError::Stopped);
        }
        let dose = weigh()?;
        self.context
            .save(async |tx| tx.insert_dose(self.context.id(), &key, &dose).await.map(|()| true))?;
        let done = self.done.fetch_add(1, Ordering::SeqCst) + 1;
        let message = format!("dose {done} of {}", self.all);
        self.context.report(&Progress { fraction: done as f64 / self.all as f64, message })?;
        Ok(dose)
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
