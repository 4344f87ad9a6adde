//! Protocol between the gate and its driver. The sketch implements it again in
//! `gate_firmware/gate_protocol.h`.
//!
//! ```text
//! request   <seq> HELLO | OPEN <permille> | CLOSE | STATUS | BEAT        *<sum> LF
//! reply     <seq> OK <state> <permille> <stops> <why>                    *<sum> LF
//!           <seq> HI <version> <state> <permille> <stops> <why>          *<sum> LF
//!           <seq> ERR CHECKSUM | FORM | COMMAND | ARGUMENT | OLD | HELLO *<sum> LF
//! seq       1 to 65535, then 1 again; 0 in a reply to what could not be read, and in the HI after a reset
//! state     CLOSED | OPEN | MOVING | STUCK
//! stops     C closed end stop | O open end stop | - neither | B both (a broken wire)
//! why       it is to be closed: RESET | ASKED | BEATS (no heartbeat for 500 ms); - while it is to be open
//! sum       four hexadecimal digits of CRC-16/CCITT-FALSE over what stands before `*`
//! ```
//!
//! The device obeys a line once: a repeated number gets the same reply again, an older one is
//! refused. So the driver may send a line again when its reply is lost. After a reset it refuses
//! everything until HELLO, which always closes the gate: a line from before the reset cannot open
//! it.

use crate::hardware::DeviceError;
use crate::hardware::wire::shown;

/// Version of the protocol above.
pub const VERSION: u16 = 1;

/// State of the slide.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum State {
    /// Closed, confirmed by its end stop.
    Closed,
    /// Open, as far as requested.
    Open,
    /// On its way.
    Moving,
    /// It should have arrived, but its end stop does not confirm it.
    Stuck,
}

/// Why the gate is to be closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Why {
    /// The board started.
    Reset,
    /// It was commanded to.
    Asked,
    /// Heartbeats ended.
    Beats,
}

/// Status reported by the gate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GateStatus {
    /// State of the slide.
    pub state: State,
    /// How far it is open, 0 to 1000 thousandths.
    pub opening_permille: u16,
    /// The closed end stop is pressed.
    pub closed_stop: bool,
    /// The open end stop is pressed.
    pub open_stop: bool,
    /// Why it is to be closed; `None` while it is to be open.
    pub closed_for: Option<Why>,
}

/// Why the device refuses a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// The checksum is wrong.
    Checksum,
    /// It is no line of the protocol.
    Form,
    /// No such command.
    Command,
    /// The argument is out of bounds.
    Argument,
    /// A newer line has already been obeyed.
    Old,
    /// The board was reset: send HELLO first.
    Hello,
}

/// A line from the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reply {
    /// Number of the request; 0 for unsolicited lines.
    pub seq: u16,
    /// Its content.
    pub said: Said,
}

/// Content of a line from the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Said {
    /// Done, with the current status.
    Ok(GateStatus),
    /// Ready, with its protocol version.
    Hi(u16, GateStatus),
    /// Refused.
    Err(Refusal),
}

/// Parse a line from the device, without its terminator.
///
/// # Errors
/// [`DeviceError::Garbled`]
pub fn parse(line: &[u8]) -> Result<Reply, DeviceError> {
    unframed(line)
        .and_then(reply)
        .ok_or_else(|| DeviceError::Garbled { device: super::DEVICE, got: shown(line) })
}

fn reply(text: &str) -> Option<Reply> {
    let words: Vec<&str> = text.split(' ').collect();
    let (seq, rest) = words.split_first()?;
    let said = match *rest {
        ["OK", state, opening, stops, why] => Said::Ok(status([state, opening, stops, why])?),
        ["HI", version, state, opening, stops, why] => {
            Said::Hi(number(version)?, status([state, opening, stops, why])?)
        }
        ["ERR", reason] => Said::Err(refusal(reason)?),
        _ => return None,
    };
    Some(Reply { seq: number(seq)?, said })
}

fn status([state, opening, stops, why]: [&str; 4]) -> Option<GateStatus> {
    let (closed_stop, open_stop) = match stops {
        "C" => (true, false),
        "O" => (false, true),
        "-" => (false, false),
        "B" => (true, true),
        _ => return None,
    };
    let state = match state {
        "CLOSED" => State::Closed,
        "OPEN" => State::Open,
        "MOVING" => State::Moving,
        "STUCK" => State::Stuck,
        _ => return None,
    };
    let closed_for = match why {
        "RESET" => Some(Why::Reset),
        "ASKED" => Some(Why::Asked),
        "BEATS" => Some(Why::Beats),
        "-" => None,
        _ => return None,
    };
    let opening_permille = number(opening).filter(|permille| *permille <= 1000)?;
    Some(GateStatus { state, opening_permille, closed_stop, open_stop, closed_for })
}

fn refusal(reason: &str) -> Option<Refusal> {
    Some(match reason {
        "CHECKSUM" => Refusal::Checksum,
        "FORM" => Refusal::Form,
        "COMMAND" => Refusal::Command,
        "ARGUMENT" => Refusal::Argument,
        "OLD" => Refusal::Old,
        "HELLO" => Refusal::Hello,
        _ => return None,
    })
}

/// Parse a number of the protocol: digits only, up to 65535.
pub fn number(text: &str) -> Option<u16> {
    text.bytes().all(|byte| byte.is_ascii_digit()).then(|| text.parse().ok()).flatten()
}

/// Format `text` as a line of the protocol, with checksum and terminator.
pub fn framed(text: &str) -> String {
    format!("{text}*{:04X}\n", crc(text.as_bytes()))
}

/// The text of a line, if its checksum is correct.
pub fn unframed(line: &[u8]) -> Option<&str> {
    let line = std::str::from_utf8(line).ok()?;
    let (text, sum) = line.rsplit_once('*')?;
    let is_sum = sum.len() == 4
        && sum.bytes().all(|byte| byte.is_ascii_digit() || (b'A'..=b'F').contains(&byte));
    (is_sum && u16::from_str_radix(sum, 16) == Ok(crc(text.as_bytes()))).then_some(text)
}

/// CRC-16/CCITT-FALSE: polynomial 0x1021 from 0xFFFF, high bit first.
fn crc(bytes: &[u8]) -> u16 {
    let shift = |sum: u16, _| if sum & 0x8000 == 0 { sum << 1 } else { sum << 1 ^ 0x1021 };
    bytes.iter().fold(0xFFFF, |sum, byte| (0..8).fold(sum ^ u16::from(*byte) << 8, shift))
}
