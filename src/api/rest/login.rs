//! `/v1/login`: tokens for people who log in with the lab's own accounts. For everyone: who logs in
//! has no token yet.

use super::answer;
use super::extract::Input;
use super::tokens::Token;
use crate::api::problem::Problem;
use crate::api::wire::{BegunLogIn, LogInAnswer, LogInOffer};
use crate::app::App;
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;

/// Where people can log in.
///
/// The name of the provider, if the service has one; otherwise people use tokens.
#[utoipa::path(get, path = "/v1/login", tag = "tokens",
    responses((status = 200, description = "The provider, if there is one", body = LogInOffer)))]
pub async fn get_log_in(State(app): State<App>) -> Json<LogInOffer> {
    Json(LogInOffer { provider: app.log_in_host().map(str::to_owned) })
}

/// Begin a log-in.
///
/// Open `url` in a browser. The provider sends it back to FLIP's page with `code` and `state`.
#[utoipa::path(post, path = "/v1/login", tag = "tokens",
    responses((status = 200, description = "The provider's page", body = BegunLogIn)))]
pub async fn begin_log_in(State(app): State<App>) -> Result<Json<BegunLogIn>, Problem> {
    Ok(answer(app.begin_log_in().await?))
}

/// Finish a log-in.
///
/// The token ends after 12 hours, and has the role of the person's group.
#[utoipa::path(post, path = "/v1/login/finish", tag = "tokens", request_body = LogInAnswer,
    responses((status = 201, description = "A token; its secret is not shown again", body = Token)))]
pub async fn finish_log_in(
    State(app): State<App>,
    Input(answer): Input<LogInAnswer>,
) -> Result<(StatusCode, Json<Token>), Problem> {
    Ok((StatusCode::CREATED, Json(Token::of(app.finish_log_in(&answer).await?))))
}
