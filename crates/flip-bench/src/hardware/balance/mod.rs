//! Driver for a balance on a serial port or a TCP connection.
//!
//! One driver for all dialects: a dialect is a table of commands and a function that parses one
//! line. The driver guarantees, for any balance:
//!
//! * A number is returned only from an undamaged frame, in mg, g or kg, that arrived after the
//!   request. Everything else is an error that says what to do.
//! * No stale readings: unsolicited input is discarded before each request. After a missing reply,
//!   and before the first request, the driver sends a query whose reply cannot be mistaken for a
//!   reading (the serial number, the version) and waits for that reply, because replies keep their
//!   order; a refusal counts as a reply. A&D has no such query that is known for sure, and some
//!   balances answer none: there the wire must have been quiet for one reply timeout.
//! * Unsolicited lines (auto-print, the print key) look like replies in most dialects. Once the
//!   driver has seen one, it keeps listening for 0.3 s after each reply and takes the last line,
//!   which is at least as new as the reply.
//! * A balance that was power-cycled after taring, as far as its dialect shows, yields no readings
//!   until it is tared again.
//! * Frames carry no checksum. A frame whose width differs from that of the first ones is damaged.
//!   A frame with another unit or other decimals than the last is requested again and accepted if
//!   it comes twice. A single wrong digit cannot be detected, so use parity where the balance has
//!   it.
//!
//! Reading is retried once after a damaged reply; taring and zeroing never are: whether they took
//! effect is read off the display.

pub mod aandd;
mod dialogue;
mod identity;
pub mod mt_sics;
pub mod ohaus;
pub mod probe;
mod refusal;
pub mod reply;
pub mod sbi;
mod settings;
#[cfg(test)]
mod terse_tests;
#[cfg(test)]
mod tests;
pub mod value;
mod wait;
mod window;

pub use identity::Identity;
pub use settings::{Dialect, Settings, StableBy};

use super::DeviceError;
use super::clock::Clock;
use super::line::Line;
use super::settle::Shown;
use super::wire::{Tap, shown};
use dialogue::Dialogue;
use refusal::{faulted, garbled, in_steps_of, obeyed, refusal, seconds};
use reply::{Condition, Reply, Said, Weight};
use serde::{Deserialize, Serialize};
use std::time::Duration;
use value::{Fit, Unit};
use wait::Patience;
use window::Window;

/// Name used in messages.
const DEVICE: &str = "the balance";
/// Bench time between two polls of a balance that is not ready or not stable, s.
const PAUSE_S: f64 = 0.05;

/// Bench time allowed for carrying out an unacknowledged command, s: a tare that took effect later
/// would shift what has been weighed by then.
const SILENT_ORDER_S: f64 = 2.0;

/// Why a net mass is no longer valid.
const RESTARTED: &str = "it was switched on anew after it was tared (it told its serial number unasked): what it shows is no net mass, weigh the vial";

/// One command and how its reply is recognised; `None`: by content alone.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Command {
    bytes: &'static [u8],
    answer: Option<&'static str>,
    wants: Wants,
}

impl Command {
    /// Whether this line is the echo of the command.
    pub(crate) fn is_echoed_by(self, line: &[u8]) -> bool {
        line == self.bytes.trim_ascii_end()
    }
}

/// Kind of reply that a command expects; lines of another kind that arrive meanwhile are skipped
/// where they can be recognised.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Wants {
    Reading,
    Done,
    Words,
}

/// Commands of a dialect.
#[derive(Debug)]
pub(crate) struct Commands {
    immediate: Command,
    stable: Option<Command>,
    tare: Command,
    zero: Command,
    /// The same without waiting for stability, where the dialect has such a command.
    tare_at_once: Option<Command>,
    zero_at_once: Option<Command>,
    /// Taring and zeroing are acknowledged.
    acknowledges: bool,
    /// A query whose reply cannot be mistaken for a reading.
    barrier: Option<Command>,
    model: &'static [Command],
    serial: Option<Command>,
    software: Option<Command>,
}

/// One reading.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sample {
    /// Bench time of arrival, s.
    pub t_s: f64,
    /// mg
    pub mass_mg: f64,
    /// The balance's stability flag.
    pub stable: bool,
    /// The line that it was parsed from, control characters escaped.
    pub raw: String,
}

/// Unit and decimals: the same in every undamaged frame until someone changes the display.
type Form = (Unit, i32);

/// An open balance.
pub struct Balance {
    dialogue: Dialogue,
    settings: Settings,
    commands: &'static Commands,
    clock: Clock,
    /// Of the last frame.
    form: Option<Form>,
    /// Of every frame; known once the first two had the same form.
    width: Option<usize>,
    /// Recent readings, for balances that never flag one stable.
    window: Window,
    /// Scatter of readings at rest, mg.
    noise_mg: f64,
    /// Optional queries that it did not answer.
    silent_to: Vec<&'static [u8]>,
    /// Readings are net: a tare was commanded.
    tared: bool,
    /// Serial number at the tare, where the balance reports one.
    serial: Option<String>,
}

/// Either a mass, or the balance's reason for having none.
enum Seen {
    Mass(Sample),
    None(Condition),
}

impl Balance {
    /// Open the port; nothing is sent yet.
    ///
    /// # Errors
    /// [`DeviceError::Lost`]
    pub fn open(settings: &Settings, tap: Tap, clock: Clock) -> Result<Self, DeviceError> {
        let serial = settings.serial.unwrap_or_else(|| settings.dialect.factory_serial());
        let line = Line::open(DEVICE, &settings.port, &serial, tap)?;
        let dialogue = Dialogue::new(line, settings.dialect, seconds(settings.timeout_s));
        Ok(Self {
            dialogue,
            settings: settings.clone(),
            commands: settings.dialect.commands(),
            clock,
            form: None,
            width: None,
            window: Window::default(),
            noise_mg: 0.0,
            silent_to: Vec::new(),
            tared: false,
            serial: None,
        })
    }

    /// The same balance with this scatter of readings at rest, mg: by FLIP's own window a display
    /// with finer steps would never be stable.
    #[must_use]
    pub fn with_noise_mg(self, noise_mg: f64) -> Self {
        Self { noise_mg, ..self }
    }

    /// The current display. A balance that is not ready is polled until `timeout_s` has passed.
    ///
    /// # Errors
    /// [`DeviceError`]: overload, underload, a foreign unit, a fault and not ready are
    /// [`DeviceError::Faulted`], a running adjustment is [`DeviceError::Forbidden`].
    pub fn immediate(&mut self) -> Result<Sample, DeviceError> {
        let patience = Patience::new(&self.clock, self.settings.timeout_s);
        loop {
            match self.look(self.commands.immediate, seconds(self.settings.timeout_s))? {
                Seen::Mass(sample) => return Ok(sample),
                Seen::None(condition) if condition.passes() && !patience.is_spent() => {
                    self.clock.wait_s(PAUSE_S)
                }
                Seen::None(condition) => return Err(refusal(condition)),
            }
        }
    }

    /// A reading that is flagged stable, or, after `timeout_s` of bench time, the last one, flagged
    /// unstable.
    ///
    /// # Errors
    /// As [`Self::immediate`]. A balance that does not answer at all is [`DeviceError::Silent`]
    /// long before `timeout_s`.
    pub fn stable(&mut self, timeout_s: f64) -> Result<Sample, DeviceError> {
        let patience = Patience::new(&self.clock, timeout_s);
        if let (StableBy::Command, Some(command)) = (self.settings.stable_by, self.commands.stable)
        {
            match self.look(command, seconds(timeout_s) + seconds(self.settings.timeout_s))? {
                Seen::Mass(sample) => return Ok(sample),
                // Ohaus gives the same reply when it waited in vain and when it does not know the
                // command.
                Seen::None(condition) if condition.passes() || condition == Condition::Unknown => {}
                Seen::None(condition) => return Err(refusal(condition)),
            }
        }
        self.poll_until_stable(&patience)
    }

    /// Tare with the present load, and verify that the display then shows zero; returns that
    /// reading.
    ///
    /// # Errors
    /// [`DeviceError::Faulted`] if the reading is not stable, or does not come to zero within
    /// `stable_timeout_s`; else as [`Self::immediate`]. The balance may have tared, or may yet:
    /// tare again before weighing anything.
    pub fn tare(&mut self) -> Result<Sample, DeviceError> {
        self.tared = false;
        self.dialogue.forget_restart();
        let zero = self.bring_to_zero(self.commands.tare, self.commands.tare_at_once, "tare")?;
        self.serial = self.serial_number().unwrap_or_default();
        self.tared = true;
        Ok(zero)
    }

    /// Check that this is the balance that was tared, and that it has not been power-cycled since,
    /// as far as it reports.
    ///
    /// # Errors
    /// [`DeviceError::Faulted`] if it is not; else as [`Self::identify`].
    pub fn is_the_same(&mut self) -> Result<(), DeviceError> {
        if let Some(before) = self.serial.clone().filter(|_| self.tared)
            && let Some(now) = self.serial_number()?.filter(|now| *now != before)
        {
            let told = format!(
                "serial number {now} answers, and {before} was tared: what it shows is no net mass, weigh the vial"
            );
            return Err(faulted(told));
        }
        self.has_not_restarted()
    }

    fn has_not_restarted(&self) -> Result<(), DeviceError> {
        match self.tared && self.dialogue.restarted() {
            true => Err(faulted(RESTARTED.to_owned())),
            false => Ok(()),
        }
    }

    /// Set the zero point, with an empty pan, and verify that the display shows it; returns that
    /// reading.
    ///
    /// # Errors
    /// As [`Self::tare`]; a balance with a vial on it may refuse.
    pub fn zero(&mut self) -> Result<Sample, DeviceError> {
        self.bring_to_zero(self.commands.zero, self.commands.zero_at_once, "zero")
    }

    fn poll_until_stable(&mut self, patience: &Patience) -> Result<Sample, DeviceError> {
        let mut last = None;
        loop {
            match self.look(self.commands.immediate, seconds(self.settings.timeout_s))? {
                Seen::Mass(sample) if sample.stable => return Ok(sample),
                Seen::Mass(sample) => last = Some(sample),
                Seen::None(condition) if condition.passes() && !patience.is_spent() => {}
                Seen::None(condition) => {
                    return last.filter(|_| condition.passes()).ok_or(refusal(condition));
                }
            }
            if let Some(sample) = last.take_if(|_| patience.is_spent()) {
                return Ok(sample);
            }
            self.clock.wait_s(PAUSE_S);
        }
    }

    fn bring_to_zero(
        &mut self,
        command: Command,
        at_once: Option<Command>,
        verb: &str,
    ) -> Result<Sample, DeviceError> {
        let limit_s = self.settings.stable_timeout_s;
        if !self.stable(limit_s)?.stable {
            return Err(faulted(format!(
                "no stable reading to {verb} at: {}",
                self.why_unstable()
            )));
        }
        self.window.forget();
        let by_window = at_once.filter(|_| self.settings.stable_by == StableBy::Window);
        if !by_window.map_or(Ok(false), |command| self.order_at_once(command, verb))? {
            self.order(command, verb)?;
        }
        let patience = Patience::new(&self.clock, limit_s);
        loop {
            let sample = self.stable(limit_s)?;
            if sample.stable && sample.mass_mg.abs() <= self.zero_mg_max() {
                return Ok(sample);
            }
            if patience.is_spent() {
                return Err(faulted(format!("it did not {verb}: it shows {} mg", sample.mass_mg)));
            }
            self.clock.wait_s(PAUSE_S);
        }
    }

    /// What to do about a balance whose readings are not flagged stable.
    pub fn why_unstable(&self) -> String {
        if self.settings.stable_by == StableBy::Window {
            return "its numbers never stand: keep draughts and vibration away, or write the noise that is measured into readings.noise_mg".to_owned();
        }
        if self.window.stands_unflagged() {
            let why = "this balance never flags a reading as stable although its numbers stand";
            return format!(
                "{why}: write stable_by = \"window\" under [balance] in the bench file, and FLIP's own window decides"
            );
        }
        "close the draught shield, keep draughts and vibration away, and look at the balance's filter setting"
            .to_owned()
    }

    /// Whether the balance carried the command out; `false` where it does not know the command.
    fn order_at_once(&mut self, command: Command, verb: &str) -> Result<bool, DeviceError> {
        match self.dialogue.ask(command, seconds(self.settings.timeout_s)) {
            Ok((Reply { said: Said::Condition(Condition::Unknown), .. }, _))
            | Err(DeviceError::Silent { .. }) => Ok(false),
            answer => obeyed(answer, verb).map(|()| true),
        }
    }

    /// Send a command and, where the dialect acknowledges commands, wait for the acknowledgement. A
    /// damaged one is ignored: the display shows the outcome.
    fn order(&mut self, command: Command, verb: &str) -> Result<(), DeviceError> {
        if !self.commands.acknowledges {
            self.dialogue.tell(command)?;
            self.clock.wait_s(SILENT_ORDER_S);
            return Ok(());
        }
        let limit = seconds(self.settings.stable_timeout_s) + seconds(self.settings.timeout_s);
        obeyed(self.dialogue.ask(command, limit), verb)
    }

    /// Largest reading that counts as zero: two of the display's last places, but at least 0.5 mg
    /// for a display of tenths, whose noise comes from its surroundings.
    fn zero_mg_max(&self) -> f64 {
        (2.0 * self.step_mg()).max(0.5)
    }

    /// Display step, mg: from the settings, or the last place shown.
    fn step_mg(&self) -> f64 {
        let last_place_mg =
            || self.form.map_or(0.0, |(unit, decimals)| value::place_mg(unit, decimals));
        self.settings.readability_mg.unwrap_or_else(last_place_mg)
    }

    /// One reading from an undamaged frame in the form of the last, or the reason for having none.
    fn look(&mut self, command: Command, limit: Duration) -> Result<Seen, DeviceError> {
        // One for a damaged frame, one for a new form.
        let mut retries = 2;
        loop {
            match self.look_once(command, limit) {
                Err(DeviceError::Garbled { .. }) if retries > 0 => retries -= 1,
                seen => return seen,
            }
        }
    }

    fn look_once(&mut self, command: Command, limit: Duration) -> Result<Seen, DeviceError> {
        let (reply, raw) = self.dialogue.ask(command, limit)?;
        self.has_not_restarted()?;
        let weight = match reply.said {
            Said::Weight(weight) => weight,
            Said::Condition(condition) => return Ok(Seen::None(condition)),
            Said::Done | Said::Text(_) => return Err(garbled(&raw)),
        };
        let Some(unit) =
            weight.unit.or(self.unit_of_moving(&weight)).or(self.unit_by_step(&weight))
        else {
            return Ok(Seen::None(Condition::NoUnit));
        };
        let form = (unit, weight.number.decimals());
        self.settings
            .readability_mg
            .map_or(Ok(()), |step_mg| in_steps_of(step_mg, &weight, unit, &raw))?;
        if self.width.is_some_and(|width| width != weight.width)
            || self.form.replace(form) != Some(form)
        {
            return Err(garbled(&raw));
        }
        self.width = Some(weight.width);
        let (t_s, mass_mg) = (self.clock.now_s(), weight.number.mg(unit));
        let one = Shown { t_s, mass_mg, flag: weight.stable };
        let stands = self.window.hear(one, self.step_mg().max(self.noise_mg));
        let stable =
            if self.settings.stable_by == StableBy::Window { stands } else { weight.stable };
        Ok(Seen::Mass(Sample { t_s, mass_mg, stable, raw: shown(&raw) }))
    }

    /// The unit of a frame without one: that of the last frame, if the number has its form.
    fn unit_of_moving(&self, weight: &Weight) -> Option<Unit> {
        let (unit, decimals) = self.form?;
        (decimals == weight.number.decimals()).then_some(unit)
    }

    /// The unit in which the number's last place is the display step, where no frame ever carries
    /// one.
    fn unit_by_step(&self, weight: &Weight) -> Option<Unit> {
        let step_mg =
            self.settings.readability_mg.filter(|_| self.settings.stable_by == StableBy::Window)?;
        let steps = |unit: &Unit| weight.number.is_in_steps_of(step_mg, *unit) != Fit::OtherPlace;
        [Unit::Milligram, Unit::Gram, Unit::Kilogram].into_iter().find(steps)
    }
}
