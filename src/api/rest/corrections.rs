//! Withdrawing and correcting measurements of powders.

use super::extract::{Input, Path};
use super::{answer, created};
use crate::api::auth::Operator;
use crate::api::problem::Problem;
use crate::api::wire::{
    CorrectMeasurement, CorrectObservation, Measurement, PowderObservation, WithdrawalRequest,
};
use crate::app::App;
use axum::Json;
use axum::extract::State;
use axum::response::Response;

/// Withdraw a measurement.
///
/// It stays on the powder's list with the reason, and nothing uses it again: not as a target, in an
/// investigation or a comparison, and an import of its file does not bring it back.
#[utoipa::path(post, path = "/v1/powders/{id}/measurements/{measurement}/withdraw", tag = "powders",
    request_body = WithdrawalRequest,
    params(("id" = String, Path, description = "Powder id"), ("measurement" = String, Path, description = "Id of the measurement")),
    responses((status = 200, description = "The measurement, withdrawn", body = Measurement),
        (status = 409, description = "It was withdrawn before", body = Problem, content_type = "application/problem+json")))]
pub async fn withdraw_measurement(
    _: Operator,
    State(app): State<App>,
    Path((powder, id)): Path<(String, String)>,
    Input(request): Input<WithdrawalRequest>,
) -> Result<Json<Measurement>, Problem> {
    Ok(answer(app.withdraw_measurement(&powder, &id, request).await?))
}

/// Correct a measurement.
///
/// A new measurement takes its place; the old one stays on the list with the reason, withdrawn.
#[utoipa::path(post, path = "/v1/powders/{id}/measurements/{measurement}/correct", tag = "powders",
    request_body = CorrectMeasurement,
    params(("id" = String, Path, description = "Powder id"), ("measurement" = String, Path, description = "Id of the wrong measurement")),
    responses((status = 201, description = "The corrected measurement", body = Measurement,
        headers(("Location" = String, description = "URL of the powder with all its measurements"))),
        (status = 409, description = "It was withdrawn before", body = Problem, content_type = "application/problem+json")))]
pub async fn correct_measurement(
    _: Operator,
    State(app): State<App>,
    Path((powder, id)): Path<(String, String)>,
    Input(request): Input<CorrectMeasurement>,
) -> Result<Response, Problem> {
    let measurement = app.correct_measurement(&powder, &id, request).await?;
    Ok(created(format!("/v1/powders/{powder}"), measurement))
}

/// Withdraw an observation other than the angle.
///
/// It stays on record, with who withdrew it and why; calibrations no longer use it.
#[utoipa::path(post, path = "/v1/powders/{id}/observations/{observation}/withdraw", tag = "powders",
    request_body = WithdrawalRequest,
    params(("id" = String, Path, description = "Powder id"), ("observation" = String, Path, description = "Id of the observation")),
    responses((status = 200, description = "The observation, withdrawn", body = PowderObservation),
        (status = 409, description = "It was withdrawn before", body = Problem, content_type = "application/problem+json")))]
pub async fn withdraw_observation(
    _: Operator,
    State(app): State<App>,
    Path((powder, id)): Path<(String, String)>,
    Input(request): Input<WithdrawalRequest>,
) -> Result<Json<PowderObservation>, Problem> {
    Ok(answer(app.withdraw_observation(&powder, &id, request).await?))
}

/// Correct an observation other than the angle.
///
/// The former one stays on record, with who corrected it and why; calibrations use the new one.
#[utoipa::path(post, path = "/v1/powders/{id}/observations/{observation}/correct", tag = "powders",
    request_body = CorrectObservation,
    params(("id" = String, Path, description = "Powder id"), ("observation" = String, Path, description = "Id of the wrong observation")),
    responses((status = 201, description = "The corrected observation", body = PowderObservation,
        headers(("Location" = String, description = "URL of the powder's observations"))),
        (status = 409, description = "It was withdrawn before", body = Problem, content_type = "application/problem+json")))]
pub async fn correct_observation(
    _: Operator,
    State(app): State<App>,
    Path((powder, id)): Path<(String, String)>,
    Input(request): Input<CorrectObservation>,
) -> Result<Response, Problem> {
    let observation = app.correct_observation(&powder, &id, request).await?;
    Ok(created(format!("/v1/powders/{powder}/observations"), observation))
}
