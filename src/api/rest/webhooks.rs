//! `/v1/webhooks`: addresses that are told when something has ended.

use super::answer;
use super::extract::{Input, Path};
use crate::api::auth::Admin;
use crate::api::problem::Problem;
use crate::api::wire::{Answer, NewWebhook, Webhook};
use crate::app::App;
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use serde::Serialize;

/// A new webhook; its secret is shown only once.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct AddedWebhook {
    /// The webhook.
    #[serde(flatten)]
    webhook: Webhook,
    /// What its messages are signed with, `whsec_…`.
    secret: String,
}

/// Tell an address when a weighing or a job has ended, or the bench is latched.
///
/// Messages are `{"type", "timestamp", "seq", "data"}` with the types `weighing.ended`, `job.ended`
/// and `bench.latched`, signed as Standard Webhooks 1.0 has it (`webhook-id`, `webhook-timestamp`,
/// `webhook-signature`). One that is not answered with 2xx is repeated, the longer the rarer, for a
/// day; a repeated one has the same `webhook-id`. A restart loses none.
#[utoipa::path(post, path = "/v1/webhooks", tag = "webhooks", request_body = NewWebhook,
    responses((status = 201, description = "The webhook; its secret is not shown again", body = AddedWebhook),
        (status = 409, description = "There are 20 already", body = Problem, content_type = "application/problem+json")))]
pub async fn add_webhook(
    _: Admin,
    State(app): State<App>,
    Input(new): Input<NewWebhook>,
) -> Result<(StatusCode, Json<AddedWebhook>), Problem> {
    let (webhook, secret) = app.add_webhook(&new).await?;
    Ok((StatusCode::CREATED, Json(AddedWebhook { webhook: webhook.wire(), secret })))
}

/// List webhooks, the oldest first; secrets are never shown.
///
/// With the error of the last message, and since when messages fail.
#[utoipa::path(get, path = "/v1/webhooks", tag = "webhooks",
    responses((status = 200, description = "All of them", body = Vec<Webhook>)))]
pub async fn list_webhooks(
    _: Admin,
    State(app): State<App>,
) -> Result<Json<Vec<Webhook>>, Problem> {
    Ok(answer(app.webhooks().await?))
}

/// Remove a webhook: it gets no further message.
///
/// Messages that are on their way may still arrive.
#[utoipa::path(delete, path = "/v1/webhooks/{id}", tag = "webhooks",
    params(("id" = String, Path, description = "Webhook id")),
    responses((status = 204, description = "It is gone")))]
pub async fn remove_webhook(
    _: Admin,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    app.remove_webhook(&id).await?;
    Ok(StatusCode::NO_CONTENT)
}
