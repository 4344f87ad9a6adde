//! CancelController: a dose is stopped, a job is cancelled.

use super::error::{Call, unanswered};
use super::feature::CANCEL;
use super::proto::sila2::org::silastandard::core::commands::cancelcontroller::v1::*;
use super::{Sila, begun_here, operate};
use crate::app::{Error, JobKind, JobState, JobsWanted, LIST_LIMIT_MAX, PageQuery};
use cancel_controller_server::CancelController;
use tonic::{Request, Response, Status};

const CANCEL_COMMAND: Call =
    Call { feature: CANCEL, command: "CancelCommand", parameters: &[], errors: &[] };

/// Kinds of jobs that are commands here.
const KINDS: [JobKind; 3] = [JobKind::Repose, JobKind::Calibration, JobKind::Investigation];

#[tonic::async_trait]
impl CancelController for Sila {
    async fn cancel_command(
        &self,
        request: Request<CancelCommandParameters>,
    ) -> Result<Response<CancelCommandResponses>, Status> {
        let asked = operate(request)?;
        let id = asked.command_execution_uuid.and_then(|it| it.uuid);
        self.cancel(&CANCEL_COMMAND.text("CommandExecutionUUID", id)?).await?;
        Ok(Response::new(CancelCommandResponses {}))
    }

    async fn cancel_all(
        &self,
        request: Request<CancelAllParameters>,
    ) -> Result<Response<CancelAllResponses>, Status> {
        operate(request)?;
        for id in self.under_way().await? {
            self.cancel(&id).await?;
        }
        Ok(Response::new(CancelAllResponses {}))
    }
}

impl Sila {
    /// Stops a dose or cancels a job; one that has ended stays as it is.
    async fn cancel(&self, id: &str) -> Result<(), Status> {
        match self.app.stop_weighing(id).await {
            Ok(_) | Err(Error::Conflict { code: "weighing_finished", .. }) => return Ok(()),
            Err(Error::NotFound { .. }) => {}
            Err(error) => return Err(CANCEL_COMMAND.refused(error)),
        }
        match self.app.cancel_job(id).await {
            Ok(_) | Err(Error::Conflict { code: "job_finished", .. }) => Ok(()),
            Err(Error::NotFound { .. }) => {
                let message = "there is no execution with this UUID";
                Err(CANCEL_COMMAND.defined("InvalidCommandExecutionUUID", message))
            }
            Err(error) => Err(CANCEL_COMMAND.refused(error)),
        }
    }

    /// Executions that have not ended: the dose in motion first, then the others of the bench from
    /// the last to the first, so that none begins in between. What other interfaces began is theirs.
    async fn under_way(&self) -> Result<Vec<String>, Status> {
        let bench = self.app.bench().await.map_err(unanswered)?;
        let waiting = bench.waiting.into_iter().rev().map(|it| it.id);
        let (mut all, own) = (Vec::new(), begun_here());
        for id in bench.moving.into_iter().chain(waiting) {
            let found = self.app.weighing(&id).await.map_err(unanswered)?;
            if own.is_among(&found.weighing.labels) {
                all.push(id);
            }
        }
        for kind in KINDS {
            for state in [JobState::Queued, JobState::Running] {
                let page = PageQuery::first(LIST_LIMIT_MAX);
                let wanted =
                    JobsWanted { kind: Some(kind), state: Some(state), label: Some(own.clone()) };
                let jobs = self.app.jobs(wanted, page).await;
                all.extend(jobs.map_err(unanswered)?.items.into_iter().map(|job| job.id));
            }
        }
        Ok(all)
    }
}
