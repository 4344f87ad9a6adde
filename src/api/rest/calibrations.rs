//! `/v1/calibrations`: from a measured angle of repose to parameter sets.

use super::answer;
use super::extract::{Input, Path, Query};
use super::list::{LabelledParams, SeriesParams, respond};
use super::started;
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{
    Calibration, CalibrationRequest, Comparison, Job, Labelled, Page, Posterior, Trial,
};
use crate::app::App;
use axum::Json;
use axum::extract::{OriginalUri, State};
use axum::response::Response;
use serde::Deserialize;

/// List calibrations, newest first.
///
/// With their state, and their result once they have succeeded; without trials.
#[utoipa::path(get, path = "/v1/calibrations", tag = "calibrations", params(LabelledParams),
    responses((status = 200, description = "A page of calibrations", body = Page<Labelled<Calibration>>)))]
pub async fn list_calibrations(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<LabelledParams>,
) -> Result<Response, Problem> {
    let found = app.calibrations(params.into()).await?;
    Ok(respond(&uri, app.all_labelled(found).await?))
}

/// Queue a calibration.
///
/// Of a registered powder, or of a bare angle of repose. The same request again is the same job:
/// its result is the same, bit by bit.
#[utoipa::path(post, path = "/v1/calibrations", tag = "calibrations", request_body = CalibrationRequest,
    responses((status = 202, description = "Queued; the calibration has the id of its job", body = Job,
        headers(("Location" = String, description = "URL of the calibration"))),
        (status = 200, description = "Requested before: the existing job", body = Job),
        (status = 409, description = "A prerequisite is missing", body = Problem,
            content_type = "application/problem+json")))]
pub async fn start_calibration(
    _: Operator,
    State(app): State<App>,
    Input(request): Input<CalibrationRequest>,
) -> Result<Response, Problem> {
    Ok(started("calibrations", app.start_calibration(request).await?))
}

/// One calibration.
///
/// With its parameter sets once it has succeeded, and whether their heaps are as steep as the
/// measured one.
#[utoipa::path(get, path = "/v1/calibrations/{id}", tag = "calibrations",
    params(("id" = String, Path, description = "Id of the calibration, same as its job's id")),
    responses((status = 200, description = "The calibration", body = Labelled<Calibration>)))]
pub async fn get_calibration(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<Labelled<Calibration>>, Problem> {
    Ok(answer(app.labelled(app.calibration(&id).await?).await?))
}

/// The posterior over the nine parameters.
///
/// Draws, what was learnt about each, and which are only determined together.
#[utoipa::path(get, path = "/v1/calibrations/{id}/posterior", tag = "calibrations",
    params(("id" = String, Path, description = "Id of the calibration")),
    responses((status = 200, description = "The posterior", body = Posterior),
        (status = 410, description = "Its file is missing or damaged", body = Problem, content_type = "application/problem+json"),
        (status = 409, description = "It has none, or none yet", body = Problem,
            content_type = "application/problem+json")))]
pub async fn get_posterior(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<Posterior>, Problem> {
    Ok(answer(app.posterior(&id).await?))
}

/// The calibration to compare with.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct CompareParams {
    /// Id of the other calibration.
    with: String,
}

/// Compare two calibrations.
///
/// Target, cost, error, parameters, and whether their mean verified angles agree.
///
/// They agree if the angles differ by at most two standard errors of their difference. The standard
/// error of a set is `repose_sd_deg` / sqrt(`runs`); that of the mean over k sets is the root of
/// the sum of their squares, over k; that of the difference is the root of the sum of both squares.
#[utoipa::path(get, path = "/v1/calibrations/{id}/compare", tag = "calibrations",
    params(("id" = String, Path, description = "Id of the calibration"), CompareParams),
    responses((status = 200, description = "Both and their difference", body = Comparison),
        (status = 409, description = "One of them has no result", body = Problem,
            content_type = "application/problem+json")))]
pub async fn compare_calibrations(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
    Query(params): Query<CompareParams>,
) -> Result<Json<Comparison>, Problem> {
    Ok(answer(app.compare_calibrations(&id, &params.with).await?))
}

/// List the trials of a calibration in order, even while it runs.
///
/// A trial is a heap simulated at one place of the parameter space, with its angle and its place in
/// the search.
#[utoipa::path(get, path = "/v1/calibrations/{id}/trials", tag = "calibrations",
    params(("id" = String, Path, description = "Id of the calibration"), SeriesParams),
    responses((status = 200, description = "A page of trials", body = Page<Trial>)))]
pub async fn list_trials(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Path(id): Path<String>,
    Query(params): Query<SeriesParams>,
) -> Result<Response, Problem> {
    Ok(respond(&uri, app.trials(&id, params.into()).await?))
}
