//! For those who watch over the service: `/healthz`, `/readyz`, `/metrics`.

use super::auth::Viewer;
use super::problem::Problem;
use crate::app::App;
use axum::Router;
use axum::extract::State;
use axum::http::header;
use axum::response::IntoResponse;
use axum::routing::get;
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
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

async fn exposition(_: Viewer, State(_app): State<App>) -> Result<impl IntoResponse, Problem> {
    let recorder = recorder().ok_or_else(|| Problem::unavailable("another recorder holds this process's metrics"))?;
    recorder.run_upkeep();
    Ok(([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], recorder.render()))
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
