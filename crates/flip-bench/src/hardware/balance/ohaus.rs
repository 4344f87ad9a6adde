//! The command set of Ohaus balances.
//!
//! ```text
//! > IP            <      192.21 g         stable        < ES      not a command, or waited 40 s in vain
//!                 <        0.01 g ?       moving        < Err8.3  overload        < Err8.4  underload
//! > T, Z          < nothing, or OK!
//! > V, PSN        < words                         (older ones: ES, or nothing)
//! ```
//!
//! The number is right-aligned in 10 to 12 bytes; a legend may follow the unit and `?`: `NET`, `N`,
//! `G`, `B`. Some balances put `ST`, `US`, `S` or `U` in front instead of `?` behind. Frames do not
//! identify the command they answer, nor whether auto-print sent them: the driver takes the last of
//! several. Frames of the Navigator (`*`, signs in front) are refused.
//!
//! Not verified on a device: frames follow the weighing notes (manuals of Courier, Explorer and
//! Scout); the error numbers and `OK!` are from memory.

use super::reply::{Condition, Reply, Said, Unreadable, foreign, is_standby, printable, weight};
use super::value::Decimal;
use super::{Command, Commands, Wants};

/// Possible end columns of the number, bytes.
const NUMBER_BYTES: std::ops::RangeInclusive<usize> = 10..=12;
/// The same with the last digit in brackets.
const BRACKETED_BYTES: std::ops::RangeInclusive<usize> = 10..=14;
/// Header words in front of a number, and whether they mean stable.
const HEADERS: [(&str, bool); 4] = [("ST", true), ("US", false), ("S", true), ("U", false)];

pub(super) const COMMANDS: Commands = Commands {
    immediate: Command { bytes: b"IP\r\n", answer: None, wants: Wants::Reading },
    stable: Some(Command { bytes: b"SP\r\n", answer: None, wants: Wants::Reading }),
    tare: Command { bytes: b"T\r\n", answer: None, wants: Wants::Done },
    zero: Command { bytes: b"Z\r\n", answer: None, wants: Wants::Done },
    tare_at_once: None,
    zero_at_once: None,
    acknowledges: false,
    barrier: Some(Command { bytes: b"V\r\n", answer: None, wants: Wants::Words }),
    model: &[],
    serial: Some(Command { bytes: b"PSN\r\n", answer: None, wants: Wants::Words }),
    software: Some(Command { bytes: b"V\r\n", answer: None, wants: Wants::Words }),
};

/// Parse one line of an Ohaus balance, without its terminator.
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
        words if is_standby(words) => Some(Condition::Standby),
        error if error.starts_with("Err") => Some(Condition::Fault(error.to_owned())),
        _ => None,
    };
    if let Some(condition) = condition {
        return Ok(Reply::condition(condition));
    }
    if let Some((at, stable)) = header(text) {
        return Ok(Reply { to: None, said: mass(text, at, Some(stable))? });
    }
    // A frame begins with spaces or its number; text begins with a letter.
    if text.starts_with(|first: char| first.is_ascii_alphabetic()) {
        return Ok(Reply::text(text));
    }
    Ok(Reply { to: None, said: mass(text, 0, None).or_else(|_| foreign(text))? })
}

/// Where the number's columns begin after a header word, and whether the header means stable.
/// Zero-padded, it is an A&D frame.
fn header(text: &str) -> Option<(usize, bool)> {
    let (word, stable) = HEADERS.into_iter().find(|(word, _)| {
        text.strip_prefix(word).is_some_and(|rest| rest.starts_with([',', ' ']))
    })?;
    let at = word.len() + 1;
    let number = text[at..].trim_start();
    let digits = number.trim_start_matches('-');
    let is_number = digits.starts_with(|first: char| first.is_ascii_digit());
    (is_number && !digits.starts_with("00")).then_some((at, stable))
}

/// The mass whose columns begin at byte `from`; stability comes from the header before them, or
/// from a `?` behind.
fn mass(text: &str, from: usize, told: Option<bool>) -> Result<Said, Unreadable> {
    let columns = &text[from..];
    let blanks = columns.len() - columns.trim_start().len();
    let end = blanks + columns[blanks..].find(' ').ok_or(Unreadable)?;
    let allowed = if columns[..end].ends_with(']') { BRACKETED_BYTES } else { NUMBER_BYTES };
    if !allowed.contains(&end) {
        return Err(Unreadable);
    }
    let number = Decimal::parse(&columns.as_bytes()[blanks..end]).ok_or(Unreadable)?;
    let mut words = columns[end..].split_ascii_whitespace().peekable();
    let unit = words.next().ok_or(Unreadable)?;
    let unmarked = words.next_if_eq(&"?").is_none();
    if words.any(|legend| !["NET", "N", "G", "B"].contains(&legend)) {
        return Err(Unreadable);
    }
    weight(number, unit.as_bytes(), told.unwrap_or(true) && unmarked, from + end)
}
