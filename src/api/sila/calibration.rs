//! PowderCalibration.

use super::error::{Call, unanswered};
use super::execution::{Values, confirmation, job_info, job_values, succeeded};
use super::feature::CALIBRATION;
use super::proto::sila2::flip::flowability::powdercalibration::v1::*;
use super::standard::{CommandConfirmation, CommandExecutionUuid, ExecutionInfo};
use super::value::{boolean, integer, json, text};
use super::{Sila, of_sila, operate};
use crate::api::wire::Answer;
use crate::app::{CalibrationMethod, CalibrationRequest, Job, JobKind, JobState};
use powder_calibration_server::PowderCalibration;
use tonic::{Request, Response, Status};

const CALIBRATE: Call = Call {
    feature: CALIBRATION,
    command: "Calibrate",
    parameters: &[
        ("powder", "Powder"),
        ("sets", "Sets"),
        ("tolerance_deg", "Tolerance"),
        ("particles", "Particles"),
        ("trials_max", "TrialsMax"),
        ("seed", "Seed"),
    ],
    errors: &[("measurement_missing", "MeasurementMissing")],
};

#[tonic::async_trait]
impl PowderCalibration for Sila {
    async fn calibrate(
        &self,
        request: Request<CalibrateParameters>,
    ) -> Result<Response<CommandConfirmation>, Status> {
        let request = asked(operate(request)?)?;
        let started = self.app.start_calibration(request).await;
        Ok(confirmation(started.map_err(|error| CALIBRATE.refused(error))?.0.id))
    }

    type Calibrate_InfoStream = Values<ExecutionInfo>;

    async fn calibrate_info(
        &self,
        request: Request<CommandExecutionUuid>,
    ) -> Result<Response<Values<ExecutionInfo>>, Status> {
        job_info(self, request.into_inner(), JobKind::Calibration).await
    }

    type Calibrate_IntermediateStream = Values<CalibrateIntermediateResponses>;

    async fn calibrate_intermediate(
        &self,
        request: Request<CommandExecutionUuid>,
    ) -> Result<Response<Values<CalibrateIntermediateResponses>>, Status> {
        job_values(self, request.into_inner(), JobKind::Calibration, |job| {
            CalibrateIntermediateResponses { message: text(&job.progress.message) }
        })
        .await
    }

    async fn calibrate_result(
        &self,
        request: Request<CommandExecutionUuid>,
    ) -> Result<Response<CalibrateResponses>, Status> {
        let id = request.into_inner().value;
        succeeded(&self.app, &id, JobKind::Calibration, ended).await?;
        let found = self.app.calibration(&id).await.map_err(unanswered)?;
        let sets = found.result.as_ref().map_or(0, |it| it.sets.len());
        let reached = found.result.as_ref().is_some_and(|it| it.reached);
        Ok(Response::new(CalibrateResponses {
            sets: integer(sets as i64),
            reached: boolean(reached),
            calibration: text(json(&found.wire())),
        }))
    }
}

fn asked(asked: CalibrateParameters) -> Result<CalibrationRequest, Status> {
    let method = match CALIBRATE.text("Method", asked.method)?.as_str() {
        "emulator" => CalibrationMethod::Emulator,
        "paper" => CalibrationMethod::Paper,
        "sequential" => CalibrationMethod::Sequential,
        _ => {
            return Err(CALIBRATE.invalid("Method", "must be `emulator`, `paper` or `sequential`"));
        }
    };
    let tolerance_deg = CALIBRATE.real("Tolerance", asked.tolerance)?;
    Ok(CalibrationRequest {
        powder: Some(CALIBRATE.text("Powder", asked.powder)?),
        method: Some(method),
        sets: CALIBRATE.count("Sets", asked.sets)?,
        tolerance_deg: Some(tolerance_deg).filter(|deg| *deg != 0.0),
        particles: CALIBRATE.count("Particles", asked.particles)?,
        trials_max: CALIBRATE.count("TrialsMax", asked.trials_max)?,
        seed: CALIBRATE.count("Seed", asked.seed)?.map(u64::from),
        labels: of_sila(),
        ..CalibrationRequest::default()
    })
}

/// The error of a calibration that ended without a result.
fn ended(job: &Job) -> Status {
    match job.state {
        JobState::Cancelled => {
            CALIBRATE.defined("CalibrationCancelled", "the calibration was cancelled")
        }
        _ => CALIBRATE.defined("CalibrationFailed", job.error.as_deref().unwrap_or_default()),
    }
}
