//! `/v1/benches`: all benches of the database, whichever process has them.

use super::answer;
use super::extract::{Input, Path};
use crate::api::auth::{Clearer, Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{Bench, BenchStatus, ClearRequest, LoadRequest, ResumeRequest};
use crate::app::App;
use axum::Json;
use axum::extract::State;

/// List the benches: which process has each, what moves and waits there, and what its container
/// holds.
///
/// Where one process serves one bench, that one.
#[utoipa::path(get, path = "/v1/benches", tag = "bench",
    responses((status = 200, description = "The benches, by name", body = Vec<Bench>)))]
pub async fn list_benches(_: Viewer, State(app): State<App>) -> Result<Json<Vec<Bench>>, Problem> {
    Ok(answer(app.benches().await?))
}

/// One bench, and whether it may be used.
///
/// As `/v1/bench`, from any server. Of another process's bench: as it is stored.
#[utoipa::path(get, path = "/v1/benches/{name}", tag = "bench",
    params(("name" = String, Path, description = "Name of the bench")),
    responses((status = 200, description = "The bench", body = BenchStatus)))]
pub async fn get_named_bench(
    _: Viewer,
    State(app): State<App>,
    Path(name): Path<String>,
) -> Result<Json<BenchStatus>, Problem> {
    Ok(answer(app.bench_named(&name).await?))
}

/// Stop all motion on one bench, from any server.
///
/// The process that has the bench is asked and answers, usually within a tenth of a second. 503 if
/// it does not within 5 s: then the stop was NOT heard. Use the wired stop.
#[utoipa::path(post, path = "/v1/benches/{name}/stop", tag = "bench",
    params(("name" = String, Path, description = "Name of the bench")),
    responses((status = 200, description = "The bench", body = BenchStatus)))]
pub async fn stop_named_bench(
    _: Operator,
    State(app): State<App>,
    Path(name): Path<String>,
) -> Result<Json<BenchStatus>, Problem> {
    Ok(answer(app.stop_bench_named(&name).await?))
}

/// Let weighings on one bench start again after a stop, from any server.
///
/// As `/v1/bench/resume`; 503 if the process that has the bench does not answer within 5 s.
#[utoipa::path(post, path = "/v1/benches/{name}/resume", tag = "bench", request_body = ResumeRequest,
    params(("name" = String, Path, description = "Name of the bench")),
    responses((status = 200, description = "The bench", body = BenchStatus),
        (status = 409, description = "It is not held, it is latched, or it was stopped after this request", body = Problem, content_type = "application/problem+json")))]
pub async fn resume_named_bench(
    _: Operator,
    State(app): State<App>,
    Path(name): Path<String>,
    Input(request): Input<ResumeRequest>,
) -> Result<Json<BenchStatus>, Problem> {
    Ok(answer(app.resume_bench_named(&name, request).await?))
}

/// Clear one latched bench, from any server.
///
/// As `/v1/bench/clear`; 503 if the process that has the bench does not answer within 5 s.
#[utoipa::path(post, path = "/v1/benches/{name}/clear", tag = "bench", request_body = ClearRequest,
    params(("name" = String, Path, description = "Name of the bench")),
    responses((status = 200, description = "The bench, which may be used again", body = BenchStatus),
        (status = 409, description = "Neither it nor its arm is latched, the arm cannot be recovered, or the bench was stopped after this request", body = Problem,
            content_type = "application/problem+json")))]
pub async fn clear_named_bench(
    _: Clearer,
    State(app): State<App>,
    Path(name): Path<String>,
    Input(request): Input<ClearRequest>,
) -> Result<Json<BenchStatus>, Problem> {
    Ok(answer(app.clear_bench_named(&name, request).await?))
}

/// Say what a bench's container holds; without a powder, that it is empty.
///
/// A weighing that asks for `any` bench goes to one that holds its powder. Recorded in the audit
/// trail.
#[utoipa::path(put, path = "/v1/benches/{name}/load", tag = "bench", request_body = LoadRequest,
    params(("name" = String, Path, description = "Name of the bench")),
    responses((status = 200, description = "The bench", body = Bench)))]
pub async fn load_bench(
    _: Operator,
    State(app): State<App>,
    Path(name): Path<String>,
    Input(request): Input<LoadRequest>,
) -> Result<Json<Bench>, Problem> {
    Ok(answer(app.load_bench(&name, request).await?))
}
