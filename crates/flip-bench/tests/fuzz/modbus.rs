//! Modbus RTU: the gripper's registers as the driver reads them, and requests as the emulated
//! gripper reads them.

use crate::engine::{Seen, Target, bounded, outcome};
use flip_bench::emulate::gripper::{self as emulated, Request};
use flip_bench::hardware::gripper::{self, GripperStatus, Object};

pub const STATUS: Target =
    Target { name: "gripper_status", check: check_status, repair: None, words: &[], bytes_max: 12 };
pub const REQUEST: Target = Target {
    name: "modbus_request",
    check: check_request,
    repair: Some(repair),
    words: &[],
    bytes_max: 300,
};

fn check_status(registers: &[u8]) -> Result<Seen, String> {
    let Ok(status) = bounded(4 * registers.len() + 512, || gripper::parse(registers))? else {
        return Ok(Seen::Refused(outcome(registers.len())));
    };
    let &[state, _, fault, requested, position, current] = registers else {
        return Err(format!("read from {} bytes", registers.len()));
    };
    let GripperStatus { activated, moving, object, follows, .. } = status;
    let stopped_by = match object {
        Object::None => 0,
        Object::Opening => 1,
        Object::Closing => 2,
        Object::AtPosition => 3,
    };
    let bits = (stopped_by, follows, activated);
    let numbers = (status.fault, status.requested, status.position, status.current_ma);
    if bits != (state >> 6, state & 8 != 0, state & 0x31 == 0x31)
        || numbers != (fault & 15, requested, position, 10 * u16::from(current))
    {
        return Err(format!("{registers:02x?} is read as {status:?}"));
    }
    if status.holds() && (moving && activated || !follows) {
        return Err(format!(
            "{registers:02x?} holds something and moves, or does not follow: {status:?}"
        ));
    }
    if gripper::fault_words(status.fault).is_empty() {
        return Err(format!("fault {} has no words", status.fault));
    }
    Ok(Seen::Read(outcome((bits, moving, status.fault))))
}

fn check_request(frame: &[u8]) -> Result<Seen, String> {
    let (slave, request) = match bounded(4 * frame.len() + 64, || emulated::parse(frame))? {
        Ok(read) => read,
        Err(error) => return Ok(Seen::Refused(outcome(format!("{error:?}")))),
    };
    let body = match &request {
        Request::Read { function, first, count } => {
            Some([&[slave, *function][..], &first.to_be_bytes(), &count.to_be_bytes()].concat())
        }
        Request::Write { first, words } => {
            let count = u16::try_from(words.len()).map_err(|error| error.to_string())?;
            let bytes = u8::try_from(2 * words.len()).map_err(|error| error.to_string())?;
            let values: Vec<u8> = words.iter().flat_map(|word| word.to_be_bytes()).collect();
            Some(
                [&[slave, 16][..], &first.to_be_bytes(), &count.to_be_bytes(), &[bytes], &values]
                    .concat(),
            )
        }
        Request::Other { .. } => None,
    };
    if body.is_some_and(|body| framed(body) != frame) {
        return Err(format!("written again it is another frame: {request:?}"));
    }
    for bit in 0..8 * frame.len() {
        let mut flipped = frame.to_vec();
        flipped[bit / 8] ^= 1 << (bit % 8);
        if emulated::parse(&flipped).is_ok() {
            return Err(format!("bit {bit} was flipped and the frame is read"));
        }
    }
    Ok(Seen::Read(match request {
        Request::Read { function, .. } => outcome(("read", function)),
        Request::Write { words, .. } => outcome(("write", words.len())),
        Request::Other { function } => outcome(("other", function)),
    }))
}

/// Replaces the last two bytes by the right checksum.
fn repair(mut frame: Vec<u8>) -> Vec<u8> {
    frame.truncate(frame.len().saturating_sub(2));
    framed(frame)
}

/// Appends a checksum computed differently from the emulator's: as a polynomial division, with bits
/// in wire order.
fn framed(mut body: Vec<u8>) -> Vec<u8> {
    let mut rest = 0xFFFF_u16;
    for byte in &body {
        rest ^= u16::from(byte.reverse_bits()) << 8;
        for _ in 0..8 {
            rest = rest << 1 ^ if rest & 0x8000 != 0 { 0x8005 } else { 0 };
        }
    }
    body.extend(rest.reverse_bits().to_le_bytes());
    body
}
