//! Probing runs: a few spoonfuls, shaken to see how a powder flows. Each is a weighing whose target
//! is the most that may fall; what falls is discarded.

use super::check::Check;
use super::weighings::TARGET_MG_MAX;
use super::{App, Result, Target, Tolerance, WeighingRequest};
use flip_core::domain::conditions::Conditions;
use flip_core::domain::labels::Labels;
use flip_core::domain::vial::VialCheck;
use flip_core::domain::weighing::{Asked, OnOverdose, PROBE_SPOONFULS_MAX, Probe};
use flip_core::domain::{FieldError, bounded};
use flip_store::weighings::Weighing;
use serde::Serialize;

/// Spoonfuls of a probing run: one for each stroke.
const SPOONFULS: u32 = 3;
/// Smallest limit, mg.
const LIMIT_MG_MIN: f64 = 1.0;

/// Which powder to probe.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CharacterisationRequest {
    /// Powder id.
    pub powder: String,
    /// Fillings of the spoon, 1 to 9; default 3. A bench where a person fills the spoon makes one.
    pub spoonfuls: Option<u32>,
    /// Most that may fall altogether, mg, 1 to 1000; default one spoonful more than are made.
    pub limit_mg: Option<f64>,
    /// Policy id, which sets the range of the pitch; default as for a weighing.
    pub policy: Option<String>,
    /// Seed of the simulated bench; by default each run gets its own.
    pub seed: Option<u64>,
    /// Extended simulator version, `sv-…`; default the base.
    pub simulator: Option<String>,
    /// Conditions of the version on the simulated bench.
    pub conditions: Conditions,
    /// Lot of the powder.
    pub lot: Option<String>,
    /// Label of the vial on the pan; it is discarded afterwards.
    pub vial: Option<String>,
    /// Name of the operator.
    pub operator: Option<String>,
    /// Whether a person must confirm that the vial is in, where the bench cannot exchange vials.
    pub vial_check: VialCheck,
    /// The bench reservation under which the request is made, `rs-…`, if any.
    pub reservation: Option<String>,
    /// What the caller writes on it, to find it again.
    pub labels: Labels,
}

impl App {
    /// Commits the intent to probe a powder; the bench moves later. It is a weighing like any other
    /// until it ends as `probed`. `true`: the key was used before with the same request.
    ///
    /// # Errors
    /// As for [`App::start_weighing`].
    pub async fn characterise(
        &self,
        request: CharacterisationRequest,
        idempotency_key: &str,
    ) -> Result<(Weighing, bool)> {
        self.commit_request(request.checked()?, idempotency_key).await
    }
}

impl CharacterisationRequest {
    /// As a weighing, with a target of 0 for the default limit.
    fn checked(self) -> Result<WeighingRequest> {
        let spoonfuls = self.spoonfuls.unwrap_or(SPOONFULS);
        let mut check = Check::default();
        check.count("spoonfuls", spoonfuls, 1, PROBE_SPOONFULS_MAX);
        if let Some(limit_mg) = self.limit_mg {
            check.keep(bounded("limit_mg", limit_mg, LIMIT_MG_MIN, TARGET_MG_MAX, "mg"));
        }
        check.done()?;
        let mg = || "mg".to_owned();
        Ok(WeighingRequest {
            powder: self.powder,
            target: Target { value: self.limit_mg.unwrap_or(0.0), unit: mg() },
            tolerance: Tolerance { lower: 0.0, upper: 0.0, unit: mg() },
            policy: self.policy,
            seed: self.seed,
            simulator: self.simulator,
            conditions: self.conditions,
            asked: Asked {
                lot: self.lot,
                vial: self.vial,
                operator: self.operator,
                on_overdose: OnOverdose::Stop,
                probe: Some(Probe { spoonfuls }),
                ..Asked::default()
            },
            vial_check: self.vial_check,
            labels: self.labels,
            reservation: self.reservation,
            bench_name: None,
        })
    }
}

/// Most that may fall, mg: as asked for; for 0 one spoonful more than are made, so that the guard
/// need not make strokes gentler for a spoon that cannot reach the limit.
pub(super) fn limit_mg(asked_mg: f64, spoonfuls: u32, capacity_mg: f64) -> f64 {
    let usual_mg = (f64::from(spoonfuls) + 1.0) * capacity_mg;
    if asked_mg > 0.0 { asked_mg } else { usual_mg.ceil().min(TARGET_MG_MAX) }
}

/// Refuses a request to weigh that asks to probe.
pub(super) fn no_probe(asked: &Asked) -> Result<()> {
    let advice = "must be absent from a weighing: POST /v1/characterisations probes a powder";
    match asked.probe {
        Some(_) => Err(FieldError::new("asked.probe", advice).into()),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_default_a_spoonful_more_than_are_made_may_fall_and_never_more_than_a_gram() {
        assert_eq!((limit_mg(0.0, 3, 36.4), limit_mg(0.0, 1, 36.4)), (146.0, 73.0));
        assert_eq!((limit_mg(20.0, 3, 36.4), limit_mg(0.0, 3, 500.0)), (20.0, 1000.0));
    }
}
