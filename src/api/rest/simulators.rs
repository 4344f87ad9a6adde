//! `/v1/simulators`: simulator versions created by investigations, and which one is current.

use super::answer;
use super::csv_file;
use super::extract::{Input, Large, Path, Query};
use super::list::{LabelledParams, respond};
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{
    ChosenSimulator, CurrentSimulator, Labelled, Page, PredictionRequest, SimulatorVersion,
};
use crate::app::{App, predictions_csv};
use axum::Json;
use axum::extract::{OriginalUri, State};
use axum::response::Response;

/// List simulator versions, newest first.
///
/// Each extends the base by the mechanisms of a cause that an investigation found, with their
/// amplitudes.
#[utoipa::path(get, path = "/v1/simulators", tag = "investigations", params(LabelledParams),
    responses((status = 200, description = "A page of versions", body = Page<Labelled<SimulatorVersion>>)))]
pub async fn list_simulators(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<LabelledParams>,
) -> Result<Response, Problem> {
    let found = app.simulators(params.into()).await?;
    Ok(respond(&uri, app.all_labelled(found).await?))
}

/// One simulator version.
///
/// `body` has its mechanisms with their amplitudes, as the investigation wrote them.
#[utoipa::path(get, path = "/v1/simulators/{id}", tag = "investigations",
    params(("id" = String, Path, description = "Version, `sv-…`")),
    responses((status = 200, description = "The version", body = Labelled<SimulatorVersion>)))]
pub async fn get_simulator(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<Labelled<SimulatorVersion>>, Problem> {
    Ok(answer(app.labelled(app.simulator(&id).await?).await?))
}

/// The version used where none is named: the base until another is chosen.
///
/// With when it was chosen and why, and which was used before.
#[utoipa::path(get, path = "/v1/simulators/current", tag = "investigations",
    responses((status = 200, description = "The current version", body = CurrentSimulator)))]
pub async fn get_current_simulator(
    _: Viewer,
    State(app): State<App>,
) -> Result<Json<CurrentSimulator>, Problem> {
    Ok(answer(app.current_simulator().await?))
}

/// Make a version current, or roll back to another or to the base.
///
/// Versions themselves never change. Choosing the current version changes nothing.
#[utoipa::path(put, path = "/v1/simulators/current", tag = "investigations", request_body = ChosenSimulator,
    responses((status = 200, description = "The current version", body = CurrentSimulator)))]
pub async fn choose_simulator(
    _: Operator,
    State(app): State<App>,
    Input(chosen): Input<ChosenSimulator>,
) -> Result<Json<CurrentSimulator>, Problem> {
    Ok(answer(app.choose_simulator(&chosen).await?))
}

/// Predict the angles of unmeasured rows.
///
/// The response has the columns of an investigation's `predict.csv`.
#[utoipa::path(post, path = "/v1/simulators/{id}/predictions", tag = "investigations",
    request_body = PredictionRequest, params(("id" = String, Path, description = "Version, `sv-…`, or `current`")),
    responses((status = 200, description = "One row for each input row", body = String, content_type = "text/csv")))]
pub async fn predict(
    _: Operator,
    State(app): State<App>,
    Path(id): Path<String>,
    Large(request): Large<PredictionRequest>,
) -> Result<Response, Problem> {
    Ok(csv_file("predict", predictions_csv(&app.predict(&id, &request.measurements_csv).await?)))
}
