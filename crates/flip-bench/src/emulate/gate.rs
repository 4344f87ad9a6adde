//! The emulated gate: the board of `hardware/gate_firmware` and the slide that it moves.

mod request;

pub use request::{Order, Request, parse};

use super::fault::named;
use super::motion::{Motion, wait_out};
use super::port::Talker;
use crate::hardware::clock::Clock;
use crate::hardware::gate::{Refusal, VERSION, Why, framed};
use flip_core::domain::FieldError;
use serde::{Deserialize, Serialize};
use std::str::FromStr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Without a heartbeat for this long the gate closes.
const WATCHDOG: Duration = Duration::from_millis(500);
/// Longest line, bytes.
const LINE_BYTES_MAX: usize = 40;
/// Positions of the slide, thousandths.
const CLOSED: f64 = 0.0;
const OPEN: f64 = 1000.0;
/// How long an end stop may stay silent after a motion, s.
const SETTLE_S: f64 = 0.3;

/// Faults of a gate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fault {
    /// A request is obeyed but its reply is lost.
    LostLine,
    /// A reply with noise in it.
    GarbledLine,
    /// A request that reaches the board with noise in it.
    ChecksumError,
    /// The slide jams half way, in either direction, until it is freed.
    StuckHalfOpen,
    /// The board restarts.
    Reset,
    /// Nothing passes the wire any more, in either direction.
    Silence,
    /// The board has no power; the slide's spring closes it.
    Unplug,
}

impl Fault {
    /// Every fault.
    pub const ALL: [Self; 7] = [
        Self::LostLine,
        Self::GarbledLine,
        Self::ChecksumError,
        Self::StuckHalfOpen,
        Self::Reset,
        Self::Silence,
        Self::Unplug,
    ];

    /// Name used on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::LostLine => "lost-line",
            Self::GarbledLine => "garbled-line",
            Self::ChecksumError => "checksum-error",
            Self::StuckHalfOpen => "stuck-half-open",
            Self::Reset => "reset",
            Self::Silence => "silence",
            Self::Unplug => "unplug",
        }
    }
}

impl FromStr for Fault {
    type Err = FieldError;

    fn from_str(name: &str) -> Result<Self, FieldError> {
        named(Self::ALL, Self::name, name)
    }
}

/// How an emulated gate is built.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// How long the board is silent after a reset. Default 2 s, like an Arduino's bootloader.
    pub boot: Duration,
    /// Travel time of the slide from end to end, s. Default 0.4, as in the sketch.
    pub travel_s: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { boot: Duration::from_secs(2), travel_s: 0.4 }
    }
}

/// The board and its slide, shared with the other emulators of the bench.
#[derive(Clone)]
pub struct Slide(Arc<Mutex<Board>>);

struct Board {
    clock: Clock,
    settings: Settings,
    target: f64,
    motion: Motion,
    /// Why the slide is to be closed; `None` while it is to be open.
    closed_for: Option<Why>,
    beat_at: Instant,
    /// When it sends its HI; `None` once it has.
    hello_at: Option<Instant>,
    /// Number of the newest line obeyed, and its reply; `None` before the first HELLO.
    newest: Option<(u16, String)>,
    is_jammed: bool,
    is_silent: bool,
    is_unplugged: bool,
    /// The fault of incoming lines, and how many it affects.
    pending: Option<(Fault, u32)>,
}

impl Slide {
    /// A closed slide whose board starts now.
    pub fn new(settings: Settings, clock: Clock) -> Self {
        let now = Instant::now();
        Self(Arc::new(Mutex::new(Board {
            clock,
            settings,
            target: CLOSED,
            motion: Motion::standing(CLOSED),
            closed_for: Some(Why::Reset),
            beat_at: now,
            hello_at: Some(now + settings.boot),
            newest: None,
            is_jammed: false,
            is_silent: false,
            is_unplugged: false,
            pending: None,
        })))
    }

    /// Current opening, 0 to 1: powder flows above 0.
    pub fn opening(&self) -> f64 {
        let board = self.locked();
        board.position() / OPEN
    }

    /// Inject this fault: into the next `lines` lines, or at once if it does not concern lines.
    pub fn cause(&self, fault: Fault, lines: u32) {
        let mut board = self.locked();
        match fault {
            Fault::StuckHalfOpen => board.is_jammed = true,
            Fault::Reset => board.reset(),
            Fault::Silence => board.is_silent = true,
            Fault::Unplug => {
                board.is_unplugged = true;
                board.close_for(Why::Reset);
            }
            of_lines => board.pending = Some((of_lines, lines)),
        }
    }

    /// Undo [`Slide::cause`]; a board that was unplugged restarts.
    pub fn repair(&self) {
        let mut board = self.locked();
        let (was_unplugged, was_jammed) = (board.is_unplugged, board.is_jammed);
        (board.is_jammed, board.is_silent, board.is_unplugged, board.pending) =
            (false, false, false, None);
        if was_unplugged {
            board.reset();
        } else if was_jammed {
            let target = board.target;
            board.head_for(target);
        }
    }

    fn locked(&self) -> MutexGuard<'_, Board> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Board {
    fn reset(&mut self) {
        self.close_for(Why::Reset);
        self.hello_at = Some(Instant::now() + self.settings.boot);
        self.newest = None;
    }

    /// Close without a command; nothing polls the slide meanwhile, so wait until it has arrived.
    fn close_for(&mut self, why: Why) {
        self.closed_for = Some(why);
        self.head_for(CLOSED);
        wait_out(&self.clock, self.motion.ends_s());
    }

    fn position(&self) -> f64 {
        self.motion.at(self.clock.now_s())
    }

    fn head_for(&mut self, target: f64) {
        let from = self.position();
        let half = OPEN / 2.0;
        let meets_jam = self.is_jammed && (from - half) * (target - half) <= 0.0;
        self.target = target;
        let per_second = OPEN / self.settings.travel_s;
        let to = if meets_jam { half } else { target };
        self.motion = Motion { from, to, began_s: self.clock.now_s(), per_second };
    }

    /// When a motion is over; for one that does not arrive, when its end stop has been silent long
    /// enough.
    fn settled_s(&self) -> f64 {
        self.motion.ends_s() + if self.motion.to == self.target { 0.0 } else { SETTLE_S }
    }

    /// State, opening, end stops and closing reason, in the protocol's format.
    fn status(&self) -> String {
        let position = self.position().round();
        let state = match () {
            () if self.clock.now_s() < self.settled_s() => "MOVING",
            () if self.motion.to != self.target => "STUCK",
            () if self.target == CLOSED => "CLOSED",
            () => "OPEN",
        };
        let stops = match position {
            CLOSED => "C",
            OPEN => "O",
            _ => "-",
        };
        let why = match self.closed_for {
            Some(Why::Reset) => "RESET",
            Some(Why::Asked) => "ASKED",
            Some(Why::Beats) => "BEATS",
            None => "-",
        };
        format!("{state} {position} {stops} {why}")
    }

    /// Unsolicited activity of the board.
    fn tick(&mut self, say: &mut dyn FnMut(&[u8])) {
        let now = Instant::now();
        if self.is_unplugged {
            return;
        }
        if self.closed_for.is_none() && now.duration_since(self.beat_at) >= WATCHDOG {
            self.close_for(Why::Beats);
        }
        if self.hello_at.is_some_and(|at| at <= now) {
            self.hello_at = None;
            self.say(&format!("0 HI {VERSION} {}", self.status()), say);
        }
    }

    fn say(&self, text: &str, say: &mut dyn FnMut(&[u8])) {
        if !self.is_silent {
            say(framed(text).as_bytes());
        }
    }

    fn hear(&mut self, line: &[u8], say: &mut dyn FnMut(&[u8])) {
        if self.is_unplugged || self.is_silent || self.hello_at.is_some() {
            return;
        }
        let fault = self.next_fault();
        let reply = match parse(line) {
            _ if fault == Some(Fault::ChecksumError) => "0 ERR CHECKSUM".to_owned(),
            Err(Refusal::Checksum) => "0 ERR CHECKSUM".to_owned(),
            Err(_) => "0 ERR FORM".to_owned(),
            Ok(request) => self.reply(&request),
        };
        match fault {
            Some(Fault::LostLine) => {}
            Some(Fault::GarbledLine) => say(framed(&reply).replacen(' ', "\u{7f}", 1).as_bytes()),
            _ => self.say(&reply, say),
        }
    }

    /// The reply to a line, which is obeyed if it is newer than all before.
    fn reply(&mut self, request: &Request) -> String {
        let seq = request.seq;
        if request.order != Ok(Order::Hello) {
            match &self.newest {
                None => return format!("{seq} ERR HELLO"),
                Some((newest, reply)) if *newest == seq => return reply.clone(),
                Some((newest, _)) if seq.wrapping_sub(*newest) > u16::MAX / 2 => {
                    return format!("{seq} ERR OLD");
                }
                Some(_) => {}
            }
        }
        let reply = match request.order {
            Ok(Order::Hello) => {
                self.asked_to_close();
                format!("{seq} HI {VERSION} {}", self.status())
            }
            Ok(order) => {
                self.obey(order);
                format!("{seq} OK {}", self.status())
            }
            Err(Refusal::Argument) => format!("{seq} ERR ARGUMENT"),
            Err(_) => format!("{seq} ERR COMMAND"),
        };
        if request.order == Ok(Order::Status) {
            wait_out(&self.clock, self.settled_s());
        }
        self.newest = Some((seq, reply.clone()));
        reply
    }

    fn obey(&mut self, order: Order) {
        match order {
            Order::Open(permille) => {
                self.closed_for = None;
                self.beat_at = Instant::now();
                self.head_for(f64::from(permille));
            }
            Order::Beat => self.beat_at = Instant::now(),
            Order::Close => self.asked_to_close(),
            Order::Hello | Order::Status => {}
        }
    }

    /// A gate that is already closed keeps its reason.
    fn asked_to_close(&mut self) {
        if self.closed_for.is_none() {
            self.closed_for = Some(Why::Asked);
            self.head_for(CLOSED);
        }
    }

    /// The fault that applies to this line.
    fn next_fault(&mut self) -> Option<Fault> {
        let (fault, lines) = self.pending?;
        self.pending = (lines > 1).then(|| (fault, lines - 1));
        (lines > 0).then_some(fault)
    }
}

/// An emulated gate on a port. On TCP each connection resets its board; a pseudo-terminal is reset
/// only by [`Fault::Reset`].
pub struct EmulatedGate {
    slide: Slide,
    /// Bytes of an incomplete line.
    partial: Vec<u8>,
}

impl EmulatedGate {
    /// A gate with this slide.
    pub fn new(slide: Slide) -> Self {
        Self { slide, partial: Vec::new() }
    }
}

impl Talker for EmulatedGate {
    fn connected(&mut self) {
        self.partial.clear();
        self.slide.locked().reset();
    }

    fn hear(&mut self, bytes: &[u8], say: &mut dyn FnMut(&[u8])) {
        let mut board = self.slide.locked();
        board.tick(say);
        for byte in bytes {
            match byte {
                b'\n' | b'\r' if self.partial.is_empty() => {}
                b'\n' | b'\r' => board.hear(&std::mem::take(&mut self.partial), say),
                // A line that is too long is cut, so that its checksum is wrong.
                _ if self.partial.len() >= LINE_BYTES_MAX => {}
                _ => self.partial.push(*byte),
            }
        }
    }

    fn idle(&mut self, say: &mut dyn FnMut(&[u8])) {
        self.slide.locked().tick(say);
    }
}

#[cfg(test)]
#[path = "gate_tests.rs"]
mod tests;
