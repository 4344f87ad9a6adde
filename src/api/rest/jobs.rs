//! `/v1/jobs`: long computations of every kind.

use super::accepted;
use super::answer;
use super::extract::{Path, Query};
use super::list::respond;
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{Job, JobKind, JobState, Page, Request};
use crate::app::App;
use crate::app::PageQuery;
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
}

/// List jobs, newest first.
#[utoipa::path(get, path = "/v1/jobs", tag = "jobs", params(JobParams),
    responses((status = 200, description = "A page of jobs", body = Page<Job>)))]
pub async fn list_jobs(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<JobParams>,
) -> Result<Response, Problem> {
    let page = PageQuery { limit: params.limit, after: params.after };
    Ok(respond(&uri, app.jobs(params.kind.means(), params.state.means(), page).await?))
}

/// One job.
#[utoipa::path(get, path = "/v1/jobs/{id}", tag = "jobs", params(("id" = String, Path, description = "Job id")),
    responses((status = 200, description = "The job", body = Job)))]
pub async fn get_job(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<Job>, Problem> {
    Ok(answer(app.job(&id).await?))
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
