//! `/v1/bench`: the bench, its latch and its checks.

use super::extract::Input;
use crate::api::auth::{Clearer, Operator, Viewer};
use crate::api::problem::Problem;
use crate::app::{App, BenchStatus, ClearRequest, Repeatability, RepeatabilityRequest};
use axum::Json;
use axum::extract::State;

/// What the bench is and whether it may be used.
#[utoipa::path(get, path = "/v1/bench", tag = "bench",
    responses((status = 200, description = "The bench", body = BenchStatus)))]
pub async fn get_bench(_: Viewer, State(app): State<App>) -> Result<Json<BenchStatus>, Problem> {
    Ok(Json(app.bench().await?))
}

/// Stop whatever moves.
///
/// The arm is told at once, before anything is written down; then the spoon is levelled and taken away. Not an emergency stop: that one is wired.
#[utoipa::path(post, path = "/v1/bench/stop", tag = "bench",
    responses((status = 200, description = "The bench", body = BenchStatus)))]
pub async fn stop_bench(_: Operator, State(app): State<App>) -> Result<Json<BenchStatus>, Problem> {
    Ok(Json(app.stop_bench().await?))
}

/// Clear a latched bench.
///
/// A person has looked at spoon, vial and balance, and says so. Nothing that was interrupted goes on by itself.
#[utoipa::path(post, path = "/v1/bench/clear", tag = "bench", request_body = ClearRequest,
    responses((status = 200, description = "The bench, which may be used again", body = BenchStatus),
        (status = 409, description = "It is not latched", body = Problem, content_type = "application/problem+json")))]
pub async fn clear_bench(
    _: Clearer,
    State(app): State<App>,
    Input(request): Input<ClearRequest>,
) -> Result<Json<BenchStatus>, Problem> {
    Ok(Json(app.clear_bench(request).await?))
}

/// Keep a repeatability check: ten or more weighings of one test weight.
///
/// The smallest mass that may be weighed follows from it, and every later result says whether it lies below.
#[utoipa::path(post, path = "/v1/bench/repeatability", tag = "bench", request_body = RepeatabilityRequest,
    responses((status = 200, description = "What it found", body = Repeatability)))]
pub async fn check_repeatability(
    _: Operator,
    State(app): State<App>,
    Input(request): Input<RepeatabilityRequest>,
) -> Result<Json<Repeatability>, Problem> {
    Ok(Json(app.check_repeatability(request).await?))
}
