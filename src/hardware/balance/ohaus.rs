//! The command set of Ohaus balances.
//!
//! ```text
//! > IP            <      192.21 g         stable        < ES      not a command, or waited 40 s in vain
//!                 <        0.01 g ?       moving        < Err8.3  overload        < Err8.4  underload
//! > T, Z          < nothing, or OK!
//! > V, PSN        < words
//! ```
//!
//! The number stands to the right in 10 to 12 bytes; behind unit and `?` a legend may follow: `NET`, `N`, `G`, `B`. Frames do not say which command they
//! answer, nor whether auto-print sent them: the driver takes the last of several. Frames of the Navigator (`*`, signs in front) are refused.
//!
//! Not verified on a device: frames are those of the weighing notes (manuals of Courier, Explorer and Scout), the error numbers and `OK!` are from memory.

use super::reply::{Condition, Reply, Said, Unreadable, printable, weight};
use super::value::Decimal;
use super::{Command, Commands, Wants};

/// Where the number may end, bytes.
const NUMBER_BYTES: std::ops::RangeInclusive<usize> = 10..=12;

pub(super) const COMMANDS: Commands = Commands {
    immediate: Command { bytes: b"IP\r\n", answer: None, wants: Wants::Reading },
    stable: Some(Command { bytes: b"SP\r\n", answer: None, wants: Wants::Reading }),
    tare: Command { bytes: b"T\r\n", answer: None, wants: Wants::Done },
    zero: Command { bytes: b"Z\r\n", answer: None, wants: Wants::Done },
    acknowledges: false,
    barrier: Some(Command { bytes: b"V\r\n", answer: None, wants: Wants::Words }),
    model: &[],
    serial: Some(Command { bytes: b"PSN\r\n", answer: None, wants: Wants::Words }),
    software: Some(Command { bytes: b"V\r\n", answer: None, wants: Wants::Words }),
};

/// One line of an Ohaus balance, without its end.
///
/// # Errors
/// [`Unreadable`]
pub fn parse(line: &[u8]) -> Result<Reply, Unreadable> {
    let text = printable(line)?;
    let condition = match text.trim() {
        "ES" => Some(Condition::Unknown),
        "OK!" => return Ok(Reply { to: None, said: Said::Done }),
        "Err8.3" | "Err 8.3" | "Error 8.3" => Some(Condition::Overload),
        "Err8.4" | "Err 8.4" | "Error 8.4" => Some(Condition::Underload),
        error if error.starts_with("Err") => Some(Condition::Fault(error.to_owned())),
        _ => None,
    };
    if let Some(condition) = condition {
        return Ok(Reply::condition(condition));
    }
    // A frame begins with blanks or its number; words begin with a letter.
    if text.starts_with(|first: char| first.is_ascii_alphabetic()) {
        return Ok(Reply::text(text));
    }
    Ok(Reply { to: None, said: mass(text)? })
}

fn mass(text: &str) -> Result<Said, Unreadable> {
    let blanks = text.len() - text.trim_start().len();
    let end = blanks + text[blanks..].find(' ').ok_or(Unreadable)?;
    if !NUMBER_BYTES.contains(&end) {
        return Err(Unreadable);
    }
    let number = Decimal::parse(&text.as_bytes()[blanks..end]).ok_or(Unreadable)?;
    let mut words = text[end..].split_ascii_whitespace().peekable();
    let unit = words.next().ok_or(Unreadable)?;
    let stable = words.next_if_eq(&"?").is_none();
    if words.any(|legend| !["NET", "N", "G", "B"].contains(&legend)) {
        return Err(Unreadable);
    }
    weight(number, unit.as_bytes(), stable, end)
}
