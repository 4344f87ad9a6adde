//! Measurements of powders: `/v1/powders/{id}/measurements`, `/v1/powders/{id}/observations`, and
//! both as CSV.

use super::answer;
use super::extract::{Csv, Input, Path, Query};
use super::list::{ListParams, respond};
use super::{created, csv_pieces};
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{
    Imported, Measurement, NewMeasurement, NewObservation, Page, PowderObservation,
};
use crate::app::App;
use axum::extract::{OriginalUri, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;

/// List the measurements of a powder, oldest first.
///
/// Angles of repose in degrees, with their spread, number of repeats, method, day and source.
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

/// Register a measurement of a powder.
///
/// Mean, SD and number of repeats, or the repeats, or the heaps' heights and bases.
#[utoipa::path(post, path = "/v1/powders/{id}/measurements", tag = "powders", request_body = NewMeasurement,
    params(("id" = String, Path, description = "Powder id")),
    responses((status = 201, description = "The measurement", body = Measurement,
        headers(("Location" = String, description = "URL of the powder with all its measurements")))))]
pub async fn add_measurement(
    _: Operator,
    State(app): State<App>,
    Path(id): Path<String>,
    Input(new): Input<NewMeasurement>,
) -> Result<Response, Problem> {
    let measurement = app.add_measurement(&id, new).await?;
    Ok(created(format!("/v1/powders/{}", measurement.powder), measurement))
}

/// List a powder's other measurements, oldest first.
///
/// For each observable the newest one is used.
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

/// Register a measurement of a powder other than its angle of repose.
///
/// A flow time, a pile height, a drained angle or a mass per shake; calibrations by `emulator` meet
/// them together with the angle.
#[utoipa::path(post, path = "/v1/powders/{id}/observations", tag = "powders", request_body = NewObservation,
    params(("id" = String, Path, description = "Powder id")),
    responses((status = 201, description = "The observation", body = PowderObservation,
        headers(("Location" = String, description = "URL of the powder's observations")))))]
pub async fn add_observation(
    _: Operator,
    State(app): State<App>,
    Path(id): Path<String>,
    Input(new): Input<NewObservation>,
) -> Result<Response, Problem> {
    let observation = app.add_observation(&id, new).await?;
    Ok(created(format!("/v1/powders/{}/observations", observation.powder), observation))
}

/// How a file of measurements is imported.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ImportParams {
    /// Register powders in the file that FLIP does not know, each under an id made from its name.
    #[serde(default)]
    #[param(default = false)]
    create: bool,
}

/// Register the measurements and observations in a CSV file, all or nothing.
///
/// Columns: `powder` (id or name); `method` (automated or camera, manual); `repose_deg`, or
/// `height_mm` with `base_diameter_mm` and optionally `funnel_height_mm`; `flow_time_s` with
/// `poured_mass_g` and `orifice_mm`; `shake_mg` with `spoon_pitch_deg` and `shake_mm`;
/// `drained_deg`; `pile_height_mm` with `base_diameter_mm` and `fall_mm`; `source`; `date`, as
/// 2026-02-03. A row is one repeat, and repeats of one powder, method, source, day and experiment
/// are combined. With `n` and the
/// SD (`repose_sd_deg`, `flow_time_sd_s`, `shake_sd_mg`, `drained_sd_deg`, `pile_height_sd_mm`) a
/// row is a summary; a single value (`n` 1) has no SD. Separators are commas, semicolons or tabs;
/// decimals take a point or a comma. Empty cells, `NA` and the like are missing values. A refusal
/// names the cell, such as `row[2].repose_deg`; the header is row 1.
#[utoipa::path(post, path = "/v1/measurements/import", tag = "powders", params(ImportParams),
    request_body(content = Vec<u8>, content_type = "application/octet-stream", description = "The file, UTF-8 or UTF-16, at most 20000 rows and 8 MiB; `text/csv` says the same"),
    responses((status = 201, description = "Entries added", body = Imported),
        (status = 415, description = "The body is not CSV", body = Problem, content_type = "application/problem+json")))]
pub async fn import_measurements(
    _: Operator,
    State(app): State<App>,
    Query(params): Query<ImportParams>,
    Csv(text): Csv,
) -> Result<Response, Problem> {
    Ok((StatusCode::CREATED, answer(app.import_measurements(&text, params.create).await?))
        .into_response())
}

/// Download all measurements of all powders as a CSV file that can be imported.
///
/// UTF-8 with a header; `POST /v1/measurements/import` reads it back and leaves out what is stored
/// already.
#[utoipa::path(get, path = "/v1/measurements.csv", tag = "powders",
    responses((status = 200, description = "One summary per row", body = String, content_type = "text/csv")))]
pub async fn export_measurements(_: Viewer, State(app): State<App>) -> Result<Response, Problem> {
    csv_pieces("measurements", app.measured_csv(None).await?).await
}

/// Download all measurements of a powder as a CSV file that can be imported.
///
/// The columns are those of the file of all powders.
#[utoipa::path(get, path = "/v1/powders/{id}/measurements.csv", tag = "powders",
    params(("id" = String, Path, description = "Powder id")),
    responses((status = 200, description = "One summary per row", body = String, content_type = "text/csv")))]
pub async fn export_powder_measurements(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    csv_pieces(&format!("{id}-measurements"), app.measured_csv(Some(id.clone())).await?).await
}
