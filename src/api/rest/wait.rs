//! `?wait=`: an answer that comes when its subject has ended, for clients that cannot hold a
//! stream of events.

use crate::api::problem::Problem;
use crate::api::wire::Answer;
use crate::app;
use axum::Json;
use axum::body::Body;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use flip_core::domain::FieldError;
use futures::stream;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Longest wait, s.
const WAIT_S_MAX: u32 = 300;

/// How long to wait.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct WaitParams {
    /// Seconds to wait for the end, 1 to 300; the answer comes then, or as it is after this time.
    /// Default: at once.
    #[param(minimum = 1, maximum = 300)]
    wait: Option<u32>,
}

impl WaitParams {
    /// How long, if at all.
    ///
    /// # Errors
    /// 400 naming `wait`.
    pub fn checked(&self) -> Result<Option<Duration>, Problem> {
        match self.wait {
            Some(seconds) if !(1..=WAIT_S_MAX).contains(&seconds) => {
                let advice = format!(
                    "must be 1 to {WAIT_S_MAX} seconds, got {seconds}: ask again when it is over"
                );
                Err(FieldError::new("wait", advice).into())
            }
            seconds => Ok(seconds.map(|it| Duration::from_secs(it.into()))),
        }
    }
}

/// The answer as it is now, or, with patience, as `later` finds it. The head is sent at once, so
/// that a request that waits takes no seat from others.
pub fn waited<T, Later>(
    now: T,
    patience: Option<Duration>,
    later: impl FnOnce(Duration) -> Later + Send + 'static,
) -> Response
where
    T: Answer<Wire: Serialize> + Send + 'static,
    Later: Future<Output = app::Result<T>> + Send + 'static,
{
    let Some(patience) = patience else { return Json(now.wire()).into_response() };
    let body =
        async move { Ok::<_, axum::BoxError>(serde_json::to_vec(&later(patience).await?.wire())?) };
    let mut response = Body::from_stream(stream::once(body)).into_response();
    let json = HeaderValue::from_static("application/json");
    response.headers_mut().insert(header::CONTENT_TYPE, json);
    response
}
