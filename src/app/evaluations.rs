//! Evaluations: a policy's errors on the simulated bench, compared with those of simple
//! controllers.

use super::check::Check;
use super::jobs::{corrupt, specification, stored};
use super::trainings::without_sets;
use super::{App, Error, Result};
use crate::jobs::evaluate::{CONTROLLERS, EvaluationResult, POLICY, rival, tuned_schedule};
use crate::jobs::{
    Conditions, EvaluationPowder, EvaluationSpec, JobSpec, can_compute, simulator_on,
};
use flip_core::domain::conditions::{Conditions as Day, Under};
use flip_core::domain::device::Device;
use flip_core::domain::job::JobKind;
use flip_core::domain::labels::Labels;
use flip_core::domain::powder::PUBLISHED;
use flip_core::domain::spoon::Spoon;
use flip_core::domain::{FieldError, bounded};
use flip_policy::{all_shipped, shipped};
use flip_store::jobs::{Job, JobRow};
use flip_store::page::{Page, PageQuery};
use flip_store::parameter_sets::CalibratedSet;
use flip_store::policies::Policy;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Default targets, mg.
const TARGETS_MG: [f64; 2] = [15.0, 20.0];
/// Maximum number of entries of each list in a request.
const LIST_MAX: usize = 20;

/// What to evaluate. Everything has a default.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EvaluationRequest {
    /// Policy id; default the newest, or the shipped one until a policy is trained.
    pub policy: Option<String>,
    /// Any of `policy`, `untrained`, `fixed`, `schedule`, `dispenser`, `pid`, `fuzzy`, `paced`;
    /// default all. A policy named by its id is always included.
    pub controllers: Option<Vec<String>>,
    /// Powder ids; default the five published ones.
    pub powders: Option<Vec<String>>,
    /// Target masses, mg, each within what the spoon holds; default 15 and 20.
    pub targets_mg: Option<Vec<f64>>,
    /// Weighings per powder and target, 1 to 100; default 5.
    pub repeats: Option<u32>,
    /// Readability (display step) of the balance, 0.01 to 10 mg; default 1.
    pub readability_mg: Option<f64>,
    /// Maximum steps per weighing, 1 to 100; default 10.
    pub max_shakes: Option<u32>,
    /// Grains on the spoon, 500 to 4000; default 2500, about 37 mg. Their mass is all the powder
    /// there is, so a target must lie within it.
    pub particles: Option<u32>,
    /// Mechanisms missing from the base simulator, by name with their amplitudes, as
    /// `{"rotation": 1}`; default none. No policy has met them in training.
    #[serde(default)]
    pub extensions: BTreeMap<String, f64>,
    /// Shake as the bench's arm was measured to shake (`flip bench calibrate-shake`); default as in
    /// the simulator.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub as_calibrated: bool,
    /// Substep of the simulator, 10 to 160 us; default 80. Half of it takes twice as long. Errors at
    /// another than the usual substep do not count for which policy weighs best.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub substep_us: Option<u32>,
    /// The spoon used for dosing; default FLIP's own, which holds about 40 mg.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spoon: Option<Spoon>,
    /// What simulates: the processor, or a graphics card of this process or of a worker. A card's doses
    /// have the statistics of the processor's and other bytes, and do not count for which policy weighs
    /// best.
    #[serde(default, skip_serializing_if = "Device::is_cpu")]
    pub device: Device,
    /// Seed; default 1.
    pub seed: Option<u64>,
    /// Extended simulator version, `sv-…`; default the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub simulator: Option<String>,
    /// Conditions of the version on the bench, each within the range of its campaign, as
    /// `{"relative_humidity_pct": 65}`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub conditions: Day,
    /// What the caller writes on it, to find it again.
    #[serde(default, skip_serializing_if = "Labels::is_empty")]
    pub labels: Labels,
}

/// An evaluation: its job, its settings, and the errors once it has succeeded.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// The job; the evaluation has the same id.
    pub job: Job,
    /// Policy id.
    pub policy: String,
    /// Controllers compared.
    pub controllers: Vec<String>,
    /// Powder ids.
    pub powders: Vec<String>,
    /// Target masses, mg.
    pub targets_mg: Vec<f64>,
    /// Weighings per powder and target.
    pub repeats: u32,
    /// Readability (display step) of the balance, mg.
    pub readability_mg: f64,
    /// Maximum steps per weighing.
    pub max_shakes: u32,
    /// What was on the spoon.
    pub conditions: Conditions,
    /// The extended simulator version and the conditions given; absent for the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub under: Option<Under>,
    /// What it simulates on; absent for the processor.
    #[serde(default, skip_serializing_if = "Device::is_cpu")]
    pub device: Device,
    /// Seed.
    pub seed: u64,
    /// The errors; absent until it has succeeded.
    pub result: Option<EvaluationResult>,
}

impl App {
    /// Queues an evaluation. `false`: the same one was requested before, and this is its job.
    ///
    /// # Errors
    /// `Invalid`; `Conflict` (`calibration_missing`).
    pub async fn start_evaluation(&self, request: EvaluationRequest) -> Result<(Job, bool)> {
        let mut conditions = checked(&request)?;
        if request.as_calibrated {
            conditions = conditions.as_calibrated(&self.shakes().await?);
        }
        // Before anybody calibrates for what would be refused then.
        can_compute(request.device, &conditions.spoon())?;
        self.check_device(JobKind::Evaluation, request.device).await?;
        let extended = self.extended(request.simulator.as_deref(), &request.conditions).await?;
        let simulator = extended.as_ref().map(|(under, _)| under.simulator.as_str());
        let mut controllers =
            request.controllers.unwrap_or_else(|| CONTROLLERS.map(str::to_owned).to_vec());
        if request.policy.is_some() && !controllers.iter().any(|name| name == POLICY) {
            controllers.insert(0, POLICY.to_owned());
        }
        let weighs = controllers.iter().any(|name| name == POLICY);
        let policy = self.policy_to_evaluate(request.policy.as_deref(), weighs).await?;
        let targets_mg = request.targets_mg.unwrap_or_else(|| TARGETS_MG.to_vec());
        let powders = match request.powders {
            Some(powders) => powders,
            None => PUBLISHED.iter().map(|powder| powder.id.to_owned()).collect(),
        };
        let mut subjects = Vec::new();
        for (k, id) in powders.iter().enumerate() {
            let id = self.powder_of(&format!("powders[{k}]"), id).await?.id;
            let day = extended
                .as_ref()
                .map(|(under, extended)| extended.at(Some(&id), &under.conditions));
            let patch = day.transpose().map_err(Error::Invalid)?.unwrap_or_default();
            let sets = self.sets_to_weigh(&id, weighs.then_some(&policy), simulator).await?;
            within_the_spoon(&id, &targets_mg, &sets, &conditions)?;
            let sets = sets.into_iter().map(|set| set.id).collect();
            subjects.push(EvaluationPowder { powder: id, sets, patch });
        }
        let spec = EvaluationSpec {
            policy: policy.id,
            rivals: controllers.iter().filter_map(|name| rival(name)).collect(),
            controllers,
            schedule: tuned_schedule(),
            powders: subjects,
            targets_mg,
            repeats: request.repeats.unwrap_or(5),
            readability_mg: request.readability_mg.unwrap_or(1.0),
            max_shakes: request.max_shakes.unwrap_or(10),
            conditions,
            under: extended.map(|it| it.0),
            device: request.device,
            seed: request.seed.unwrap_or(1),
            simulator: simulator_on(request.device),
        };
        self.queue(JobSpec::Evaluation(spec), request.labels).await
    }

    /// The named policy, or the newest that does not ship; if no policy takes part in the weighing,
    /// the default, so that no other can change the result.
    async fn policy_to_evaluate(&self, named: Option<&str>, weighs: bool) -> Result<Policy> {
        let id = match named {
            Some(id) => id.to_owned(),
            None if weighs => self.newest_policy().await?,
            None => shipped().id.clone(),
        };
        self.store().policy(&id).await?.ok_or_else(|| {
            let advice = format!("there is no policy `{id}`: GET /v1/policies lists them");
            FieldError::new("policy", advice).into()
        })
    }

    /// The newest policy that does not ship, or the default until there is one.
    async fn newest_policy(&self) -> Result<String> {
        let most = all_shipped().len() as u32 + 1;
        let newest = self.store().policies(PageQuery::first(most).window(most)?).await?.items;
        let mut own = newest.into_iter().map(|it| it.id);
        let own = own.find(|id| all_shipped().iter().all(|shipped| shipped.id != *id));
        Ok(own.unwrap_or_else(|| shipped().id.clone()))
    }

    /// The sets that represent a powder: those of its newest calibration, without those that a
    /// policy taking part has met in training, if others are left.
    async fn sets_to_weigh(
        &self,
        powder: &str,
        weighs: Option<&Policy>,
        simulator: Option<&str>,
    ) -> Result<Vec<CalibratedSet>> {
        let sets = self.calibrated_sets(Some(powder), 0.0, simulator).await?.ok_or_else(|| {
            let advice = format!(
                "powder {} or POST /v1/calibrations, and evaluate when it has succeeded",
                without_sets(powder, simulator)
            );
            Error::conflict("calibration_missing", advice)
        })?;
        Ok(match weighs {
            Some(policy) => unmet(sets, policy),
            None => sets,
        })
    }

    /// One evaluation.
    pub async fn evaluation(&self, id: &str) -> Result<Evaluation> {
        let row = self.store().job(id).await?.filter(|row| row.job.kind == JobKind::Evaluation);
        evaluation(self.placed(row.ok_or_else(|| Error::not_found("evaluation", id))?).await?)
    }

    /// Evaluations, newest first.
    pub async fn evaluations(&self, page: PageQuery) -> Result<Page<Evaluation>> {
        self.jobs_as(JobKind::Evaluation, page, evaluation).await
    }
}

/// Validates everything that needs no database; returns the conditions of the request.
fn checked(request: &EvaluationRequest) -> Result<Conditions> {
    let mut check = Check::default();
    check.count("repeats", request.repeats.unwrap_or(5), 1, 100);
    check.count("max_shakes", request.max_shakes.unwrap_or(10), 1, 100);
    check.keep(bounded("readability_mg", request.readability_mg.unwrap_or(1.0), 0.01, 10.0, "mg"));
    for (k, name) in request.controllers.iter().flatten().enumerate() {
        if !CONTROLLERS.contains(&name.as_str()) {
            check.refuse(
                &format!("controllers[{k}]"),
                format!("must be one of {}", CONTROLLERS.join(", ")),
            );
        }
    }
    for (k, target) in request.targets_mg.iter().flatten().enumerate() {
        check.keep(bounded(&format!("targets_mg[{k}]"), *target, 0.1, 1e6, "mg"));
    }
    let lengths = [
        ("controllers", request.controllers.as_ref().map(Vec::len)),
        ("powders", request.powders.as_ref().map(Vec::len)),
        ("targets_mg", request.targets_mg.as_ref().map(Vec::len)),
    ];
    for (field, length) in lengths {
        if length.is_some_and(|length| !(1..=LIST_MAX).contains(&length)) {
            check.refuse(
                field,
                format!("must hold 1 to {LIST_MAX} entries; leave it out for the default"),
            );
        }
    }
    let conditions =
        Conditions::named(request.particles, &request.extensions).unwrap_or_else(|errors| {
            errors.into_iter().for_each(|error| check.refuse(&error.field, error.message));
            Conditions::default()
        });
    let conditions =
        conditions.with_spoon(request.spoon.unwrap_or_default()).unwrap_or_else(|error| {
            check.refuse(&error.field, error.message);
            conditions
        });
    let conditions = match request.substep_us.map(|us| conditions.with_substep(us)) {
        Some(Err(error)) => {
            check.refuse(&error.field, error.message);
            conditions
        }
        Some(Ok(conditions)) => conditions,
        None => conditions,
    };
    check.done()?;
    Ok(conditions)
}

fn within_the_spoon(
    powder: &str,
    targets_mg: &[f64],
    sets: &[CalibratedSet],
    conditions: &Conditions,
) -> Result<()> {
    let Some(capacity_mg) = conditions.spoon_holds_mg(sets.iter().map(|set| &set.parameters))
    else {
        return Ok(());
    };
    let mut check = Check::default();
    for (k, target_mg) in targets_mg.iter().enumerate().filter(|(_, target)| **target > capacity_mg)
    {
        let field = format!("targets_mg[{k}]");
        check.refuse(
            &field,
            format!(
                "must be at most {capacity_mg:.1} mg, which is what the spoon holds of `{powder}`, got {target_mg}"
            ),
        );
    }
    check.done()
}

/// The sets that a policy was not trained on; all of them when it has met every one.
pub(super) fn unmet(sets: Vec<CalibratedSet>, policy: &Policy) -> Vec<CalibratedSet> {
    let list = |value: &serde_json::Value| value.as_array().cloned().unwrap_or_default();
    let known = list(&policy.manifest["levels"])
        .iter()
        .flat_map(|level| list(&level["sets"]))
        .collect::<Vec<_>>();
    let met = |set: &CalibratedSet| known.iter().any(|known| known["id"] == *set.id);
    let unmet: Vec<CalibratedSet> = sets.iter().filter(|set| !met(set)).cloned().collect();
    if unmet.is_empty() { sets } else { unmet }
}

fn evaluation(row: JobRow) -> Result<Evaluation> {
    let JobSpec::Evaluation(spec) = specification(&row)? else {
        return Err(corrupt("an evaluation's specification"));
    };
    Ok(Evaluation {
        job: row.job,
        policy: spec.policy,
        controllers: spec.controllers,
        powders: spec.powders.into_iter().map(|powder| powder.powder).collect(),
        targets_mg: spec.targets_mg,
        repeats: spec.repeats,
        readability_mg: spec.readability_mg,
        max_shakes: spec.max_shakes,
        conditions: spec.conditions,
        under: spec.under,
        device: spec.device,
        seed: spec.seed,
        result: row.result.as_deref().map(stored).transpose()?,
    })
}
