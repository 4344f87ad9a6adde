//! MT-SICS, the command set of Mettler-Toledo balances; newer Ohaus balances can be set to it.
//!
//! ```text
//! > SI            < S S   100.0000 g      stable        < S I     not ready, adjusting, or waited in vain
//!                 < S D   100.0003 g      moving        < S +     overload        < S -   underload
//! > T             < T S   100.0000 g      the tare that was taken
//! > TI, ZI        < TI D  100.0003 g      the same at once
//! > Z             < Z A                                 < ES      not a command   < EL    not possible    < ET  damaged on the way
//! > I4            < I4 A "B123456789"
//! ```
//!
//! Replies name their command, so that replies to other commands can be told apart. Lines that the
//! balance sends unsolicited (print key, `SIR`) look like the reply to `SI`: the driver takes the
//! last of several. `@` is never sent: it may clear the tare. A balance may support only `S`, `SI`,
//! `T` and `Z`.
//!
//! Source: frames as in the weighing notes (MT-SICS reference manual, via public drivers), tested
//! against an independent simulator.

use super::reply::{Condition, Reply, Said, Unreadable, foreign, is_standby, printable, weight};
use super::value::Decimal;
use super::{Command, Commands, Wants};

/// Width of the number in a frame, bytes.
const NUMBER_BYTES: usize = 10;
/// The same with the last digit in brackets.
const BRACKETED_BYTES: std::ops::RangeInclusive<usize> = 10..=12;

pub(super) const COMMANDS: Commands = Commands {
    immediate: Command { bytes: b"SI\r\n", answer: Some("S"), wants: Wants::Reading },
    stable: Some(Command { bytes: b"S\r\n", answer: Some("S"), wants: Wants::Reading }),
    tare: Command { bytes: b"T\r\n", answer: Some("T"), wants: Wants::Done },
    zero: Command { bytes: b"Z\r\n", answer: Some("Z"), wants: Wants::Done },
    tare_at_once: Some(Command { bytes: b"TI\r\n", answer: Some("TI"), wants: Wants::Done }),
    zero_at_once: Some(Command { bytes: b"ZI\r\n", answer: Some("ZI"), wants: Wants::Done }),
    acknowledges: true,
    barrier: Some(Command { bytes: b"I4\r\n", answer: Some("I4"), wants: Wants::Words }),
    model: &[
        Command { bytes: b"I11\r\n", answer: Some("I11"), wants: Wants::Words },
        Command { bytes: b"I2\r\n", answer: Some("I2"), wants: Wants::Words },
    ],
    serial: Some(Command { bytes: b"I4\r\n", answer: Some("I4"), wants: Wants::Words }),
    software: Some(Command { bytes: b"I3\r\n", answer: Some("I3"), wants: Wants::Words }),
};

/// Parse one line of MT-SICS, without its terminator.
///
/// # Errors
/// [`Unreadable`]
pub fn parse(line: &[u8]) -> Result<Reply, Unreadable> {
    let text = printable(line)?;
    match text.trim_end() {
        "ES" | "EL" => return Ok(Reply::condition(Condition::Unknown)),
        "ET" => return Err(Unreadable),
        words if is_standby(words) => return Ok(Reply::condition(Condition::Standby)),
        _ => {}
    }
    let (command, rest) = text.split_once(' ').ok_or(Unreadable)?;
    let is_command = !command.is_empty()
        && command.len() <= 5
        && command.bytes().all(|byte| byte.is_ascii_uppercase() || byte.is_ascii_digit());
    if !is_command {
        return Err(Unreadable);
    }
    Ok(Reply { to: Some(command.to_owned()), said: said(command, rest)? })
}

fn said(command: &str, rest: &str) -> Result<Said, Unreadable> {
    let (status, rest) = rest.split_once(' ').unwrap_or((rest, ""));
    match (status, rest.is_empty()) {
        ("I", true) => Ok(Said::Condition(Condition::NotReady)),
        ("L", true) => Ok(Said::Condition(Condition::Unknown)),
        ("+", true) => Ok(Said::Condition(Condition::Overload)),
        ("-", true) => Ok(Said::Condition(Condition::Underload)),
        ("A" | "B", true) => Ok(Said::Done),
        ("S" | "D", true) if command == "ZI" => Ok(Said::Done),
        ("S", false) if rest.starts_with("Error") => {
            Ok(Said::Condition(Condition::Fault(rest.trim().to_owned())))
        }
        ("A" | "B", false) if rest.contains('"') => Ok(Said::Text(unquoted(rest))),
        ("A" | "S" | "D", false) => mass(command, status != "D", rest).or_else(|_| foreign(rest)),
        (_, true) if is_standby(status) => Ok(Said::Condition(Condition::Standby)),
        _ => Err(Unreadable),
    }
}

fn mass(command: &str, stable: bool, rest: &str) -> Result<Said, Unreadable> {
    let end = match rest.find(']') {
        Some(at) if BRACKETED_BYTES.contains(&(at + 1)) => at + 1,
        Some(_) => return Err(Unreadable),
        None => NUMBER_BYTES,
    };
    let number = rest.get(..end).ok_or(Unreadable)?;
    let unit = rest[end..].strip_prefix(' ').ok_or(Unreadable)?.trim_end();
    let number = Decimal::parse(number.trim_start().as_bytes()).ok_or(Unreadable)?;
    weight(number, unit.as_bytes(), stable, command.len() + 3 + end)
}

/// The quoted parts of a reply, separated by a space.
fn unquoted(rest: &str) -> String {
    rest.split('"')
        .skip(1)
        .step_by(2)
        .map(str::trim)
        .filter(|part| !part.is_empty())
        .collect::<Vec<_>>()
        .join(" ")
}
