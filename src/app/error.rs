//! Why a request is refused, in the caller's terms.

use flip_core::domain::FieldError;
use flip_store as store;

/// Why the application did not carry out a request. REST and gRPC map each variant once.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// One or more fields are invalid; each entry gives the field, the bound, and what to do.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    Invalid(Vec<FieldError>),
    /// There is no such thing.
    #[error("there is no {what} `{id}`")]
    NotFound {
        /// `powder`, `job`, `policy`, ...
        what: &'static str,
        /// The requested id.
        id: String,
    },
    /// The request is valid but not possible now: something is missing, in use, or already there.
    #[error("{message}")]
    Conflict {
        /// Stable name: `powder_exists`, `measurement_missing`, `calibration_missing`,
        /// `calibration_unfinished`, `investigation_unfinished`, `job_finished`,
        /// `weighing_finished`, `log_in_not_set_up`.
        code: &'static str,
        /// What prevents it and which command or endpoint helps.
        message: String,
    },
    /// The Idempotency-Key was used before with another body.
    #[error(
        "the Idempotency-Key `{key}` belongs to weighing {weighing}, which was requested with another body: use a new key for a new weighing"
    )]
    Unprocessable {
        /// The key.
        key: String,
        /// The weighing created with it.
        weighing: String,
    },
    /// The bench's queue is full.
    #[error("{0}")]
    Busy(String),
    /// Temporary and not the caller's fault: shutting down, opened read-only, the database locked
    /// by another program, the disk full.
    #[error("{0}")]
    Unavailable(String),
    /// A log-in that is not accepted: why, and what to do.
    #[error("{0}")]
    Refused(String),
    /// The token used for the request has expired or was revoked meanwhile.
    #[error("the token has expired or was revoked")]
    TokenEnded,
    /// A stored part is missing or damaged; the other parts still exist.
    #[error("{0}")]
    Lost(String),
    /// Our fault. The cause is logged, never returned to the caller.
    #[error("internal error")]
    Internal(#[source] Box<dyn std::error::Error + Send + Sync>),
}

/// Result of every function of the application.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// A conflict with a stable code.
    pub(crate) fn conflict(code: &'static str, message: impl Into<String>) -> Self {
        Self::Conflict { code, message: message.into() }
    }

    /// The error of a stored part that can no longer be read; any other error is passed on.
    pub(crate) fn of_part(what: &str, error: store::Error) -> Self {
        match error.is_lost_part() {
            true => {
                tracing::warn!(%error, what, "a part of what was stored is lost");
                Self::Lost(lost(what))
            }
            false => error.into(),
        }
    }

    /// A missing thing.
    pub(crate) fn not_found(what: &'static str, id: impl Into<String>) -> Self {
        Self::NotFound { what, id: id.into() }
    }
}

/// The message about a lost part.
pub(crate) fn lost(what: &str) -> String {
    format!(
        "{what} is lost: its file is gone or damaged (the log says which). A backup may hold it; nothing else is affected"
    )
}

impl From<FieldError> for Error {
    fn from(error: FieldError) -> Self {
        Self::Invalid(vec![error])
    }
}

impl From<store::Error> for Error {
    fn from(error: store::Error) -> Self {
        match error {
            store::Error::ReadOnly => Self::Unavailable(
                "the data folder was opened for reading only, because `flip serve` holds it: use the server instead".into(),
            ),
            store::Error::Locked
            | store::Error::Archiving
            | store::Error::Busy
            | store::Error::Full
            | store::Error::Disk(_)
            | store::Error::Unreachable(_)
            | store::Error::ArtifactsAway { .. }
            | store::Error::Gone(_) => Self::Unavailable(error.to_string()),
            store::Error::Disowned(_) => Self::conflict("bench_lost", error.to_string()),
            error if error.is_closed() => {
                Self::Unavailable("FLIP is shutting down: try again after the restart".into())
            }
            other => Self::Internal(Box::new(other)),
        }
    }
}
