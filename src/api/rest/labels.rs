//! `/v1/labels`: what people call things, and what lists hide.

use super::answer;
use super::extract::{Input, Path, Query};
use super::list::{LabelledParams, respond};
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{ArchivedItems, Label, LabelChange, LabelKind, Page, Request};
use crate::app::App;
use axum::Json;
use axum::extract::{OriginalUri, State};
use axum::response::Response;
use serde::Deserialize;

/// Which page of which labels.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct LabelsParams {
    /// Items on the page, 1 to 200.
    #[param(minimum = 1, maximum = 200, default = 50)]
    limit: Option<u32>,
    /// `next` of the previous page.
    after: Option<String>,
    /// Whether archived ones are listed.
    #[serde(default)]
    #[param(inline)]
    archived: ArchivedItems,
    /// Only with this tag.
    tag: Option<String>,
    /// Only on things of this kind.
    #[param(inline)]
    kind: Option<LabelKind>,
}

/// List labels, the one first made first.
///
/// Only what somebody has named, noted, tagged or archived has one.
#[utoipa::path(get, path = "/v1/labels", tag = "labels", params(LabelsParams),
    responses((status = 200, description = "A page of labels", body = Page<Label>)))]
pub async fn list_labels(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<LabelsParams>,
) -> Result<Response, Problem> {
    let LabelsParams { limit, after, archived, tag, kind } = params;
    let page = LabelledParams { limit, after, archived, tag };
    Ok(respond(&uri, app.labels(kind.means(), page.into()).await?))
}

/// The label of one thing; an empty one if nobody has named it.
///
/// Name, note, tags, and whether lists hide it. What callers write for their programs is in
/// `labels` of weighings and jobs.
#[utoipa::path(get, path = "/v1/labels/{kind}/{id}", tag = "labels",
    params(("kind" = LabelKind, Path, description = "What it is on"), ("id" = String, Path, description = "Id of that")),
    responses((status = 200, description = "The label", body = Label)))]
pub async fn get_label(
    _: Viewer,
    State(app): State<App>,
    Path((kind, id)): Path<(LabelKind, String)>,
) -> Result<Json<Label>, Problem> {
    Ok(answer(app.label(kind.means(), &id).await?))
}

/// Rename, note, tag or archive one thing.
///
/// What the body leaves out stays as it is. Archiving hides a thing from lists and deletes nothing;
/// `archived: false` shows it again. Every change goes into the audit trail.
#[utoipa::path(put, path = "/v1/labels/{kind}/{id}", tag = "labels", request_body = LabelChange,
    params(("kind" = LabelKind, Path, description = "What it is on"), ("id" = String, Path, description = "Id of that")),
    responses((status = 200, description = "The label as it is now", body = Label),
        (status = 409, description = "Another powder has that name, or what is to be archived has not ended", body = Problem,
            content_type = "application/problem+json")))]
pub async fn set_label(
    _: Operator,
    State(app): State<App>,
    Path((kind, id)): Path<(LabelKind, String)>,
    Input(change): Input<LabelChange>,
) -> Result<Json<Label>, Problem> {
    Ok(answer(app.set_label(kind.means(), &id, change).await?))
}
