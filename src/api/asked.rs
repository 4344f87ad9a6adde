//! When a request was asked: at its head, before anything of it is waited for. Counted in stops of the bench, so that one which comes before the body does
//! makes void what the request would let move.

use crate::app::{App, asked_after};
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::Response;

/// Stops of the bench until the head of a request was there.
#[derive(Debug, Clone, Copy)]
struct Stops(u64);

/// Counts the stops at the head of a request.
pub async fn at_head(State(app): State<App>, mut request: Request, next: Next) -> Response {
    request.extensions_mut().insert(Stops(app.stops()));
    next.run(request).await
}

/// Lets all that a request does know them, on the task that carries it out: its body is there by then.
pub async fn as_of_head(request: Request, next: Next) -> Response {
    match request.extensions().get().copied() {
        Some(Stops(stops)) => asked_after(stops, next.run(request)).await,
        None => next.run(request).await,
    }
}
