//! `/v1/jobs`: long computations of every kind.

use super::accepted;
use super::answer;
use super::extract::{Path, Query};
use super::list::{LabelledParams, respond};
use super::started;
use super::wait::{WaitParams, waited};
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{
    ArchivedItems, Device, Job, JobKind, JobState, JobTimes, Labelled, Page, Request, Worker,
};
use crate::app::{App, JobsWanted, LabelWanted, Topic};
use axum::Json;
use axum::extract::{OriginalUri, State};
use axum::response::Response;
use serde::Deserialize;

/// Selection of jobs.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct JobParams {
    /// Items on the page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
    /// `next` of the previous page.
    after: Option<String>,
    /// Only jobs of this kind.
    #[param(inline)]
    kind: Option<JobKind>,
    /// Only jobs in this state.
    #[param(inline)]
    state: Option<JobState>,
    /// Only with this label of a caller, as `plate:A7`.
    label: Option<String>,
    /// Whether archived ones are listed.
    #[serde(default)]
    #[param(inline)]
    archived: ArchivedItems,
    /// Only with this tag.
    tag: Option<String>,
}

/// List jobs, newest first.
///
/// Of one kind, state or label, if given. Those that wait have their place in the queue and how
/// long they are expected to take.
#[utoipa::path(get, path = "/v1/jobs", tag = "jobs", params(JobParams),
    responses((status = 200, description = "A page of jobs", body = Page<Labelled<Job>>)))]
pub async fn list_jobs(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<JobParams>,
) -> Result<Response, Problem> {
    let JobParams { limit, after, kind, state, label, archived, tag } = params;
    let page = LabelledParams { limit, after, archived, tag };
    let label = LabelWanted::among(label.as_deref())?;
    let wanted = JobsWanted { kind: kind.means(), state: state.means(), label };
    let found = app.jobs(wanted, page.into()).await?;
    Ok(respond(&uri, app.all_labelled(found).await?))
}

/// How long jobs took on this machine.
///
/// Of each kind, and of calibrations by their method; none of a sort of which none has succeeded.
#[utoipa::path(get, path = "/v1/jobs/times", tag = "jobs",
    responses((status = 200, description = "Quartiles of each sort", body = Vec<JobTimes>)))]
pub async fn list_job_times(
    _: Viewer,
    State(app): State<App>,
) -> Result<Json<Vec<JobTimes>>, Problem> {
    Ok(answer(app.job_times().await?))
}

/// The processes that compute jobs.
///
/// Those of the last week, the one that started last first. One without `ended_at` that has not been
/// heard of for half a minute was lost: its jobs go on elsewhere.
#[utoipa::path(get, path = "/v1/workers", tag = "jobs",
    responses((status = 200, description = "The processes", body = Vec<Worker>)))]
pub async fn list_workers(_: Viewer, State(app): State<App>) -> Result<Json<Vec<Worker>>, Problem> {
    Ok(answer(app.workers().await?))
}

/// One job.
///
/// With `wait` the answer comes once the job has ended, or after so many seconds as it then is.
#[utoipa::path(get, path = "/v1/jobs/{id}", tag = "jobs", params(("id" = String, Path, description = "Job id"), WaitParams),
    responses((status = 200, description = "The job", body = Labelled<Job>)))]
pub async fn get_job(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
    Query(params): Query<WaitParams>,
) -> Result<Response, Problem> {
    let patience = params.checked()?;
    let found = app.job(&id).await?;
    let ended = found.state.is_terminal();
    let now = app.labelled(found).await?;
    Ok(waited(now, patience.filter(|_| !ended), async move |patience| {
        app.wait_for(Topic::Job(id.clone()), patience).await?;
        app.labelled(app.job(&id).await?).await
    }))
}

/// Cancel a job.
///
/// A waiting job is cancelled at once, a running one at its next step.
#[utoipa::path(post, path = "/v1/jobs/{id}/cancel", tag = "jobs", params(("id" = String, Path, description = "Job id")),
    responses((status = 202, description = "The job, cancelling or cancelled", body = Job),
        (status = 409, description = "It has ended", body = Problem, content_type = "application/problem+json")))]
pub async fn cancel_job(
    _: Operator,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    let job = app.cancel_job(&id).await?;
    Ok(accepted(format!("/v1/jobs/{}", job.id), job))
}

/// How a job starts again.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct AgainParams {
    /// `cpu`: compute it on the processor instead of a card. A training whose card failed goes on from
    /// its checkpoint. Left out, the job has the same inputs.
    device: Option<Device>,
}

/// Start a failed or cancelled job again.
///
/// The same inputs, as a new job whose `again_of` is the old one.
#[utoipa::path(post, path = "/v1/jobs/{id}/again", tag = "jobs",
    params(("id" = String, Path, description = "Job id"), AgainParams),
    responses((status = 202, description = "The new job", body = Job,
        headers(("Location" = String, description = "URL of the new job"))),
        (status = 200, description = "An equal job was requested meanwhile: that one", body = Job),
        (status = 409, description = "It did not fail and was not cancelled, was for another simulator, or the bench cannot be used", body = Problem,
            content_type = "application/problem+json")))]
pub async fn start_job_again(
    _: Operator,
    State(app): State<App>,
    Path(id): Path<String>,
    Query(params): Query<AgainParams>,
) -> Result<Response, Problem> {
    let device = params.device.map(Request::means);
    Ok(started("jobs", app.start_again(&id, device).await?))
}
