//! The gripper: a Robotiq 2F-85 on Modbus RTU, slave 9, 115200 8N1.
//!
//! Three registers are written at 1000 (action, position, speed and force) and three are read at
//! 2000 (state, fault and echoed position, position and current). Frames and registers follow
//! Robotiq's instruction manuals for two-finger grippers.
//!
//! Retries: a read without a valid reply is sent once more. A write that moves the fingers is never
//! repeated: when its reply is lost, the driver reads the position that the gripper echoes, and
//! continues if it is the requested one. Modbus RTU does not number frames, so after a failure the
//! driver waits until the wire is quiet, and unsolicited bytes are discarded (and recorded) before
//! each request.
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

/// Name used in messages.
const DEVICE: &str = "the gripper";
const SLAVE: Slave = Slave(9);
/// First register written: action, position, speed and force.
const ACTION: u16 = 0x03E8;
/// First register read: state, fault and echo, position and current.
const STATUS: u16 = 0x07D0;
/// Bits of the action byte: activate, and go to the requested position.
const ACTIVATE: u8 = 0x01;
const GO: u8 = 0x08;
/// Commanded positions.
const OPEN: u8 = 0x00;
const CLOSED: u8 = 0xFF;
/// Reply timeout: a frame of 23 bytes lasts 2 ms.
const REPLY: Duration = Duration::from_millis(250);
/// How long the wire is left alone after a failure.
const QUIET: Duration = Duration::from_millis(60);
/// How often the gripper is polled while it moves.
const ASK_EVERY: Duration = Duration::from_millis(10);
/// How long the gripper may take to echo the commanded position.
const ECHO: Duration = Duration::from_millis(100);
/// How long a motion may take: the whole stroke at the lowest speed (20 mm/s, not verified) lasts
/// 4.3 s.
const MOTION_MAX: Duration = Duration::from_secs(7);
/// How long an activation may take; the manual gives no time (not verified).
const ACTIVATION_MAX: Duration = Duration::from_secs(10);

/// Object detection status (`gOBJ`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Object {
    /// The fingers are moving, or were not commanded to move.
    None,
    /// Something stopped them while opening.
    Opening,
    /// Something stopped them while closing: it is held.
    Closing,
    /// They reached the commanded position: nothing is held, or it was lost.
    AtPosition,
}

/// Status reported by the gripper.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GripperStatus {
    /// Activation is complete (`gACT` 1, `gSTA` 3).
    pub activated: bool,
    /// The fingers are moving, or activation is in progress.
    pub moving: bool,
    /// Object detection; means little unless `follows`.
    pub object: Object,
    /// It moves to the requested position (`gGTO`).
    pub follows: bool,
    /// Its fault code, 0 for none; [`fault_words`] explains it.
    pub fault: u8,
    /// The requested position, 0 open to 255 closed.
    pub requested: u8,
    /// Actual position of the fingers, 0 open to 255 closed.
    pub position: u8,
    /// Motor current, mA.
    pub current_ma: u16,
}

impl GripperStatus {
    /// The fingers closed on something and hold it.
    pub fn holds(&self) -> bool {
        self.follows && self.object == Object::Closing
    }
}

/// How the fingers move; each from 0, the gripper's minimum, to 255.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Effort {
    /// Speed.
    pub speed: u8,
    /// Force.
    pub force: u8,
}

impl Effort {
    /// The gripper's maximum.
    pub const FULL: Self = Self { speed: 255, force: 255 };
}

/// A person's confirmation that there is no spoon between the fingers. Consumed when used.
#[derive(Debug)]
pub struct NoSpoon(());

impl NoSpoon {
    /// `person` has checked.
    ///
    /// # Errors
    /// Nobody is named.
    pub fn seen_by(person: &str) -> Result<Self, FieldError> {
        if person.trim().is_empty() {
            return Err(FieldError::new(
                "seen_by",
                "must name the person who looked between the fingers",
            ));
        }
        Ok(Self(()))
    }
}

/// Parse the six bytes of the registers at 2000: state, reserved, fault, echoed position, position,
/// current.
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
    let object = [Object::None, Object::Opening, Object::Closing, Object::AtPosition]
        [usize::from(state >> 6)];
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

/// An open gripper. It blocks, so it must live on a thread outside any asynchronous runtime.
pub struct Gripper {
    runtime: tokio::runtime::Runtime,
    wire: Wire,
    /// It closed on something and has not been commanded to open since. The gripper forgets that
    /// when it loses power, the driver does not.
    gripped: bool,
}

impl Gripper {
    /// Open `port`: a path such as `/dev/ttyUSB0`, or `tcp://host:port`. Nothing moves.
    ///
    /// # Errors
    /// [`DeviceError::Lost`] with the reason.
    pub fn open(port: &str, tap: Tap) -> Result<Self, DeviceError> {
        let lost =
            |cause: String| DeviceError::Lost { device: DEVICE, cause: format!("{port}: {cause}") };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(|error| lost(error.to_string()))?;
        let wire = {
            let _within = runtime.enter();
            Wire::open(port, tap).map_err(|error| lost(error.to_string()))?
        };
        Ok(Self { runtime, wire, gripped: false })
    }

    /// Read the status.
    ///
    /// # Errors
    /// No valid reply, twice.
    pub fn status(&mut self) -> Result<GripperStatus, DeviceError> {
        let status = parse(&self.read(3)?)?;
        // Fingers that follow and have reached their commanded position no longer hold anything.
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

    /// Close the fingers until something stops them or they meet. The returned status tells whether
    /// something is held.
    ///
    /// # Errors
    /// [`DeviceError::Forbidden`] before activation, [`DeviceError::Faulted`] with the gripper's
    /// fault; the fingers may then be anywhere.
    pub fn grip(&mut self, effort: Effort) -> Result<GripperStatus, DeviceError> {
        self.go(CLOSED, effort)
    }

    /// Open the fingers: anything they hold falls, so the spoon must be in its rack.
    ///
    /// # Errors
    /// As for [`Gripper::grip`].
    pub fn release(&mut self, effort: Effort) -> Result<GripperStatus, DeviceError> {
        let status = self.go(OPEN, effort)?;
        self.gripped = false;
        Ok(status)
    }

    /// Activate a gripper that is not active; an active one without a fault is left as it is.
    ///
    /// The fingers open and close over their whole stroke: a spoon between them is dropped or bent.
    /// So a person has to confirm that there is none, because a gripper that lost power no longer
    /// knows whether it holds one; and activation is refused despite that confirmation when gripper
    /// or driver know better.
    ///
    /// # Errors
    /// [`DeviceError::Forbidden`] with what to do first, [`DeviceError::Faulted`] when activation
    /// does not complete.
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
                    "activation does not complete: look between the fingers and at the supply"
                        .to_owned(),
                ));
            }
            std::thread::sleep(ASK_EVERY);
        }
        self.status()
    }

    /// A person took the spoon out of fingers that cannot open: the driver no longer counts it as
    /// held.
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
            return Err(forbidden(format!(
                "activation opens and closes the fingers, and they hold a spoon; {first}"
            )));
        }
        if status.moving {
            return Err(forbidden(
                "the fingers are moving; wait until they stand still, then activate".to_owned(),
            ));
        }
        Ok(())
    }

    /// Move the fingers and wait until they stop.
    fn go(&mut self, position: u8, effort: Effort) -> Result<GripperStatus, DeviceError> {
        let before = self.status()?;
        if !before.activated {
            return Err(forbidden(
                "it is not activated; take any spoon out of the fingers, then activate it"
                    .to_owned(),
            ));
        }
        check_fault(&before)?;
        match self.write(ACTIVATE | GO, position, effort) {
            // Whether the command arrived shows in the echoed position, which the wait below
            // checks.
            Ok(()) | Err(DeviceError::Silent { .. } | DeviceError::Garbled { .. }) => {}
            Err(error) => return Err(error),
        }
        self.arrival(position)
    }

    /// Wait until the fingers, commanded to `position`, have stopped.
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
                    "it did not take the order to move: look at the fingers, then ask again"
                        .to_owned(),
                ));
            }
            if asked.elapsed() >= MOTION_MAX {
                return Err(faulted(format!(
                    "the fingers do not come to rest, they are at {} of 255",
                    now.position
                )));
            }
            std::thread::sleep(ASK_EVERY);
        }
    }

    /// Read the bytes of this many status registers, with one retry.
    fn read(&mut self, registers: u16) -> Result<Vec<u8>, DeviceError> {
        match self.read_once(registers) {
            Err(DeviceError::Silent { .. } | DeviceError::Garbled { .. }) => {
                self.read_once(registers)
            }
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
        let words =
            [[action, 0], [0, position], [effort.speed, effort.force]].map(u16::from_be_bytes);
        match self.call(Request::WriteMultipleRegisters(ACTION, words.as_slice().into()))? {
            Response::WriteMultipleRegisters(ACTION, 3) => Ok(()),
            _ => Err(self.unreadable()),
        }
    }

    fn call(&mut self, request: Request<'_>) -> Result<Response, DeviceError> {
        // A new context for each request: one that got an unreadable reply gives up the next as
        // well.
        let mut modbus = rtu::attach_slave(self.wire.clone(), SLAVE);
        // Outer result: whether a reply came in time; middle: whether it could be read; inner:
        // whether it is an exception.
        match self
            .runtime
            .block_on(async { tokio::time::timeout(REPLY, modbus.call(request)).await })
        {
            Ok(Ok(Ok(response))) => Ok(response),
            Ok(Ok(Err(exception))) => Err(faulted(format!("Modbus exception: {exception}"))),
            Ok(Err(tokio_modbus::Error::Transport(error)))
                if error.kind() != io::ErrorKind::InvalidData =>
            {
                Err(DeviceError::Lost { device: DEVICE, cause: error.to_string() })
            }
            Ok(Err(_)) | Err(_) => Err(self.unreadable()),
        }
    }

    /// Nothing, or nothing readable, was received; leaves the wire alone until anything still in
    /// flight has arrived.
    fn unreadable(&self) -> DeviceError {
        std::thread::sleep(QUIET);
        let heard = self.wire.heard();
        if heard.is_empty() { DeviceError::Silent { device: DEVICE } } else { garbled(&heard) }
    }
}

/// A wait for activation (5) and past communication loss (9) clear by themselves; other faults need
/// a person.
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
