//! What was measured of powders: `/v1/powders/{id}/measurements` and `/v1/powders/{id}/observations`.

use super::created;
use super::extract::{Input, Path, Query};
use super::list::{ListParams, respond};
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::app::App;
use crate::app::{Measurement, NewMeasurement, NewObservation, Page, PowderObservation};
use axum::extract::{OriginalUri, State};
use axum::response::Response;

/// List the measurements of a powder, oldest first.
#[utoipa::path(get, path = "/v1/powders/{id}/measurements", tag = "powders",
    params(("id" = String, Path, description = "Powder id"), ListParams),
    responses((status = 200, description = "A page of measurements", body = Page<Measurement>)))]
pub async fn list_measurements(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Path(id): Path<String>,
    Query(params): Query<ListParams>,
) -> Result<Response, Problem> {
    Ok(respond(&uri, app.measurements(&id, params.into()).await?))
}

/// Register a measurement of a powder: mean, SD and number of repeats, or the repeats, or the heaps' heights and bases.
#[utoipa::path(post, path = "/v1/powders/{id}/measurements", tag = "powders", request_body = NewMeasurement,
    params(("id" = String, Path, description = "Powder id")),
    responses((status = 201, description = "The measurement", body = Measurement,
        headers(("Location" = String, description = "The powder with all its measurements")))))]
pub async fn add_measurement(
    _: Operator,
    State(app): State<App>,
    Path(id): Path<String>,
    Input(new): Input<NewMeasurement>,
) -> Result<Response, Problem> {
    let measurement = app.add_measurement(&id, new).await?;
    Ok(created(format!("/v1/powders/{}", measurement.powder), measurement))
}

/// List what else was measured of a powder, oldest first; the newest of an equal observable is the one that counts.
#[utoipa::path(get, path = "/v1/powders/{id}/observations", tag = "powders",
    params(("id" = String, Path, description = "Powder id"), ListParams),
    responses((status = 200, description = "A page of observations", body = Page<PowderObservation>)))]
pub async fn list_observations(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Path(id): Path<String>,
    Query(params): Query<ListParams>,
) -> Result<Response, Problem> {
    Ok(respond(&uri, app.observations(&id, params.into()).await?))
}

/// Register an observation of a powder beside its angle of repose.
#[utoipa::path(post, path = "/v1/powders/{id}/observations", tag = "powders", request_body = NewObservation,
    params(("id" = String, Path, description = "Powder id")),
    responses((status = 201, description = "The observation", body = PowderObservation,
        headers(("Location" = String, description = "The powder's observations")))))]
pub async fn add_observation(
    _: Operator,
    State(app): State<App>,
    Path(id): Path<String>,
    Input(new): Input<NewObservation>,
) -> Result<Response, Problem> {
    let observation = app.add_observation(&id, new).await?;
    Ok(created(format!("/v1/powders/{}/observations", observation.powder), observation))
}
