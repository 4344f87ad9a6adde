//! The slide gate under the funnel: an Arduino on a serial port, 115200 8N1. Its sketch is in
//! `gate_firmware/`.
//!
//! Each line carries a number and a checksum (`gate/protocol.rs`), and the device obeys a number
//! only once, so a line whose reply is lost can be sent again.
//!
//! While the gate is open, a thread sends heartbeats, for no longer than the caller allowed; when
//! they stop, for any reason, the device closes the gate by itself.

mod protocol;

pub use protocol::{
    GateStatus, Refusal, Reply, Said, State, VERSION, Why, framed, number, parse, unframed,
};

use super::DeviceError;
use super::line::{Line, Parity, Serial};
use super::wire::{Tap, shown};
use flip_core::domain::FieldError;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Name used in messages.
const DEVICE: &str = "the gate";
const SERIAL: Serial = Serial { baud: 115_200, data_bits: 8, parity: Parity::None };
/// Reply timeout.
const REPLY: Duration = Duration::from_millis(150);
/// Maximum number of times a line is sent.
const SENDS_MAX: usize = 3;
/// How long a board may be silent after its port was opened, which resets it: the bootloader takes
/// about 2 s.
const BOOT: Duration = Duration::from_secs(4);
/// Heartbeat interval: four may be lost.
const BEAT_EVERY: Duration = Duration::from_millis(100);
/// How often the gate is polled while it moves.
const ASK_EVERY: Duration = Duration::from_millis(20);
/// Maximum time that heartbeats keep the gate open, whatever the caller allows.
const OPEN_MAX: Duration = Duration::from_secs(600);
/// Maximum travel time of the slide.
const TRAVEL_MAX: Duration = Duration::from_secs(3);

/// How far to open, in thousandths of the full opening.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Opening(u16);

impl Opening {
    /// All the way.
    pub const FULL: Self = Self(1000);

    /// This fraction of the full opening.
    ///
    /// # Errors
    /// It is not between 0.001 and 1.
    pub fn fraction(value: f64) -> Result<Self, FieldError> {
        let value = flip_core::domain::bounded("opening", value, 0.001, 1.0, "")?;
        Ok(Self((value * 1000.0).round() as u16))
    }
}

/// An open gate port. Dropping it closes the gate.
pub struct Gate {
    wire: Arc<Mutex<Wire>>,
    beats: Option<Beats>,
}

impl Gate {
    /// Open `port`, which resets the board, and wait for its HI. The gate is then closed.
    ///
    /// # Errors
    /// [`DeviceError::Silent`] when no board answers, [`DeviceError::Faulted`] for another version
    /// of the protocol, [`DeviceError::Lost`].
    pub fn open(port: &str, tap: Tap) -> Result<Self, DeviceError> {
        Self::open_within(port, BOOT, tap)
    }

    /// As [`Gate::open`], for a board that starts within `boot`.
    ///
    /// # Errors
    /// As for [`Gate::open`].
    pub fn open_within(port: &str, boot: Duration, tap: Tap) -> Result<Self, DeviceError> {
        let mut wire =
            Wire { line: Line::open(DEVICE, port, &SERIAL, tap)?, seq: 0, trouble: None };
        wire.await_hello(boot)?;
        wire.hello()?;
        Ok(Self { wire: Arc::new(Mutex::new(wire)), beats: None })
    }

    /// Request the status. Trouble met by the heartbeats since the gate was opened is reported
    /// first, once.
    ///
    /// # Errors
    /// [`DeviceError::Faulted`] when the gate closed by itself while heartbeats were sent, or the
    /// board was reset; the line failed.
    pub fn status(&mut self) -> Result<GateStatus, DeviceError> {
        let mut wire = locked(&self.wire);
        match wire.trouble.take() {
            Some(trouble) => Err(trouble),
            None => wire.order("STATUS"),
        }
    }

    /// Open, and wait until the slide has arrived. Heartbeats are sent for `at_most`; then the gate
    /// closes by itself.
    ///
    /// # Errors
    /// [`DeviceError::Faulted`] when the slide does not arrive; the line failed. The gate is then
    /// commanded to close, and closes anyway without heartbeats.
    pub fn open_gate(
        &mut self,
        opening: Opening,
        at_most: Duration,
    ) -> Result<GateStatus, DeviceError> {
        let opened = self.opened(opening, at_most);
        if opened.is_err() {
            // The caller must get the first error.
            let _ = self.close();
        }
        opened
    }

    fn opened(&mut self, opening: Opening, at_most: Duration) -> Result<GateStatus, DeviceError> {
        self.beats = None;
        {
            let mut wire = locked(&self.wire);
            wire.trouble = None;
            wire.order(&format!("OPEN {}", opening.0))?;
        }
        self.beats = Some(Beats::start(self.wire.clone(), at_most)?);
        let status = self.arrival()?;
        match status.state {
            State::Open => Ok(status),
            _ => Err(faulted(format!(
                "the slide does not open, {}: look for powder in its guide",
                in_words(&status)
            ))),
        }
    }

    /// Close, and wait until the end stop confirms it. A board that was reset gets a new HELLO,
    /// which closes it as well.
    ///
    /// # Errors
    /// [`DeviceError::Faulted`] when the slide does not arrive: powder may flow; the line failed:
    /// without heartbeats the gate closes by itself.
    pub fn close(&mut self) -> Result<GateStatus, DeviceError> {
        self.beats = None;
        {
            let mut wire = locked(&self.wire);
            wire.trouble = None;
            match wire.ask("CLOSE") {
                Ok(Said::Ok(_)) => {}
                Ok(_) | Err(DeviceError::Faulted { .. }) => drop(wire.hello()?),
                Err(error) => return Err(error),
            }
        }
        let status = self.arrival()?;
        match status.state {
            State::Closed => Ok(status),
            _ => Err(faulted(format!(
                "the slide does not close, {}: powder may flow",
                in_words(&status)
            ))),
        }
    }

    fn arrival(&mut self) -> Result<GateStatus, DeviceError> {
        let asked = Instant::now();
        loop {
            let status = self.status()?;
            if status.state != State::Moving || asked.elapsed() >= TRAVEL_MAX {
                return Ok(status);
            }
            std::thread::sleep(ASK_EVERY);
        }
    }
}

impl Drop for Gate {
    fn drop(&mut self) {
        // Whatever this returns, heartbeats have ended and the device closes by itself.
        let _ = self.close();
    }
}

/// The line, and the number of the last request on it.
struct Wire {
    line: Line,
    seq: u16,
    /// The error met by the heartbeats.
    trouble: Option<DeviceError>,
}

impl Wire {
    /// Wait for the HI of a board that starts. One that was not reset is silent and is queried
    /// afterwards: bytes sent earlier could keep a bootloader waiting.
    fn await_hello(&mut self, boot: Duration) -> Result<(), DeviceError> {
        let until = Instant::now() + boot;
        loop {
            match self.line.receive(until.saturating_duration_since(Instant::now())) {
                Ok(line) if matches!(parse(&line), Ok(Reply { said: Said::Hi(..), .. })) => {
                    return Ok(());
                }
                // A starting board may send noise.
                Ok(_) | Err(DeviceError::Garbled { .. }) => {}
                Err(DeviceError::Silent { .. }) => return Ok(()),
                Err(error) => return Err(error),
            }
        }
    }

    /// Start a session, which closes the gate.
    fn hello(&mut self) -> Result<GateStatus, DeviceError> {
        self.line.discard_input()?;
        match self.ask("HELLO")? {
            Said::Hi(VERSION, status) => Ok(status),
            Said::Hi(version, _) => Err(faulted(format!(
                "it speaks version {version} of the protocol; load the sketch of version {VERSION}"
            ))),
            other => Err(unexpected(other)),
        }
    }

    /// One heartbeat, sent once: the next follows soon. Silence is no error yet: if it lasts, the
    /// gate closes, and the next reply reports it.
    fn beat(&mut self) -> Result<(), DeviceError> {
        match self.ask_up_to("BEAT", 1) {
            Ok(Said::Ok(GateStatus { closed_for: Some(why), .. })) => {
                Err(faulted(format!("it closed by itself ({why:?})")))
            }
            Ok(Said::Ok(_)) | Err(DeviceError::Silent { .. } | DeviceError::Garbled { .. }) => {
                Ok(())
            }
            Ok(other) => Err(unexpected(other)),
            Err(error) => Err(error),
        }
    }

    /// Send a request that is answered with a status.
    fn order(&mut self, request: &str) -> Result<GateStatus, DeviceError> {
        match self.ask(request)? {
            Said::Ok(status) => Ok(status),
            other => Err(unexpected(other)),
        }
    }

    fn ask(&mut self, request: &str) -> Result<Said, DeviceError> {
        self.ask_up_to(request, SENDS_MAX)
    }

    /// Send a request under a new number until it is answered, at most this many times, and return
    /// the answer.
    fn ask_up_to(&mut self, request: &str, sends_max: usize) -> Result<Said, DeviceError> {
        self.seq = self.seq.checked_add(1).unwrap_or(1);
        let line = framed(&format!("{} {request}", self.seq));
        let mut failure = DeviceError::Silent { device: DEVICE };
        for _ in 0..sends_max {
            self.line.send(line.as_bytes())?;
            match self.answer() {
                Err(error @ (DeviceError::Silent { .. } | DeviceError::Garbled { .. })) => {
                    failure = error
                }
                other => return other,
            }
        }
        Err(failure)
    }

    /// The answer to the last line. A line that the device could not read, or an answer that cannot
    /// be parsed, is to be retried.
    fn answer(&mut self) -> Result<Said, DeviceError> {
        let until = Instant::now() + REPLY;
        let mut failure = DeviceError::Silent { device: DEVICE };
        loop {
            let line = match self.line.receive(until.saturating_duration_since(Instant::now())) {
                Err(DeviceError::Silent { .. }) => return Err(failure),
                other => other?,
            };
            match parse(&line) {
                Ok(Reply { seq, said }) if seq == self.seq => return Ok(said),
                Ok(Reply { seq: 0, said: Said::Hi(..) }) => return Err(reset()),
                Ok(Reply { seq: 0, said: Said::Err(_) }) => {
                    return Err(DeviceError::Garbled { device: DEVICE, got: shown(&line) });
                }
                // A late answer to an earlier line.
                Ok(_) => {}
                Err(error) => failure = error,
            }
        }
    }
}

/// The thread that sends heartbeats. It ends when this is dropped.
struct Beats {
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Beats {
    fn start(wire: Arc<Mutex<Wire>>, at_most: Duration) -> Result<Self, DeviceError> {
        let (stop, stopped) = channel();
        let until = Instant::now() + at_most.min(OPEN_MAX);
        let beat = move || {
            while Instant::now() < until
                && stopped.recv_timeout(BEAT_EVERY) == Err(RecvTimeoutError::Timeout)
            {
                let mut wire = locked(&wire);
                if let Err(trouble) = wire.beat() {
                    wire.trouble = Some(trouble);
                    return;
                }
            }
        };
        let thread = std::thread::Builder::new().name("gate heartbeat".into()).spawn(beat);
        let thread =
            thread.map_err(|error| faulted(format!("no thread for its heartbeats: {error}")))?;
        Ok(Self { stop: Some(stop), thread: Some(thread) })
    }
}

impl Drop for Beats {
    fn drop(&mut self) {
        self.stop = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn locked(wire: &Mutex<Wire>) -> MutexGuard<'_, Wire> {
    wire.lock().unwrap_or_else(PoisonError::into_inner)
}

fn in_words(status: &GateStatus) -> String {
    format!("it is {} of 1000 open ({:?})", status.opening_permille, status.state)
}

fn faulted(cause: String) -> DeviceError {
    DeviceError::Faulted { device: DEVICE, cause }
}

fn reset() -> DeviceError {
    faulted("its board was reset, which closed it; close it once more to go on".to_owned())
}

fn unexpected(said: Said) -> DeviceError {
    match said {
        Said::Err(Refusal::Hello) => reset(),
        other => faulted(format!("it answered {other:?}")),
    }
}
