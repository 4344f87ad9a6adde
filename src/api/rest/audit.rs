//! `/v1/audit`: the record of everything that happened on the bench.

use super::answer;
use super::extract::Query;
use super::list::{ListParams, to_next};
use super::{csv_pieces, pieces};
use crate::api::auth::Viewer;
use crate::api::problem::Problem;
use crate::api::wire::{Answer, AuditFound, AuditRecord, AuditVerification};
use crate::app;
use crate::app::{AUDIT_CSV_HEADER, App, AuditAsked, AuditWanted, audit_csv};
use axum::Json;
use axum::extract::{OriginalUri, State};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use futures::StreamExt;
use futures::stream;
use serde::Deserialize;
use utoipa::IntoParams;

/// Selection of records.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
pub struct AuditParams {
    /// Maximum number of items to return.
    limit: Option<u32>,
    /// `next` of the previous page.
    after: Option<String>,
    /// Only records of this weighing.
    weighing: Option<String>,
    /// Only of this kind: `intent`, `state`, `sent`, `received`, `reading`, `decision`, `outcome`,
    /// `person`, `latch`, `hold`, `check`, `pile`, `rows` or `stock`.
    kind: Option<String>,
    /// Words, each of which stands in the name of the person who acted, signed or is the operator;
    /// up to 200 characters.
    person: Option<String>,
    /// On this day (UTC) or later, `2026-11-24`, or from this time on, `2026-11-24T08:00:00Z`.
    since: Option<String>,
    /// On this day (UTC) or earlier, or before this time.
    until: Option<String>,
    /// Words, each of which stands in the weighing, the kind or the contents; up to 200 characters.
    q: Option<String>,
}

/// A hash kept elsewhere.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
pub struct VerifyParams {
    /// The hash, as printed on a certificate.
    hash: Option<String>,
}

/// Which records are downloaded.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
pub struct ExportParams {
    /// Only records of this weighing.
    weighing: Option<String>,
    /// Only of this kind.
    kind: Option<String>,
    /// Words in the name of a person.
    person: Option<String>,
    /// On this day (UTC) or later, or from this time on.
    since: Option<String>,
    /// On this day (UTC) or earlier, or before this time.
    until: Option<String>,
    /// Words in the weighing, the kind or the contents.
    q: Option<String>,
}

impl ExportParams {
    fn asked(self) -> AuditAsked {
        let Self { weighing, kind, person, since, until, q: text } = self;
        let wanted = AuditWanted { weighing, kind, person, text, ..AuditWanted::default() };
        AuditAsked { wanted, since, until }
    }
}

/// List the audit trail, newest first: all of it, or the records that match, and how many they are.
///
/// Each record holds the hash of the one before, so that a change is noticed; `GET
/// /v1/audit/verify` checks them all.
#[utoipa::path(get, path = "/v1/audit", tag = "audit", params(AuditParams),
    responses((status = 200, description = "A page of records", body = AuditFound)))]
pub async fn list_audit(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<AuditParams>,
) -> Result<Response, Problem> {
    let AuditParams { limit, after, weighing, kind, person, since, until, q } = params;
    let asked = ExportParams { weighing, kind, person, since, until, q }.asked();
    let found = app.audit(asked, ListParams { limit, after }.into()).await?;
    let link = to_next(&uri, found.page.next.as_deref());
    Ok((link, answer(found)).into_response())
}

/// Verify that the audit trail is intact.
///
/// Checks every record. A trail truncated at its end still looks intact: pass a hash that was kept
/// elsewhere.
#[utoipa::path(get, path = "/v1/audit/verification", tag = "audit", params(VerifyParams),
    responses((status = 200, description = "Whether it is intact", body = AuditVerification)))]
pub async fn verify_audit(
    _: Viewer,
    State(app): State<App>,
    Query(params): Query<VerifyParams>,
) -> Result<Json<AuditVerification>, Problem> {
    Ok(answer(app.verify_audit(params.hash.as_deref()).await?))
}

/// Download the audit trail, oldest first.
///
/// One record a line, as JSON, each with the hash of the one before.
#[utoipa::path(get, path = "/v1/audit.json", tag = "audit", params(ExportParams),
    responses((status = 200, description = "Every record", body = Vec<AuditRecord>)))]
pub async fn export_audit(
    _: Viewer,
    State(app): State<App>,
    Query(params): Query<ExportParams>,
) -> Result<Response, Problem> {
    let batches = app.audit_trail(params.asked())?.enumerate();
    let begun =
        batches.map(|(k, batch)| Ok(format!("{}{}", ["[", ","][k.min(1)], json_items(batch?)?)));
    let document = begun.chain(stream::once(async { Ok("]".to_owned()) }));
    Ok(([(header::CONTENT_TYPE, "application/json")], pieces(document.boxed()).await?)
        .into_response())
}

/// Records as JSON, separated by commas.
fn json_items(records: Vec<app::AuditRecord>) -> app::Result<String> {
    let items = records
        .into_iter()
        .map(|record| serde_json::to_string(&record.wire()))
        .collect::<Result<Vec<_>, _>>();
    Ok(items.map_err(|error| app::Error::Internal(error.into()))?.join(","))
}

/// Download the audit trail as CSV, oldest first.
///
/// The filters are those of the list. Times are UTC; what a record says is JSON in one column.
#[utoipa::path(get, path = "/v1/audit.csv", tag = "audit", params(ExportParams),
    responses((status = 200, description = "One line per record", body = String, content_type = "text/csv")))]
pub async fn export_audit_csv(
    _: Viewer,
    State(app): State<App>,
    Query(params): Query<ExportParams>,
) -> Result<Response, Problem> {
    let batches = app.audit_trail(params.asked())?.enumerate();
    let lines = batches.map(|(k, batch)| {
        let lines: String = batch?.iter().map(audit_csv).collect();
        Ok([AUDIT_CSV_HEADER, ""][k.min(1)].to_owned() + &lines)
    });
    csv_pieces("audit", lines.boxed()).await
}
