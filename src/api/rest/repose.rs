//! `/v1/repose-measurements`: angles of repose by camera; `/v1/measurements/comparison`: automated
//! and manual measurements compared.

use super::answer;
use super::extract::{Input, Large, Path, Query};
use super::list::{LabelledParams, respond};
use super::{accepted, started};
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{
    Awaited, Compared, Job, Labelled, Page, ReposeMeasurement, ReposeRequest, Request,
};
use crate::app::{App, FrameUpload};
use axum::Json;
use axum::extract::{self, FromRequest, OriginalUri, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flip_core::domain::FieldError;
use serde::{Deserialize, Serialize};

/// PNG signature.
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";

/// A frame of a depth camera.
#[derive(Debug, Deserialize, Serialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewFrame {
    /// Depth, Base64: a 16-bit grey PNG, or the raw Z16 values, little-endian, row by row.
    depth: String,
    /// Colour of the same size, Base64: an 8-bit RGB PNG.
    colour: String,
    /// `intrinsics` with `width`, `height`, `fx`, `fy`, `ppx`, `ppy`, `model` and five
    /// `coefficients`; `depth_unit_m`; `taken_at` (RFC 3339). All are required.
    #[schema(value_type = Object)]
    description: serde_json::Value,
}

impl Request for NewFrame {
    type Means = Result<FrameUpload, FieldError>;
    fn means(self) -> Self::Means {
        let bytes = |field: &str, text: &str| {
            STANDARD
                .decode(text)
                .map_err(|error| FieldError::new(field, format!("must be Base64: {error}")))
        };
        Ok(FrameUpload {
            depth: bytes("depth", &self.depth)?,
            colour: bytes("colour", &self.colour)?,
            description: self.description.to_string().into(),
        })
    }
}

/// List measurements by camera, newest first, without their piles.
///
/// With their state, and the angle with its uncertainty once they have succeeded.
#[utoipa::path(get, path = "/v1/repose-measurements", tag = "powders", params(LabelledParams),
    responses((status = 200, description = "A page of measurements", body = Page<Labelled<ReposeMeasurement>>)))]
pub async fn list_repose_measurements(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<LabelledParams>,
) -> Result<Response, Problem> {
    let found = app.reposes(params.into()).await?;
    Ok(respond(&uri, app.all_labelled(found).await?))
}

/// Measure a powder's angle of repose by camera.
///
/// For each pile, the arm turns the platform over above the funnel, the gate opens, the pile comes
/// to rest, and frames are taken. On real devices the frames are uploaded while `awaits` is set.
/// Each pile is stored with its raw frames.
#[utoipa::path(post, path = "/v1/repose-measurements", tag = "powders", request_body = ReposeRequest,
    responses((status = 202, description = "Queued; the measurement has the id of its job", body = Job,
        headers(("Location" = String, description = "URL of the measurement"))),
        (status = 200, description = "Requested before: the existing job", body = Job),
        (status = 409, description = "The bench cannot make piles, or may not be used", body = Problem,
            content_type = "application/problem+json")))]
pub async fn start_repose_measurement(
    _: Operator,
    State(app): State<App>,
    Input(request): Input<ReposeRequest>,
) -> Result<Response, Problem> {
    Ok(started("repose-measurements", app.start_repose(request).await?))
}

/// One measurement by camera, with its piles.
///
/// With `awaits` while it waits for frames: which pile, and how many.
#[utoipa::path(get, path = "/v1/repose-measurements/{id}", tag = "powders",
    params(("id" = String, Path, description = "Id of the measurement, same as its job's id")),
    responses((status = 200, description = "The measurement", body = Labelled<ReposeMeasurement>)))]
pub async fn get_repose_measurement(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<Labelled<ReposeMeasurement>>, Problem> {
    Ok(answer(app.labelled(app.repose(&id).await?).await?))
}

/// Upload a frame of the pile that is waiting for frames; at most 16 MiB.
///
/// Depth as a 16-bit grey PNG or raw Z16 values, colour as an 8-bit RGB PNG if there is any, and a
/// description of the camera as JSON. A frame that does not show the pile is refused with the
/// reason.
#[utoipa::path(post, path = "/v1/repose-measurements/{id}/frames", tag = "powders", request_body = NewFrame,
    params(("id" = String, Path, description = "Id of the measurement")),
    responses((status = 202, description = "Number of frames the pile has now", body = Awaited),
        (status = 409, description = "No pile is waiting for frames", body = Problem,
            content_type = "application/problem+json")))]
pub async fn add_frame(
    _: Operator,
    State(app): State<App>,
    Path(id): Path<String>,
    request: extract::Request,
) -> Result<Response, Problem> {
    app.frames_awaited(&id).await?;
    let Large(frame) = Large::<NewFrame>::from_request(request, &app).await?;
    let awaited = app.add_frame(&id, frame?).await?;
    Ok(accepted(format!("/v1/repose-measurements/{id}"), awaited))
}

/// Download one part of a raw frame, as received.
///
/// `part` is `depth`, `colour` or `description`.
#[utoipa::path(get, path = "/v1/repose-measurements/{id}/piles/{pile}/frames/{frame}/{part}", tag = "powders",
    params(("id" = String, Path, description = "Id of the measurement"),
        ("pile" = u32, Path, description = "Number of the pile, from 1"), ("frame" = u32, Path, description = "Number of the frame, from 1"),
        ("part" = String, Path, description = "`depth`, `colour` or `description`")),
    responses((status = 200, description = "The bytes", body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 410, description = "Its file is missing or damaged", body = Problem, content_type = "application/problem+json")))]
pub async fn download_frame(
    _: Viewer,
    State(app): State<App>,
    Path((id, pile, frame, part)): Path<(String, u32, u32, String)>,
) -> Result<Response, Problem> {
    let bytes = app.raw_frame(&id, pile, frame, &part).await?;
    let kind = match part.as_str() {
        "description" => "application/json",
        _ if bytes.starts_with(PNG) => "image/png",
        _ => "application/octet-stream",
    };
    let headers = [
        (header::CONTENT_TYPE, kind),
        // What was received never changes.
        (header::CACHE_CONTROL, super::policies::IMMUTABLE),
    ];
    Ok((headers, bytes).into_response())
}

/// Compare automated with manual measurements, for every powder measured both ways.
///
/// Automated less manual, degrees, with its standard error; the last measurement by each counts.
#[utoipa::path(get, path = "/v1/measurements/comparison", tag = "powders",
    responses((status = 200, description = "One row per powder", body = Vec<Compared>)))]
pub async fn compare_methods(
    _: Viewer,
    State(app): State<App>,
) -> Result<Json<Vec<Compared>>, Problem> {
    Ok(answer(app.compare_methods().await?))
}
