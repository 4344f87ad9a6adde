//! `/v1/shakes`: what spoons let fall, of weighings and imported.

use super::extract::{Csv, Query};
use super::list::respond;
use super::{answer, csv_pieces};
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{self, ForgottenShakes, ImportedShakes, KeptSpoonful, Page, Request};
use crate::app::{App, PageQuery, ShakesWanted};
use axum::Json;
use axum::extract::{OriginalUri, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;

/// Which page of which spoonfuls.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ShakesParams {
    /// Weighings and imported spoonfuls on the page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
    /// `next` of the previous page.
    after: Option<String>,
    /// Only of this powder.
    powder: Option<String>,
    /// Only of this lot.
    lot: Option<String>,
    /// Only of weighings on this bench, and imported ones.
    #[param(inline)]
    bench: Option<wire::BenchKind>,
}

/// Which spoonfuls are downloaded.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ShakesFilter {
    /// Only of this powder.
    powder: Option<String>,
    /// Only of this lot.
    lot: Option<String>,
    /// Only of weighings on this bench, and imported ones.
    #[param(inline)]
    bench: Option<wire::BenchKind>,
}

/// How a file of shakes is imported.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ShakesImportParams {
    /// Where the numbers come from; up to 500 characters.
    #[serde(default)]
    source: String,
    /// Register powders in the file that FLIP does not know, each under an id made from its name.
    #[serde(default)]
    #[param(default = false)]
    create: bool,
}

/// Which shakes are forgotten.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ForgetParams {
    /// Powder id.
    powder: String,
    /// Only of this lot; without it of all lots, and of unknown ones.
    lot: Option<String>,
}

/// List spoonfuls, each with its shakes.
///
/// Those of weighings come first, read from their traces; then imported ones; each oldest first.
/// What was forgotten is left out.
#[utoipa::path(get, path = "/v1/shakes", tag = "shakes", params(ShakesParams),
    responses((status = 200, description = "A page of spoonfuls", body = Page<KeptSpoonful>)))]
pub async fn list_shakes(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<ShakesParams>,
) -> Result<Response, Problem> {
    let ShakesParams { limit, after, powder, lot, bench } = params;
    let wanted = ShakesWanted { powder, lot, bench: bench.means() };
    Ok(respond(
        &uri,
        app.list_shakes(&wanted, PageQuery { limit, after, ..PageQuery::default() }).await?,
    ))
}

/// Download shakes as a CSV file that can be imported.
///
/// One row a shake: pitch, stroke, and the mass that fell, mg. The filters are those of the list.
#[utoipa::path(get, path = "/v1/shakes.csv", tag = "shakes", params(ShakesFilter),
    responses((status = 200, description = "One shake per row", body = String, content_type = "text/csv")))]
pub async fn export_shakes(
    _: Viewer,
    State(app): State<App>,
    Query(params): Query<ShakesFilter>,
) -> Result<Response, Problem> {
    let ShakesFilter { powder, lot, bench } = params;
    let wanted = ShakesWanted { powder, lot, bench: bench.means() };
    csv_pieces("shakes", app.shakes_csv(wanted).await?).await
}

/// Store the spoonfuls in a CSV file, all or nothing.
///
/// Columns: `weighing`, `powder` (id or name), `pitch_deg`, `shake_mm` (0 where the step only
/// changed the pitch), `fell_mg` (also 0 and below), `sd_mg` or `readability_mg`; optionally
/// `spoonful` (1 if it is left out), `step`, `lot`, `session`, `acceleration_m_s2`, `spoon_mg`
/// (before the step), `since_filled_s`. A row is one step; rows of one powder, weighing and
/// spoonful belong together. In place of `fell_mg`, `balance_mg` is the reading after the step, as
/// in the traces of an investigation, whose names of columns are understood. A spoonful that is
/// listed already, with the same shakes, is skipped. A refusal names the cell, such as
/// `row[2].fell_mg`; the header is row 1.
#[utoipa::path(post, path = "/v1/shakes/import", tag = "shakes", params(ShakesImportParams),
    request_body(content = Vec<u8>, content_type = "application/octet-stream", description = "The file, UTF-8 or UTF-16, at most 20000 rows and 8 MiB; `text/csv` says the same"),
    responses((status = 201, description = "What was added", body = ImportedShakes),
        (status = 415, description = "The body is not CSV", body = Problem, content_type = "application/problem+json")))]
pub async fn import_shakes(
    _: Operator,
    State(app): State<App>,
    Query(params): Query<ShakesImportParams>,
    Csv(text): Csv,
) -> Result<Response, Problem> {
    let imported = app.import_shakes(&text, &params.source, params.create).await?;
    Ok((StatusCode::CREATED, answer(imported)).into_response())
}

/// Forget the shakes of a powder, or of one of its lots.
///
/// From now on those of weighings that began until now, and those imported until now, are neither
/// listed nor used, as in the forecast of a dose. Weighings and their traces stay.
#[utoipa::path(delete, path = "/v1/shakes", tag = "shakes", params(ForgetParams),
    responses((status = 200, description = "What was forgotten", body = ForgottenShakes)))]
pub async fn forget_shakes(
    _: Operator,
    State(app): State<App>,
    Query(params): Query<ForgetParams>,
) -> Result<Json<ForgottenShakes>, Problem> {
    Ok(answer(app.forget_shakes(&params.powder, params.lot.as_deref()).await?))
}
