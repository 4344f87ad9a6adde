//! Modbus RTU frames, parsed and built without the driver's library.

const READ_HOLDING: u8 = 0x03;
const READ_INPUT: u8 = 0x04;
pub(super) const WRITE: u8 = 0x10;

/// Request of a frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Request {
    /// Registers to read.
    Read {
        /// 3 or 4.
        function: u8,
        /// Address of the first register.
        first: u16,
        /// Number of registers.
        count: u16,
    },
    /// Registers to write.
    Write {
        /// Address of the first register.
        first: u16,
        /// Their values.
        words: Vec<u16>,
    },
    /// A function that the gripper does not have.
    Other {
        /// The function code.
        function: u8,
    },
}

/// A frame that cannot be parsed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unreadable {
    /// Its length does not match its function.
    Length,
    /// Its checksum is wrong.
    Crc,
}

/// Parse a complete frame: the slave it is for, and its request.
///
/// # Errors
/// [`Unreadable`]
pub fn parse(frame: &[u8]) -> Result<(u8, Request), Unreadable> {
    let (body, sum) =
        frame.split_at_checked(frame.len().wrapping_sub(2)).ok_or(Unreadable::Length)?;
    if crc(body).to_le_bytes() != sum {
        return Err(Unreadable::Crc);
    }
    let word = |bytes: &[u8]| bytes.iter().fold(0, |high: u16, low| high << 8 | u16::from(*low));
    match *body {
        [slave, function @ (READ_HOLDING | READ_INPUT), ref rest @ ..] => {
            let (first, count) = rest
                .split_at_checked(2)
                .filter(|(_, count)| count.len() == 2)
                .ok_or(Unreadable::Length)?;
            Ok((slave, Request::Read { function, first: word(first), count: word(count) }))
        }
        [slave, WRITE, a, b, c, d, bytes, ref values @ ..] => {
            let count = word(&[c, d]);
            if values.len() != usize::from(bytes) || values.len() != usize::from(count) * 2 {
                return Err(Unreadable::Length);
            }
            Ok((
                slave,
                Request::Write {
                    first: word(&[a, b]),
                    words: values.chunks(2).map(word).collect(),
                },
            ))
        }
        [_, WRITE, ..] | [] | [_] => Err(Unreadable::Length),
        [slave, function, ..] => Ok((slave, Request::Other { function })),
    }
}

/// `body` as a frame: followed by its checksum, low byte first.
pub(super) fn framed(body: &[u8]) -> Vec<u8> {
    [body, &crc(body).to_le_bytes()].concat()
}

/// The checksum of Modbus RTU: CRC-16, polynomial 0x8005 with bits reversed, from 0xFFFF.
fn crc(bytes: &[u8]) -> u16 {
    let shift = |sum: u16, _| if sum & 1 == 1 { sum >> 1 ^ 0xA001 } else { sum >> 1 };
    bytes.iter().fold(0xFFFF, |sum, byte| (0..8).fold(sum ^ u16::from(*byte), shift))
}

/// Length in bytes of the frame that begins here; `None` if that is not yet known.
pub(super) fn frame_length(bytes: &[u8]) -> Option<usize> {
    match *bytes {
        [_, WRITE, _, _, _, _, count, ..] => Some(9 + usize::from(count)),
        [_, WRITE, ..] | [] | [_] => None,
        _ => Some(8),
    }
}
