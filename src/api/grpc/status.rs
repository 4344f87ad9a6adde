//! Problems as gRPC statuses.
//!
//! The code follows from the HTTP status; the message is the problem's detail; the whole problem
//! travels as JSON in the binary trailer `flip-problem-bin`, so that a gRPC caller gets the same
//! fields as a REST caller.

use crate::api::problem::Problem;
use crate::app;
use axum::response::Response;
use tonic::metadata::MetadataValue;
use tonic::{Code, Status};

/// Trailer that holds the problem as JSON.
pub const PROBLEM_TRAILER: &str = "flip-problem-bin";

/// The status that corresponds to `problem`.
pub fn from_problem(problem: Problem) -> Status {
    let mut status = Status::new(code(&problem), problem.detail.clone());
    if let Ok(json) = serde_json::to_vec(&problem) {
        status.metadata_mut().insert_bin(PROBLEM_TRAILER, MetadataValue::from_bytes(&json));
    }
    status
}

fn code(problem: &Problem) -> Code {
    match problem.status {
        400 | 415 => Code::InvalidArgument,
        401 => Code::Unauthenticated,
        403 => Code::PermissionDenied,
        404 => Code::NotFound,
        405 => Code::Unimplemented,
        408 => Code::DeadlineExceeded,
        409 if problem.kind.ends_with(":queue-full") => Code::ResourceExhausted,
        409 => Code::FailedPrecondition,
        410 => Code::DataLoss,
        413 | 429 => Code::ResourceExhausted,
        422 => Code::AlreadyExists,
        503 => Code::Unavailable,
        _ => Code::Internal,
    }
}

/// Completes the response of a handler or of tonic: problems get the request's id, and messages
/// that do not decode become problems. The latter are tonic's own: it decodes the message before we
/// see it, and reports a malformed one as an internal error although the caller is at fault.
pub fn explain(response: Response, id: &str) -> Response {
    let Some(status) = response.extensions().get::<Status>() else { return response };
    let carried =
        status.metadata().get_bin(PROBLEM_TRAILER).and_then(|value| value.to_bytes().ok());
    let problem = match carried.map(|json| serde_json::from_slice(&json)) {
        Some(Ok(problem)) => problem,
        None if status.code() == Code::Internal => {
            Problem::malformed(format!("the message does not decode: {}", status.message()))
        }
        _ => return response,
    };
    from_problem(Problem { instance: Some(format!("urn:uuid:{id}")), ..problem }).into_http()
}

impl From<Problem> for Status {
    fn from(problem: Problem) -> Self {
        from_problem(problem)
    }
}

impl From<app::Error> for Status {
    fn from(error: app::Error) -> Self {
        Problem::from(error).into()
    }
}
