//! `/v1/bench`: the bench, its latch and its checks.

use super::extract::{Input, Path};
use crate::api::auth::{Clearer, Operator, Viewer};
use crate::api::problem::Problem;
use crate::app::{
    App, BenchStatus, ClearRequest, Repeatability, RepeatabilityRequest, Reservation, ReservationRequest, ResumeRequest,
};
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;

/// What the bench is and whether it may be used.
#[utoipa::path(get, path = "/v1/bench", tag = "bench",
    responses((status = 200, description = "The bench", body = BenchStatus)))]
pub async fn get_bench(_: Viewer, State(app): State<App>) -> Result<Json<BenchStatus>, Problem> {
    Ok(Json(app.bench().await?))
}

/// Stop whatever moves, and begin nothing until a person resumes.
///
/// The arm is told at once, before anything is written down; then the spoon is levelled and taken away. The answer comes from memory and waits for no
/// database. Not an emergency stop: that one is wired.
#[utoipa::path(post, path = "/v1/bench/stop", tag = "bench",
    responses((status = 200, description = "The bench", body = BenchStatus)))]
pub async fn stop_bench(_: Operator, State(app): State<App>) -> Result<Json<BenchStatus>, Problem> {
    Ok(Json(app.stop_bench().await?))
}

/// Let weighings begin again after a stop.
///
/// `waiting` says which ones would: the oldest begins at once.
#[utoipa::path(post, path = "/v1/bench/resume", tag = "bench", request_body = ResumeRequest,
    responses((status = 200, description = "The bench", body = BenchStatus),
        (status = 409, description = "It is not held, it is latched, or it was stopped after this was asked", body = Problem, content_type = "application/problem+json")))]
pub async fn resume_bench(
    _: Operator,
    State(app): State<App>,
    Input(request): Input<ResumeRequest>,
) -> Result<Json<BenchStatus>, Problem> {
    Ok(Json(app.resume_bench(request).await?))
}

/// Clear a latched bench.
///
/// A person has looked at spoon, vial and balance, and says so; an arm that is latched, also where the bench is not, may move again. Nothing that was
/// interrupted goes on by itself, and where weighings wait the bench is held afterwards unless `resume` is true, which also ends the hold of a stop. Of two
/// who clear at once one does.
#[utoipa::path(post, path = "/v1/bench/clear", tag = "bench", request_body = ClearRequest,
    responses((status = 200, description = "The bench, which may be used again", body = BenchStatus),
        (status = 409, description = "Neither it nor its arm is latched, the arm cannot be recovered, or the bench was stopped after this was asked", body = Problem,
            content_type = "application/problem+json")))]
pub async fn clear_bench(
    _: Clearer,
    State(app): State<App>,
    Input(request): Input<ClearRequest>,
) -> Result<Json<BenchStatus>, Problem> {
    Ok(Json(app.clear_bench(request).await?))
}

/// Have the bench for oneself for a while.
///
/// Weighings and measurements that do not name the reservation are refused until it ends, which it does by itself. Naming one's own reservation in `id` makes it longer.
#[utoipa::path(post, path = "/v1/bench/reservation", tag = "bench", request_body = ReservationRequest,
    responses((status = 201, description = "The reservation", body = Reservation),
        (status = 409, description = "Somebody else has it, or weighings wait", body = Problem, content_type = "application/problem+json")))]
pub async fn reserve_bench(
    _: Operator,
    State(app): State<App>,
    Input(request): Input<ReservationRequest>,
) -> Result<(StatusCode, Json<Reservation>), Problem> {
    Ok((StatusCode::CREATED, Json(app.reserve_bench(request).await?)))
}

/// Give the bench back before the reservation ends.
#[utoipa::path(delete, path = "/v1/bench/reservation/{id}", tag = "bench",
    params(("id" = String, Path, description = "Reservation id")),
    responses((status = 200, description = "The bench", body = BenchStatus)))]
pub async fn release_bench(
    _: Operator,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<BenchStatus>, Problem> {
    app.release_bench(&id).await?;
    Ok(Json(app.bench().await?))
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
