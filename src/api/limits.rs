//! What one client may take from the others: seats and time.

use super::problem::Problem;
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Semaphore;

/// How much there is for all; cheap to clone.
#[derive(Debug, Clone)]
pub struct Limits {
    /// Requests worked on at once; event streams count only until they begin.
    seats: Arc<Semaphore>,
    /// Until the head of the answer.
    patience: Duration,
}

impl Default for Limits {
    /// 256 requests at once, 30 s each: nothing here computes for longer than a database takes.
    fn default() -> Self {
        Self { seats: Arc::new(Semaphore::new(256)), patience: Duration::from_secs(30) }
    }
}

/// Refuses at once when all seats are taken, which is kinder than a queue that nobody outlives, and ends what takes too
/// long, such as a body that never comes.
pub async fn fair(State(limits): State<Limits>, request: Request, next: Next) -> Response {
    let Ok(_seat) = limits.seats.try_acquire() else {
        return Problem::unavailable("too many requests at once; try again in a moment").into_response();
    };
    match tokio::time::timeout(limits.patience, next.run(request)).await {
        Ok(response) => response,
        Err(_) => Problem::unavailable("the request took too long; it may still have been carried out").into_response(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::Router;
    use axum::middleware::from_fn_with_state;
    use axum::routing::get;
    use tower::ServiceExt;

    async fn status(seats: usize, path: &str) -> u16 {
        let limits = Limits { seats: Arc::new(Semaphore::new(seats)), patience: Duration::from_millis(5) };
        let router = Router::new()
            .route("/quick", get(async || ()))
            .route("/never", get(std::future::pending::<()>))
            .layer(from_fn_with_state(limits, fair));
        let request = Request::builder().uri(path).body(axum::body::Body::empty()).unwrap();
        router.oneshot(request).await.unwrap().status().as_u16()
    }

    #[tokio::test]
    async fn a_request_without_a_seat_or_without_an_end_is_refused() {
        assert_eq!(status(1, "/quick").await, 200);
        assert_eq!(status(0, "/quick").await, 503);
        assert_eq!(status(1, "/never").await, 503);
    }
}
