//! SBI, the interface of Sartorius balances.
//!
//! ```text
//! > ESC P         < +  52.1873 g          14 bytes: sign, number (9), blank, unit (3)
//!                 < N     +  52.1873 g    20 bytes: the same behind an identification (6)
//!                 < N     +  52.1873      the unit is left out while the mass is not stable
//!                 < Stat         High     overload (H); Low (L); Cal.Int. (C); Err 54
//! > ESC T, ESC V  < nothing               tare, zero
//! > ESC x1_       < QUINTIX224-1S         model; x2_ serial number, x3_ software
//! ```
//!
//! Only frames without identification or with `N` are readings: blocks of gross, tare and net are read for their net. Frames do not say what they answer,
//! nor whether auto-print sent them: the driver takes the last of several. With auto-print on, `ESC P` may switch it off. `ESC T` tares on old and new
//! balances alike.
//!
//! Source: frames as in the weighing notes (interface descriptions of Entris II, Quintix, GC), tested against an independent simulator.

use super::reply::{Condition, Reply, Said, Unreadable, Weight, printable, weight};
use super::value::Decimal;
use super::{Command, Commands, Wants};

/// Bytes of a frame without identification.
const FRAME_BYTES: usize = 14;
/// Bytes of an identification.
const NAME_BYTES: usize = 6;
/// Bytes of sign and number.
const NUMBER_BYTES: usize = 10;

pub(super) const COMMANDS: Commands = Commands {
    immediate: Command { bytes: b"\x1bP\r\n", answer: None, wants: Wants::Reading },
    stable: None,
    tare: Command { bytes: b"\x1bT\r\n", answer: None, wants: Wants::Done },
    zero: Command { bytes: b"\x1bV\r\n", answer: None, wants: Wants::Done },
    acknowledges: false,
    barrier: Some(Command { bytes: b"\x1bx1_\r\n", answer: None, wants: Wants::Words }),
    model: &[Command { bytes: b"\x1bx1_\r\n", answer: None, wants: Wants::Words }],
    serial: Some(Command { bytes: b"\x1bx2_\r\n", answer: None, wants: Wants::Words }),
    software: Some(Command { bytes: b"\x1bx3_\r\n", answer: None, wants: Wants::Words }),
};

/// One line of SBI, without its end.
///
/// # Errors
/// [`Unreadable`]
pub fn parse(line: &[u8]) -> Result<Reply, Unreadable> {
    let text = printable(line)?;
    let framed = [FRAME_BYTES, FRAME_BYTES + NAME_BYTES].contains(&text.len());
    let (name, body) = if text.len() == FRAME_BYTES + NAME_BYTES { text.split_at(NAME_BYTES) } else { ("", text) };
    if let Some(condition) = condition(body.trim()).filter(|_| framed || text.starts_with("Stat")) {
        return Ok(Reply::condition(condition));
    }
    let said = if framed && ["", "N"].contains(&name.trim_end()) { mass(body) } else { None };
    match said {
        Some(said) => Ok(Reply { to: None, said: said? }),
        None if looks_like_a_frame(text) => Err(Unreadable),
        None => Ok(Reply::text(text)),
    }
}

fn condition(body: &str) -> Option<Condition> {
    match body {
        "High" | "H" => Some(Condition::Overload),
        "Low" | "L" => Some(Condition::Underload),
        "- -" | "--" => Some(Condition::NotReady),
        "C" => Some(Condition::Adjusting),
        _ if body.starts_with("Cal.") => Some(Condition::Adjusting),
        _ if body.to_ascii_uppercase().starts_with("ERR") || body.ends_with(".ERR") => {
            Some(Condition::Fault(body.to_owned()))
        }
        _ => None,
    }
}

/// The mass of a body of [`FRAME_BYTES`]; `None` if sign and number are not where they belong.
fn mass(body: &str) -> Option<Result<Said, Unreadable>> {
    let (number, unit) = body.split_at_checked(NUMBER_BYTES)?;
    let (sign, number) = number.split_at_checked(1)?;
    if ![" ", "+", "-"].contains(&sign) || number.ends_with(' ') {
        return None;
    }
    let number = Decimal::parse(format!("{}{}", sign.trim(), number.trim_start()).as_bytes())?;
    let unit = unit.strip_prefix(' ')?.trim_end();
    let said = match unit {
        "" => Ok(Said::Weight(Weight { number, unit: None, stable: false, width: NUMBER_BYTES })),
        unit => weight(number, unit.as_bytes(), true, NUMBER_BYTES),
    };
    Some(said)
}

/// A damaged frame must not pass as words: those of a balance hold no sign before a number and no unit behind one.
fn looks_like_a_frame(text: &str) -> bool {
    text.starts_with(['+', '-', ' ']) || text.starts_with("N ")
}
