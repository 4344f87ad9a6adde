//! Weighings: checked, committed as intents, then carried out one at a time by the bench.

use super::caller_labels::written;
use super::characterisations::{limit_mg, no_probe};
use super::check::Check;
use super::checklist::check_items;
use super::evaluations::unmet;
use super::retry::{check_key, replay, request_sha256};
use super::vials::refused;
use super::{App, Error, Result};
use crate::jobs::bench::WAITING_MAX;
use flip_core::domain::bench::{BenchKind, Tick};
use flip_core::domain::conditions::{Conditions, Under};
use flip_core::domain::labels::Labels;
use flip_core::domain::seed::{derive, index_of};
use flip_core::domain::vial::VialCheck;
use flip_core::domain::weighing::{Asked, OnOverdose, WeighRequest};
use flip_core::domain::{FieldError, bounded};
use flip_policy::shipped;
use flip_store::bench::Latch;
use flip_store::page::{LIST_LIMIT_MAX, PageQuery};
use flip_store::parameter_sets::CalibratedSet;
use flip_store::policies::Policy;
use flip_store::stops::Stopped;
use flip_store::weighings::{Intent, Weighing};
use flip_store::{new_id, now};
use rand::TryRng;
use rand::rngs::SysRng;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Minimum target, mg: below the finest display step nothing can be weighed.
const TARGET_MG_MIN: f64 = 0.1;
/// What to do about a target above what the bench can dose; in no other refusal.
pub const IN_PORTIONS: &str = "weigh it in portions";
/// Name of the ticks of a weighing in an error that reports them lost.
const TRACE: &str = "the trace of this weighing";
/// Index of the seed that selects the simulated powder.
const SET_CHOICE: u64 = 1;

/// What to weigh.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WeighingRequest {
    /// Powder id.
    pub powder: String,
    /// Target mass.
    pub target: Target,
    /// Accepted error.
    pub tolerance: Tolerance,
    /// Policy id; default the one with the smallest evaluated error for the powder under the same
    /// version of the simulator, or the shipped one if there is none.
    pub policy: Option<String>,
    /// Seed of the simulated bench; by default each weighing gets its own.
    pub seed: Option<u64>,
    /// Extended simulator version, `sv-…`; default the base.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub simulator: Option<String>,
    /// Conditions of the version on the simulated bench, each within the range of its campaign, as
    /// `{"relative_humidity_pct": 65}`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub conditions: Conditions,
    /// What the caller writes on it, to find it again.
    #[serde(default, skip_serializing_if = "Labels::is_empty")]
    pub labels: Labels,
    /// Purpose and circumstances: lot, vial, operator, air, and what follows an overdose.
    #[serde(default, skip_serializing_if = "Asked::is_nothing")]
    pub asked: Asked,
    /// Whether a person must confirm that the vial is in (POST /v1/weighings/{id}/vial-ready),
    /// where the bench cannot exchange vials.
    #[serde(default, skip_serializing_if = "VialCheck::is_confirm")]
    pub vial_check: VialCheck,
    /// The bench reservation under which the request is made, `rs-…`, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reservation: Option<String>,
    /// The bench, by its name, or `any`: the least busy of those that hold the powder; default the
    /// one of this service.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bench_name: Option<String>,
}

/// A mass with its unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Value: at least one display step of the balance, and within what the spoon holds.
    pub value: f64,
    /// `mg` or `g`.
    pub unit: String,
}

/// Permitted deviation of a dose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tolerance {
    /// Accepted shortfall, >= 0 and less than the target.
    pub lower: f64,
    /// Accepted excess, >= 0; together they are more than 0 and at least one display step of the
    /// balance.
    pub upper: f64,
    /// `mg`, `g`, or `%` of the target.
    pub unit: String,
}

/// A weighing with its ticks, even while it runs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WeighingDetail {
    /// The weighing.
    pub weighing: Weighing,
    /// Actions of the bench and balance readings, in order.
    pub ticks: Vec<Tick>,
    /// Why ticks are missing: their file is missing or damaged. The weighing itself is not
    /// affected.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trace_lost: Option<String>,
    /// Who stopped it, and when; absent if nobody did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stopped: Option<Stopped>,
}

impl App {
    /// Commits the intent to weigh; the bench moves later. `true`: the key was used before with the
    /// same request, and this is the weighing it created.
    ///
    /// # Errors
    /// `Invalid`, `Unprocessable` (the key belongs to another request), `Busy` (64 are waiting),
    /// `Conflict` (`calibration_missing`).
    pub async fn start_weighing(
        &self,
        request: WeighingRequest,
        idempotency_key: &str,
    ) -> Result<(Weighing, bool)> {
        no_probe(&request.asked)?;
        self.commit_request(request, idempotency_key).await
    }

    /// Validates a request for a dose and makes every choice that it leaves open.
    pub(super) async fn plan_dose(
        &self,
        request: WeighingRequest,
    ) -> Result<(WeighRequest, String)> {
        no_probe(&request.asked)?;
        if request.bench_name.is_some() {
            let advice = "must be absent from a list, which is weighed on the bench of the service that gets it: leave it out, or ask for the weighing alone";
            return Err(FieldError::new("bench_name", advice).into());
        }
        self.plan(request).await
    }

    /// As `start_weighing`, for a request that may ask to probe the powder.
    pub(super) async fn commit_request(
        &self,
        request: WeighingRequest,
        idempotency_key: &str,
    ) -> Result<(Weighing, bool)> {
        check_key(idempotency_key)?;
        let sha256 = request_sha256(&request)?;
        if let Some(first) = self.store().weighing_by_key(idempotency_key).await? {
            return replay(first, &sha256, idempotency_key);
        }
        match self.send_weighing(request, idempotency_key).await? {
            Ok(sent) => Ok(sent),
            Err(request) => self.commit_here(request, idempotency_key).await,
        }
    }

    /// As [`App::commit_request`], on the bench of this process, whichever the request names.
    pub(super) async fn commit_here(
        &self,
        request: WeighingRequest,
        idempotency_key: &str,
    ) -> Result<(Weighing, bool)> {
        let request_sha256 = request_sha256(&request)?;
        self.check_reservation(request.reservation.as_deref())?;
        let reservation = request.reservation.clone();
        let (request, parameter_set) = self.plan(request).await?;
        let key = idempotency_key.to_owned();
        let intent =
            Intent { id: new_id(), idempotency_key: key, request_sha256, request, parameter_set };
        self.commit(intent, reservation.as_deref()).await
    }

    /// Validates a request and makes every choice that it leaves open.
    async fn plan(&self, request: WeighingRequest) -> Result<(WeighRequest, String)> {
        let step_mg = self.jobs_or_refuse()?.bench().readability_mg();
        let dose = match request.asked.probe {
            Some(_) => None,
            None => Some(provable(&request, step_mg)?),
        };
        check_asked(&request.asked)?;
        let labels = written(request.labels)?;
        if request.asked.on_overdose != OnOverdose::Stop
            && !self.jobs_or_refuse()?.bench().exchanges_vials()
        {
            let advice = "must be `stop`: this bench cannot exchange vials by itself";
            return Err(FieldError::new("asked.on_overdose", advice).into());
        }
        let powder = self.powder_of("powder", &request.powder).await?.id;
        let every = PageQuery::first(LIST_LIMIT_MAX).window(LIST_LIMIT_MAX)?;
        let extended = self.extended(request.simulator.as_deref(), &request.conditions).await?;
        let day = extended
            .as_ref()
            .map(|(under, extended)| extended.at(Some(&powder), &under.conditions));
        let patch = day.transpose().map_err(Error::Invalid)?.unwrap_or_default();
        let under = extended.map(|it| it.0);
        let simulator = under.as_ref().map(|under| under.simulator.as_str());
        let sets = self.store().sets_under(&powder, simulator, every).await?.items;
        let bench = self.jobs_or_refuse()?.bench();
        let Some(capacity_mg) = bench.spoon_holds_mg(sets.iter().map(|set| &set.parameters)) else {
            return Err(self.uncalibrated(&powder, simulator).await?);
        };
        let fills = bench.fills_spoon();
        let probed = request.asked.probe.filter(|_| fills).map_or(1, |probe| probe.spoonfuls);
        let (target_mg, tolerance) = dose
            .unwrap_or_else(|| (limit_mg(request.target.value, probed, capacity_mg), (0.0, 0.0)));
        let too_much = too_much(target_mg, capacity_mg, &powder, fills);
        if let Some(message) = too_much.filter(|_| dose.is_some()) {
            let own = match bench.kind() == BenchKind::Devices && bench.spoon_is_usual() {
                true => ", or write what yours holds under [spoon] in the bench file",
                false => "",
            };
            let advice = format!("{message}: {IN_PORTIONS}{own}");
            return Err(FieldError::new("target.value", advice).into());
        }
        let named = request.policy.as_deref();
        let policy = self.policy_for(&powder, under.as_ref(), named).await?;
        let seed = match request.seed {
            Some(seed) => seed,
            // 53 bits, which every JSON reader preserves exactly.
            None => SysRng.try_next_u64().map_err(|error| Error::Internal(error.into()))? >> 11,
        };
        let set = choose_set(sets, &policy, request.asked.lot.as_deref(), seed);
        let (tolerance_lower_mg, tolerance_upper_mg) = tolerance;
        let policy = policy.id;
        let (asked, vial_check) = (request.asked, request.vial_check);
        let request = WeighRequest {
            powder,
            target_mg,
            tolerance_lower_mg,
            tolerance_upper_mg,
            policy,
            seed,
            under,
            patch,
            asked,
            labels,
            vial_check,
        };
        Ok((request, set))
    }

    async fn policy_for(
        &self,
        powder: &str,
        under: Option<&Under>,
        named: Option<&str>,
    ) -> Result<Policy> {
        let id = match named {
            Some(id) => id.to_owned(),
            None => {
                let shipped = &shipped().id;
                let best = self.store().best_policy(powder, under, shipped).await?;
                best.unwrap_or_else(|| shipped.clone())
            }
        };
        self.store().policy(&id).await?.ok_or_else(|| {
            FieldError::new(
                "policy",
                format!("there is no policy `{id}`: GET /v1/policies lists them"),
            )
            .into()
        })
    }

    /// Commits the intent: from here on a repeated request finds this weighing. Anything that may
    /// have changed since validation is checked again within the transaction.
    async fn commit(&self, intent: Intent, reservation: Option<&str>) -> Result<(Weighing, bool)> {
        let bench = self.jobs_or_refuse()?.bench();
        let mut tx = self.store().write().await?;
        if let Some(first) = tx.weighing_by_key(&intent.idempotency_key).await? {
            return replay(first, &intent.request_sha256, &intent.idempotency_key);
        }
        if let Some(why) = tx.may_use_bench(reservation, now()).await? {
            return Err(refused(why));
        }
        if let Some(latch) = bench.standing().latch {
            return Err(latched(&latch));
        }
        if tx.planned_weighings().await? >= WAITING_MAX {
            let advice = format!(
                "{WAITING_MAX} weighings are waiting for the bench: try again when some are done"
            );
            return Err(Error::Busy(advice));
        }
        let weighing = tx.insert_weighing(&intent, now()).await?;
        tx.commit().await?;
        bench.planned().await;
        Ok((weighing, false))
    }

    /// One weighing with its ticks.
    pub async fn weighing(&self, id: &str) -> Result<WeighingDetail> {
        let row =
            self.store().weighing(id).await?.ok_or_else(|| Error::not_found("weighing", id))?;
        let (ticks, trace_lost) = match &row.trace {
            Some(trace) => match self.stored_ticks(trace).await {
                Ok(ticks) => (ticks, None),
                Err(Error::Lost(why)) => (Vec::new(), Some(why)),
                Err(error) => return Err(error),
            },
            None => (self.store().live_ticks(id).await?, None),
        };
        let stopped = self.store().stop_of(id).await?;
        Ok(WeighingDetail { weighing: row.weighing, ticks, trace_lost, stopped })
    }

    pub(super) async fn stored_ticks(&self, trace: &str) -> Result<Vec<Tick>> {
        let bytes = self.store().artifacts().get(trace).await;
        let bytes = bytes.map_err(|error| Error::of_part(TRACE, error))?;
        // Its hash is correct, so it was written like this.
        serde_json::from_slice(&bytes).map_err(|error| Error::Internal(error.into()))
    }

    /// Only the ticks of a weighing.
    ///
    /// # Errors
    /// `NotFound`; `Lost`.
    pub async fn trace(&self, id: &str) -> Result<Vec<Tick>> {
        let WeighingDetail { ticks, trace_lost, .. } = self.weighing(id).await?;
        trace_lost.map_or(Ok(ticks), |why| Err(Error::Lost(why)))
    }
}

/// The error while nobody may use the bench until a person has checked it.
pub(super) fn latched(latch: &Latch) -> Error {
    let advice = format!(
        "the bench is latched since {}: {}. Look at spoon, vial and balance, then clear it (page, `flip bench clear`, POST /v1/bench/clear)",
        latch.at, latch.reason
    );
    Error::conflict("bench_latched", advice)
}

/// Checks the purpose and circumstances of a weighing; returns all errors.
fn check_asked(asked: &Asked) -> Result<()> {
    let mut check = Check::default();
    for (field, text) in [
        ("lot", &asked.lot),
        ("vial", &asked.vial),
        ("operator", &asked.operator),
        ("list", &asked.list),
        ("position", &asked.position),
    ] {
        if let Some(text) = text {
            check.text(&format!("asked.{field}"), text, 200);
        }
    }
    for (field, value, lower, upper, unit) in [
        ("temperature_c", asked.temperature_c, -50.0, 150.0, "degrees C"),
        ("relative_humidity_pct", asked.relative_humidity_pct, 0.0, 100.0, "%"),
        ("accuracy_pct", asked.accuracy_pct, 0.001, 100.0, "%"),
    ] {
        if let Some(value) = value {
            check.keep(bounded(&format!("asked.{field}"), value, lower, upper, unit));
        }
    }
    if let OnOverdose::DiscardAndRetry { max } = asked.on_overdose {
        check.count("asked.on_overdose.max", max, 1, 5);
    }
    check_items(&mut check, "asked.checked", &asked.checked);
    check.done()
}

/// Target and tolerances in mg, or all errors in them.
fn masses(request: &WeighingRequest) -> Result<(f64, (f64, f64))> {
    let mut check = Check::default();
    let in_mg = |unit: &str| match unit {
        "mg" => Some(1.0),
        "g" => Some(1000.0),
        _ => None,
    };
    let target_mg =
        match in_mg(&request.target.unit) {
            Some(factor) => {
                let value = request.target.value * factor;
                let checked = bounded("target.value", value, TARGET_MG_MIN, f64::MAX, "mg");
                let advice = "must be at least 0.1 mg and at most what the spoon holds";
                check.keep(checked.map_err(|error| {
                    FieldError::new(error.field, format!("{advice}, got {value} mg"))
                }))
            }
            None => {
                check.refuse(
                    "target.unit",
                    format!("must be `mg` or `g`, got `{}`", shown(&request.target.unit)),
                );
                None
            }
        };
    let factor = match (request.tolerance.unit.as_str(), target_mg) {
        ("%", target) => target.map(|mg| mg / 100.0),
        (unit, _) => in_mg(unit),
    };
    if factor.is_none() && request.tolerance.unit != "%" {
        check.refuse(
            "tolerance.unit",
            format!("must be `mg`, `g` or `%`, got `{}`", shown(&request.tolerance.unit)),
        );
    }
    for (field, value) in
        [("tolerance.lower", request.tolerance.lower), ("tolerance.upper", request.tolerance.upper)]
    {
        let limit = factor.zip(target_mg).map_or(f64::MAX, |(factor, target)| target / factor);
        if !(value.is_finite() && (0.0..=limit).contains(&value)) {
            check.refuse(
                field,
                format!(
                    "must be from 0 to the target itself, got {value} {}",
                    shown(&request.tolerance.unit)
                ),
            );
        }
    }
    check.done()?;
    let (Some(target_mg), Some(factor)) = (target_mg, factor) else {
        unreachable!("checked above")
    };
    Ok((target_mg, (request.tolerance.lower * factor, request.tolerance.upper * factor)))
}

/// Target and tolerances of a dose, mg, that a display with this step can show.
fn provable(request: &WeighingRequest, step_mg: Option<f64>) -> Result<(f64, (f64, f64))> {
    let (target_mg, tolerance) = masses(request)?;
    super::provable::check(target_mg, tolerance, step_mg)?;
    Ok((target_mg, tolerance))
}

/// A caller's text for use in a message: short, and without control characters.
fn shown(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(20).collect()
}

/// One of the powder's sets: among those that the policy has not met, if there are any. All doses of
/// a lot have the same, as one powder has; a dose without a lot draws its own by its seed.
fn choose_set(sets: Vec<CalibratedSet>, policy: &Policy, lot: Option<&str>, seed: u64) -> String {
    let mut sets = unmet(sets, policy);
    // By content rather than by age, so that the choice is the same in every data folder that has
    // the same sets.
    sets.sort_by(|a, b| a.id.cmp(&b.id));
    let index = derive(lot.map_or(seed, index_of), &[SET_CHOICE]) % sets.len() as u64;
    sets.swap_remove(index as usize).id
}

/// Most spoonfuls that a target may take.
const SPOONFULS_MAX: f64 = 40.0;
/// Largest target in several spoonfuls, mg.
pub(super) const TARGET_MG_MAX: f64 = 1000.0;

/// Why a target is too large for a bench whose spoon holds so much, if it is. `fills`: the bench
/// fills the spoon by itself, during a dose too.
fn too_much(target_mg: f64, capacity_mg: f64, powder: &str, fills: bool) -> Option<String> {
    let most_mg = match fills {
        true => (SPOONFULS_MAX * capacity_mg).min(TARGET_MG_MAX).max(capacity_mg),
        false => capacity_mg,
    };
    let holds = match fills {
        true => format!("the spoon holds {capacity_mg:.1} mg of `{powder}`"),
        false => format!("which is what the spoon holds of `{powder}`"),
    };
    (target_mg > most_mg)
        .then(|| format!("must be at most {most_mg:.1} mg, {holds}, got {target_mg} mg"))
}

#[cfg(test)]
mod tests {
    use super::too_much;

    #[test]
    fn a_bench_that_fills_its_spoon_weighs_up_to_a_gram_and_any_other_what_the_spoon_holds() {
        let said = |target_mg, capacity_mg, fills| too_much(target_mg, capacity_mg, "salt", fills);
        assert_eq!((said(37.0, 37.0, false), said(500.0, 37.0, true)), (None, None));
        let one = said(38.0, 37.0, false).unwrap();
        assert_eq!(
            one,
            "must be at most 37.0 mg, which is what the spoon holds of `salt`, got 38 mg"
        );
        let gram = said(1001.0, 37.0, true).unwrap();
        assert!(gram.contains("at most 1000.0 mg, the spoon holds 37.0 mg"), "{gram}");
        assert!(said(500.0, 5.0, true).unwrap().contains("at most 200.0 mg"));
        assert_eq!(said(1500.0, 2000.0, true), None);
    }
}
