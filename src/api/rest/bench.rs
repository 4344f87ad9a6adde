//! `/v1/bench`: the bench, its latch and its checks.

use super::answer;
use super::extract::{Input, Path};
use crate::api::auth::{Clearer, Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{
    BalanceReading, BalanceRequest, BenchStatus, Checklist, ClearRequest, NewChecklist,
    Repeatability, RepeatabilityRequest, Reservation, ReservationRequest, ResumeRequest,
};
use crate::app::App;
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;

/// The bench, and whether it may be used.
///
/// What moves, what waits, which vial is on the pan, and why nothing starts if it is latched, held
/// or reserved.
#[utoipa::path(get, path = "/v1/bench", tag = "bench",
    responses((status = 200, description = "The bench", body = BenchStatus)))]
pub async fn get_bench(_: Viewer, State(app): State<App>) -> Result<Json<BenchStatus>, Problem> {
    Ok(answer(app.bench().await?))
}

/// Stop all motion, and start nothing until a person resumes.
///
/// The arm is stopped at once, before anything is recorded; then the spoon is levelled and
/// retracted. The response comes from memory and waits for no database. Not an emergency stop: that
/// one is wired.
#[utoipa::path(post, path = "/v1/bench/stop", tag = "bench",
    responses((status = 200, description = "The bench", body = BenchStatus)))]
pub async fn stop_bench(_: Operator, State(app): State<App>) -> Result<Json<BenchStatus>, Problem> {
    Ok(answer(app.stop_bench().await?))
}

/// Let weighings start again after a stop.
///
/// `waiting` lists the ones concerned: the oldest starts at once.
#[utoipa::path(post, path = "/v1/bench/resume", tag = "bench", request_body = ResumeRequest,
    responses((status = 200, description = "The bench", body = BenchStatus),
        (status = 409, description = "It is not held, it is latched, or it was stopped after this request", body = Problem, content_type = "application/problem+json")))]
pub async fn resume_bench(
    _: Operator,
    State(app): State<App>,
    Input(request): Input<ResumeRequest>,
) -> Result<Json<BenchStatus>, Problem> {
    Ok(answer(app.resume_bench(request).await?))
}

/// Clear a latched bench.
///
/// A person confirms having checked spoon, vial and balance. A latched arm may then move again,
/// even if the bench itself was not latched. Nothing that was interrupted resumes by itself. If
/// weighings are waiting, the bench is held afterwards unless `resume` is true, which also ends the
/// hold of a stop. If two people clear at once, one succeeds.
#[utoipa::path(post, path = "/v1/bench/clear", tag = "bench", request_body = ClearRequest,
    responses((status = 200, description = "The bench, which may be used again", body = BenchStatus),
        (status = 409, description = "Neither it nor its arm is latched, the arm cannot be recovered, or the bench was stopped after this request", body = Problem,
            content_type = "application/problem+json")))]
pub async fn clear_bench(
    _: Clearer,
    State(app): State<App>,
    Input(request): Input<ClearRequest>,
) -> Result<Json<BenchStatus>, Problem> {
    Ok(answer(app.clear_bench(request).await?))
}

/// Reserve the bench for a limited time.
///
/// Weighings and measurements that do not name the reservation are refused until it expires. Naming
/// your own reservation in `id` extends it.
#[utoipa::path(post, path = "/v1/bench/reservation", tag = "bench", request_body = ReservationRequest,
    responses((status = 201, description = "The reservation", body = Reservation),
        (status = 409, description = "Already reserved, or weighings are waiting", body = Problem, content_type = "application/problem+json")))]
pub async fn reserve_bench(
    _: Operator,
    State(app): State<App>,
    Input(request): Input<ReservationRequest>,
) -> Result<(StatusCode, Json<Reservation>), Problem> {
    Ok((StatusCode::CREATED, answer(app.reserve_bench(request).await?)))
}

/// Release the bench before the reservation ends.
///
/// Whoever knows its id may; one that has ended already is released too.
#[utoipa::path(delete, path = "/v1/bench/reservation/{id}", tag = "bench",
    params(("id" = String, Path, description = "Reservation id")),
    responses((status = 200, description = "The bench", body = BenchStatus)))]
pub async fn release_bench(
    _: Operator,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<BenchStatus>, Problem> {
    app.release_bench(&id).await?;
    Ok(answer(app.bench().await?))
}

/// Record a repeatability check: ten or more weighings of one test weight.
///
/// It determines the smallest mass that may be weighed; every later result states whether it lies
/// below.
#[utoipa::path(post, path = "/v1/bench/repeatability", tag = "bench", request_body = RepeatabilityRequest,
    responses((status = 200, description = "Result of the check", body = Repeatability)))]
pub async fn check_repeatability(
    _: Operator,
    State(app): State<App>,
    Input(request): Input<RepeatabilityRequest>,
) -> Result<Json<Repeatability>, Problem> {
    Ok(answer(app.check_repeatability(request).await?))
}

/// Read the balance while nothing is dosed.
///
/// The display at once, stable or not; ask again until `stable` is true. During a dose its trace has
/// the readings.
#[utoipa::path(get, path = "/v1/bench/balance", tag = "bench",
    responses((status = 200, description = "What it shows", body = BalanceReading),
        (status = 409, description = "A dose or a pile has it, there is none between doses, or it failed", body = Problem, content_type = "application/problem+json")))]
pub async fn read_balance(
    _: Viewer,
    State(app): State<App>,
) -> Result<Json<BalanceReading>, Problem> {
    Ok(answer(app.read_balance().await?))
}

/// Tare the balance with the load on it, while nothing is dosed.
///
/// It waits until the reading is stable. No dose starts meanwhile, and each dose tares again by
/// itself. Recorded in the audit trail.
#[utoipa::path(post, path = "/v1/bench/balance/tare", tag = "bench", request_body = BalanceRequest,
    responses((status = 200, description = "What it shows afterwards", body = BalanceReading),
        (status = 409, description = "A dose or a pile has it, the bench is latched or reserved, there is none between doses, or it failed", body = Problem, content_type = "application/problem+json")))]
pub async fn tare_balance(
    _: Operator,
    State(app): State<App>,
    Input(request): Input<BalanceRequest>,
) -> Result<Json<BalanceReading>, Problem> {
    Ok(answer(app.tare_balance(request).await?))
}

/// Set the balance's zero point, while nothing is dosed.
///
/// As tare, but with an empty pan: with a load beyond its zero range a balance refuses.
#[utoipa::path(post, path = "/v1/bench/balance/zero", tag = "bench", request_body = BalanceRequest,
    responses((status = 200, description = "What it shows afterwards", body = BalanceReading),
        (status = 409, description = "A dose or a pile has it, the bench is latched or reserved, there is none between doses, or it failed", body = Problem, content_type = "application/problem+json")))]
pub async fn zero_balance(
    _: Operator,
    State(app): State<App>,
    Input(request): Input<BalanceRequest>,
) -> Result<Json<BalanceReading>, Problem> {
    Ok(answer(app.zero_balance(request).await?))
}

/// What a person checks before a dose.
///
/// Name what was confirmed in `asked.checked` of the weighing.
#[utoipa::path(get, path = "/v1/bench/checklist", tag = "bench",
    responses((status = 200, description = "The checklist", body = Checklist)))]
pub async fn get_checklist(_: Viewer, State(app): State<App>) -> Result<Json<Checklist>, Problem> {
    Ok(answer(app.checklist().await?))
}

/// Replace the checklist, for everyone; an empty one asks for nothing.
///
/// Up to 20 items. Weighings asked for later name the items that a person confirmed, in
/// `asked.checked`.
#[utoipa::path(put, path = "/v1/bench/checklist", tag = "bench", request_body = NewChecklist,
    responses((status = 200, description = "The checklist", body = Checklist)))]
pub async fn change_checklist(
    _: Operator,
    State(app): State<App>,
    Input(new): Input<NewChecklist>,
) -> Result<Json<Checklist>, Problem> {
    Ok(answer(app.change_checklist(&new).await?))
}
