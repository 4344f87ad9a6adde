//! The path of a stop: from the socket to the bench without a seat, a body or a database that
//! others could hold.
//!
//! Both the caller's role and the moving weighing are looked up in memory: the flag and the hold
//! are set on the thread that read the request, before anything is awaited. Work that then waits
//! for the database, such as stopping a weighing that has not begun, is done elsewhere.

use super::arrival::Arrivals;
use super::connection::{Connection, Kind};
use crate::api::auth;
use crate::api::problem::Problem;
use crate::api::{grpc, madsci, rest};
use crate::app::{App, Role};
use axum::Router;
use axum::body::Body;
use axum::extract::{Extension, Request, State};
use axum::middleware::{Next, from_fn, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use futures::FutureExt;
use std::sync::{Arc, LazyLock};
use std::time::{Duration, Instant};
use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use tracing::Instrument;

/// How long a stop may take to be answered; it is carried out even if the response times out.
const ANSWER: Duration = Duration::from_secs(5);
/// Number of stops that may wait for the database at once: of weighings that have not begun, four
/// times as many as may wait for the bench.
const WAITING: usize = 256;
/// Maximum of these on one connection: an HTTP/2 client still has room for a stop of the bench.
const WAITING_CONNECTION: usize = 96;
/// Maximum size of the gRPC message that names the weighing to stop, bytes.
const MESSAGE_BYTES_MAX: usize = 4096;

/// Runs stops that wait for the database; cheap to clone.
#[derive(Clone)]
struct Elsewhere {
    main: Handle,
    places: Arc<Semaphore>,
}

impl Elsewhere {
    fn of(main: &Handle) -> Self {
        Self { main: main.clone(), places: Arc::new(Semaphore::new(WAITING)) }
    }
}

/// The stop routes. Waiting is done on `main`, and stops of the bench never queue with stops
/// of single weighings.
pub fn router(app: App, main: &Handle) -> Router {
    let bench = rest::bench_stop(app.clone())
        .merge(grpc::bench_stop(app.clone()))
        .merge(madsci::stop(app.clone()));
    let (by_path, by_message) = (rest::weighing_stop(app.clone()), grpc::weighing_stop(app));
    let of_weighings = Elsewhere::of(main);
    let by_message = carried(by_message, of_weighings.clone()).route_layer(from_fn(message));
    let stops =
        carried(bench, Elsewhere::of(main)).merge(carried(by_path, of_weighings)).merge(by_message);
    let stops = stops.route_layer(from_fn(permit));
    stops.method_not_allowed_fallback(async || Problem::method_not_allowed())
}

fn carried(stops: Router, elsewhere: Elsewhere) -> Router {
    stops.route_layer(from_fn(auth::on_behalf)).route_layer(from_fn_with_state(elsewhere, at_once))
}

/// Requires the operator role; from here on the connection is not closed to make room for others.
async fn permit(
    Extension(connection): Extension<Arc<Connection>>,
    request: Request,
    next: Next,
) -> Response {
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

/// Applies what is in memory immediately; only work that is not finished then is moved elsewhere,
/// where it completes however long it takes.
async fn at_once(
    State(elsewhere): State<Elsewhere>,
    Extension(connection): Extension<Arc<Connection>>,
    request: Request,
    next: Next,
) -> Response {
    let mut work = Box::pin(next.run(request));
    if let Some(response) = work.as_mut().now_or_never() {
        return response;
    }
    let place = elsewhere
        .places
        .try_acquire_owned()
        .ok()
        .filter(|_| connection.stops() <= WAITING_CONNECTION);
    let Some(place) = place else {
        return Problem::unavailable(
            "whatever moves was told to stop, but too many stops of weighings that have not begun are waiting for the database: try again in a moment, or stop the bench",
        )
        .into_response();
    };
    let work = async move {
        let _place = place;
        work.await
    };
    match tokio::time::timeout(ANSWER, elsewhere.main.spawn(work.in_current_span())).await {
        Ok(Ok(response)) => response,
        Ok(Err(panic)) => {
            tracing::error!(%panic, "a stop broke down");
            Problem::internal().into_response()
        }
        Err(_) => Problem::unavailable(
            "the stop was passed on, but the database has not answered within 5 s: look at the bench and use the wired stop if it moves",
        )
        .into_response(),
    }
}
