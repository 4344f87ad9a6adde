//! REST under `/v1`: every route on one screen, and the OpenAPI document generated from the same
//! routes.

mod audit;
mod bench;
mod benches;
mod calibrations;
mod characterisations;
mod corrections;
mod document;
mod evaluations;
mod events;
pub mod extract;
mod films;
mod investigations;
mod jobs;
mod labels;
mod list;
mod login;
mod measurements;
mod parameters;
mod policies;
mod powders;
mod repose;
mod shakes;
mod simulators;
pub mod tables;
mod tokens;
mod trainings;
mod wait;
mod webhooks;
mod weighings;

pub(super) use weighings::trace_csv;

use super::problem::Problem;
use super::wire::Answer;
use crate::app;
use crate::app::App;
use axum::body::Body;
use axum::extract::DefaultBodyLimit;
use axum::http::{StatusCode, header};
use axum::middleware::from_fn;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use futures::stream::{self, BoxStream};
use futures::{StreamExt, TryStreamExt};
use serde::Serialize;
use tower::limit::GlobalConcurrencyLimitLayer;
use utoipa::openapi::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// Number of image uploads read at once; others wait their turn.
const LARGE_AT_ONCE: usize = 4;

fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::with_openapi(document::head())
        .routes(routes!(powders::list_powders, powders::create_powder))
        .routes(routes!(powders::get_powder))
        .routes(routes!(characterisations::get_card))
        .routes(routes!(measurements::list_measurements, measurements::add_measurement))
        .routes(routes!(measurements::list_observations, measurements::add_observation))
        .routes(routes!(corrections::withdraw_measurement))
        .routes(routes!(corrections::correct_measurement))
        .routes(routes!(corrections::withdraw_observation))
        .routes(routes!(corrections::correct_observation))
        .routes(routes!(measurements::export_measurements))
        .routes(routes!(measurements::export_powder_measurements))
        .routes(routes!(repose::compare_methods))
        .routes(routes!(repose::list_repose_measurements, repose::start_repose_measurement))
        .routes(routes!(repose::get_repose_measurement))
        .routes(routes!(repose::download_frame))
        .routes(routes!(parameters::list_parameters))
        .routes(routes!(parameters::list_parameter_sets))
        .routes(routes!(parameters::get_parameter_set))
        .routes(routes!(calibrations::list_calibrations, calibrations::start_calibration))
        .routes(routes!(calibrations::get_calibration))
        .routes(routes!(calibrations::get_posterior))
        .routes(routes!(calibrations::compare_calibrations))
        .routes(routes!(calibrations::list_trials))
        .routes(routes!(trainings::list_trainings, trainings::start_training))
        .routes(routes!(trainings::get_training))
        .routes(routes!(trainings::list_episodes))
        .routes(routes!(policies::list_policies))
        .routes(routes!(policies::get_policy))
        .routes(routes!(policies::get_policy_manifest))
        .routes(routes!(policies::download_policy_weights))
        .routes(routes!(evaluations::list_evaluations, evaluations::start_evaluation))
        .routes(routes!(evaluations::get_evaluation))
        .routes(routes!(films::list_films, films::start_film))
        .routes(routes!(films::get_film))
        .routes(routes!(films::download_film))
        .routes(routes!(investigations::list_investigations))
        .routes(routes!(investigations::get_investigation))
        .routes(routes!(investigations::download_predictions))
        .routes(routes!(investigations::get_report_page))
        .routes(routes!(shakes::list_shakes, shakes::forget_shakes))
        .routes(routes!(shakes::export_shakes))
        .routes(routes!(simulators::list_simulators))
        .routes(routes!(simulators::get_current_simulator, simulators::choose_simulator))
        .routes(routes!(simulators::get_simulator))
        .routes(routes!(weighings::list_weighings, weighings::start_weighing))
        .routes(routes!(weighings::start_dose_list))
        .routes(routes!(weighings::get_list_certificate))
        .routes(routes!(characterisations::characterise))
        .routes(routes!(weighings::get_weighing))
        .routes(routes!(weighings::get_trace))
        .routes(routes!(weighings::download_trace))
        .routes(routes!(weighings::vial_ready))
        .routes(routes!(weighings::stop_weighing))
        .routes(routes!(weighings::get_certificate))
        .routes(routes!(weighings::get_asm))
        .routes(routes!(bench::get_bench))
        .routes(routes!(bench::stop_bench))
        .routes(routes!(bench::resume_bench))
        .routes(routes!(bench::clear_bench))
        .routes(routes!(bench::reserve_bench))
        .routes(routes!(bench::release_bench))
        .routes(routes!(bench::check_repeatability))
        .routes(routes!(bench::read_balance))
        .routes(routes!(bench::tare_balance))
        .routes(routes!(bench::zero_balance))
        .routes(routes!(bench::get_checklist, bench::change_checklist))
        .routes(routes!(benches::list_benches))
        .routes(routes!(benches::get_named_bench))
        .routes(routes!(benches::stop_named_bench))
        .routes(routes!(benches::resume_named_bench))
        .routes(routes!(benches::clear_named_bench))
        .routes(routes!(benches::load_bench))
        .routes(routes!(audit::list_audit))
        .routes(routes!(audit::verify_audit))
        .routes(routes!(audit::export_audit))
        .routes(routes!(audit::export_audit_csv))
        .routes(routes!(jobs::list_jobs))
        .routes(routes!(jobs::list_job_times))
        .routes(routes!(jobs::list_workers))
        .routes(routes!(jobs::get_job))
        .routes(routes!(jobs::cancel_job))
        .routes(routes!(jobs::start_job_again))
        .routes(routes!(labels::list_labels))
        .routes(routes!(labels::get_label, labels::set_label))
        .routes(routes!(events::watch_all))
        .routes(routes!(events::watch_job))
        .routes(routes!(events::watch_weighing))
        .routes(routes!(webhooks::list_webhooks, webhooks::add_webhook))
        .routes(routes!(webhooks::remove_webhook))
        .routes(routes!(tokens::list_tokens, tokens::create_token))
        .routes(routes!(tokens::revoke_token))
        .routes(routes!(tokens::get_identity))
        .routes(routes!(login::get_log_in, login::begin_log_in))
        .routes(routes!(login::finish_log_in))
}

/// The stop of the bench, for the front end: the same handler as in the document, which reads no
/// body.
pub fn bench_stop(app: App) -> Router {
    Router::new().route("/v1/bench/stop", post(bench::stop_bench)).with_state(app)
}

/// The stop of a weighing, for the front end.
pub fn weighing_stop(app: App) -> Router {
    Router::new().route("/v1/weighings/{id}/stop", post(weighings::stop_weighing)).with_state(app)
}

/// Routes whose bodies are images or tables: only a few at once, so that they fit in memory.
fn large_routes() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(repose::add_frame))
        .routes(routes!(measurements::import_measurements))
        .routes(routes!(shakes::import_shakes))
        .routes(routes!(investigations::start_investigation))
        .routes(routes!(simulators::predict))
        .routes(routes!(policies::import_policy))
        .layer(DefaultBodyLimit::max(extract::LARGE_BYTES_MAX))
        .layer(GlobalConcurrencyLimitLayer::new(LARGE_AT_ONCE))
}

/// The OpenAPI document of everything below `/v1`.
pub fn openapi() -> OpenApi {
    let large = large_routes().into_openapi();
    let bare = routes().merge(large_routes()).into_openapi();
    document::complete(bare, |path| large.paths.paths.contains_key(path))
}

/// The routes, with `/openapi.json`.
pub fn router(app: App) -> Router {
    let document = openapi();
    let describe = move || async move { Json(document) };
    Router::from(routes())
        .layer(DefaultBodyLimit::max(extract::BODY_BYTES_MAX))
        .merge(Router::from(large_routes()))
        .route_layer(from_fn(tables::as_table))
        .with_state(app)
        .route("/openapi.json", get(describe))
        .method_not_allowed_fallback(async || Problem::method_not_allowed())
}

/// A file to download, `NAME.csv`.
fn csv_file(name: &str, text: String) -> Response {
    let headers = [
        (header::CONTENT_TYPE, "text/csv; charset=utf-8".to_owned()),
        (header::CONTENT_DISPOSITION, format!("attachment; filename=\"{name}.csv\"")),
    ];
    (headers, text).into_response()
}

/// As [`csv_file`], streamed.
async fn csv_pieces(
    name: &str,
    text: BoxStream<'static, app::Result<String>>,
) -> Result<Response, Problem> {
    let body = pieces(text).await?;
    let mut response = csv_file(name, String::new());
    *response.body_mut() = body;
    Ok(response)
}

/// A streamed body. The first piece is awaited, so that an immediate failure becomes an error
/// response; later failures break off the response.
async fn pieces(mut text: BoxStream<'static, app::Result<String>>) -> Result<Body, Problem> {
    let first = text.next().await.transpose()?;
    let rest = text.inspect_err(|error| tracing::warn!(%error, "a long answer broke off"));
    // What compresses it asks once more after its end.
    Ok(Body::from_stream(stream::iter(first.map(Ok)).chain(rest).fuse()))
}

/// What an answer is made from, as JSON.
fn answer<T: Answer>(body: T) -> Json<T::Wire> {
    Json(body.wire())
}

/// 202 for accepted work, with its location.
fn accepted(location: String, body: impl Answer<Wire: Serialize>) -> Response {
    (StatusCode::ACCEPTED, [(header::LOCATION, location)], answer(body)).into_response()
}

/// 201 for a new resource, with its location.
fn created(location: String, body: impl Answer<Wire: Serialize>) -> Response {
    (StatusCode::CREATED, [(header::LOCATION, location)], answer(body)).into_response()
}

/// The response to a request for long work: 202 if it was queued, 200 with the existing job
/// otherwise.
fn started(resource: &str, (job, created): (crate::app::Job, bool)) -> Response {
    match created {
        true => accepted(format!("/v1/{resource}/{}", job.id), job),
        false => answer(job).into_response(),
    }
}
