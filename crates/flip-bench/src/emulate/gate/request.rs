//! Lines to the gate's board, as the board parses them.

use crate::hardware::gate::{Refusal, number, unframed};

/// Command of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Start a session, closed.
    Hello,
    /// Open by this much, thousandths.
    Open(u16),
    /// Close.
    Close,
    /// Report the status.
    Status,
    /// Stay open.
    Beat,
}

/// A line to the board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Request {
    /// Its number, from 1.
    pub seq: u16,
    /// Its command, or what is wrong with the command when the line itself could be parsed.
    pub order: Result<Order, Refusal>,
}

/// Parse a line to the board, without its terminator.
///
/// # Errors
/// [`Refusal::Checksum`] or [`Refusal::Form`]
pub fn parse(line: &[u8]) -> Result<Request, Refusal> {
    let text = unframed(line).ok_or(Refusal::Checksum)?;
    let (seq, words) = text.split_once(' ').ok_or(Refusal::Form)?;
    let seq = number(seq).filter(|seq| *seq > 0).ok_or(Refusal::Form)?;
    let order = match words {
        "HELLO" => Ok(Order::Hello),
        "CLOSE" => Ok(Order::Close),
        "STATUS" => Ok(Order::Status),
        "BEAT" => Ok(Order::Beat),
        _ => words.strip_prefix("OPEN ").ok_or(Refusal::Command).and_then(|argument| {
            let permille = number(argument).filter(|permille| (1..=1000).contains(permille));
            permille.map(Order::Open).ok_or(Refusal::Argument)
        }),
    };
    Ok(Request { seq, order })
}
