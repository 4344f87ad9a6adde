//! `/v1/investigations`: what measured angles reveal that the calibrated simulator does not
//! reproduce.

use super::answer;
use super::extract::{Large, Path, Query};
use super::list::{LabelledParams, respond};
use super::{csv_file, started};
use crate::api::auth::{Operator, Viewer};
use crate::api::problem::Problem;
use crate::api::wire::{Investigation, InvestigationRequest, Job, Labelled, Page};
use crate::app::App;
use crate::app::{document, report_html};
use axum::Json;
use axum::extract::{OriginalUri, State};
use axum::http::header;
use axum::response::{Html, IntoResponse, Response};
use serde::Deserialize;

/// List investigations, newest first, without their reports.
///
/// With their verdict and its sentence once they have succeeded.
#[utoipa::path(get, path = "/v1/investigations", tag = "investigations", params(LabelledParams),
    responses((status = 200, description = "A page of investigations", body = Page<Labelled<Investigation>>)))]
pub async fn list_investigations(
    _: Viewer,
    State(app): State<App>,
    OriginalUri(uri): OriginalUri,
    Query(params): Query<LabelledParams>,
) -> Result<Response, Problem> {
    let found = app.investigations(params.into()).await?;
    Ok(respond(&uri, app.all_labelled(found).await?))
}

/// Queue an investigation of a campaign, or of all stored measurements.
///
/// Looks in measurements for what the simulator gets wrong and names the cause if the data tell.
/// The same request again is the same job.
#[utoipa::path(post, path = "/v1/investigations", tag = "investigations", request_body = InvestigationRequest,
    responses((status = 202, description = "Queued; the investigation has the id of its job", body = Job,
        headers(("Location" = String, description = "URL of the investigation"))),
        (status = 200, description = "Requested before: the existing job", body = Job)))]
pub async fn start_investigation(
    _: Operator,
    State(app): State<App>,
    Large(request): Large<InvestigationRequest>,
) -> Result<Response, Problem> {
    Ok(started("investigations", app.start_investigation(request).await?))
}

/// One investigation, with its report once it has succeeded.
///
/// The report has the verdict, causes with their probabilities, effects with intervals, and the
/// experiment that would tell more.
#[utoipa::path(get, path = "/v1/investigations/{id}", tag = "investigations",
    params(("id" = String, Path, description = "Id of the investigation, same as its job's id")),
    responses((status = 200, description = "The investigation", body = Labelled<Investigation>)))]
pub async fn get_investigation(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<Labelled<Investigation>>, Problem> {
    Ok(answer(app.labelled(app.investigation(&id).await?).await?))
}

/// Download the angle of every row of the file, before and after the extension of the simulator.
///
/// Columns: `row` (the header is row 1); `powder`; `before_deg`, `before_sd_deg`; `after_deg`,
/// `after_sd_deg`. The SD is that of a single run.
#[utoipa::path(get, path = "/v1/investigations/{id}/predict.csv", tag = "investigations",
    params(("id" = String, Path, description = "Id of the investigation")),
    responses((status = 200, description = "One row for each input row", body = String, content_type = "text/csv"),
        (status = 409, description = "It has no report, or none yet", body = Problem,
            content_type = "application/problem+json")))]
pub async fn download_predictions(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    Ok(csv_file("predict", app.predictions(&id).await?))
}

/// Which part of a report is wanted.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ReportParams {
    /// The sections alone, for a page that has their style.
    #[serde(default)]
    #[param(default = false)]
    fragment: bool,
}

/// The report as a self-contained page.
///
/// HTML with its pictures and style inside: it can be saved and sent.
#[utoipa::path(get, path = "/v1/investigations/{id}/report.html", tag = "investigations",
    params(("id" = String, Path, description = "Id of the investigation"), ReportParams),
    responses((status = 200, description = "The page", body = String, content_type = "text/html"),
        (status = 409, description = "It has no report, or none yet", body = Problem,
            content_type = "application/problem+json")))]
pub async fn get_report_page(
    _: Viewer,
    State(app): State<App>,
    Path(id): Path<String>,
    Query(params): Query<ReportParams>,
) -> Result<Response, Problem> {
    let page = match params.fragment {
        true => app.report_fragment(&id).await?,
        false => report_html::html(&app.report(&id).await?),
    };
    // It may load only its own inline style.
    Ok(([(header::CONTENT_SECURITY_POLICY, document::POLICY)], Html(page)).into_response())
}
