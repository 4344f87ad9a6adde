//! AngleOfReposeMeasurement.

use super::error::{Call, unanswered};
use super::execution::{Seen, Values, confirmation, follow, job, job_info, succeeded, unknown};
use super::feature::REPOSE;
use super::identity::lock_identifier;
use super::proto::sila2::flip::flowability::angleofreposemeasurement::v1::*;
use super::standard::{CommandConfirmation, CommandExecutionUuid, ExecutionInfo};
use super::value::{boolean, integer, json, real, text};
use super::{Sila, of_sila, operate, read};
use crate::api::wire::Answer;
use crate::app::{
    FrameUpload, Job, JobKind, JobState, Procedure, ReposeMeasurement, ReposeRequest, Topic,
};
use angle_of_repose_measurement_server::AngleOfReposeMeasurement;
use tonic::{Request, Response, Status};

const MEASURE: Call = Call {
    feature: REPOSE,
    command: "MeasureAngleOfRepose",
    parameters: &[
        ("powder", "Powder"),
        ("run", "Run"),
        ("procedure.repeats", "Piles"),
        ("procedure.frames", "Frames"),
    ],
    errors: &[
        ("no_stand", "NoStand"),
        ("bench_latched", "BenchLatched"),
        ("bench_held", "BenchHeld"),
        ("bench_reserved", "BenchReserved"),
        ("reservation_ended", "BenchReserved"),
        ("calibration_missing", "PowderNotCalibrated"),
    ],
};
const ADD_FRAME: Call = Call {
    feature: REPOSE,
    command: "AddFrame",
    parameters: &[
        ("id", "CommandExecutionUUID"),
        ("depth", "Depth"),
        ("colour", "Colour"),
        ("description", "Description"),
    ],
    errors: &[("no_pile_waits", "NoPileWaits")],
};
const GET_FRAME: Call = Call {
    feature: REPOSE,
    command: "GetFrame",
    parameters: &[("id", "CommandExecutionUUID")],
    errors: &[],
};

#[tonic::async_trait]
impl AngleOfReposeMeasurement for Sila {
    async fn measure_angle_of_repose(
        &self,
        request: Request<MeasureAngleOfReposeParameters>,
    ) -> Result<Response<CommandConfirmation>, Status> {
        let lock = lock_identifier(request.metadata().as_ref())?;
        let wanted = operate(request)?;
        let request = asked(wanted, self.reservation(lock).await?)?;
        let started = self.app.start_repose(request).await;
        Ok(confirmation(started.map_err(|error| MEASURE.refused(error))?.0.id))
    }

    type MeasureAngleOfRepose_InfoStream = Values<ExecutionInfo>;

    async fn measure_angle_of_repose_info(
        &self,
        request: Request<CommandExecutionUuid>,
    ) -> Result<Response<Values<ExecutionInfo>>, Status> {
        job_info(self, request.into_inner(), JobKind::Repose).await
    }

    type MeasureAngleOfRepose_IntermediateStream =
        Values<MeasureAngleOfReposeIntermediateResponses>;

    async fn measure_angle_of_repose_intermediate(
        &self,
        request: Request<CommandExecutionUuid>,
    ) -> Result<Response<Values<MeasureAngleOfReposeIntermediateResponses>>, Status> {
        let id = request.into_inner().value;
        job(&self.app, &id, JobKind::Repose).await?;
        let (app, seen, topic) = (self.app.clone(), id.clone(), Topic::Job(id.clone()));
        let look = move || {
            let (app, id) = (app.clone(), seen.clone());
            async move {
                let found = app.repose(&id).await.map_err(|error| unknown(error, &id))?;
                Ok(so_far(&found))
            }
        };
        let values = follow(&self.app, topic, |_| true, look).await?;
        Ok(self.audience.values(&id, values))
    }

    async fn measure_angle_of_repose_result(
        &self,
        request: Request<CommandExecutionUuid>,
    ) -> Result<Response<MeasureAngleOfReposeResponses>, Status> {
        let id = request.into_inner().value;
        succeeded(&self.app, &id, JobKind::Repose, ended).await?;
        result(self.app.repose(&id).await.map_err(unanswered)?)
    }

    async fn add_frame(
        &self,
        request: Request<AddFrameParameters>,
    ) -> Result<Response<AddFrameResponses>, Status> {
        let asked = operate(request)?;
        let id = ADD_FRAME.text("CommandExecutionUUID", asked.command_execution_uuid)?;
        let frame = FrameUpload {
            depth: self.binaries.given(&ADD_FRAME, "Depth", asked.depth)?,
            colour: self.binaries.given(&ADD_FRAME, "Colour", asked.colour)?,
            description: ADD_FRAME.text("Description", asked.description)?.into_bytes(),
        };
        let added = self.app.add_frame(&id, frame).await;
        let now = added.map_err(|error| ADD_FRAME.refused(error))?;
        let (have, wanted) = (integer(now.have), integer(now.wanted));
        Ok(Response::new(AddFrameResponses { have, wanted }))
    }

    async fn get_frame(
        &self,
        request: Request<GetFrameParameters>,
    ) -> Result<Response<GetFrameResponses>, Status> {
        let asked = read(request)?;
        let id = GET_FRAME.text("CommandExecutionUUID", asked.command_execution_uuid)?;
        let pile = GET_FRAME.count("Pile", asked.pile)?.unwrap_or(0);
        let frame = GET_FRAME.count("Frame", asked.frame)?.unwrap_or(0);
        let part = GET_FRAME.text("Part", asked.part)?;
        let found = self.app.raw_frame(&id, pile, frame, &part).await;
        let found = found.map_err(|error| GET_FRAME.refused(error))?;
        let content = Some(self.binaries.answer(found));
        Ok(Response::new(GetFrameResponses { content }))
    }
}

fn asked(
    asked: MeasureAngleOfReposeParameters,
    reservation: Option<String>,
) -> Result<ReposeRequest, Status> {
    let usual = Procedure::default();
    let procedure = Procedure {
        repeats: MEASURE.count("Piles", asked.piles)?.unwrap_or(usual.repeats),
        frames: MEASURE.count("Frames", asked.frames)?.unwrap_or(usual.frames),
        ..usual
    };
    Ok(ReposeRequest {
        powder: MEASURE.text("Powder", asked.powder)?,
        run: MEASURE.count("Run", asked.run)?,
        procedure,
        reservation,
        labels: of_sila(),
        ..ReposeRequest::default()
    })
}

fn so_far(found: &ReposeMeasurement) -> Seen<MeasureAngleOfReposeIntermediateResponses> {
    let last = found.piles.iter().rev().find_map(|pile| pile.measured);
    let value = MeasureAngleOfReposeIntermediateResponses {
        piles: integer(found.piles.len() as i64),
        angle_of_repose: real(last.map_or(0.0, |angle| angle.tip.deg)),
        message: text(&found.job.progress.message),
    };
    Seen { value, is_last: found.job.state.is_terminal() }
}

fn result(found: ReposeMeasurement) -> Result<Response<MeasureAngleOfReposeResponses>, Status> {
    let missing = || MEASURE.defined("MeasurementFailed", "the measurement has no result");
    let result = found.result.as_ref().ok_or_else(missing)?;
    let (tip, u_deg) = (&result.repeats.tip, result.repeats.tip_u_deg);
    Ok(Response::new(MeasureAngleOfReposeResponses {
        angle_of_repose: real(tip.repose_deg),
        standard_deviation: real(tip.sd_deg),
        uncertainty: real(u_deg),
        piles: integer(tip.n),
        registered: boolean(result.registered),
        measurement: text(json(&found.wire())),
    }))
}

/// The error of a measurement that ended without a result.
fn ended(job: &Job) -> Status {
    match job.state {
        JobState::Cancelled => {
            MEASURE.defined("MeasurementCancelled", "the measurement was cancelled")
        }
        _ => MEASURE.defined("MeasurementFailed", job.error.as_deref().unwrap_or_default()),
    }
}
