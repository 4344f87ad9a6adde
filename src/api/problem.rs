//! One error format for both transports: RFC 9457 problem details.
//!
//! A handler, an extractor or a layer returns a [`Problem`]; [`super::edge`] adds the request's id
//! and writes it as `application/problem+json`, or as a gRPC status ([`super::grpc::status`]) if
//! the caller speaks gRPC.

use super::wire::{self, Answer};
use crate::app;
use axum::Json;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use flip_core::domain::FieldError;
use serde::{Deserialize, Serialize};

/// What went wrong, for programs (`type`, `status`, `errors`) and people (`title`, `detail`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Problem {
    /// Stable name of the kind of problem, e.g. `urn:flip:problem:invalid`.
    #[serde(rename = "type")]
    #[schema(value_type = String)]
    pub kind: Box<str>,
    /// The kind in words; the same for every problem of one type.
    #[schema(value_type = String)]
    pub title: Box<str>,
    /// HTTP status.
    pub status: u16,
    /// What went wrong this time and what to do.
    pub detail: String,
    /// The request, as in its `x-request-id` header and in the logs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// The fields that were refused; empty when no single field is at fault.
    pub errors: Vec<wire::FieldError>,
}

/// The content type of [`Problem`].
pub const CONTENT_TYPE: &str = "application/problem+json";

/// Retry delay after a 503, s: about as long as another program's lock is waited for before the
/// request fails.
const RETRY_AFTER_S: &str = "5";

impl Problem {
    fn new(status: StatusCode, kind: &str, title: &str, detail: impl Into<String>) -> Self {
        Self {
            kind: format!("urn:flip:problem:{kind}").into(),
            title: title.into(),
            status: status.as_u16(),
            detail: detail.into(),
            instance: None,
            errors: Vec::new(),
        }
    }

    /// 400: invalid fields, with their bounds.
    pub fn invalid(errors: impl IntoIterator<Item = FieldError>) -> Self {
        let errors: Vec<_> = errors.into_iter().collect();
        let detail = errors
            .iter()
            .map(|e| format!("{} {}", e.field, e.message))
            .collect::<Vec<_>>()
            .join("; ");
        Self {
            errors: errors.wire(),
            ..Self::new(StatusCode::BAD_REQUEST, "invalid", "The request is not valid", detail)
        }
    }

    /// 400: the request cannot be parsed.
    pub fn malformed(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "malformed", "The request cannot be read", detail)
    }

    /// 401: a token is missing or unknown.
    pub fn unauthorized(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::UNAUTHORIZED, "unauthorized", "A valid token is needed", detail)
    }

    /// 403: the token's role is too low.
    pub fn forbidden(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::FORBIDDEN, "forbidden", "Not allowed", detail)
    }

    /// 404: no such thing.
    pub fn not_found(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, "not-found", "Not found", detail)
    }

    /// 405: the path exists, the method does not.
    pub fn method_not_allowed() -> Self {
        let detail = "the Allow header lists the methods of this path";
        Self::new(
            StatusCode::METHOD_NOT_ALLOWED,
            "method-not-allowed",
            "Method not allowed",
            detail,
        )
    }

    /// 409: conflicts with the current state; `code` names how.
    pub fn conflict(code: &str, detail: impl Into<String>) -> Self {
        Self::new(StatusCode::CONFLICT, code, "Conflicts with the present state", detail)
    }

    /// 410: it was stored, and can no longer be read.
    pub fn lost(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::GONE, "lost", "Lost", detail)
    }

    /// 408: a request that does not complete in time.
    pub fn too_slow(detail: impl Into<String>) -> Self {
        Self::new(
            StatusCode::REQUEST_TIMEOUT,
            "too-slow",
            "The request did not arrive in time",
            detail,
        )
    }

    /// 413: the body is larger than the service reads.
    pub fn too_large(limit_bytes: usize) -> Self {
        let detail = format!("a request body may hold at most {limit_bytes} bytes");
        Self::new(StatusCode::PAYLOAD_TOO_LARGE, "too-large", "The body is too large", detail)
    }

    /// 415: not the content type the operation reads, such as `application/json`.
    pub fn unsupported_media_type(expected: &str) -> Self {
        let detail = format!("send the body as Content-Type: {expected}");
        Self::new(
            StatusCode::UNSUPPORTED_MEDIA_TYPE,
            "unsupported-media-type",
            "Unsupported media type",
            detail,
        )
    }

    /// 422: an idempotency key was reused with another request.
    pub fn key_reused(detail: impl Into<String>) -> Self {
        Self::new(
            StatusCode::UNPROCESSABLE_ENTITY,
            "idempotency-key-reused",
            "The key belongs to another request",
            detail,
        )
    }

    /// 429: this client already has too many.
    pub fn too_many(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::TOO_MANY_REQUESTS, "too-many", "Too many at once", detail)
    }

    /// 500: our fault; the cause is logged under the request's id.
    pub fn internal() -> Self {
        let detail =
            "the request failed on the server's side; the log has the cause under this instance";
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, "internal", "Internal error", detail)
    }

    /// 503: not now; the same request may succeed later.
    pub fn unavailable(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::SERVICE_UNAVAILABLE, "unavailable", "Not available now", detail)
    }

    /// The HTTP status.
    pub fn status(&self) -> StatusCode {
        StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR)
    }
}

impl From<app::Error> for Problem {
    fn from(error: app::Error) -> Self {
        use app::Error;
        let detail = error.to_string();
        match error {
            Error::Invalid(errors) => Self::invalid(errors),
            Error::NotFound { .. } => Self::not_found(detail),
            Error::Conflict { code, .. } => Self::conflict(&code.replace('_', "-"), detail),
            Error::Busy(_) => Self::conflict("queue-full", detail),
            Error::Unprocessable { .. } => Self::key_reused(detail),
            Error::Unavailable(_) => Self::unavailable(detail),
            Error::Refused(_) => Self::forbidden(detail),
            Error::TokenEnded => Self::unauthorized(detail),
            Error::Lost(_) => Self::lost(detail),
            Error::Internal(cause) => {
                tracing::error!(cause = ?cause, "internal error");
                Self::internal()
            }
        }
    }
}

impl From<FieldError> for Problem {
    fn from(error: FieldError) -> Self {
        Self::invalid([error])
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let mut response = (self.status(), Json(&self)).into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(CONTENT_TYPE));
        if self.status() == StatusCode::UNAUTHORIZED {
            headers.insert(
                header::WWW_AUTHENTICATE,
                HeaderValue::from_static("Bearer realm=\"flip\""),
            );
        }
        if self.status() == StatusCode::SERVICE_UNAVAILABLE {
            headers.insert(header::RETRY_AFTER, HeaderValue::from_static(RETRY_AFTER_S));
        }
        // For `edge`, which writes it again with the request's id.
        response.extensions_mut().insert(self);
        response
    }
}
