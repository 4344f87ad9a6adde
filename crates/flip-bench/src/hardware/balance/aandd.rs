//! The standard format of A&D balances.
//!
//! ```text
//! > Q             < ST,+00123.456  g      stable        < OL,+9999999E+19   overload
//!                 < US,+00123.451  g      moving        < OL,-9999999E+19   underload
//!                                                       < EC,E01 not a command, EC,E02 not ready, other errors
//!                 < ST,GS,+  12.345 g      gross or net (NT) said as well, as indicators do
//!                 < QT,+00000123 PC        counts pieces: not weighed by
//! > T, Z          < nothing, or ACK
//! > ?TN, ?SN      < words
//! ```
//!
//! Frames do not identify the command they answer, nor whether auto-print or stream mode sent them:
//! the driver takes the last of several.
//!
//! Not verified on a device: everything here is from memory, above all the error numbers and the
//! queries for model and serial number.

use super::reply::{Condition, Reply, Said, Unreadable, foreign, is_standby, printable, weight};
use super::value::Decimal;
use super::{Command, Commands, Wants};

/// Bytes of sign and number; more on balances with more digits.
const NUMBER_BYTES: std::ops::RangeInclusive<usize> = 9..=11;
/// The same with the last digit in brackets.
const BRACKETED_BYTES: std::ops::RangeInclusive<usize> = 9..=13;
/// Bytes of the unit.
const UNIT_BYTES: usize = 3;

pub(super) const COMMANDS: Commands = Commands {
    immediate: Command { bytes: b"Q\r\n", answer: None, wants: Wants::Reading },
    stable: Some(Command { bytes: b"S\r\n", answer: None, wants: Wants::Reading }),
    tare: Command { bytes: b"T\r\n", answer: None, wants: Wants::Done },
    zero: Command { bytes: b"Z\r\n", answer: None, wants: Wants::Done },
    tare_at_once: None,
    zero_at_once: None,
    acknowledges: false,
    barrier: None,
    model: &[Command { bytes: b"?TN\r\n", answer: None, wants: Wants::Words }],
    serial: Some(Command { bytes: b"?SN\r\n", answer: None, wants: Wants::Words }),
    software: None,
};

/// Parse one line of an A&D balance, without its terminator.
///
/// # Errors
/// [`Unreadable`]
pub fn parse(line: &[u8]) -> Result<Reply, Unreadable> {
    if line == b"\x06" {
        return Ok(Reply { to: None, said: Said::Done });
    }
    let text = printable(line)?;
    if is_standby(text) {
        return Ok(Reply::condition(Condition::Standby));
    }
    let Some((header, rest)) = text.split_once(',') else {
        let is_words = text.starts_with(|first: char| first.is_ascii_alphanumeric());
        return if is_words { Ok(Reply::text(text)) } else { Err(Unreadable) };
    };
    let before = header.len() + 1;
    match header {
        "ST" | "US" | "S" | "U" => {
            let stable = header.starts_with('S');
            Ok(Reply { to: None, said: mass(rest, before, stable).or_else(|_| foreign(rest))? })
        }
        "QT" => Ok(Reply { to: None, said: foreign(rest)? }),
        "OL" if rest == "+9999999E+19" => Ok(Reply::condition(Condition::Overload)),
        "OL" if rest == "-9999999E+19" => Ok(Reply::condition(Condition::Underload)),
        "EC" => Ok(Reply::condition(error(rest))),
        "TN" | "SN" => Ok(Reply::text(rest)),
        _ => Err(Unreadable),
    }
}

/// The mass behind a header of `before` bytes.
fn mass(rest: &str, before: usize, stable: bool) -> Result<Said, Unreadable> {
    if let Some((kind, number)) =
        rest.split_once(',').filter(|(kind, _)| ["GS", "NT", "G", "N"].contains(kind))
    {
        return loose_mass(number, before + kind.len() + 1, stable);
    }
    let end = rest.len().saturating_sub(UNIT_BYTES);
    let number =
        rest.get(..end).filter(|number| number.starts_with(['+', '-'])).ok_or(Unreadable)?;
    let allowed = if number.ends_with(']') { BRACKETED_BYTES } else { NUMBER_BYTES };
    if !allowed.contains(&number.len()) {
        return Err(Unreadable);
    }
    let number = Decimal::parse(number.as_bytes()).ok_or(Unreadable)?;
    weight(number, rest[end..].trim_start().as_bytes(), stable, before + end)
}

/// The same for an indicator, whose columns are narrower: the unit begins at the first letter.
fn loose_mass(rest: &str, before: usize, stable: bool) -> Result<Said, Unreadable> {
    let unit = rest.find(|c: char| c.is_ascii_alphabetic()).ok_or(Unreadable)?;
    let number = rest[..unit].trim_end();
    let said = Decimal::parse(number.as_bytes()).ok_or(Unreadable)?;
    weight(said, rest[unit..].trim_end().as_bytes(), stable, before + number.len())
}

fn error(number: &str) -> Condition {
    match number {
        "E01" => Condition::Unknown,
        "E02" => Condition::NotReady,
        "E03" => Condition::NotStable,
        other => Condition::Fault(format!("EC,{other}")),
    }
}
