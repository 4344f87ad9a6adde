//! What an emulated balance understands and answers, whatever its dialect.

use super::cell::Display;
use super::{aandd, mt_sics, ohaus, sbi};
use crate::hardware::balance::Dialect;

/// What was asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Request {
    /// A reading as it is.
    Now,
    /// A reading when it is stable.
    WhenStable,
    /// Take the load for nothing, when stable or at once.
    Tare { at_once: bool },
    /// Set the zero point, when stable or at once.
    Zero { at_once: bool },
    /// What the tare is.
    TareValue,
    /// Forget the tare.
    ClearTare,
    /// Who are you?
    Words(&'static str),
    /// Not a command of this balance.
    Unknown,
    /// Nothing to do and nothing to say.
    Nothing,
}

/// What comes of it.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Outcome {
    /// The display.
    Shows(Display),
    /// The load, which is the tare now.
    Tared(String, &'static str),
    /// Done; the reading was stable, or not.
    Done { stable: bool },
    /// No stable reading in time.
    NotStable,
    /// The load is too large for a zero point.
    OutOfRange,
    /// Words and unknown commands carry their answer in the request.
    AsAsked,
}

/// The command that these bytes, without their end, are.
pub(super) fn understand(dialect: Dialect, command: &str) -> Request {
    match dialect {
        Dialect::MtSics => mt_sics::understand(command),
        Dialect::Ohaus => ohaus::understand(command),
        Dialect::Sbi => sbi::understand(command),
        Dialect::Aandd => aandd::understand(command),
    }
}

/// The line that says so, without its end; `None`: nothing is said.
pub(super) fn say(dialect: Dialect, request: Request, outcome: &Outcome, tared: bool) -> Option<String> {
    match dialect {
        Dialect::MtSics => mt_sics::say(request, outcome),
        Dialect::Ohaus => ohaus::say(request, outcome, tared),
        Dialect::Sbi => sbi::say(request, outcome),
        Dialect::Aandd => aandd::say(request, outcome),
    }
}

/// The line that a balance says when it is switched on, without its end; none is known but of MT-SICS.
pub(super) fn announcement(dialect: Dialect) -> Option<&'static str> {
    match understand(dialect, "I4") {
        Request::Words(words) if dialect == Dialect::MtSics => Some(words),
        _ => None,
    }
}
