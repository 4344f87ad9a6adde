//! `/v1/policies`: trained policies, and their files.

use super::answer;
use super::extract::{Octets, Path, Query};
use super::list::{LabelledParams, respond};
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{Labelled, Page, Policy};
use crate::app::App;
use axum::Json;
use axum::extract::{OriginalUri, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};

/// Cache policy of a file that never changes, because its address is derived from its content.
pub(super) const IMMUTABLE: &str = "private, max-age=31536000, immutable";

/// List policies, newest first.
///
/// Learnt ones, the one that ships, and imported ones, with their manifests.
#[utoipa::path(get, path = "/v1/policies", tag = "policies", params(LabelledParams),
    responses((status = 200, description = "A page of policies", body = Page<Labelled<Policy>>)))]
pub async fn list_policies(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<LabelledParams>,
) -> Result<Response, Problem> {
    let found = app.policies(params.into()).await?;
    Ok(respond(&uri, app.all_labelled(found).await?))
}

/// Import a policy that was trained elsewhere.
///
/// A safetensors file with a manifest, at most 16 MiB, as `GET /v1/policies/{id}/weights` and the
/// Python package give it. The policy's id is a hash of the file.
#[utoipa::path(post, path = "/v1/policies", tag = "policies",
    request_body(content = Vec<u8>, content_type = "application/octet-stream", description = "The file"),
    responses((status = 201, description = "The policy", body = Labelled<Policy>),
        (status = 200, description = "Known already: the policy", body = Labelled<Policy>),
        (status = 415, description = "The body is not `application/octet-stream`", body = Problem,
            content_type = "application/problem+json")))]
pub async fn import_policy(
    _: Operator,
    State(app): State<App>,
    Octets(file): Octets,
) -> Result<Response, Problem> {
    let (policy, is_new) = app.import_policy("file", &file).await?;
    let status = if is_new { StatusCode::CREATED } else { StatusCode::OK };
    Ok((status, answer(app.labelled(policy).await?)).into_response())
}

/// One policy.
///
/// With its manifest: settings, origin, and the range of actions. `…/weights` downloads the
/// network.
#[utoipa::path(get, path = "/v1/policies/{id}", tag = "policies",
    params(("id" = String, Path, description = "Policy id, `p-…`")),
    responses((status = 200, description = "The policy", body = Labelled<Policy>)))]
pub async fn get_policy(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<Labelled<Policy>>, Problem> {
    Ok(answer(app.labelled(app.policy(&id).await?).await?))
}

/// Download a policy's manifest.
///
/// Its settings, seed, parameter sets, curriculum history and versions.
#[utoipa::path(get, path = "/v1/policies/{id}/manifest", tag = "policies",
    params(("id" = String, Path, description = "Policy id, `p-…`")),
    responses((status = 200, description = "The manifest", body = serde_json::Value)))]
pub async fn get_policy_manifest(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    let policy = app.policy(&id).await?;
    let name = format!("attachment; filename=\"{}.json\"", policy.id);
    Ok(([(header::CONTENT_DISPOSITION, name)], Json(policy.manifest)).into_response())
}

/// Download a policy's weights.
///
/// A safetensors file; the ETag is its SHA-256.
#[utoipa::path(get, path = "/v1/policies/{id}/weights", tag = "policies",
    params(("id" = String, Path, description = "Policy id, `p-…`")),
    responses((status = 200, description = "The file", body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 410, description = "Its file is missing or damaged", body = Problem, content_type = "application/problem+json")))]
pub async fn download_policy_weights(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    let policy = app.policy(&id).await?;
    let headers = [
        (header::CONTENT_TYPE, "application/octet-stream".to_owned()),
        (
            header::CONTENT_DISPOSITION,
            format!("attachment; filename=\"{}.safetensors\"", policy.id),
        ),
        (header::ETAG, format!("\"{}\"", policy.sha256)),
        (header::CACHE_CONTROL, IMMUTABLE.to_owned()),
    ];
    Ok((headers, app.policy_bytes(&id).await?).into_response())
}
