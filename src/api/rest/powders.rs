//! `/v1/powders`: real powders and their measured flowability.

use super::answer;
use super::created;
use super::extract::{Input, Path, Query};
use super::list::{LabelledParams, respond};
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{Labelled, NewPowder, Page, Powder, PowderDetail};
use crate::app::App;
use axum::Json;
use axum::extract::{OriginalUri, State};
use axum::response::Response;

/// List powders, oldest first.
///
/// With the angle of repose that calibrations aim at, if one was measured.
#[utoipa::path(get, path = "/v1/powders", tag = "powders", params(LabelledParams),
    responses((status = 200, description = "A page of powders", body = Page<Labelled<Powder>>)))]
pub async fn list_powders(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<LabelledParams>,
) -> Result<Response, Problem> {
    let found = app.powders(params.into()).await?;
    Ok(respond(&uri, app.all_labelled(found).await?))
}

/// Register a powder.
///
/// Its id is a word; it is shown by its name, which may be in any script. An angle of repose is
/// added as a measurement.
#[utoipa::path(post, path = "/v1/powders", tag = "powders", request_body = NewPowder,
    responses((status = 201, description = "The powder", body = Powder,
        headers(("Location" = String, description = "URL of the powder"))),
        (status = 409, description = "The id is taken", body = Problem, content_type = "application/problem+json")))]
pub async fn create_powder(
    _: Operator,
    State(app): State<App>,
    Input(new): Input<NewPowder>,
) -> Result<Response, Problem> {
    let powder = app.create_powder(new).await?;
    Ok(created(format!("/v1/powders/{}", powder.id), powder))
}

/// One powder with its measurements and calibrated sets.
///
/// Measurements that were corrected or withdrawn are not among them; they stay on record.
#[utoipa::path(get, path = "/v1/powders/{id}", tag = "powders", params(("id" = String, Path, description = "Powder id")),
    responses((status = 200, description = "The powder", body = Labelled<PowderDetail>)))]
pub async fn get_powder(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<Labelled<PowderDetail>>, Problem> {
    Ok(answer(app.labelled(app.powder(&id).await?).await?))
}
