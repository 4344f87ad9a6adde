//! The outermost layer: assigns the request id, answers in the caller's protocol, sets security
//! headers, counts and logs.

use super::grpc;
use super::problem::Problem;
use crate::app::correlated;
use axum::extract::MatchedPath;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::time::Instant;
use tracing::Instrument;

/// Headers on every response. Scripts, styles and connections only from our own origin; no framing,
/// no content sniffing.
const HARDENING: [(HeaderName, &str); 5] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'self'; base-uri 'none'; object-src 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::REFERRER_POLICY, "no-referrer"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
];

/// Headers in which callers send their own id of a request, the first one first.
const CORRELATION: [HeaderName; 2] =
    [HeaderName::from_static("x-correlation-id"), HeaderName::from_static("x-request-id")];

/// The layer described in the module documentation.
pub async fn edge(mut request: Request, next: Next) -> Response {
    let id = uuid::Uuid::now_v7().to_string();
    let grpc = grpc::is_grpc(request.headers());
    let method = request.method().clone();
    let own_route = request.extensions().get::<MatchedPath>().cloned();
    let span = tracing::info_span!(
        "request",
        id,
        method = counted(&method),
        route = tracing::field::Empty,
        correlation_id = tracing::field::Empty
    );
    let correlation = correlation_id(request.headers());
    if let Some(correlation) = &correlation {
        let id = String::from_utf8_lossy(correlation.as_bytes()).into_owned();
        span.record("correlation_id", &id);
        request.extensions_mut().insert(CorrelationId(id));
    }

    let started = Instant::now();
    let mut response = next.run(request).instrument(span.clone()).await;
    // The route rather than the path: ids would create a metric per weighing.
    let route = response.extensions_mut().remove::<MatchedPath>().or(own_route);
    let route = route.as_ref().map_or("none", MatchedPath::as_str).to_owned();
    span.record("route", route.as_str());
    let mut response = in_callers_protocol(response, grpc, &id);
    harden(response.headers_mut(), &id);
    if let Some(correlation) = correlation {
        response.headers_mut().insert(&CORRELATION[0], correlation);
    }

    let seconds = started.elapsed().as_secs_f64();
    let status = response.status().as_u16();
    span.in_scope(|| tracing::debug!(status, seconds, "answered"));
    let labels =
        [("method", counted(&method).to_owned()), ("route", route), ("status", status.to_string())];
    metrics::counter!("flip_requests_total", &labels).increment(1);
    metrics::histogram!("flip_request_seconds", &labels).record(seconds);
    response
}

/// The caller's own id of a request, on its way through the layers: work may go on in another task.
#[derive(Clone)]
struct CorrelationId(String);

/// Carries a request out, which its caller may know by an id.
pub async fn carried_out(request: Request, next: Next) -> Response {
    let id = request.extensions().get::<CorrelationId>().map(|id| id.0.clone());
    correlated(id, next.run(request)).await
}

/// The caller's own id of a request, as it was sent: only what would keep it refuses one, so that
/// no header keeps a stop from being carried out.
fn correlation_id(headers: &HeaderMap) -> Option<HeaderValue> {
    CORRELATION.iter().find_map(|name| headers.get(name)).filter(|id| !id.is_empty()).cloned()
}

/// Label under which a method is counted and logged: callers make up methods, and every label is
/// kept forever.
fn counted(method: &Method) -> &str {
    let known = [
        Method::GET,
        Method::HEAD,
        Method::POST,
        Method::PUT,
        Method::PATCH,
        Method::DELETE,
        Method::OPTIONS,
        Method::CONNECT,
        Method::TRACE,
    ];
    if known.contains(method) { method.as_str() } else { "other" }
}

/// Passes the matched route to [`edge`], which sits in front of another router.
pub async fn tell_route(request: Request, next: Next) -> Response {
    let route = request.extensions().get::<MatchedPath>().cloned();
    let mut response = next.run(request).await;
    if let Some(route) = route {
        response.extensions_mut().insert(route);
    }
    response
}

/// Writes a [`Problem`] in the caller's protocol: with the request's id, and as a status over gRPC.
fn in_callers_protocol(mut response: Response, grpc: bool, id: &str) -> Response {
    let Some(problem) = response.extensions_mut().remove::<Problem>() else {
        return if grpc { grpc::status::explain(response, id) } else { response };
    };
    let problem = Problem { instance: Some(format!("urn:uuid:{id}")), ..problem };
    if grpc {
        return grpc::status::from_problem(problem).into_http();
    }
    // Keeps headers set by inner layers, such as Allow.
    let mut written = problem.into_response();
    for (name, value) in response.headers() {
        if name != header::CONTENT_LENGTH {
            written.headers_mut().insert(name, value.clone());
        }
    }
    written
}

fn harden(headers: &mut HeaderMap, id: &str) {
    // A page with its own style sets its own policy.
    for (name, value) in HARDENING {
        headers.entry(name).or_insert(HeaderValue::from_static(value));
    }
    // Responses change and may be private; cacheable ones set their own header.
    headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    if let Ok(id) = HeaderValue::from_str(id) {
        headers.insert("x-request-id", id);
    }
}

/// The response of a handler that panicked; the panic itself is logged.
pub fn panicked(cause: Box<dyn std::any::Any + Send>) -> Response {
    let text = cause
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| cause.downcast_ref::<&str>().copied());
    tracing::error!(panic = text.unwrap_or("of unknown cause"), "a request handler panicked");
    Problem::internal().into_response()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::grpc::status::PROBLEM_TRAILER;
    use axum::Router;
    use axum::body::{Body, to_bytes};
    use axum::middleware::from_fn;
    use axum::routing::post;
    use tower::ServiceExt;
    use tower_http::catch_panic::CatchPanicLayer;

    #[test]
    fn invented_methods_share_one_label() {
        for invented in ["M1YYYY", "get", "PURGE"] {
            assert_eq!(counted(&Method::from_bytes(invented.as_bytes()).unwrap()), "other");
        }
        assert_eq!((counted(&Method::GET), counted(&Method::DELETE)), ("GET", "DELETE"));
    }

    async fn answer_of_a_panic(content_type: &str) -> Response {
        let fails = async || -> () { panic!("a bug") };
        let layers = (from_fn(edge), CatchPanicLayer::custom(panicked));
        let router = Router::new().route("/", post(fails)).layer(layers);
        let request = Request::post("/").header(header::CONTENT_TYPE, content_type);
        router.oneshot(request.body(Body::empty()).unwrap()).await.unwrap()
    }

    #[tokio::test]
    async fn a_panic_is_a_problem_with_the_requests_id_and_without_the_cause() {
        let response = answer_of_a_panic("application/json").await;
        assert_eq!(response.status(), 500);
        let id = response.headers()["x-request-id"].to_str().unwrap().to_owned();
        let body = to_bytes(response.into_body(), 10_000).await.unwrap();
        let problem: Problem = serde_json::from_slice(&body).unwrap();
        assert_eq!(problem.instance, Some(format!("urn:uuid:{id}")));
        assert!(!String::from_utf8_lossy(&body).contains("a bug"));
    }

    #[tokio::test]
    async fn a_panic_is_a_status_for_those_who_speak_grpc() {
        let response = answer_of_a_panic("application/grpc").await;
        assert_eq!(response.status(), 200);
        assert_eq!(response.headers()["grpc-status"], "13");
        assert!(response.headers().contains_key(PROBLEM_TRAILER));
    }
}
