//! When a request was made: at its head, before waiting for anything else. Measured in stops of the
//! bench, so that a stop that arrives before the body cancels any motion the request would allow.

use crate::app::{App, asked_after};
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::Response;

/// Number of bench stops by the time the request head had arrived.
#[derive(Debug, Clone, Copy)]
struct Stops(u64);

/// Counts the stops at the head of a request.
pub async fn at_head(State(app): State<App>, mut request: Request, next: Next) -> Response {
    request.extensions_mut().insert(Stops(app.stops()));
    next.run(request).await
}

/// Makes the count available to everything the request does, in the task that handles it; by then
/// its body has arrived.
pub async fn as_of_head(request: Request, next: Next) -> Response {
    match request.extensions().get().copied() {
        Some(Stops(stops)) => asked_after(stops, next.run(request)).await,
        None => next.run(request).await,
    }
}
