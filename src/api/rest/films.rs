//! `/v1/films`: what the grains of a weighing did, how a calibrated powder piles up, and how a
//! training's network doses.

use super::answer;
use super::extract::{Input, Path, Query};
use super::list::respond;
use super::started;
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{Film, FilmRequest, Job, Page};
use crate::app::{App, FilmsAsked, PageQuery};
use axum::Json;
use axum::extract::{OriginalUri, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;

/// Which page of which films.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct FilmsParams {
    /// Items on the page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
    /// `next` of the previous page.
    after: Option<String>,
    /// Only of this weighing, by id.
    weighing: Option<String>,
    /// Only of heaps of this parameter set, by id.
    set: Option<String>,
    /// Only of this training's episodes, by id.
    training: Option<String>,
}

/// List films, newest first.
///
/// Of everything, or of one weighing, parameter set or training.
#[utoipa::path(get, path = "/v1/films", tag = "films", params(FilmsParams),
    responses((status = 200, description = "A page of films", body = Page<Film>)))]
pub async fn list_films(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<FilmsParams>,
) -> Result<Response, Problem> {
    let FilmsParams { limit, after, weighing, set, training } = params;
    let of = FilmsAsked {
        weighing: weighing.as_deref(),
        set: set.as_deref(),
        training: training.as_deref(),
    };
    let found = app.films(of, PageQuery { limit, after, ..PageQuery::default() }).await?;
    Ok(respond(&uri, found))
}

/// Film a spoonful of a weighing, a heap of a parameter set, or a dose with a training's network.
///
/// The simulator makes the spoonful again from its record: the same powder, spoon, moves and seed.
/// Where the powder was simulated, the same grains fall. Of real powder the film shows what the
/// simulator makes of the same moves. A heap of 2000 grains is poured from its set and its seed; its
/// film says what its angle of repose comes from. The dose of a training is the same for each of its
/// episodes: its first parameter set, its seed, the middle of its targets, no exploration.
#[utoipa::path(post, path = "/v1/films", tag = "films", request_body = FilmRequest,
    responses((status = 202, description = "Queued; the film has the id of its job", body = Job,
        headers(("Location" = String, description = "URL of the film"))),
        (status = 200, description = "Requested before: the existing job", body = Job),
        (status = 409, description = "The weighing has not ended, or no step of it is on record; or the training has kept no network", body = Problem,
            content_type = "application/problem+json"),
        (status = 410, description = "The record of its steps is missing or damaged", body = Problem,
            content_type = "application/problem+json")))]
pub async fn start_film(
    _: Operator,
    State(app): State<App>,
    Input(request): Input<FilmRequest>,
) -> Result<Response, Problem> {
    Ok(started("films", app.start_film(request).await?))
}

/// One film, without its grains.
///
/// What it shows, and how many frames and grains it has; `…/file` downloads it.
#[utoipa::path(get, path = "/v1/films/{id}", tag = "films",
    params(("id" = String, Path, description = "Id of the film, same as its job's id")),
    responses((status = 200, description = "The film", body = Film)))]
pub async fn get_film(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<Film>, Problem> {
    Ok(answer(app.film(&id).await?))
}

/// Download a film's grains.
///
/// A binary file of at most 16 MiB, little-endian; the ETag is its SHA-256. Its layout is described
/// under "Films" in the documentation.
#[utoipa::path(get, path = "/v1/films/{id}/grains", tag = "films",
    params(("id" = String, Path, description = "Id of the film, same as its job's id")),
    responses((status = 200, description = "The file", body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 409, description = "It is not made yet", body = Problem, content_type = "application/problem+json"),
        (status = 410, description = "Its file is missing or damaged", body = Problem, content_type = "application/problem+json")))]
pub async fn download_film(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    let (sha256, bytes) = app.film_file(&id).await?;
    let headers = [
        (header::CONTENT_TYPE, "application/octet-stream".to_owned()),
        (header::CONTENT_DISPOSITION, format!("attachment; filename=\"film-{id}.flipfilm\"")),
        (header::ETAG, format!("\"{sha256}\"")),
        (header::CACHE_CONTROL, super::policies::IMMUTABLE.to_owned()),
    ];
    Ok((headers, bytes).into_response())
}
