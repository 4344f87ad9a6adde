//! SimulatorDiscovery.

use super::error::{Call, unanswered};
use super::execution::{Values, confirmation, job_info, job_values, succeeded};
use super::feature::DISCOVERY;
use super::proto::sila2::flip::discovery::simulatordiscovery::v1::*;
use super::standard::{CommandConfirmation, CommandExecutionUuid, ExecutionInfo};
use super::value::{json, real, text};
use super::{Sila, of_sila, operate, read};
use crate::api::journal::word;
use crate::api::wire::Answer;
use crate::app::{InvestigationRequest, Job, JobKind, JobState, table_text};
use simulator_discovery_server::SimulatorDiscovery;
use tonic::{Request, Response, Status};

const INVESTIGATE: Call = Call {
    feature: DISCOVERY,
    command: "Investigate",
    parameters: &[
        ("simulations", "Simulations"),
        ("budget_runs", "Heaps"),
        ("seed", "Seed"),
        ("measurements", "Campaign"),
        ("row", "Campaign"),
        ("powder", "Campaign"),
        ("header", "Campaign"),
    ],
    errors: &[],
};

#[tonic::async_trait]
impl SimulatorDiscovery for Sila {
    async fn investigate(
        &self,
        request: Request<InvestigateParameters>,
    ) -> Result<Response<CommandConfirmation>, Status> {
        let request = self.investigation(operate(request)?)?;
        let started = self.app.start_investigation(request).await;
        Ok(confirmation(started.map_err(|error| INVESTIGATE.refused(error))?.0.id))
    }

    type Investigate_InfoStream = Values<ExecutionInfo>;

    async fn investigate_info(
        &self,
        request: Request<CommandExecutionUuid>,
    ) -> Result<Response<Values<ExecutionInfo>>, Status> {
        job_info(self, request.into_inner(), JobKind::Investigation).await
    }

    type Investigate_IntermediateStream = Values<InvestigateIntermediateResponses>;

    async fn investigate_intermediate(
        &self,
        request: Request<CommandExecutionUuid>,
    ) -> Result<Response<Values<InvestigateIntermediateResponses>>, Status> {
        job_values(self, request.into_inner(), JobKind::Investigation, |job| {
            InvestigateIntermediateResponses { message: text(&job.progress.message) }
        })
        .await
    }

    async fn investigate_result(
        &self,
        request: Request<CommandExecutionUuid>,
    ) -> Result<Response<InvestigateResponses>, Status> {
        let id = request.into_inner().value;
        succeeded(&self.app, &id, JobKind::Investigation, ended).await?;
        let found = self.app.investigation(&id).await.map_err(unanswered)?;
        let report = found.report.map_or(String::new(), |report| json(&report.wire()));
        let verdict = found.verdict.as_ref().map(word);
        Ok(Response::new(InvestigateResponses {
            verdict: text(verdict.unwrap_or_default()),
            sentence: text(found.sentence.unwrap_or_default()),
            p_value: real(found.p_value.unwrap_or(1.0)),
            report: Some(self.binaries.answer(report.into_bytes())),
        }))
    }

    async fn get_simulator(
        &self,
        request: Request<GetSimulatorParameters>,
    ) -> Result<Response<GetSimulatorResponses>, Status> {
        read(request)?;
        let current = self.app.current_simulator().await.map_err(unanswered)?;
        Ok(Response::new(GetSimulatorResponses { simulator: text(current.simulator) }))
    }
}

impl Sila {
    fn investigation(&self, asked: InvestigateParameters) -> Result<InvestigationRequest, Status> {
        let campaign = self.binaries.given(&INVESTIGATE, "Campaign", asked.campaign)?;
        let text = table_text(&campaign).map_err(|error| INVESTIGATE.refused(error.into()))?;
        let heaps = INVESTIGATE.integer("Heaps", asked.heaps)?;
        Ok(InvestigationRequest {
            measurements_csv: Some(text).filter(|text| !text.is_empty()),
            simulations: INVESTIGATE.count("Simulations", asked.simulations)?,
            budget_runs: u32::try_from(heaps).ok(),
            seed: INVESTIGATE.count("Seed", asked.seed)?.map(u64::from),
            labels: of_sila(),
            ..InvestigationRequest::default()
        })
    }
}

/// The error of an investigation that ended without a result.
fn ended(job: &Job) -> Status {
    match job.state {
        JobState::Cancelled => {
            INVESTIGATE.defined("InvestigationCancelled", "the investigation was cancelled")
        }
        _ => INVESTIGATE.defined("InvestigationFailed", job.error.as_deref().unwrap_or_default()),
    }
}
