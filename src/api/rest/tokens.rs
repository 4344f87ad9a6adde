//! `/v1/tokens`: keys for programs and people.

use super::answer;
use super::extract::{Input, Path, Query};
use super::list::{ListParams, respond};
use crate::api::auth::{Admin, Caller, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{Answer, Identity, NewToken, Page, TokenEntry};
use crate::app;
use crate::app::App;
use axum::Json;
use axum::extract::{OriginalUri, State};
use axum::http::{Extensions, StatusCode};
use axum::response::Response;
use serde::Serialize;

/// A token; its secret is shown only once.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct Token {
    /// The stored entry.
    #[serde(flatten)]
    entry: TokenEntry,
    /// Send it as `Authorization: Bearer …`. Only its hash is stored.
    secret: String,
}

impl Token {
    pub(super) fn of((entry, secret): (app::TokenEntry, String)) -> Self {
        Self { entry: entry.wire(), secret }
    }
}

/// Create a token.
///
/// The answer has the secret, this one time: the service keeps only its hash.
#[utoipa::path(post, path = "/v1/tokens", tag = "tokens", request_body = NewToken,
    responses((status = 201, description = "The token; its secret is not shown again", body = Token)))]
pub async fn create_token(
    _: Admin,
    State(app): State<App>,
    Input(new): Input<NewToken>,
) -> Result<(StatusCode, Json<Token>), Problem> {
    Ok((StatusCode::CREATED, Json(Token::of(app.make_token(&new).await?))))
}

/// List tokens, newest first, including ended ones; secrets are never shown.
///
/// With role, end and last use; those of people who logged in with who they are.
#[utoipa::path(get, path = "/v1/tokens", tag = "tokens", params(ListParams),
    responses((status = 200, description = "A page of tokens", body = Page<TokenEntry>)))]
pub async fn list_tokens(
    _: Admin,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<ListParams>,
) -> Result<Response, Problem> {
    Ok(respond(&uri, app.tokens(params.into()).await?))
}

/// Revoke a token with immediate effect.
///
/// A token that has ended is left unchanged. Records still refer to it.
#[utoipa::path(delete, path = "/v1/tokens/{id}", tag = "tokens",
    params(("id" = String, Path, description = "Token id: the first part of its secret")),
    responses((status = 200, description = "The token, now ended", body = TokenEntry)))]
pub async fn revoke_token(
    _: Admin,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<TokenEntry>, Problem> {
    Ok(answer(app.revoke_token(&id).await?))
}

/// Who the caller is.
///
/// For every caller, not only admins: a page shows the name, and offers what the role permits.
#[utoipa::path(get, path = "/v1/me", tag = "tokens",
    responses((status = 200, description = "Name and role", body = Identity)))]
pub async fn get_identity(_: Viewer, extensions: Extensions) -> Json<Identity> {
    answer(Caller::of(&extensions).identity())
}
