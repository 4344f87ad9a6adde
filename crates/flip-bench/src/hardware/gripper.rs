//! The gripper: a Robotiq 2F-85 on Modbus RTU, slave 9, 115200 8N1.
//!
//! Three registers are written at 1000 (action, position, speed and force) and three are read at 2000 (state, fault and echoed position, position
//! and current). Frames and registers are those of Robotiq's instruction manuals for two-finger grippers.
//!
//! What is repeated: a read that brought no readable answer is sent once more. A write that moves the fingers never is: when its answer is lost the
//! driver reads the position that the gripper echoes, and goes on if that is the one it asked for. Modbus RTU numbers no frames, so after a failure the
//! driver waits until the wire is quiet, and bytes that nobody asked for are forgotten (and recorded) before each request.
//!
//! Activation opens and closes the fingers over their whole stroke: see [`Gripper::activate`].

mod wire;

use super::DeviceError;
use super::wire::Tap;
use flip_core::domain::FieldError;
use std::io;
use std::time::{Duration, Instant};
use tokio_modbus::client::{Client, rtu};
use tokio_modbus::{Request, Response, Slave};
use wire::{Wire, shown};

/// As messages name it.
const DEVICE: &str = "the gripper";
const SLAVE: Slave = Slave(9);
/// First register written: action, position, speed and force.
const ACTION: u16 = 0x03E8;
/// First register read: state, fault and echo, position and current.
const STATUS: u16 = 0x07D0;
/// Bits of the action byte: activate, and go to the requested position.
const ACTIVATE: u8 = 0x01;
const GO: u8 = 0x08;
/// Positions that are asked for.
const OPEN: u8 = 0x00;
const CLOSED: u8 = 0xFF;
/// How long an answer may take: a frame of 23 bytes lasts 2 ms.
const REPLY: Duration = Duration::from_millis(250);
/// How long the wire is left alone after a failure.
const QUIET: Duration = Duration::from_millis(60);
/// How often the gripper is asked whether it has arrived.
const ASK_EVERY: Duration = Duration::from_millis(10);
/// How long it may take until the gripper echoes the position that it was asked for.
const ECHO: Duration = Duration::from_millis(100);
/// How long a motion may take: the whole stroke at the lowest speed (20 mm/s, not verified) lasts 4.3 s.
const MOTION_MAX: Duration = Duration::from_secs(7);
/// How long an activation may take; the manual gives no time (not verified).
const ACTIVATION_MAX: Duration = Duration::from_secs(10);

/// Why the fingers stand where they stand (`gOBJ`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Object {
    /// They are moving, or were not told to move.
    None,
    /// Something stopped them while they opened.
    Opening,
    /// Something stopped them while they closed: it is held.
    Closing,
    /// They are where they were told to be: nothing is held, or it was lost.
    AtPosition,
}

/// What the gripper says of itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GripperStatus {
    /// Activation is complete (`gACT` 1, `gSTA` 3).
    pub activated: bool,
    /// Fingers move, or activation is going on.
    pub moving: bool,
    /// What stopped the fingers; means little unless `follows`.
    pub object: Object,
    /// It follows the requested position (`gGTO`).
    pub follows: bool,
    /// Its fault code, 0 for none; [`fault_words`] explains it.
    pub fault: u8,
    /// The position it was asked for, 0 open to 255 closed.
    pub requested: u8,
    /// Where the fingers are, 0 open to 255 closed.
    pub position: u8,
    /// Current of the motor, mA.
    pub current_ma: u16,
}

impl GripperStatus {
    /// The fingers closed on something and hold it.
    pub fn holds(&self) -> bool {
        self.follows && self.object == Object::Closing
    }
}

/// How the fingers move; each from 0, the least that the gripper can, to 255.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Effort {
    /// Speed.
    pub speed: u8,
    /// Force.
    pub force: u8,
}

impl Effort {
    /// All that the gripper can.
    pub const FULL: Self = Self { speed: 255, force: 255 };
}

/// A person has looked and says that no spoon is between the fingers. Spent when it is used.
#[derive(Debug)]
pub struct NoSpoon(());

impl NoSpoon {
    /// `person` has looked.
    ///
    /// # Errors
    /// Nobody is named.
    pub fn seen_by(person: &str) -> Result<Self, FieldError> {
        if person.trim().is_empty() {
            return Err(FieldError::new("seen_by", "must name the person who looked between the fingers"));
        }
        Ok(Self(()))
    }
}

/// The six bytes of the registers at 2000: state, reserved, fault, echoed position, position, current.
///
/// # Errors
/// [`DeviceError::Garbled`]: another number of bytes, or a state that the gripper does not have.
pub fn parse(registers: &[u8]) -> Result<GripperStatus, DeviceError> {
    let &[state, _, fault, requested, position, current] = registers else {
        return Err(garbled(registers));
    };
    let is_set = state & ACTIVATE != 0;
    let activation = state >> 4 & 3;
    if activation == 2 {
        return Err(garbled(registers));
    }
    let object = [Object::None, Object::Opening, Object::Closing, Object::AtPosition][usize::from(state >> 6)];
    let follows = state & GO != 0;
    Ok(GripperStatus {
        activated: is_set && activation == 3,
        moving: (follows && object == Object::None) || (is_set && activation == 1),
        object,
        follows,
        // The upper half of the byte is for an optional controller.
        fault: fault & 0x0F,
        requested,
        position,
        current_ma: u16::from(current) * 10,
    })
}

/// What a fault code means. From memory of the manual's table: not verified.
pub fn fault_words(code: u8) -> &'static str {
    match code {
        0x00 => "none",
        0x05 => "the action waits until activation is complete",
        0x07 => "it must be activated first",
        0x08 => "too hot",
        0x09 => "no message for a second",
        0x0A => "supply voltage too low",
        0x0B => "automatic release is going on",
        0x0C => "internal fault",
        0x0D => "activation failed",
        0x0E => "too much current",
        0x0F => "automatic release is complete",
        _ => "unknown",
    }
}

/// An open gripper. It must live on a thread that is not one of an asynchronous runtime: it waits.
pub struct Gripper {
    runtime: tokio::runtime::Runtime,
    wire: Wire,
    /// It closed on something and was not told to open since. The gripper forgets that with its supply, the driver does not.
    gripped: bool,
}

impl Gripper {
    /// Open `port`: a path, as `/dev/ttyUSB0`, or `tcp://host:port`. Nothing moves.
    ///
    /// # Errors
    /// [`DeviceError::Lost`] with the reason.
    pub fn open(port: &str, tap: Tap) -> Result<Self, DeviceError> {
        let lost = |cause: String| DeviceError::Lost { device: DEVICE, cause: format!("{port}: {cause}") };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(|error| lost(error.to_string()))?;
        let wire = {
            let _within = runtime.enter();
            Wire::open(port, tap).map_err(|error| lost(error.to_string()))?
        };
        Ok(Self { runtime, wire, gripped: false })
    }

    /// Ask for its state.
    ///
    /// # Errors
    /// No readable answer, twice.
    pub fn status(&mut self) -> Result<GripperStatus, DeviceError> {
        let status = parse(&self.read(3)?)?;
        // Fingers that follow and have arrived where they were told to be hold nothing any more.
        let is_empty = status.activated && status.follows && status.object == Object::AtPosition;
        self.gripped = status.holds() || (self.gripped && !is_empty);
        Ok(status)
    }

    /// The fingers closed on something and hold it.
    ///
    /// # Errors
    /// As for [`Gripper::status`].
    pub fn holds_spoon(&mut self) -> Result<bool, DeviceError> {
        Ok(self.status()?.holds())
    }

    /// Close the fingers until something stops them or they meet. Whether something is held is in the answer.
    ///
    /// # Errors
    /// [`DeviceError::Forbidden`] before activation, [`DeviceError::Faulted`] with the gripper's fault; the fingers may then stand anywhere.
    pub fn grip(&mut self, effort: Effort) -> Result<GripperStatus, DeviceError> {
        self.go(CLOSED, effort)
    }

    /// Open the fingers: what they hold falls, so the spoon must be in its rack.
    ///
    /// # Errors
    /// As for [`Gripper::grip`].
    pub fn release(&mut self, effort: Effort) -> Result<GripperStatus, DeviceError> {
        let status = self.go(OPEN, effort)?;
        self.gripped = false;
        Ok(status)
    }

    /// Activate a gripper that is not active; one that is active and has no fault is left as it is.
    ///
    /// The fingers open and close over their whole stroke: a spoon between them is dropped or bent. So it needs a person's word
    /// that there is none, because a gripper that lost its supply no longer knows what it holds; and it is refused
    /// whatever was said when gripper or driver know better.
    ///
    /// # Errors
    /// [`DeviceError::Forbidden`] with what to do first, [`DeviceError::Faulted`] when activation does not complete.
    pub fn activate(&mut self, _word: NoSpoon) -> Result<GripperStatus, DeviceError> {
        let status = self.status()?;
        self.check_empty(&status)?;
        if status.activated && status.fault == 0 {
            return Ok(status);
        }
        self.write(0, OPEN, Effort { speed: 0, force: 0 })?;
        self.write(ACTIVATE, OPEN, Effort { speed: 0, force: 0 })?;
        let until = Instant::now() + ACTIVATION_MAX;
        while self.read(1)?[0] >> 4 & 3 != 3 {
            if Instant::now() >= until {
                return Err(faulted(
                    "activation does not complete: look between the fingers and at the supply".to_owned(),
                ));
            }
            std::thread::sleep(ASK_EVERY);
        }
        self.status()
    }

    /// A person took the spoon out of fingers that cannot open, so that the driver no longer counts it as held.
    pub fn taken_out(&mut self, _word: NoSpoon) {
        self.gripped = false;
    }

    fn check_empty(&self, status: &GripperStatus) -> Result<(), DeviceError> {
        let is_stopped_by_something = matches!(status.object, Object::Opening | Object::Closing);
        if is_stopped_by_something || self.gripped {
            let can_move = status.activated && status.fault == 0;
            let first = match can_move {
                true => "put it into its rack and release it",
                false => {
                    "take it out by hand, switch the gripper's supply off and on, and confirm that it was taken out"
                }
            };
            return Err(forbidden(format!("activation opens and closes the fingers, and they hold a spoon; {first}")));
        }
        if status.moving {
            return Err(forbidden("the fingers are moving; wait until they stand still, then activate".to_owned()));
        }
        Ok(())
    }

    /// Move the fingers and wait until they stand.
    fn go(&mut self, position: u8, effort: Effort) -> Result<GripperStatus, DeviceError> {
        let before = self.status()?;
        if !before.activated {
            return Err(forbidden(
                "it is not activated; take any spoon out of the fingers, then activate it".to_owned(),
            ));
        }
        check_fault(&before)?;
        match self.write(ACTIVATE | GO, position, effort) {
            // Whether it heard is in the position that it echoes, which the wait below looks at.
            Ok(()) | Err(DeviceError::Silent { .. } | DeviceError::Garbled { .. }) => {}
            Err(error) => return Err(error),
        }
        self.arrival(position)
    }

    /// Wait until the fingers stand, having been told to go to `position`.
    fn arrival(&mut self, position: u8) -> Result<GripperStatus, DeviceError> {
        let asked = Instant::now();
        loop {
            let now = self.status()?;
            check_fault(&now)?;
            let took_it = now.follows && now.requested == position;
            if took_it && !now.moving {
                return Ok(now);
            }
            if !took_it && asked.elapsed() >= ECHO {
                return Err(faulted(
                    "it did not take the order to move: look at the fingers, then ask again".to_owned(),
                ));
            }
            if asked.elapsed() >= MOTION_MAX {
                return Err(faulted(format!("the fingers do not come to rest, they are at {} of 255", now.position)));
            }
            std::thread::sleep(ASK_EVERY);
        }
    }

    /// Bytes of this many status registers; asked twice if need be.
    fn read(&mut self, registers: u16) -> Result<Vec<u8>, DeviceError> {
        match self.read_once(registers) {
            Err(DeviceError::Silent { .. } | DeviceError::Garbled { .. }) => self.read_once(registers),
            other => other,
        }
    }

    fn read_once(&mut self, registers: u16) -> Result<Vec<u8>, DeviceError> {
        match self.call(Request::ReadHoldingRegisters(STATUS, registers))? {
            Response::ReadHoldingRegisters(words) if words.len() == usize::from(registers) => {
                Ok(words.into_iter().flat_map(u16::to_be_bytes).collect())
            }
            _ => Err(self.unreadable()),
        }
    }

    fn write(&mut self, action: u8, position: u8, effort: Effort) -> Result<(), DeviceError> {
        let words = [[action, 0], [0, position], [effort.speed, effort.force]].map(u16::from_be_bytes);
        match self.call(Request::WriteMultipleRegisters(ACTION, words.as_slice().into()))? {
            Response::WriteMultipleRegisters(ACTION, 3) => Ok(()),
            _ => Err(self.unreadable()),
        }
    }

    fn call(&mut self, request: Request<'_>) -> Result<Response, DeviceError> {
        // A context of its own for each request, because one that met an unreadable reply gives up the next as well.
        let mut modbus = rtu::attach_slave(self.wire.clone(), SLAVE);
        // The first layer says whether an answer came in time, the second whether it could be read, the third whether it is an exception.
        match self.runtime.block_on(async { tokio::time::timeout(REPLY, modbus.call(request)).await }) {
            Ok(Ok(Ok(response))) => Ok(response),
            Ok(Ok(Err(exception))) => Err(faulted(format!("Modbus exception: {exception}"))),
            Ok(Err(tokio_modbus::Error::Transport(error))) if error.kind() != io::ErrorKind::InvalidData => {
                Err(DeviceError::Lost { device: DEVICE, cause: error.to_string() })
            }
            Ok(Err(_)) | Err(_) => Err(self.unreadable()),
        }
    }

    /// Nothing came, or nothing that can be read; leaves the wire alone until whatever is still on its way has come.
    fn unreadable(&self) -> DeviceError {
        std::thread::sleep(QUIET);
        let heard = self.wire.heard();
        if heard.is_empty() { DeviceError::Silent { device: DEVICE } } else { garbled(&heard) }
    }
}

/// A wait for activation (5) and a past silence (9) end by themselves; other faults need a person.
fn check_fault(status: &GripperStatus) -> Result<(), DeviceError> {
    if matches!(status.fault, 0 | 5 | 9) {
        return Ok(());
    }
    Err(faulted(format!("fault {:#04x}, {}", status.fault, fault_words(status.fault))))
}

fn faulted(cause: String) -> DeviceError {
    DeviceError::Faulted { device: DEVICE, cause }
}

fn forbidden(cause: String) -> DeviceError {
    DeviceError::Forbidden { device: DEVICE, cause }
}

fn garbled(bytes: &[u8]) -> DeviceError {
    DeviceError::Garbled { device: DEVICE, got: shown(bytes) }
}
