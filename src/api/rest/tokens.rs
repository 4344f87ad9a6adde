//! `/v1/tokens`: keys for programs and people.

use super::extract::Input;
use crate::api::auth::Admin;
use crate::api::problem::Problem;
use crate::app::App;
use crate::app::Role;
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use serde::{Deserialize, Serialize};

/// A token to make.
#[derive(Debug, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewToken {
    /// Who will hold it, for the record.
    name: String,
    /// What its holder may do.
    role: Role,
}

/// A token, shown this once.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct Token {
    /// Who holds it.
    name: String,
    /// What its holder may do.
    role: Role,
    /// Send it as `Authorization: Bearer …`. Only its hash is stored.
    secret: String,
}

/// Make a token.
#[utoipa::path(post, path = "/v1/tokens", tag = "tokens", request_body = NewToken,
    responses((status = 201, description = "The token; its secret is not shown again", body = Token)))]
pub async fn create_token(
    _: Admin,
    State(app): State<App>,
    Input(NewToken { name, role }): Input<NewToken>,
) -> Result<(StatusCode, Json<Token>), Problem> {
    let secret = app.create_token(&name, role).await?;
    Ok((StatusCode::CREATED, Json(Token { name, role, secret })))
}
