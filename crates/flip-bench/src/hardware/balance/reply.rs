//! Parsed balance replies, independent of the dialect.

use super::value::{Decimal, Unit};

/// One parsed line.
#[derive(Debug, Clone, PartialEq)]
pub struct Reply {
    /// The command it answers, where the dialect names it: `S`, `T`, `I4`.
    pub to: Option<String>,
    /// Its content.
    pub said: Said,
}

/// Content of one line.
#[derive(Debug, Clone, PartialEq)]
pub enum Said {
    /// A mass on the display.
    Weight(Weight),
    /// A command was carried out.
    Done,
    /// Why the balance has no number.
    Condition(Condition),
    /// Text: a name, a serial number, or a line printed for people.
    Text(String),
}

/// A mass on the display.
#[derive(Debug, Clone, PartialEq)]
pub struct Weight {
    /// The number as shown.
    pub number: Decimal,
    /// Its unit; `None` where the dialect omits the unit while the mass is not stable.
    pub unit: Option<Unit>,
    /// The balance's stability flag.
    pub stable: bool,
    /// Bytes of the line up to the number's last digit: the same in every undamaged frame of one
    /// balance.
    pub width: usize,
}

/// Why there is no number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Condition {
    /// More on the pan than the balance can weigh.
    Overload,
    /// Negative load: the pan is lifted or not in place.
    Underload,
    /// The balance is busy.
    NotReady,
    /// The balance waited for a stable mass in vain.
    NotStable,
    /// A number without a unit, as some dialects send while unstable, before any arrived with one.
    NoUnit,
    /// An adjustment is running.
    Adjusting,
    /// The display is off.
    Standby,
    /// The balance does not know the command, or cannot carry it out.
    Unknown,
    /// The display shows a unit that FLIP does not support.
    ForeignUnit(String),
    /// A fault, in the balance's own words.
    Fault(String),
}

/// A line that matches no frame of the dialect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("no frame of this dialect")]
pub struct Unreadable;

impl Reply {
    pub(super) fn condition(condition: Condition) -> Self {
        Self { to: None, said: Said::Condition(condition) }
    }

    pub(super) fn text(text: &str) -> Self {
        Self { to: None, said: Said::Text(text.trim().to_owned()) }
    }
}

/// A mass in this unit, or a refusal of a unit that FLIP does not know.
pub(super) fn weight(
    number: Decimal,
    unit: &[u8],
    stable: bool,
    width: usize,
) -> Result<Said, Unreadable> {
    if let Some(unit) = Unit::named(unit) {
        return Ok(Said::Weight(Weight { number, unit: Some(unit), stable, width }));
    }
    if !is_unit(unit) {
        return Err(Unreadable);
    }
    Ok(Said::Condition(Condition::ForeignUnit(String::from_utf8_lossy(unit).into_owned())))
}

/// A frame whose number cannot be parsed, such as `12:07.50 lb:oz`, still names its unit: a unit
/// that FLIP does not support is refused by name.
pub(super) fn foreign(frame: &str) -> Result<Said, Unreadable> {
    let words = || frame.split_ascii_whitespace();
    let is_foreign = |(number, unit): &(&str, &str)| {
        let has_digit = number.bytes().any(|byte| byte.is_ascii_digit());
        has_digit && is_unit(unit.as_bytes()) && Unit::named(unit.as_bytes()).is_none()
    };
    let (_, unit) = words().zip(words().skip(1)).find(is_foreign).ok_or(Unreadable)?;
    Ok(Said::Condition(Condition::ForeignUnit(unit.to_owned())))
}

/// At most five letters, or a symbol or compound: `%`, `lb:oz`.
fn is_unit(name: &[u8]) -> bool {
    let starts = name.first().is_some_and(|byte| byte.is_ascii_alphabetic() || *byte == b'%');
    starts
        && name.len() <= 5
        && name.iter().all(|byte| byte.is_ascii_alphabetic() || b"%/:".contains(byte))
}

/// Whether this is one of the ways in which a balance reports that its display is off, if it
/// reports anything.
pub(super) fn is_standby(words: &str) -> bool {
    let words = words.trim().to_ascii_uppercase();
    ["OFF", "STANDBY", "STAND-BY", "STAND BY", "DISPLAY OFF"].contains(&words.as_str())
}

/// The line as text, if it is printable ASCII.
pub(super) fn printable(line: &[u8]) -> Result<&str, Unreadable> {
    let text = std::str::from_utf8(line).map_err(|_| Unreadable)?;
    if text.bytes().all(|byte| (b' '..=b'~').contains(&byte)) { Ok(text) } else { Err(Unreadable) }
}
