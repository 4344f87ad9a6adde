//! Requests and outcomes of an emulated balance, independent of the dialect.

use super::cell::Display;
use super::{aandd, mt_sics, ohaus, sbi};
use crate::hardware::balance::Dialect;

/// A request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Request {
    /// A reading at once.
    Now,
    /// A reading once stable.
    WhenStable,
    /// Tare, once stable or at once.
    Tare { at_once: bool },
    /// Set the zero point, once stable or at once.
    Zero { at_once: bool },
    /// Query the tare.
    TareValue,
    /// Clear the tare.
    ClearTare,
    /// Identification query.
    Words(&'static str),
    /// Not a command of this balance.
    Unknown,
    /// Nothing to do and nothing to reply.
    Nothing,
}

/// The outcome of a request.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Outcome {
    /// The display.
    Shows(Display),
    /// The load, which is now the tare.
    Tared(String, &'static str),
    /// Done; whether the reading was stable.
    Done { stable: bool },
    /// No stable reading in time.
    NotStable,
    /// The load is too large for a zero point.
    OutOfRange,
    /// Text queries and unknown commands carry their reply in the request.
    AsAsked,
}

/// Parse a command, without its terminator.
pub(super) fn understand(dialect: Dialect, command: &str) -> Request {
    match dialect {
        Dialect::MtSics => mt_sics::understand(command),
        Dialect::Ohaus => ohaus::understand(command),
        Dialect::Sbi => sbi::understand(command),
        Dialect::Aandd => aandd::understand(command),
    }
}

/// The reply line, without its terminator; `None`: no reply.
pub(super) fn say(
    dialect: Dialect,
    request: Request,
    outcome: &Outcome,
    tared: bool,
) -> Option<String> {
    match dialect {
        Dialect::MtSics => mt_sics::say(request, outcome),
        Dialect::Ohaus => ohaus::say(request, outcome, tared),
        Dialect::Sbi => sbi::say(request, outcome),
        Dialect::Aandd => aandd::say(request, outcome),
    }
}

/// The line that a balance sends on power-up, without its terminator; known only for MT-SICS.
pub(super) fn announcement(dialect: Dialect) -> Option<&'static str> {
    match understand(dialect, "I4") {
        Request::Words(words) if dialect == Dialect::MtSics => Some(words),
        _ => None,
    }
}
