//! `/v1/characterisations` and a powder's card: how powders leave the spoon.

use super::answer;
use super::extract::{Input, Path, Query};
use super::weighings::planned;
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{self, CardOfPowder, CharacterisationRequest, Request, Weighing};
use crate::app::App;
use axum::Json;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use serde::Deserialize;

/// Of which shakes the card is.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct CardParams {
    /// Only of this lot.
    lot: Option<String>,
    /// Of weighings on this bench, and imported spoonfuls; default the service's bench.
    #[param(inline)]
    bench: Option<wire::BenchKind>,
}

/// Probe a powder.
///
/// A few spoonfuls are shaken over a vial that is discarded afterwards: pitch rises in steps, with
/// full, half and quarter strokes in turn. The run is a weighing that ends as `probed`: it is
/// watched, confirmed and stopped under `/v1/weighings`. What it shows is on the powder's card. The
/// same key with the same body returns the first run and never pours twice.
#[utoipa::path(post, path = "/v1/characterisations", tag = "weighings", request_body = CharacterisationRequest,
    params(("Idempotency-Key" = String, Header, description = "New for every run, 1 to 255 visible ASCII characters")),
    responses(
        (status = 202, description = "Planned, or the run the key started before", body = Weighing, headers(
            ("Location" = String, description = "URL of the weighing"),
            ("Idempotency-Replayed" = String, description = "`true` if the key was used before"))),
        (status = 409, description = "64 weighings are waiting already, the bench is latched or reserved, or a calibration or policy is missing", body = Problem,
            content_type = "application/problem+json"),
        (status = 422, description = "The key was used for another request", body = Problem,
            content_type = "application/problem+json")))]
pub async fn characterise(
    _: Operator,
    State(app): State<App>,
    headers: HeaderMap,
    Input(request): Input<CharacterisationRequest>,
) -> Result<Response, Problem> {
    let key = headers.get("idempotency-key").and_then(|key| key.to_str().ok()).unwrap_or_default();
    Ok(planned(app.characterise(request, key).await?))
}

/// The card of a powder: how it leaves the spoon.
///
/// Computed from all its shakes that count, of doses, probing runs and imports; what is forgotten
/// is not on it. With fewer than two spoonfuls it says what is missing.
#[utoipa::path(get, path = "/v1/powders/{id}/card", tag = "powders",
    params(("id" = String, Path, description = "Powder id"), CardParams),
    responses((status = 200, description = "The card", body = CardOfPowder)))]
pub async fn get_card(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
    Query(params): Query<CardParams>,
) -> Result<Json<CardOfPowder>, Problem> {
    let CardParams { lot, bench } = params;
    Ok(answer(app.powder_card(&id, lot.as_deref(), bench.means()).await?))
}
