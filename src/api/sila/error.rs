//! The four kinds of errors of the standard. Each travels as a gRPC status `ABORTED` whose message
//! is the error in base64.

use super::feature::AUTHORIZATION;
use super::standard::{self, framework_error::ErrorType, si_la_error};
use crate::api::auth::Caller;
use crate::api::problem::Problem;
use crate::app::{self, Role};
use axum::http::Extensions;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use prost::Message;
use tonic::{Code, Status};

/// A command, and what its refusals are called: the application speaks of fields and codes, the
/// standard of parameters and defined execution errors.
pub struct Call {
    /// The feature's fully qualified identifier.
    pub feature: &'static str,
    /// The command's identifier.
    pub command: &'static str,
    /// Fields of the application's requests, or what they begin with, and the parameters that they
    /// come from.
    pub parameters: &'static [(&'static str, &'static str)],
    /// Codes of conflicts, and the defined execution errors that they are.
    pub errors: &'static [(&'static str, &'static str)],
}

impl Call {
    /// A parameter is refused.
    pub fn invalid(&self, parameter: &str, message: impl Into<String>) -> Status {
        let parameter = format!("{}/Command/{}/Parameter/{parameter}", self.feature, self.command);
        let message = message.into();
        status(si_la_error::Error::ValidationError(standard::ValidationError {
            parameter,
            message,
        }))
    }

    /// A parameter is missing.
    pub fn missing(&self, parameter: &str) -> Status {
        self.invalid(parameter, "is missing")
    }

    /// A defined execution error of the feature.
    pub fn defined(&self, error: &str, message: impl Into<String>) -> Status {
        defined(self.feature, error, message)
    }

    /// Why the application refuses.
    pub fn refused(&self, error: app::Error) -> Status {
        use app::Error;
        let message = error.to_string();
        match error {
            Error::Invalid(all) => {
                let named = |it: &app::FieldError| Some((self.parameter(&it.field)?, it.clone()));
                match all.iter().find_map(named) {
                    Some((parameter, first)) if all.len() == 1 => {
                        self.invalid(parameter, first.message)
                    }
                    Some((parameter, _)) => self.invalid(parameter, message),
                    None => undefined(message),
                }
            }
            Error::Conflict { code, .. } => self.conflict(code, message),
            Error::Unprocessable { .. } => self.conflict("idempotency_key_reused", message),
            Error::NotFound { .. } => match self.parameter("id") {
                Some(parameter) => self.invalid(parameter, message),
                None => undefined(message),
            },
            error => unlike(error),
        }
    }

    fn conflict(&self, code: &str, message: String) -> Status {
        match self.errors.iter().find(|(known, _)| *known == code) {
            Some((_, identifier)) => self.defined(identifier, message),
            None => undefined(message),
        }
    }

    /// The parameter that a field comes from.
    fn parameter(&self, field: &str) -> Option<&'static str> {
        let begins = |known: &str| {
            field
                .strip_prefix(known)
                .is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
        };
        self.parameters.iter().find(|(known, _)| begins(known)).map(|(_, parameter)| *parameter)
    }
}

/// Refusals that have no name of their own in any feature.
fn unlike(error: app::Error) -> Status {
    use app::Error;
    let message = error.to_string();
    match error {
        Error::Busy(_) | Error::Unavailable(_) => {
            framework(ErrorType::CommandExecutionNotAccepted, message)
        }
        Error::TokenEnded => invalid_token(message),
        Error::Internal(cause) => {
            tracing::error!(cause = ?cause, "internal error");
            undefined("it failed on the server's side; the log has the cause")
        }
        _ => undefined(message),
    }
}

/// Why the application cannot answer what has no parameters that could be wrong.
pub fn unanswered(error: app::Error) -> Status {
    unlike(error)
}

/// A defined execution error.
pub fn defined(feature: &str, error: &str, message: impl Into<String>) -> Status {
    let error_identifier = format!("{feature}/DefinedExecutionError/{error}");
    let message = message.into();
    status(si_la_error::Error::DefinedExecutionError(standard::DefinedExecutionError {
        error_identifier,
        message,
    }))
}

/// An execution error that no feature defines.
pub fn undefined(message: impl Into<String>) -> Status {
    let message = message.into();
    status(si_la_error::Error::UndefinedExecutionError(standard::UndefinedExecutionError {
        message,
    }))
}

/// The protocol was used wrongly, or the command is not accepted.
pub fn framework(kind: ErrorType, message: impl Into<String>) -> Status {
    let (error_type, message) = (kind as i32, message.into());
    status(si_la_error::Error::FrameworkError(standard::FrameworkError { error_type, message }))
}

/// There is no execution of this command with this UUID.
pub fn no_execution(uuid: &str) -> Status {
    let shown: String = uuid.chars().filter(|c| !c.is_control()).take(40).collect();
    let message = format!("`{shown}` is no execution of this command");
    framework(ErrorType::InvalidCommandExecutionUuid, message)
}

/// The execution has no result yet.
pub fn not_finished(uuid: &str) -> Status {
    let message = format!("execution {uuid} has not ended: subscribe to its execution info");
    framework(ErrorType::CommandExecutionNotFinished, message)
}

/// The access token is refused.
pub fn invalid_token(message: impl Into<String>) -> Status {
    defined(AUTHORIZATION, "InvalidAccessToken", message)
}

fn status(error: si_la_error::Error) -> Status {
    aborted(&standard::SiLaError { error: Some(error) })
}

/// The status that carries an error of the standard.
pub fn aborted(error: &impl Message) -> Status {
    Status::new(Code::Aborted, STANDARD.encode(error.encode_to_vec()))
}

/// Succeeds if the caller has at least `role`.
///
/// # Errors
/// `InvalidMetadata` without a token, `InvalidAccessToken` if its role is too low.
pub fn may(extensions: &Extensions, role: Role) -> Result<(), Status> {
    let caller = Caller::of(extensions);
    caller.require(role).map_err(|problem| forbidden(&caller, &problem))
}

/// Succeeds if the caller may clear a latched bench.
///
/// # Errors
/// As [`may`].
pub fn may_clear(extensions: &Extensions) -> Result<(), Status> {
    let caller = Caller::of(extensions);
    caller.require_clearer().map_err(|problem| forbidden(&caller, &problem))
}

fn forbidden(caller: &Caller, problem: &Problem) -> Status {
    match caller.is_anonymous() {
        true => framework(
            ErrorType::InvalidMetadata,
            "send the metadata AccessToken of the AuthorizationService: Login of the AuthenticationService gives one for a FLIP token",
        ),
        false => invalid_token(&problem.detail),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::FieldError;

    const CALL: Call = Call {
        feature: "flip/weighing/PowderWeighing/v1",
        command: "DosePowder",
        parameters: &[("target", "TargetMass"), ("asked.vial", "Vial")],
        errors: &[("bench_latched", "BenchLatched")],
    };

    fn decoded(status: &Status) -> si_la_error::Error {
        assert_eq!(status.code(), Code::Aborted);
        let bytes = STANDARD.decode(status.message()).unwrap();
        standard::SiLaError::decode(&*bytes).unwrap().error.unwrap()
    }

    #[test]
    fn a_field_becomes_the_parameter_that_it_came_from() {
        let error = app::Error::Invalid(vec![FieldError::new("target.value", "must be less")]);
        let si_la_error::Error::ValidationError(error) = decoded(&CALL.refused(error)) else {
            panic!("another kind");
        };
        let parameter = "flip/weighing/PowderWeighing/v1/Command/DosePowder/Parameter/TargetMass";
        assert_eq!((error.parameter.as_str(), error.message.as_str()), (parameter, "must be less"));
        let elsewhere = app::Error::Invalid(vec![FieldError::new("targets", "must be less")]);
        let other = decoded(&CALL.refused(elsewhere));
        assert!(matches!(other, si_la_error::Error::UndefinedExecutionError(_)), "{other:?}");
    }

    #[test]
    fn a_conflict_is_defined_where_the_feature_knows_it() {
        let of = |code| app::Error::Conflict { code, message: "because".to_owned() };
        let si_la_error::Error::DefinedExecutionError(known) =
            decoded(&CALL.refused(of("bench_latched")))
        else {
            panic!("another kind");
        };
        let identifier = "flip/weighing/PowderWeighing/v1/DefinedExecutionError/BenchLatched";
        assert_eq!(known.error_identifier, identifier);
        let other = decoded(&CALL.refused(of("something_else")));
        assert!(matches!(other, si_la_error::Error::UndefinedExecutionError(_)), "{other:?}");
    }

    #[test]
    fn a_full_queue_is_a_command_that_is_not_accepted() {
        let si_la_error::Error::FrameworkError(error) =
            decoded(&CALL.refused(app::Error::Busy("64 wait".to_owned())))
        else {
            panic!("another kind");
        };
        assert_eq!(error.error_type(), ErrorType::CommandExecutionNotAccepted);
    }
}
