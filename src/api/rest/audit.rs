//! `/v1/audit`: the record of all that happened on the bench.

use super::csv_file;
use super::extract::Query;
use super::list::{ListParams, respond};
use crate::api::auth::Viewer;
use crate::api::problem::Problem;
use crate::app::{AUDIT_CSV_HEADER, App, AuditRecord, AuditVerification, Page, audit_csv};
use axum::Json;
use axum::extract::{OriginalUri, State};
use axum::response::Response;
use serde::Deserialize;
use utoipa::IntoParams;

/// Whose records.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
pub struct AuditParams {
    /// Most items to return.
    limit: Option<u32>,
    /// `next` of the page before.
    after: Option<String>,
    /// Of this weighing alone.
    weighing: Option<String>,
}

/// A hash that somebody kept.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
pub struct VerifyParams {
    /// As a certificate prints it.
    hash: Option<String>,
}

/// Of one weighing, or of all.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
pub struct ExportParams {
    /// Of this weighing alone.
    weighing: Option<String>,
}

/// List the audit trail, newest first.
#[utoipa::path(get, path = "/v1/audit", tag = "audit", params(AuditParams),
    responses((status = 200, description = "A page of records", body = Page<AuditRecord>)))]
pub async fn list_audit(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<AuditParams>,
) -> Result<Response, Problem> {
    let page = ListParams { limit: params.limit, after: params.after };
    Ok(respond(&uri, app.audit(params.weighing.as_deref(), page.into()).await?))
}

/// Is the audit trail whole?
///
/// Goes through every record. A trail that was cut off at its end looks whole: pass a hash that was kept elsewhere.
#[utoipa::path(get, path = "/v1/audit/verification", tag = "audit", params(VerifyParams),
    responses((status = 200, description = "Whether it is whole", body = AuditVerification)))]
pub async fn verify_audit(
    _: Viewer,
    State(app): State<App>,
    Query(params): Query<VerifyParams>,
) -> Result<Json<AuditVerification>, Problem> {
    Ok(Json(app.verify_audit(params.hash.as_deref()).await?))
}

/// Download the audit trail, oldest first.
#[utoipa::path(get, path = "/v1/audit.json", tag = "audit", params(ExportParams),
    responses((status = 200, description = "Every record", body = Vec<AuditRecord>)))]
pub async fn export_audit(
    _: Viewer,
    State(app): State<App>,
    Query(params): Query<ExportParams>,
) -> Result<Json<Vec<AuditRecord>>, Problem> {
    let mut records = Vec::new();
    app.export_audit(params.weighing.as_deref(), |record| records.push(record.clone())).await?;
    Ok(Json(records))
}

/// Download the audit trail as CSV, oldest first.
#[utoipa::path(get, path = "/v1/audit.csv", tag = "audit", params(ExportParams),
    responses((status = 200, description = "A line for each record", body = String, content_type = "text/csv")))]
pub async fn export_audit_csv(
    _: Viewer,
    State(app): State<App>,
    Query(params): Query<ExportParams>,
) -> Result<Response, Problem> {
    let mut text = AUDIT_CSV_HEADER.to_owned();
    app.export_audit(params.weighing.as_deref(), |record| text += &audit_csv(record)).await?;
    Ok(csv_file("audit", text))
}
