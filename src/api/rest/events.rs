//! Live views as server-sent events.
//!
//! Every event has its sequence number as `id:`; a reconnecting client sends it back as
//! `Last-Event-ID` (browsers do so by themselves) and misses nothing. The stream of a job or
//! weighing ends with it, and further requests are answered with 204, which tells browsers not to
//! reconnect. A stream also ends when the token it was opened with ends; reconnecting is then
//! refused.

use super::extract::{Path, Query};
use crate::api::auth::Viewer;
use crate::api::problem::Problem;
use crate::api::wire::{Answer, Event};
use crate::app::{self, App};
use crate::app::{Error, Topic};
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{self, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use flip_core::domain::FieldError;
use flip_core::domain::weighing::WeighingState;
use futures::StreamExt;
use futures::stream::{self, BoxStream};
use serde::Deserialize;
use std::time::Duration;

/// A comment is sent when nothing happens for this long, so that proxies keep the connection open.
const KEEP_ALIVE: Duration = Duration::from_secs(15);

/// Where to start.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct WatchParams {
    /// Sequence number of the last event already seen, for clients that cannot send
    /// `Last-Event-ID`.
    #[param(minimum = 0)]
    after_seq: Option<i64>,
}

impl WatchParams {
    /// The header takes precedence: a reconnecting browser sends it along with the address it first
    /// requested.
    fn after(&self, headers: &HeaderMap) -> Result<Option<i64>, Problem> {
        let asked = checked("after_seq", self.after_seq)?;
        let Some(header) = headers.get("last-event-id") else { return Ok(asked) };
        let number = header.to_str().ok().and_then(|text| text.trim().parse().ok());
        checked("Last-Event-ID", Some(number.unwrap_or(-1)))
    }
}

fn checked(field: &str, seq: Option<i64>) -> Result<Option<i64>, Problem> {
    match seq {
        Some(..0) => Err(FieldError::new(
            field,
            "must be the id of an event of this stream, a number from 0",
        )
        .into()),
        seq => Ok(seq),
    }
}

/// Stream all events.
///
/// From now on, or after the given event.
#[utoipa::path(get, path = "/v1/events", tag = "events",
    params(WatchParams, ("Last-Event-ID" = Option<i64>, Header, description = "Sequence number of the last event seen")),
    responses((status = 200, description = "Events; `data` holds one Event as JSON", body = Event,
        content_type = "text/event-stream")))]
pub async fn watch_all(
    _: Viewer,
    State(app): State<App>,
    headers: HeaderMap,
    Query(params): Query<WatchParams>,
) -> Result<Response, Problem> {
    let after = params.after(&headers)?.unwrap_or_else(|| app.last_event());
    Ok(live(app.events(Topic::All, after).await?))
}

/// Stream the events of a job.
///
/// State, progress, trials and episodes from the beginning, or after the given event. Ends with the
/// job.
#[utoipa::path(get, path = "/v1/jobs/{id}/events", tag = "jobs",
    params(("id" = String, Path, description = "Job id"), WatchParams,
        ("Last-Event-ID" = Option<i64>, Header, description = "Sequence number of the last event seen")),
    responses((status = 200, description = "Events; `data` holds one Event as JSON", body = Event,
            content_type = "text/event-stream"),
        (status = 204, description = "The job has ended and all its events were seen")))]
pub async fn watch_job(
    _: Viewer,
    State(app): State<App>,
    headers: HeaderMap,
    Path(id): Path<String>,
    Query(params): Query<WatchParams>,
) -> Result<Response, Problem> {
    let after = params.after(&headers)?.unwrap_or(0);
    let ended = app.job(&id).await?.state.is_terminal();
    follow(app.events(Topic::Job(id), after).await?, ended).await
}

/// Stream the events of a weighing.
///
/// State and ticks from the beginning, or after the given event. Ends with the weighing.
#[utoipa::path(get, path = "/v1/weighings/{id}/events", tag = "weighings",
    params(("id" = String, Path, description = "Weighing id"), WatchParams,
        ("Last-Event-ID" = Option<i64>, Header, description = "Sequence number of the last event seen")),
    responses((status = 200, description = "Events; `data` holds one Event as JSON", body = Event,
            content_type = "text/event-stream"),
        (status = 204, description = "The weighing has ended and all its events were seen")))]
pub async fn watch_weighing(
    _: Viewer,
    State(app): State<App>,
    headers: HeaderMap,
    Path(id): Path<String>,
    Query(params): Query<WatchParams>,
) -> Result<Response, Problem> {
    let after = params.after(&headers)?.unwrap_or(0);
    let state = app.weighing(&id).await?.weighing.state;
    let ended =
        matches!(state, WeighingState::Done | WeighingState::Aborted | WeighingState::Unknown);
    follow(app.events(Topic::Weighing(id), after).await?, ended).await
}

type Events = BoxStream<'static, app::Result<app::Event>>;

/// The stream, or 204 if its subject has `ended` and there are no events left.
async fn follow(mut events: Events, ended: bool) -> Result<Response, Problem> {
    if !ended {
        return Ok(live(events));
    }
    // All events of an ended subject are stored: the first arrives at once, or there is none.
    match events.next().await {
        None => Ok(StatusCode::NO_CONTENT.into_response()),
        Some(first) => Ok(live(stream::iter([first]).chain(events).boxed())),
    }
}

/// Server-sent events until the stream ends or the token it was opened with does; an error ends it
/// too, and the client resumes where it was.
fn live(events: Events) -> Response {
    let events =
        events.take_while(|event| std::future::ready(!matches!(event, Err(Error::TokenEnded))));
    Sse::new(events.map(frame)).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response()
}

fn frame(event: app::Result<app::Event>) -> Result<sse::Event, axum::BoxError> {
    let event = event.inspect_err(|error| tracing::warn!(%error, "an event stream broke off"))?;
    Ok(sse::Event::default()
        .id(event.seq.to_string())
        .event(event.kind.clone())
        .json_data(event.wire())?)
}
