//! The standard format of A&D balances.
//!
//! ```text
//! > Q             < ST,+00123.456  g      stable        < OL,+9999999E+19   overload
//!                 < US,+00123.451  g      moving        < OL,-9999999E+19   underload
//!                                                       < EC,E01 not a command, EC,E02 not ready, other errors
//! > T, Z          < nothing, or ACK
//! > ?TN, ?SN      < words
//! ```
//!
//! Frames do not say which command they answer, nor whether auto-print or stream mode sent them: the driver takes the last of several.
//!
//! Not verified on a device: everything here is from memory, the error numbers and the questions for model and serial number above all.

use super::reply::{Condition, Reply, Said, Unreadable, printable, weight};
use super::value::Decimal;
use super::{Command, Commands, Wants};

/// Bytes of header and comma.
const HEADER_BYTES: usize = 3;
/// Bytes of the sign and number: more on balances with more digits.
const NUMBER_BYTES: std::ops::RangeInclusive<usize> = 9..=11;
/// Bytes of the unit.
const UNIT_BYTES: usize = 3;

pub(super) const COMMANDS: Commands = Commands {
    immediate: Command { bytes: b"Q\r\n", answer: None, wants: Wants::Reading },
    stable: Some(Command { bytes: b"S\r\n", answer: None, wants: Wants::Reading }),
    tare: Command { bytes: b"T\r\n", answer: None, wants: Wants::Done },
    zero: Command { bytes: b"Z\r\n", answer: None, wants: Wants::Done },
    acknowledges: false,
    barrier: None,
    model: &[Command { bytes: b"?TN\r\n", answer: None, wants: Wants::Words }],
    serial: Some(Command { bytes: b"?SN\r\n", answer: None, wants: Wants::Words }),
    software: None,
};

/// One line of an A&D balance, without its end.
///
/// # Errors
/// [`Unreadable`]
pub fn parse(line: &[u8]) -> Result<Reply, Unreadable> {
    if line == b"\x06" {
        return Ok(Reply { to: None, said: Said::Done });
    }
    let text = printable(line)?;
    let Some((header, rest)) = text.split_once(',') else {
        let is_words = text.starts_with(|first: char| first.is_ascii_alphanumeric());
        return if is_words { Ok(Reply::text(text)) } else { Err(Unreadable) };
    };
    match header {
        "ST" | "US" => Ok(Reply { to: None, said: mass(text, header == "ST")? }),
        "OL" if rest == "+9999999E+19" => Ok(Reply::condition(Condition::Overload)),
        "OL" if rest == "-9999999E+19" => Ok(Reply::condition(Condition::Underload)),
        "EC" => Ok(Reply::condition(error(rest))),
        "TN" | "SN" => Ok(Reply::text(rest)),
        _ => Err(Unreadable),
    }
}

fn mass(text: &str, stable: bool) -> Result<Said, Unreadable> {
    let end = text.len().saturating_sub(UNIT_BYTES);
    let number = text.get(HEADER_BYTES..end).filter(|number| number.starts_with(['+', '-'])).ok_or(Unreadable)?;
    if !NUMBER_BYTES.contains(&number.len()) {
        return Err(Unreadable);
    }
    let number = Decimal::parse(number.as_bytes()).ok_or(Unreadable)?;
    weight(number, text[end..].trim_start().as_bytes(), stable, end)
}

fn error(number: &str) -> Condition {
    match number {
        "E01" => Condition::Unknown,
        "E02" => Condition::NotReady,
        "E03" => Condition::NotStable,
        other => Condition::Fault(format!("EC,{other}")),
    }
}
