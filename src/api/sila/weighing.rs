//! PowderWeighing.

use super::error::{Call, not_finished, unanswered};
use super::execution::{Seen, Values, confirmation, follow, is_result, weighing, weighing_info};
use super::feature::WEIGHING;
use super::identity::lock_identifier;
use super::proto::sila2::flip::weighing::powderweighing::v1::*;
use super::standard::{self, CommandConfirmation, CommandExecutionUuid, ExecutionInfo};
use super::value::{boolean, integer, json, real, text};
use super::{Sila, of_sila, operate, read};
use crate::api::journal::word;
use crate::api::wire::Answer;
use crate::app::{
    self, Asked, IN_PORTIONS, LIST_LIMIT_MAX, PageQuery, Target, Tolerance, Topic, VialCheck,
    VialReadyRequest, Weighing, WeighingDetail, WeighingRequest,
};
use flip_core::domain::weighing::Outcome;
use powder_weighing_server::PowderWeighing;
use std::collections::BTreeMap;
use tonic::{Request, Response, Status};

const DOSE: Call = Call {
    feature: WEIGHING,
    command: "DosePowder",
    parameters: &[
        ("powder", "Powder"),
        ("target", "TargetMass"),
        ("tolerance.lower", "LowerTolerance"),
        ("tolerance", "UpperTolerance"),
        ("asked.vial", "Vial"),
        ("asked.lot", "Lot"),
        ("asked.operator", "Operator"),
        ("Idempotency-Key", "DoseIdentifier"),
    ],
    errors: &[
        ("calibration_missing", "PowderNotCalibrated"),
        ("calibration_unfinished", "PowderNotCalibrated"),
        ("measurement_missing", "PowderNotCalibrated"),
        ("bench_latched", "BenchLatched"),
        ("bench_reserved", "BenchReserved"),
        ("reservation_ended", "BenchReserved"),
        ("idempotency_key_reused", "DoseIdentifierReused"),
    ],
};

const CONFIRM: Call = Call {
    feature: WEIGHING,
    command: "ConfirmVial",
    parameters: &[("id", "CommandExecutionUUID"), ("by", "Person"), ("vial", "Vial")],
    errors: &[
        ("not_its_turn", "NotItsTurn"),
        ("vial_differs", "VialDiffers"),
        ("weighing_finished", "WeighingFinished"),
        ("stopped_meanwhile", "StoppedMeanwhile"),
    ],
};

const GET: Call = Call {
    feature: WEIGHING,
    command: "GetWeighing",
    parameters: &[("id", "CommandExecutionUUID")],
    errors: &[],
};

const CERTIFICATE: Call = Call { command: "GetCertificate", ..GET };

#[tonic::async_trait]
impl PowderWeighing for Sila {
    async fn dose_powder(
        &self,
        request: Request<DosePowderParameters>,
    ) -> Result<Response<CommandConfirmation>, Status> {
        let lock = lock_identifier(request.metadata().as_ref())?;
        let asked = operate(request)?;
        let (dose, key) = dose(asked, self.reservation(lock).await?)?;
        let (weighing, _) = self.app.start_weighing(dose, &key).await.map_err(not_begun)?;
        Ok(confirmation(weighing.id))
    }

    type DosePowder_InfoStream = Values<ExecutionInfo>;

    async fn dose_powder_info(
        &self,
        request: Request<CommandExecutionUuid>,
    ) -> Result<Response<Values<ExecutionInfo>>, Status> {
        weighing_info(self, request.into_inner()).await
    }

    type DosePowder_IntermediateStream = Values<DosePowderIntermediateResponses>;

    async fn dose_powder_intermediate(
        &self,
        request: Request<CommandExecutionUuid>,
    ) -> Result<Response<Values<DosePowderIntermediateResponses>>, Status> {
        let id = request.into_inner().value;
        weighing(&self.app, &id).await?;
        let (app, seen, topic) = (self.app.clone(), id.clone(), Topic::Weighing(id.clone()));
        let look = move || {
            let (app, id) = (app.clone(), seen.clone());
            async move { Ok(so_far(&weighing(&app, &id).await?)) }
        };
        let values = follow(&self.app, topic, |_| true, look).await?;
        Ok(self.audience.values(&id, values))
    }

    async fn dose_powder_result(
        &self,
        request: Request<CommandExecutionUuid>,
    ) -> Result<Response<DosePowderResponses>, Status> {
        let id = request.into_inner().value;
        result(weighing(&self.app, &id).await?.weighing)
    }

    async fn confirm_vial(
        &self,
        request: Request<ConfirmVialParameters>,
    ) -> Result<Response<ConfirmVialResponses>, Status> {
        let lock = lock_identifier(request.metadata().as_ref())?;
        let asked = operate(request)?;
        self.reservation(lock).await?;
        let id = CONFIRM.text("CommandExecutionUUID", asked.command_execution_uuid)?;
        let by = CONFIRM.some_text("Person", asked.person)?;
        let vial = CONFIRM.some_text("Vial", asked.vial)?;
        let confirmed = self.app.vial_ready(&id, VialReadyRequest { by, vial }).await;
        confirmed.map_err(|error| CONFIRM.refused(error))?;
        Ok(Response::new(ConfirmVialResponses {}))
    }

    async fn get_weighing(
        &self,
        request: Request<GetWeighingParameters>,
    ) -> Result<Response<GetWeighingResponses>, Status> {
        let id = GET.text("CommandExecutionUUID", read(request)?.command_execution_uuid)?;
        let found = self.app.weighing(&id).await.map_err(|error| GET.refused(error))?.weighing;
        let outcome = found.outcome.as_ref().map(word).unwrap_or_default();
        let state = text(word(&found.state));
        let weighing = text(json(&found.wire()));
        Ok(Response::new(GetWeighingResponses { state, outcome: text(outcome), weighing }))
    }

    async fn get_certificate(
        &self,
        request: Request<GetCertificateParameters>,
    ) -> Result<Response<GetCertificateResponses>, Status> {
        let id = read(request)?.command_execution_uuid;
        let id = CERTIFICATE.text("CommandExecutionUUID", id)?;
        let page = self.app.certificate(&id, None).await;
        let page = page.map_err(|error| CERTIFICATE.refused(error))?;
        let certificate = Some(self.binaries.answer(page.into_bytes()));
        Ok(Response::new(GetCertificateResponses { certificate }))
    }

    async fn get_powders(
        &self,
        request: Request<GetPowdersParameters>,
    ) -> Result<Response<GetPowdersResponses>, Status> {
        read(request)?;
        let (mut powders, mut page) = (Vec::new(), PageQuery::first(LIST_LIMIT_MAX));
        loop {
            let found = self.app.powders(page.clone()).await.map_err(unanswered)?;
            powders.extend(found.items.into_iter().filter_map(|it| text(it.id)));
            match found.next {
                None => return Ok(Response::new(GetPowdersResponses { powders })),
                next => page.after = next,
            }
        }
    }
}

/// A dose, and its key.
fn dose(
    asked: DosePowderParameters,
    reservation: Option<String>,
) -> Result<(WeighingRequest, String), Status> {
    let mg = |value| Target { value, unit: "mg".to_owned() };
    let tolerance = Tolerance {
        lower: DOSE.real("LowerTolerance", asked.lower_tolerance)?,
        upper: DOSE.real("UpperTolerance", asked.upper_tolerance)?,
        unit: "mg".to_owned(),
    };
    let request = WeighingRequest {
        bench_name: None,
        powder: DOSE.text("Powder", asked.powder)?,
        target: mg(DOSE.real("TargetMass", asked.target_mass)?),
        tolerance,
        policy: None,
        seed: None,
        simulator: None,
        conditions: BTreeMap::new(),
        asked: Asked {
            vial: DOSE.some_text("Vial", asked.vial)?,
            lot: DOSE.some_text("Lot", asked.lot)?,
            operator: DOSE.some_text("Operator", asked.operator)?,
            ..Asked::default()
        },
        vial_check: vial_check(asked.vial_check)?,
        reservation,
        labels: of_sila(),
    };
    Ok((request, DOSE.text("DoseIdentifier", asked.dose_identifier)?))
}

fn vial_check(given: Option<standard::String>) -> Result<VialCheck, Status> {
    match DOSE.text("VialCheck", given)?.as_str() {
        "Confirm" => Ok(VialCheck::Confirm),
        "Skip" => Ok(VialCheck::Skip),
        _ => Err(DOSE.invalid("VialCheck", "must be `Confirm` or `Skip`")),
    }
}

/// Why a dose was not begun.
fn not_begun(error: app::Error) -> Status {
    if let app::Error::Invalid(all) = &error {
        let is_too_much =
            |it: &&app::FieldError| it.field == "target.value" && it.message.contains(IN_PORTIONS);
        if let Some(too_much) = all.iter().find(is_too_much) {
            let message = format!("the target {}", too_much.message);
            return DOSE.defined("TargetAboveCapacity", message);
        }
    }
    DOSE.refused(error)
}

fn so_far(detail: &WeighingDetail) -> Seen<DosePowderIntermediateResponses> {
    let tick = detail.ticks.last();
    let weighing = &detail.weighing;
    let shown_mg = tick.map_or(0.0, |tick| tick.reading.mass_mg);
    let value = DosePowderIntermediateResponses {
        mass: real(weighing.reading_mg.unwrap_or(shown_mg)),
        stable: boolean(tick.is_some_and(|tick| tick.reading.stable)),
        state: text(word(&weighing.state)),
        step: integer(tick.map_or(0, |tick| tick.step)),
        spoonful: integer(tick.map_or(0, |tick| tick.spoonful)),
    };
    Seen { value, is_last: weighing.outcome.is_some() }
}

fn result(weighing: Weighing) -> Result<Response<DosePowderResponses>, Status> {
    let Some(outcome) = weighing.outcome else { return Err(not_finished(&weighing.id)) };
    if !is_result(outcome) {
        return Err(failed(outcome, weighing));
    }
    Ok(Response::new(DosePowderResponses {
        outcome: text(word(&outcome)),
        mass: real(weighing.reading_mg.unwrap_or(0.0)),
        deviation: real(weighing.error_mg.unwrap_or(0.0)),
        shakes: integer(weighing.shakes.unwrap_or(0)),
        duration: real(weighing.seconds.unwrap_or(0.0)),
        bench: text(weighing.bench.map_or("", |bench| bench.name())),
        weighing: text(json(&weighing.wire())),
    }))
}

/// The error of a dose that ended otherwise: a sentence, and on the next line the weighing as JSON,
/// because an error has no other fields.
fn failed(outcome: Outcome, weighing: Weighing) -> Status {
    let Weighing { powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, .. } = &weighing;
    let reading = match weighing.reading_mg {
        Some(mg) => format!("the balance shows {mg} mg"),
        None => "no reading of the balance counts".to_owned(),
    };
    let wanted =
        format!("{target_mg} mg (-{tolerance_lower_mg} / +{tolerance_upper_mg}) of {powder}");
    let why = weighing.error.as_deref().map_or(String::new(), |why| format!(": {why}"));
    let (error, sentence) = match outcome {
        Outcome::Over => ("OverTolerance", "too much was dosed"),
        Outcome::Blocked => ("Blocked", "no more powder left the spoon"),
        Outcome::NotStable => ("BalanceNotStable", "the balance did not settle"),
        Outcome::Stopped => ("DoseStopped", "the dose was stopped on request"),
        Outcome::Unknown => (
            "DoseOutcomeUnknown",
            "the process ended during the dose, what is in the vial is unknown, and nothing was poured again",
        ),
        _ => ("DoseAborted", "the dose was aborted"),
    };
    let message = format!("{sentence}{why}; {reading}, wanted were {wanted}");
    DOSE.defined(error, format!("{message}\n{}", json(&weighing.wire())))
}
