//! `flip.v1.Jobs`.

use super::convert::{all, at, card_of, named, page};
use super::proto::*;
use super::{EventStream, Service, after, read, watch, write};
use crate::api::problem::Problem;
use crate::app::{self, JobsWanted, LabelWanted, Topic};
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl jobs_server::Jobs for Service {
    async fn list_jobs(
        &self,
        request: Request<ListJobsRequest>,
    ) -> Result<Response<ListJobsResponse>, Status> {
        let ListJobsRequest { page: wanted, kind, state, label } = read(request)?;
        let kind = named::<JobKind, _>("kind", kind.unwrap_or_default())?;
        let state = named::<JobState, _>("state", state.unwrap_or_default())?;
        let label = LabelWanted::among(label.as_deref()).map_err(Problem::from)?;
        let found = self.app.jobs(JobsWanted { kind, state, label }, page(wanted)).await?;
        let found = self.app.all_labelled(found).await?;
        Ok(Response::new(ListJobsResponse { items: all(found.items), next: found.next }))
    }

    async fn list_job_times(
        &self,
        request: Request<ListJobTimesRequest>,
    ) -> Result<Response<ListJobTimesResponse>, Status> {
        read(request)?;
        Ok(Response::new(ListJobTimesResponse { items: all(self.app.job_times().await?) }))
    }

    async fn list_workers(
        &self,
        request: Request<ListWorkersRequest>,
    ) -> Result<Response<ListWorkersResponse>, Status> {
        read(request)?;
        Ok(Response::new(ListWorkersResponse { items: all(self.app.workers().await?) }))
    }

    async fn get_job(&self, request: Request<GetJobRequest>) -> Result<Response<Job>, Status> {
        let found = self.app.job(&read(request)?.id).await?;
        Ok(Response::new(self.app.labelled(found).await?.into()))
    }

    async fn cancel_job(
        &self,
        request: Request<CancelJobRequest>,
    ) -> Result<Response<Job>, Status> {
        Ok(Response::new(self.app.cancel_job(&write(request)?.id).await?.into()))
    }

    async fn start_job_again(
        &self,
        request: Request<StartJobAgainRequest>,
    ) -> Result<Response<StartJobResponse>, Status> {
        let StartJobAgainRequest { id, device } = write(request)?;
        let device = named::<Device, _>("device", device.unwrap_or_default())?;
        Ok(Response::new(self.app.start_again(&id, device).await?.into()))
    }

    type WatchJobStream = EventStream;

    async fn watch_job(
        &self,
        request: Request<WatchRequest>,
    ) -> Result<Response<EventStream>, Status> {
        let WatchRequest { id, after_seq } = read(request)?;
        let events = self.app.events(Topic::Job(id), after(after_seq)?).await?;
        Ok(Response::new(watch(events)))
    }
}

impl From<app::JobTimes> for JobTimes {
    fn from(it: app::JobTimes) -> Self {
        let app::JobTimes { sort, n, lower_s, median_s, upper_s } = it;
        let kind = JobKind::from(sort.kind).into();
        Self { kind, method: sort.method, n, lower_s, median_s, upper_s }
    }
}

impl From<app::Worker> for Worker {
    fn from(it: app::Worker) -> Self {
        Self {
            id: it.id,
            name: it.name,
            version: it.version,
            kinds: it.kinds.into_iter().map(|kind| JobKind::from(kind).into()).collect(),
            threads: it.threads,
            serves: it.serves,
            started_at: at(it.started_at),
            heard_at: at(it.heard_at),
            ended_at: it.ended_at.and_then(at),
            jobs: it.jobs,
            card: it.card,
        }
    }
}

impl From<app::Job> for Job {
    fn from(j: app::Job) -> Self {
        Self {
            id: j.id,
            kind: JobKind::from(j.kind).into(),
            state: JobState::from(j.state).into(),
            fraction: j.progress.fraction,
            message: j.progress.message,
            attempts: j.attempts,
            cancelling: j.cancelling,
            created_at: at(j.created_at),
            started_at: j.started_at.and_then(at),
            finished_at: j.finished_at.and_then(at),
            error: j.error,
            label: None,
            powders: j.subject.powders,
            policy: j.subject.policy,
            repose_deg: j.subject.repose_deg,
            device: card_of(j.subject.device),
            left_s: j.left_s,
            place: j.place,
            expected_s: j.expected_s,
            again_of: j.again_of,
            labels: j.labels.0.into_iter().collect(),
        }
    }
}
