//! For those who watch over the service: `/healthz`, `/readyz`, `/metrics`.

use super::auth::Viewer;
use super::problem::Problem;
use crate::app::App;
use crate::app::Counts;
use axum::Router;
use axum::extract::State;
use axum::http::header;
use axum::response::IntoResponse;
use axum::routing::get;
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
use serde::Serialize;
use std::sync::OnceLock;
use tokio_util::sync::CancellationToken;

/// Upper bounds of the latency histogram, seconds.
const BUCKETS_S: [f64; 8] = [0.001, 0.005, 0.02, 0.1, 0.5, 2.0, 10.0, 60.0];

/// The three routes; `closing` is cancelled once the service shuts down.
pub fn router(app: App, closing: CancellationToken) -> Router {
    let ready = move || async move {
        match closing.is_cancelled() {
            true => Err(Problem::unavailable("shutting down")),
            false => Ok("ready\n"),
        }
    };
    recorder();
    Router::new()
        .route("/metrics", get(exposition))
        .with_state(app)
        .route("/healthz", get(async || "alive\n"))
        .route("/readyz", get(ready))
        .method_not_allowed_fallback(async || Problem::method_not_allowed())
}

async fn exposition(_: Viewer, State(app): State<App>) -> Result<impl IntoResponse, Problem> {
    let recorder = recorder().ok_or_else(|| Problem::unavailable("another recorder holds this process's metrics"))?;
    recorder.run_upkeep();
    let text = recorder.render() + &gauges(&app.counts().await?);
    Ok(([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text))
}

/// What the database holds, written out here: a recorder would go on telling of states that nothing is in any more.
fn gauges(counts: &Counts) -> String {
    let jobs = counts.jobs.iter().map(|((kind, state), n)| {
        let (kind, state) = (name(kind), name(state));
        format!("flip_jobs{{kind=\"{kind}\",state=\"{state}\"}} {n}\n")
    });
    let weighings = counts.weighings.iter().map(|((state, outcome), n)| {
        let (state, outcome) = (name(state), outcome.map_or("none".to_owned(), |outcome| name(&outcome)));
        format!("flip_weighings{{state=\"{state}\",outcome=\"{outcome}\"}} {n}\n")
    });
    [
        "# HELP flip_jobs Jobs in the database, by kind and state.\n# TYPE flip_jobs gauge\n".to_owned(),
        jobs.collect(),
        "# HELP flip_weighings Weighings in the database, by state and outcome.\n# TYPE flip_weighings gauge\n"
            .to_owned(),
        weighings.collect(),
    ]
    .concat()
}

/// An enum's variant as the rest of the API writes it.
fn name(variant: &impl Serialize) -> String {
    serde_json::to_value(variant).ok().and_then(|json| json.as_str().map(str::to_owned)).unwrap_or_default()
}

/// The process's one recorder, started at the first call; tests run several services beside each other.
fn recorder() -> Option<&'static PrometheusHandle> {
    static RECORDER: OnceLock<Option<PrometheusHandle>> = OnceLock::new();
    let start = || {
        let latency = Matcher::Full("flip_request_seconds".to_owned());
        let builder = PrometheusBuilder::new().set_buckets_for_metric(latency, &BUCKETS_S).ok()?;
        let handle = builder.install_recorder().ok()?;
        metrics::describe_counter!("flip_requests_total", "Requests answered, by method, route and status.");
        metrics::describe_histogram!("flip_request_seconds", "Seconds to the head of the answer.");
        Some(handle)
    };
    RECORDER.get_or_init(start).as_ref()
}
