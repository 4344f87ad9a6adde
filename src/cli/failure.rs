//! How a command fails: its output, and the exit status that scripts see.

use crate::app::{Error, OpenError};
use crate::telemetry;
use flip_core::domain::FieldError;
use serde_json::json;
use std::io::Write;
use std::process::ExitCode;

/// Why a command did not do what was requested.
#[derive(Debug)]
pub(super) enum Failure {
    /// The input is invalid, field by field. Exit status 2.
    BadInput(Vec<FieldError>),
    /// The input is valid but the command is not possible now: a prerequisite is missing, another
    /// process holds the database, or a server does not accept the token. Exit status 2.
    NotNow(String),
    /// The command printed its document, which reports a problem. Exit status 1; nothing more on
    /// stdout.
    Found(String),
    /// Everything else. Exit status 1.
    Failed(anyhow::Error),
}

impl Failure {
    /// Prints the reason (on stderr, and as the single document on stdout with `json`) and returns
    /// the exit status.
    pub(super) fn report(&self, json: bool) -> ExitCode {
        let (status, document) = match self {
            Self::Found(message) => {
                telemetry::say(format_args!("flip: {message}"));
                return ExitCode::from(1);
            }
            Self::BadInput(errors) => {
                let errors: Vec<_> = errors
                    .iter()
                    .map(|e| json!({ "field": e.field, "message": e.message }))
                    .collect();
                (2, json!({ "error": { "kind": "bad_input", "errors": errors } }))
            }
            Self::NotNow(message) => {
                (2, json!({ "error": { "kind": "not_now", "message": message } }))
            }
            Self::Failed(error) => {
                (1, json!({ "error": { "kind": "failed", "message": format!("{error:#}") } }))
            }
        };
        match self {
            Self::Found(_) => {}
            Self::BadInput(errors) => {
                errors.iter().for_each(|e| telemetry::say(format_args!("flip: {e}")))
            }
            Self::NotNow(message) => telemetry::say(format_args!("flip: {message}")),
            Self::Failed(error) => telemetry::say(format_args!("flip: {error:#}")),
        }
        if json {
            print(&document);
        }
        ExitCode::from(status)
    }
}

/// The exit status after clap refused the arguments, or after `--help` and `--version`.
pub(super) fn of_arguments(error: &clap::Error) -> ExitCode {
    // A message that cannot be written has nowhere else to go.
    let _ = error.print();
    if error.exit_code() != 0 && std::env::args().any(|argument| argument == "--json") {
        let message = error.render().to_string();
        print(&json!({ "error": { "kind": "bad_input", "message": message } }));
    }
    ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(1))
}

/// Prints the single document. A reader that has closed the pipe does not want it; stderr and the
/// exit status still convey the result.
fn print(document: &serde_json::Value) {
    let _ = writeln!(std::io::stdout(), "{document:#}");
}

impl From<FieldError> for Failure {
    fn from(error: FieldError) -> Self {
        Self::BadInput(vec![error])
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        match error {
            Error::Invalid(errors) => Self::BadInput(errors),
            Error::NotFound { what, ref id } => {
                FieldError::new(what, format!("there is no {what} `{id}`")).into()
            }
            Error::Conflict { .. }
            | Error::Unprocessable { .. }
            | Error::Refused(_)
            | Error::TokenEnded => Self::NotNow(error.to_string()),
            Error::Busy(_) | Error::Unavailable(_) | Error::Lost(_) | Error::Internal(_) => {
                Self::Failed(error.into())
            }
        }
    }
}

impl From<OpenError> for Failure {
    fn from(error: OpenError) -> Self {
        match error {
            OpenError::Held(message) => Self::NotNow(message),
            error => Self::Failed(error.into()),
        }
    }
}

impl From<anyhow::Error> for Failure {
    fn from(error: anyhow::Error) -> Self {
        Self::Failed(error)
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Self {
        Self::Failed(error.into())
    }
}

impl From<serde_json::Error> for Failure {
    fn from(error: serde_json::Error) -> Self {
        Self::Failed(error.into())
    }
}
