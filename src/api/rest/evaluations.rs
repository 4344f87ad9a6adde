//! `/v1/evaluations`: a policy's errors on the simulated bench, compared with those of simple
//! controllers.

use super::answer;
use super::extract::{Input, Path, Query};
use super::list::{LabelledParams, respond};
use super::started;
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{Evaluation, EvaluationRequest, Job, Labelled, Page};
use crate::app::App;
use axum::Json;
use axum::extract::{OriginalUri, State};
use axum::response::Response;

/// List evaluations, newest first.
///
/// With their state and, once they have succeeded, the errors of each controller, powder and
/// target.
#[utoipa::path(get, path = "/v1/evaluations", tag = "evaluations", params(LabelledParams),
    responses((status = 200, description = "A page of evaluations", body = Page<Labelled<Evaluation>>)))]
pub async fn list_evaluations(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<LabelledParams>,
) -> Result<Response, Problem> {
    let found = app.evaluations(params.into()).await?;
    Ok(respond(&uri, app.all_labelled(found).await?))
}

/// Queue an evaluation.
///
/// Weighs on the simulated bench, every controller the same powders, targets and seeds.
#[utoipa::path(post, path = "/v1/evaluations", tag = "evaluations", request_body = EvaluationRequest,
    responses((status = 202, description = "Queued; the evaluation has the id of its job", body = Job,
        headers(("Location" = String, description = "URL of the evaluation"))),
        (status = 200, description = "Requested before: the existing job", body = Job),
        (status = 409, description = "A prerequisite is missing", body = Problem,
            content_type = "application/problem+json")))]
pub async fn start_evaluation(
    _: Operator,
    State(app): State<App>,
    Input(request): Input<EvaluationRequest>,
) -> Result<Response, Problem> {
    Ok(started("evaluations", app.start_evaluation(request).await?))
}

/// One evaluation.
///
/// With every weighing, and means with 95 % intervals, once it has succeeded.
#[utoipa::path(get, path = "/v1/evaluations/{id}", tag = "evaluations",
    params(("id" = String, Path, description = "Id of the evaluation, same as its job's id")),
    responses((status = 200, description = "The evaluation", body = Labelled<Evaluation>)))]
pub async fn get_evaluation(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<Labelled<Evaluation>>, Problem> {
    Ok(answer(app.labelled(app.evaluation(&id).await?).await?))
}
