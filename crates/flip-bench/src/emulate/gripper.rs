//! The emulated gripper: a Robotiq 2F-85 that parses Modbus RTU frames itself, so that the driver's
//! bytes are checked by an independent parser.
//!
//! Times and positions that the manual does not give (activation, stroke, where empty fingers stop)
//! are estimates: not verified.

mod frame;

pub use frame::{Request, Unreadable, parse};

use super::fault::named;
use super::motion::{Motion, wait_out};
use super::port::Talker;
use crate::hardware::clock::Clock;
use flip_core::domain::FieldError;
use frame::{WRITE, frame_length, framed};
use serde::{Deserialize, Serialize};
use std::str::FromStr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

const SLAVE: u8 = 9;
const ACTION: u16 = 0x03E8;
const STATUS: u16 = 0x07D0;
/// Modbus exceptions.
const ILLEGAL_FUNCTION: u8 = 1;
const ILLEGAL_ADDRESS: u8 = 2;
/// How long an activation lasts, s.
const ACTIVATION_S: f64 = 2.0;
/// Where open and closed empty fingers stop, and where a spoon's handle stops them.
const OPEN_AT: f64 = 3.0;
const CLOSED_AT: f64 = 228.0;
const SPOON_AT: f64 = 189.0;
/// Motor current while moving, in units of 10 mA.
const MOVING_CURRENT: u8 = 0x0A;
/// Overcurrent, the code of [`Fault::FaultCode`].
const OVERCURRENT: u8 = 0x0E;
/// Delay of a slow reply.
const SLOW: Duration = Duration::from_millis(400);

/// Faults of a gripper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fault {
    /// A reply with a wrong checksum.
    CrcError,
    /// A reply from another slave.
    WrongSlave,
    /// A request is obeyed but its reply is lost.
    LostFrame,
    /// A request is lost.
    LostRequest,
    /// A reply that arrives after the driver gave up.
    SlowReply,
    /// No power until it is plugged in again; the fingers stay where they are.
    Unplug,
    /// Overcurrent: it stands still until it is activated again.
    FaultCode,
    /// The object it held slipped out.
    DroppedSpoon,
}

impl Fault {
    /// Every fault.
    pub const ALL: [Self; 8] = [
        Self::CrcError,
        Self::WrongSlave,
        Self::LostFrame,
        Self::LostRequest,
        Self::SlowReply,
        Self::Unplug,
        Self::FaultCode,
        Self::DroppedSpoon,
    ];

    /// Name used on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::CrcError => "crc-error",
            Self::WrongSlave => "wrong-slave",
            Self::LostFrame => "lost-frame",
            Self::LostRequest => "lost-request",
            Self::SlowReply => "slow-reply",
            Self::Unplug => "unplug",
            Self::FaultCode => "fault-code",
            Self::DroppedSpoon => "dropped-spoon",
        }
    }
}

impl FromStr for Fault {
    type Err = FieldError;

    fn from_str(name: &str) -> Result<Self, FieldError> {
        named(Self::ALL, Self::name, name)
    }
}

/// Where the spoon is relative to the fingers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spoon {
    /// Not between the fingers.
    Away,
    /// In its rack between the fingers.
    InRack,
    /// Held.
    Held,
    /// It fell.
    Dropped,
}

/// The fingers, shared with the other emulators of the bench.
#[derive(Clone)]
pub struct Fingers(Arc<Mutex<Body>>);

struct Body {
    clock: Clock,
    spoon: Spoon,
    at_rack: bool,
    is_unplugged: bool,
    /// The fault of incoming frames: how many are spared first, and how many are affected.
    pending: Option<(Fault, u32, u32)>,
    is_active: bool,
    ready_at_s: f64,
    follows: bool,
    fault: u8,
    requested: u8,
    motion: Motion,
}

impl Fingers {
    /// Open fingers without a spoon, not activated.
    pub fn new(clock: Clock) -> Self {
        Self(Arc::new(Mutex::new(Body {
            clock,
            spoon: Spoon::Away,
            at_rack: false,
            is_unplugged: false,
            pending: None,
            is_active: false,
            ready_at_s: 0.0,
            follows: false,
            fault: 0,
            requested: 0,
            motion: Motion { per_second: 60.0, ..Motion::standing(OPEN_AT) },
        })))
    }

    /// Activated fingers that hold a spoon.
    pub fn holding(clock: Clock) -> Self {
        let fingers = Self::new(clock);
        {
            let mut body = fingers.locked();
            (body.spoon, body.is_active, body.follows) = (Spoon::Held, true, true);
            body.requested = 255;
            body.motion = Motion { per_second: 60.0, ..Motion::standing(SPOON_AT) };
        }
        fingers
    }

    /// The arm moved the fingers to the rack, where a spoon is taken or put back, or away from it.
    pub fn set_at_rack(&self, at_rack: bool) {
        let mut body = self.locked();
        body.at_rack = at_rack;
        body.spoon = match (body.spoon, at_rack) {
            (Spoon::Away, true) => Spoon::InRack,
            (Spoon::InRack, false) => Spoon::Away,
            (spoon, _) => spoon,
        };
    }

    /// Where the spoon is.
    pub fn spoon(&self) -> Spoon {
        let mut body = self.locked();
        body.settle();
        body.spoon
    }

    /// Inject this fault: into the next `frames` frames, or at once if it does not concern frames.
    pub fn cause(&self, fault: Fault, frames: u32) {
        let mut body = self.locked();
        body.settle();
        let now_s = body.clock.now_s();
        match fault {
            Fault::Unplug => {
                body.is_unplugged = true;
                body.motion = Motion::standing(body.motion.at(now_s));
            }
            Fault::FaultCode => {
                body.fault = OVERCURRENT;
                body.motion = Motion::standing(body.motion.at(now_s));
            }
            Fault::DroppedSpoon if body.spoon == Spoon::Held => {
                body.spoon = Spoon::Dropped;
                body.head_for(CLOSED_AT);
            }
            Fault::DroppedSpoon => {}
            of_frames => body.pending = Some((of_frames, 0, frames)),
        }
    }

    /// Inject this fault into one frame, after sparing that many.
    pub fn cause_after(&self, spared: u32, fault: Fault) {
        self.locked().pending = Some((fault, spared, 1));
    }

    /// Restore power: it does not know what it holds and must be activated.
    pub fn plug_in(&self) {
        let mut body = self.locked();
        body.is_unplugged = false;
        body.reset();
    }

    fn locked(&self) -> MutexGuard<'_, Body> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Body {
    fn reset(&mut self) {
        (self.is_active, self.follows, self.fault, self.requested) = (false, false, 0, 0);
    }

    /// Update to now: fingers that met the spoon hold it.
    fn settle(&mut self) {
        let now_s = self.clock.now_s();
        if self.spoon == Spoon::InRack
            && self.motion.to == SPOON_AT
            && now_s >= self.motion.ends_s()
        {
            self.spoon = Spoon::Held;
        }
    }

    fn head_for(&mut self, to: f64) {
        let now_s = self.clock.now_s();
        let from = self.motion.at(now_s);
        let is_in_the_way =
            matches!(self.spoon, Spoon::InRack | Spoon::Held) && from <= SPOON_AT && to > SPOON_AT;
        let to = if is_in_the_way { SPOON_AT } else { to };
        self.motion = Motion { from, to, began_s: now_s, per_second: self.motion.per_second };
    }

    /// Apply the words written to the three registers at [`ACTION`].
    fn obey(&mut self, words: [u16; 3]) {
        let [[action, _], [_, position], [speed, _]] = words.map(u16::to_be_bytes);
        let now_s = self.clock.now_s();
        if action & 1 == 0 {
            self.reset();
            self.motion = Motion::standing(self.motion.at(now_s));
            return;
        }
        if !self.is_active {
            self.is_active = true;
            self.ready_at_s = now_s + ACTIVATION_S;
            self.let_go();
            self.motion = Motion::standing(OPEN_AT);
        }
        self.requested = position;
        self.follows = action & 8 != 0 && self.fault == 0;
        if self.follows && now_s >= self.ready_at_s {
            if position < SPOON_AT as u8 {
                self.let_go();
            }
            // 20 to 150 mm/s over a stroke of 85 mm.
            self.motion.per_second = 3.0 * (20.0 + 130.0 * f64::from(speed) / 255.0);
            self.head_for(f64::from(position).clamp(OPEN_AT, CLOSED_AT));
        }
    }

    fn let_go(&mut self) {
        if self.spoon == Spoon::Held {
            self.spoon = if self.at_rack { Spoon::InRack } else { Spoon::Dropped };
        }
    }

    /// The six bytes of the registers at [`STATUS`].
    fn registers(&mut self) -> [u8; 6] {
        self.settle();
        let now_s = self.clock.now_s();
        let is_moving = now_s < self.motion.ends_s();
        let activation = match self.is_active {
            false => 0,
            true if now_s < self.ready_at_s => 1,
            true => 3,
        };
        let object = match (self.follows, is_moving) {
            (false, _) | (_, true) => 0,
            (true, false) if self.motion.to == SPOON_AT && self.requested > SPOON_AT as u8 => 2,
            (true, false) => 3,
        };
        let state =
            u8::from(self.is_active) | u8::from(self.follows) << 3 | activation << 4 | object << 6;
        let current = if is_moving { MOVING_CURRENT } else { 0 };
        let seen =
            [state, 0, self.fault, self.requested, self.motion.at(now_s).round() as u8, current];
        wait_out(
            &self.clock,
            self.motion.ends_s().max(if self.is_active { self.ready_at_s } else { 0.0 }),
        );
        seen
    }

    fn answer(&mut self, request: &Request) -> Vec<u8> {
        match *request {
            Request::Read { function, first, count } => {
                let registers = self.registers();
                let from =
                    usize::from(first).checked_sub(usize::from(STATUS)).map(|skipped| skipped * 2);
                let asked =
                    from.and_then(|from| registers.get(from..from + usize::from(count) * 2));
                match asked {
                    Some(asked) => [&[function, asked.len() as u8], asked].concat(),
                    None => vec![function | 0x80, ILLEGAL_ADDRESS],
                }
            }
            Request::Write { first: ACTION, ref words } if words.len() == 3 => {
                self.obey([words[0], words[1], words[2]]);
                [&[WRITE][..], &ACTION.to_be_bytes(), &3u16.to_be_bytes()].concat()
            }
            Request::Write { .. } => vec![WRITE | 0x80, ILLEGAL_ADDRESS],
            Request::Other { function } => vec![function | 0x80, ILLEGAL_FUNCTION],
        }
    }

    /// The fault that applies to this frame.
    fn next_fault(&mut self) -> Option<Fault> {
        let (fault, spared, frames) = self.pending?;
        if spared > 0 {
            self.pending = Some((fault, spared - 1, frames));
            return None;
        }
        self.pending = (frames > 1).then(|| (fault, 0, frames - 1));
        (frames > 0).then_some(fault)
    }
}

/// An emulated gripper on a port.
pub struct EmulatedGripper {
    fingers: Fingers,
    /// Bytes of an incomplete frame.
    partial: Vec<u8>,
    /// Delayed replies, and when they are due.
    late: Vec<(Instant, Vec<u8>)>,
}

impl EmulatedGripper {
    /// A gripper with these fingers.
    pub fn new(fingers: Fingers) -> Self {
        Self { fingers, partial: Vec::new(), late: Vec::new() }
    }

    fn take(&mut self, frame: &[u8], say: &mut dyn FnMut(&[u8])) {
        let mut body = self.fingers.locked();
        let fault = body.next_fault();
        // A slave does not answer frames that it cannot parse or that are for another.
        let Ok((SLAVE, request)) = parse(frame) else { return };
        if body.is_unplugged || fault == Some(Fault::LostRequest) {
            return;
        }
        let answer = body.answer(&request);
        let mut reply = framed(&[&[SLAVE], &answer[..]].concat());
        match fault {
            Some(Fault::LostFrame) => return,
            Some(Fault::CrcError) => reply[2] ^= 0x40,
            Some(Fault::WrongSlave) => reply = framed(&[&[SLAVE + 1], &answer[..]].concat()),
            Some(Fault::SlowReply) => return self.late.push((Instant::now() + SLOW, reply)),
            _ => {}
        }
        say(&reply);
    }

    fn say_late(&mut self, say: &mut dyn FnMut(&[u8])) {
        let now = Instant::now();
        self.late.iter().filter(|(at, _)| *at <= now).for_each(|(_, reply)| say(reply));
        self.late.retain(|(at, _)| *at > now);
    }
}

impl Talker for EmulatedGripper {
    fn hear(&mut self, bytes: &[u8], say: &mut dyn FnMut(&[u8])) {
        self.say_late(say);
        self.partial.extend_from_slice(bytes);
        while let Some(length) =
            frame_length(&self.partial).filter(|length| *length <= self.partial.len())
        {
            let frame: Vec<u8> = self.partial.drain(..length).collect();
            self.take(&frame, say);
        }
    }

    fn idle(&mut self, say: &mut dyn FnMut(&[u8])) {
        // Silence ends a frame.
        self.partial.clear();
        self.say_late(say);
    }
}

#[cfg(test)]
#[path = "gripper_tests.rs"]
mod tests;
