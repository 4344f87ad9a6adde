//! SBI, the interface of Sartorius balances.
//!
//! ```text
//! > ESC P         < +  52.1873 g          14 bytes: sign, number (9), blank, unit (3)
//!                 < N     +  52.1873 g    20 bytes: the same behind an identification (6)
//!                 < N     +  52.1873      the unit is left out while the mass is not stable
//!                 < Stat         High     overload (H); Low (L); Cal.Int. (C); Err 54
//! > ESC T, ESC V  < nothing               tare, zero
//!                 < N     +12.000[0] g    a verified balance's auxiliary digit in brackets
//! > ESC x1_       < QUINTIX224-1S         model; x2_ serial number, x3_ software; not every balance answers
//! ```
//!
//! Only frames without identification or with `N` are readings: from blocks of gross, tare and net,
//! the net is taken. Trailing spaces after the unit may be missing. Frames do not identify the
//! command they answer, nor whether auto-print sent them: the driver takes the last of several.
//! With auto-print on, `ESC P` may switch it off. `ESC T` tares on old and new balances alike.
//!
//! Source: frames as in the weighing notes (interface descriptions of Entris II, Quintix, GC),
//! tested against an independent simulator.

use super::reply::{
    Condition, Reply, Said, Unreadable, Weight, foreign, is_standby, printable, weight,
};
use super::value::Decimal;
use super::{Command, Commands, Wants};

/// Bytes of a frame without identification.
const FRAME_BYTES: usize = 14;
/// Bytes of an identification.
const NAME_BYTES: usize = 6;
/// Bytes of sign and number.
const NUMBER_BYTES: usize = 10;
/// Extra bytes of a number whose last digit is in brackets, and of its frame.
const BRACKET_BYTES: usize = 2;

pub(super) const COMMANDS: Commands = Commands {
    immediate: Command { bytes: b"\x1bP\r\n", answer: None, wants: Wants::Reading },
    stable: None,
    tare: Command { bytes: b"\x1bT\r\n", answer: None, wants: Wants::Done },
    zero: Command { bytes: b"\x1bV\r\n", answer: None, wants: Wants::Done },
    tare_at_once: None,
    zero_at_once: None,
    acknowledges: false,
    barrier: Some(Command { bytes: b"\x1bx1_\r\n", answer: None, wants: Wants::Words }),
    model: &[Command { bytes: b"\x1bx1_\r\n", answer: None, wants: Wants::Words }],
    serial: Some(Command { bytes: b"\x1bx2_\r\n", answer: None, wants: Wants::Words }),
    software: Some(Command { bytes: b"\x1bx3_\r\n", answer: None, wants: Wants::Words }),
};

/// Parse one line of SBI, without its terminator.
///
/// # Errors
/// [`Unreadable`]
pub fn parse(line: &[u8]) -> Result<Reply, Unreadable> {
    let text = printable(line)?;
    let frame = Frame::of(text);
    if let Some(condition) =
        frame.as_ref().map_or_else(|| condition(text.trim()), |it| condition(it.body.trim()))
    {
        return Ok(Reply::condition(condition));
    }
    let said = frame.filter(|it| ["", "N"].contains(&it.name.trim_end())).and_then(|it| it.mass());
    match said {
        Some(Ok(said)) => Ok(Reply { to: None, said }),
        None if !looks_like_a_frame(text) => Ok(Reply::text(text)),
        _ => Ok(Reply { to: None, said: foreign(text)? }),
    }
}

/// A line split into its columns.
struct Frame<'a> {
    /// The identification; blank if there is none.
    name: &'a str,
    /// Sign, number and unit, padded with spaces.
    body: String,
    /// Trailing spaces were missing.
    trimmed: bool,
}

impl<'a> Frame<'a> {
    /// `None` if the line is too long for a frame.
    fn of(text: &'a str) -> Option<Self> {
        let bytes = FRAME_BYTES + if text.contains(']') { BRACKET_BYTES } else { 0 };
        let (name, body) = match text.len() {
            short if short <= bytes => ("", text),
            long if long <= bytes + NAME_BYTES => text.split_at(NAME_BYTES),
            _ => return None,
        };
        Some(Self {
            name,
            body: format!("{body:<FRAME_BYTES$}"),
            trimmed: body.len() < FRAME_BYTES,
        })
    }

    /// The mass; `None` if sign and number are not in their columns.
    fn mass(&self) -> Option<Result<Said, Unreadable>> {
        let end = match self.body.find(']') {
            Some(at) => Some(at + 1)
                .filter(|end| (NUMBER_BYTES..=NUMBER_BYTES + BRACKET_BYTES).contains(end))?,
            None => NUMBER_BYTES,
        };
        let (number, unit) = self.body.split_at_checked(end)?;
        let (sign, number) = number.split_at_checked(1)?;
        if ![" ", "+", "-"].contains(&sign) || number.ends_with(' ') {
            return None;
        }
        let number = Decimal::parse(format!("{}{}", sign.trim(), number.trim_start()).as_bytes())?;
        let unit = unit.strip_prefix(' ')?.trim_end();
        match unit {
            "" if self.trimmed => Some(Err(Unreadable)),
            "" => Some(Ok(Said::Weight(Weight { number, unit: None, stable: false, width: end }))),
            unit => Some(weight(number, unit.as_bytes(), true, end)),
        }
    }
}

fn condition(body: &str) -> Option<Condition> {
    let body = body.strip_prefix("Stat").map_or(body, str::trim);
    match body {
        "High" | "H" => Some(Condition::Overload),
        "Low" | "L" => Some(Condition::Underload),
        "- -" | "--" => Some(Condition::NotReady),
        "C" => Some(Condition::Adjusting),
        "ES" | "EL" => Some(Condition::Unknown),
        _ if is_standby(body) => Some(Condition::Standby),
        _ if body.starts_with("Cal.") => Some(Condition::Adjusting),
        _ if body.to_ascii_uppercase().starts_with("ERR") || body.ends_with(".ERR") => {
            Some(Condition::Fault(body.to_owned()))
        }
        _ => None,
    }
}

/// A damaged frame must not pass as text: a balance's texts have no sign before a number and no
/// unit after one.
fn looks_like_a_frame(text: &str) -> bool {
    text.starts_with(['+', '-', ' ']) || text.starts_with("N ")
}
