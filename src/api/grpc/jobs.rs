//! `flip.v1.Jobs`.

use super::convert::{all, named, page};
use super::proto::*;
use super::{EventStream, Service, after, read, watch, write};
use crate::app::Topic;
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl jobs_server::Jobs for Service {
    async fn list_jobs(
        &self,
        request: Request<ListJobsRequest>,
    ) -> Result<Response<ListJobsResponse>, Status> {
        let ListJobsRequest { page: wanted, kind, state } = read(request)?;
        let kind = named::<JobKind, _>("kind", kind.unwrap_or_default())?;
        let state = named::<JobState, _>("state", state.unwrap_or_default())?;
        let found = self.app.jobs(kind, state, page(wanted)).await?;
        Ok(Response::new(ListJobsResponse { items: all(found.items), next: found.next }))
    }

    async fn get_job(&self, request: Request<GetJobRequest>) -> Result<Response<Job>, Status> {
        Ok(Response::new(self.app.job(&read(request)?.id).await?.into()))
    }

    async fn cancel_job(
        &self,
        request: Request<CancelJobRequest>,
    ) -> Result<Response<Job>, Status> {
        Ok(Response::new(self.app.cancel_job(&write(request)?.id).await?.into()))
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
