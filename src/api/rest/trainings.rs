//! `/v1/trainings`: from parameter sets to a policy.

use super::answer;
use super::extract::{Input, Path, Query};
use super::list::{LabelledParams, SeriesParams, respond};
use super::started;
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{Episode, Job, Labelled, Page, Training, TrainingRequest};
use crate::app::App;
use axum::Json;
use axum::extract::{OriginalUri, State};
use axum::response::Response;

/// List trainings, newest first.
///
/// With their state, and their policy once they have succeeded; without episodes.
#[utoipa::path(get, path = "/v1/trainings", tag = "trainings", params(LabelledParams),
    responses((status = 200, description = "A page of trainings", body = Page<Labelled<Training>>)))]
pub async fn list_trainings(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<LabelledParams>,
) -> Result<Response, Problem> {
    let found = app.trainings(params.into()).await?;
    Ok(respond(&uri, app.all_labelled(found).await?))
}

/// Queue a training.
///
/// Soft Actor-Critic on simulated powders, from free-flowing to cohesive. The same request again is
/// the same job.
#[utoipa::path(post, path = "/v1/trainings", tag = "trainings", request_body = TrainingRequest,
    responses((status = 202, description = "Queued; the training has the id of its job", body = Job,
        headers(("Location" = String, description = "URL of the training"))),
        (status = 200, description = "Requested before: the existing job", body = Job),
        (status = 409, description = "A prerequisite is missing", body = Problem,
            content_type = "application/problem+json")))]
pub async fn start_training(
    _: Operator,
    State(app): State<App>,
    Input(request): Input<TrainingRequest>,
) -> Result<Response, Problem> {
    Ok(started("trainings", app.start_training(request).await?))
}

/// One training.
///
/// With its levels and settings, and its policy once it has succeeded.
#[utoipa::path(get, path = "/v1/trainings/{id}", tag = "trainings",
    params(("id" = String, Path, description = "Id of the training, same as its job's id")),
    responses((status = 200, description = "The training", body = Labelled<Training>)))]
pub async fn get_training(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<Labelled<Training>>, Problem> {
    Ok(answer(app.labelled(app.training(&id).await?).await?))
}

/// List the episodes of a training in order, even while it runs.
///
/// Reward, error in mg and number of shakes of each, with the powder that it dosed.
#[utoipa::path(get, path = "/v1/trainings/{id}/episodes", tag = "trainings",
    params(("id" = String, Path, description = "Id of the training"), SeriesParams),
    responses((status = 200, description = "A page of episodes", body = Page<Episode>)))]
pub async fn list_episodes(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Path(id): Path<String>,
    Query(params): Query<SeriesParams>,
) -> Result<Response, Problem> {
    Ok(respond(&uri, app.training_episodes(&id, params.into()).await?))
}
