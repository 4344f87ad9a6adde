//! The way of a stop: from the socket to the bench without a seat, a body or a database that others could hold.
//!
//! Its role is looked up in memory, and it is carried out on a thread of its own, so that an arm that does not answer holds nobody up.

use super::arrival::Arrivals;
use super::connection::{Connection, Kind};
use crate::api::auth;
use crate::api::problem::Problem;
use crate::api::{grpc, rest};
use crate::app::{App, Role};
use axum::Router;
use axum::body::Body;
use axum::extract::{Extension, Request};
use axum::middleware::{Next, from_fn};
use axum::response::{IntoResponse, Response};
use std::sync::{Arc, LazyLock};
use std::time::{Duration, Instant};
use tokio::runtime::Handle;
use tokio::task::spawn_blocking;

/// How long a stop may take to be answered; it is carried out all the same.
const ANSWER: Duration = Duration::from_secs(5);
/// Most bytes of the message of gRPC that names the weighing to stop.
const MESSAGE_BYTES_MAX: usize = 4096;

/// The four ways to stop.
pub fn router(app: App) -> Router {
    let bodyless = rest::stops(app.clone()).merge(grpc::bench_stop(app.clone()));
    let named = grpc::weighing_stop(app).route_layer(from_fn(message));
    let stops = bodyless
        .merge(named)
        .route_layer(from_fn(auth::on_behalf))
        .route_layer(from_fn(own_thread))
        .route_layer(from_fn(permit));
    stops.method_not_allowed_fallback(async || Problem::method_not_allowed())
}

/// An operator's; from here on its connection is not closed for others.
async fn permit(Extension(connection): Extension<Arc<Connection>>, request: Request, next: Next) -> Response {
    if let Err(problem) = auth::require(request.extensions(), Role::Operator) {
        return problem.into_response();
    }
    let _stopping = connection.begin(Kind::Stop);
    let started = Instant::now();
    let response = next.run(request).await;
    metrics::histogram!("flip_stop_seconds").record(started.elapsed().as_secs_f64());
    response
}

/// Waits for the message that names the weighing.
async fn message(request: Request, next: Next) -> Response {
    static ARRIVALS: LazyLock<Arrivals> = LazyLock::new(Arrivals::default);
    let (parts, body) = request.into_parts();
    match ARRIVALS.gather(&parts.headers, body, MESSAGE_BYTES_MAX, true).await {
        Ok(bytes) => next.run(Request::from_parts(parts, Body::from(bytes))).await,
        Err(problem) => problem.into_response(),
    }
}

async fn own_thread(request: Request, next: Next) -> Response {
    let front = Handle::current();
    let work = spawn_blocking(move || front.block_on(next.run(request)));
    match tokio::time::timeout(ANSWER, work).await {
        Ok(Ok(response)) => response,
        Ok(Err(panic)) => {
            tracing::error!(%panic, "a stop broke down");
            Problem::internal().into_response()
        }
        Err(_) => Problem::unavailable(
            "the stop was passed on, but neither the arm nor the database has answered within 5 s: look at the bench and use the wired stop if it moves",
        )
        .into_response(),
    }
}
