//! Endpoints for monitoring: `/healthz`, `/readyz`, `/metrics`.

use super::auth::{Viewer, require};
use super::journal::word;
use super::problem::Problem;
use crate::app::{App, BenchStatus, Counts, Role};
use axum::extract::State;
use axum::http::{Extensions, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use metrics_exporter_prometheus::{Matcher, PrometheusBuilder, PrometheusHandle};
use std::sync::OnceLock;
use tokio_util::sync::CancellationToken;

/// Bucket bounds of the histograms: seconds to a response or a stop, error in mg, duration in
/// seconds and shakes of a dose.
const BUCKETS: [(&str, &[f64]); 5] = [
    ("flip_request_seconds", &[0.001, 0.005, 0.02, 0.1, 0.5, 2.0, 10.0, 60.0]),
    ("flip_stop_seconds", &[0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.5, 2.0]),
    ("flip_dose_error_mg", &[0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0]),
    ("flip_dose_seconds", &[15.0, 30.0, 60.0, 90.0, 120.0, 180.0, 300.0, 600.0]),
    ("flip_dose_shakes", &[1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0]),
];

/// `/metrics`.
pub fn metrics(app: App) -> Router {
    recorder();
    let refused = async || Problem::method_not_allowed();
    Router::new()
        .route("/metrics", get(exposition))
        .with_state(app)
        .method_not_allowed_fallback(refused)
}

/// `/healthz` and `/readyz`, which answer whatever the rest of the service does; `closing` is
/// cancelled once it shuts down.
pub fn alive(app: App, closing: CancellationToken) -> Router {
    let ready = move |extensions: Extensions| async move {
        match closing.is_cancelled() {
            true => Problem::unavailable("shutting down").into_response(),
            false => readiness(&app, &extensions).await,
        }
    };
    Router::new()
        .route("/healthz", get(async || "alive\n"))
        .route("/readyz", get(ready))
        .method_not_allowed_fallback(async || Problem::method_not_allowed())
}

/// 200 if a weighing could be carried out and recorded, else 503; each check by name, with reasons
/// for callers who may read.
async fn readiness(app: &App, extensions: &Extensions) -> Response {
    let mut found = app.readiness().await;
    if require(extensions, Role::Viewer).is_err() {
        found.checks = found.checks.without_reasons();
    }
    let status = if found.ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    (status, Json(found)).into_response()
}

async fn exposition(_: Viewer, State(app): State<App>) -> Result<impl IntoResponse, Problem> {
    let recorder = recorder()
        .ok_or_else(|| Problem::unavailable("another recorder holds this process's metrics"))?;
    recorder.run_upkeep();
    let text =
        recorder.render() + &gauges(&app.counts().await?) + &of_the_bench(&app.bench().await?);
    Ok(([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text))
}

/// Gauges from the database, written out here: a recorder would go on exporting states that no
/// longer occur.
fn gauges(counts: &Counts) -> String {
    let jobs = counts.jobs.iter().map(|((kind, state), n)| {
        let (kind, state) = (word(kind), word(state));
        format!("flip_jobs{{kind=\"{kind}\",state=\"{state}\"}} {n}\n")
    });
    let weighings = counts.weighings.iter().map(|((state, outcome), n)| {
        let (state, outcome) =
            (word(state), outcome.map_or("none".to_owned(), |outcome| word(&outcome)));
        format!("flip_weighings{{state=\"{state}\",outcome=\"{outcome}\"}} {n}\n")
    });
    let waits = counts
        .waits_s
        .iter()
        .map(|(queue, seconds)| format!("flip_queue_age_seconds{{queue=\"{queue}\"}} {seconds}\n"));
    [
        format!("# HELP flip_build_info What runs.\n# TYPE flip_build_info gauge\nflip_build_info{{version=\"{}\"}} 1\n", env!("CARGO_PKG_VERSION")),
        "# HELP flip_queue_age_seconds For how long the oldest that waits has waited, s; 0 where nothing does.\n# TYPE flip_queue_age_seconds gauge\n".to_owned(),
        waits.collect(),
        "# HELP flip_jobs Jobs in the database, by kind and state.\n# TYPE flip_jobs gauge\n".to_owned(),
        jobs.collect(),
        "# HELP flip_weighings Weighings in the database, by state and outcome.\n# TYPE flip_weighings gauge\n"
            .to_owned(),
        weighings.collect(),
    ]
    .concat()
}

/// Whether the bench may be used and whether it moves.
fn of_the_bench(bench: &BenchStatus) -> String {
    let gauge = |name: &str, help: &str, holds: bool| {
        format!("# HELP {name} {help}\n# TYPE {name} gauge\n{name} {}\n", u8::from(holds))
    };
    [
        gauge(
            "flip_bench_latched",
            "1 while nobody may use the bench until a person has looked.",
            bench.latch.is_some(),
        ),
        gauge("flip_bench_held", "1 after a stop, until a person resumes.", bench.held.is_some()),
        gauge(
            "flip_bench_moving",
            "1 while a weighing moves or a pile is made.",
            bench.moving.is_some() || bench.piling.is_some(),
        ),
    ]
    .concat()
}

/// The process's single recorder, started at the first call; tests run several services side by
/// side.
fn recorder() -> Option<&'static PrometheusHandle> {
    static RECORDER: OnceLock<Option<PrometheusHandle>> = OnceLock::new();
    let start = || {
        let bounded =
            BUCKETS.iter().try_fold(PrometheusBuilder::new(), |builder, (name, bounds)| {
                builder.set_buckets_for_metric(Matcher::Full((*name).to_owned()), bounds)
            });
        let handle = bounded.ok()?.install_recorder().ok()?;
        metrics::describe_counter!(
            "flip_requests_total",
            "Requests answered, by method, route and status."
        );
        metrics::describe_histogram!("flip_request_seconds", "Seconds to the head of the answer.");
        metrics::describe_histogram!(
            "flip_stop_seconds",
            "Seconds from a stop's head to its answer; the arm is told before."
        );
        metrics::describe_counter!(
            "flip_doses_total",
            "Weighings that ended, by bench and outcome, since the service started."
        );
        metrics::describe_counter!(
            "flip_bench_latches_total",
            "Times that the bench was latched since the service started."
        );
        metrics::describe_histogram!(
            "flip_dose_error_mg",
            "Absolute error of doses that ran their course, mg."
        );
        metrics::describe_histogram!(
            "flip_dose_seconds",
            "Bench time of doses that ran their course, s."
        );
        metrics::describe_histogram!("flip_dose_shakes", "Shakes of doses that ran their course.");
        Some(handle)
    };
    RECORDER.get_or_init(start).as_ref()
}
