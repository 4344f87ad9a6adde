//! From the front end to the rest of the service: what a request waits for before it is processed,
//! and the way back for its response.

use super::answer::relay;
use super::arrival::Arrivals;
use super::connection::Connection;
use crate::api::auth::Caller;
use crate::api::grpc::access::{self, Access};
use crate::api::grpc::is_grpc;
use crate::api::limits::{Class, Seats, StreamSeat, Streams};
use crate::api::problem::Problem;
use crate::api::rest::extract::bytes_max;
use crate::app::Role;
use axum::Router;
use axum::body::{Body, HttpBody};
use axum::extract::{Extension, Request, State};
use axum::http::{Method, Uri};
use axum::response::{IntoResponse, Response};
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::sync::{OwnedSemaphorePermit, oneshot};
use tokio::task::AbortHandle;
use tower::ServiceExt;
use tracing::Instrument;

/// Time limit for the head of a response: nothing behind the front end computes for longer than a
/// database call takes.
const PATIENCE: Duration = Duration::from_secs(30);
/// Bytes that a gRPC message has in addition to its content.
const GRPC_PREFIX: usize = 5;

/// Hands requests from the front end to the rest; cheap to clone.
#[derive(Clone)]
pub struct Hall {
    /// Runtime that handles everything except stops.
    main: Handle,
    router: Router,
    seats: Seats,
    streams: Streams,
    arrivals: Arc<Arrivals>,
}

/// Resources held while a response is produced.
struct Held {
    seat: OwnedSemaphorePermit,
    /// It holds the seat until its last byte is sent.
    is_long: bool,
    _stream: Option<StreamSeat>,
}

impl Hall {
    /// Creates one in front of `router`, which runs on `main`.
    pub fn new(main: Handle, router: Router) -> Self {
        Self {
            main,
            router,
            seats: Seats::default(),
            streams: Streams::default(),
            arrivals: Arc::default(),
        }
    }

    /// Checks the role first, then awaits the body, then a seat: a request waiting for one holds
    /// none of the later ones.
    async fn admit(
        &self,
        connection: &Connection,
        request: Request,
    ) -> Result<(Request, Held), Problem> {
        let caller = Caller::of(request.extensions());
        let of_grpc = is_grpc(request.headers());
        let path = request.uri().path();
        if of_grpc && let Some(Access::Least(role)) = access::access(path) {
            caller.require(role)?;
        }
        let (class, streams) = (class(&request, &caller), is_stream(request.uri()));
        let request = self.with_body(request, &caller).await?;
        let stream =
            streams.then(|| self.streams.take(connection, caller.is_anonymous())).transpose()?;
        let seat = self.seats.take(class).await?;
        let is_long = matches!(class, Class::Long | Class::LongAnonymous);
        Ok((request, Held { seat, is_long, _stream: stream }))
    }

    /// The request with its complete body; without it if the caller may not send one, in which case
    /// the route refuses it.
    async fn with_body(&self, request: Request, caller: &Caller) -> Result<Request, Problem> {
        let (of_grpc, path) = (is_grpc(request.headers()), request.uri().path());
        if of_grpc && access::listens(path) {
            return Ok(request);
        }
        let may_send = caller.require(Role::Operator).is_ok() || path == LOG_IN;
        if !of_grpc && (is_safe(request.method()) || !may_send) {
            return Ok(request.map(|_| Body::empty()));
        }
        let bytes_max = bytes_max(path) + if of_grpc { GRPC_PREFIX } else { 0 };
        let (parts, body) = request.into_parts();
        let bytes =
            self.arrivals.gather(&parts.headers, body, bytes_max, !caller.is_anonymous()).await?;
        Ok(Request::from_parts(parts, Body::from(bytes)))
    }

    /// Hands the request to the main runtime; aborts it if the client leaves before the head of the
    /// response exists.
    async fn hand_over(self, request: Request, held: Held) -> Response {
        let (head, answer) = oneshot::channel();
        let work = work(self.router, request, held, head).in_current_span();
        let mut giving_up = GiveUp(Some(self.main.spawn(work).abort_handle()));
        let answer = answer.await;
        giving_up.0 = None;
        answer.unwrap_or_else(|_| Problem::unavailable("shutting down").into_response())
    }
}

/// Aborts the work on a request when dropped.
struct GiveUp(Option<AbortHandle>);

impl Drop for GiveUp {
    fn drop(&mut self) {
        if let Some(work) = &self.0 {
            work.abort();
        }
    }
}

/// Answers a request that is not a stop.
pub async fn hall(
    State(hall): State<Hall>,
    Extension(connection): Extension<Arc<Connection>>,
    request: Request,
) -> Response {
    if is_grpc(request.headers()) && access::access(request.uri().path()).is_none() {
        return tonic::Status::unimplemented("no such method; reflection lists all").into_http();
    }
    match hall.admit(&connection, request).await {
        Ok((request, held)) => hall.hand_over(request, held).await,
        Err(problem) => problem.into_response(),
    }
}

/// Runs on the main runtime: produces the head of the response, then its body, so that the front
/// end only copies bytes.
async fn work(router: Router, request: Request, held: Held, head: oneshot::Sender<Response>) {
    let answered = tokio::time::timeout(PATIENCE, router.oneshot(request)).await;
    let late = || {
        Problem::unavailable("the request took too long; it may still have been carried out")
            .into_response()
    };
    let Ok(response) = answered.unwrap_or_else(|_| Ok(late()));
    let (parts, body) = response.into_parts();
    if body.size_hint().exact().is_some() {
        let _client_is_gone = head.send(Response::from_parts(parts, body));
        return;
    }
    let (source, relayed) = relay();
    let _client_is_gone = head.send(Response::from_parts(parts, relayed));
    let Held { seat, is_long, _stream } = held;
    let _seat = is_long.then_some(seat);
    source.feed(body).await;
}

fn is_safe(method: &Method) -> bool {
    matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS)
}

/// Whether the response continues for as long as events arrive, or waits for one.
pub fn is_stream(uri: &Uri) -> bool {
    let path = uri.path();
    match path.starts_with("/v1/") {
        true => path.ends_with("/events") || uri.query().is_some_and(waits),
        false => access::streams(path),
    }
}

/// Whether a query asks to wait until something has ended.
fn waits(query: &str) -> bool {
    form_urlencoded::parse(query.as_bytes()).any(|(key, _)| key == "wait")
}

/// Where people without a token send something.
const LOG_IN: &str = "/v1/login/finish";

/// Whether the response grows with the whole history.
fn is_long(path: &str) -> bool {
    const LONG: [&str; 5] = [
        "/v1/audit.json",
        "/v1/audit.csv",
        "/v1/audit/verification",
        "/v1/shakes.csv",
        "/flip.v1.Bench/VerifyAudit",
    ];
    LONG.contains(&path) || path.starts_with("/v1/") && path.ends_with("measurements.csv")
}

fn class(request: &Request, caller: &Caller) -> Class {
    let path = request.uri().path();
    let writes = match is_grpc(request.headers()) {
        true => match access::access(path) {
            Some(Access::Least(role)) => role > Role::Viewer,
            Some(Access::LogIn) => false,
            Some(Access::Anybody) | None => return Class::Probe,
        },
        false => !is_safe(request.method()),
    };
    match (caller.is_anonymous(), is_long(path)) {
        _ if path == "/metrics" => Class::Probe,
        (true, true) => Class::LongAnonymous,
        (true, false) => Class::Anonymous,
        (false, true) => Class::Long,
        (false, false) if writes => Class::Writer,
        (false, false) => Class::Reader,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(method: &str, path: &str, caller: &Caller) -> Class {
        let kind = if path.starts_with("/v1") { "application/json" } else { "application/grpc" };
        let request = Request::builder().method(method).uri(path).header("content-type", kind);
        class(&request.body(Body::empty()).unwrap(), caller)
    }

    #[test]
    fn requests_wait_with_their_like() {
        let nobody = Caller::Anonymous { may_read: true };
        let operator = Caller::of_role(Role::Operator);
        assert_eq!(of("GET", "/v1/powders", &nobody), Class::Anonymous);
        assert_eq!(of("GET", "/v1/powders", &operator), Class::Reader);
        assert_eq!(of("POST", "/v1/powders", &operator), Class::Writer);
        assert_eq!(of("POST", "/flip.v1.Powders/ListPowders", &operator), Class::Reader);
        assert_eq!(of("POST", "/flip.v1.Weighings/StartWeighing", &operator), Class::Writer);
        assert_eq!(of("GET", "/v1/audit.json", &nobody), Class::LongAnonymous);
        assert_eq!(of("GET", "/v1/powders/salt/measurements.csv", &operator), Class::Long);
        assert_eq!(of("POST", "/grpc.health.v1.Health/Check", &nobody), Class::Probe);
        assert_eq!(of("POST", LOG_IN, &nobody), Class::Anonymous);
        assert_eq!(of("POST", "/flip.v1.Tokens/FinishLogIn", &nobody), Class::Anonymous);
    }

    #[test]
    fn events_are_followed_over_both_transports() {
        for path in [
            "/v1/events",
            "/v1/jobs/1/events",
            "/v1/jobs/1?wait=30",
            "/flip.v1.Jobs/WatchJob",
            "/grpc.health.v1.Health/Watch",
        ] {
            assert!(is_stream(&path.parse().unwrap()), "{path}");
        }
        for path in ["/v1/jobs/1", "/v1/jobs/1?limit=1", "/flip.v1.Jobs/GetJob"] {
            assert!(!is_stream(&path.parse().unwrap()), "{path}");
        }
    }
}
