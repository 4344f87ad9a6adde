//! Request and reply over one wire: matching lines to commands, and resynchronising.

use super::reply::{Condition, Reply, Said};
use super::{Command, DEVICE, Dialect, Wants, faulted, garbled};
use crate::hardware::DeviceError;
use crate::hardware::line::Line;
use std::time::{Duration, Instant};

/// How long the driver keeps listening after a reply when the balance also sends unsolicited lines.
const CHATTER: Duration = Duration::from_millis(300);
/// How long it keeps listening after any other reply: a line that follows at once means that the
/// one before it was unsolicited.
const GLANCE: Duration = Duration::from_millis(1);
/// Maximum number of lines read for one reply.
const LINES_MAX: usize = 64;

/// A wire to a balance.
pub(super) struct Dialogue {
    line: Line,
    dialect: Dialect,
    /// Reply timeout.
    limit: Duration,
    /// The balance may send unsolicited lines.
    chatty: bool,
    /// A reply that is no longer waited for may be in flight.
    behind: bool,
    /// The balance has answered the barrier command (whose reply cannot be a reading), even if by
    /// refusing it.
    keeps_step: bool,
    /// Replies to the serial-number query that may still arrive.
    owed: u32,
    /// It sent its serial number unsolicited, as it does on power-up.
    restarted: bool,
}

/// What followed the barrier command.
enum After {
    /// Its reply.
    Words,
    /// A refusal: the balance does not know the command.
    Refusal,
    /// Lines, none of which is its reply.
    Lines,
    /// Nothing.
    Nothing,
}

impl Dialogue {
    pub(super) fn new(line: Line, dialect: Dialect, limit: Duration) -> Self {
        Self {
            line,
            dialect,
            limit,
            chatty: true,
            behind: true,
            keeps_step: false,
            owed: 0,
            restarted: false,
        }
    }

    /// Whether the balance answers the barrier command.
    pub(super) fn keeps_step(&self) -> bool {
        self.keeps_step
    }

    /// Send one command; returns the reply with the raw line it was parsed from.
    pub(super) fn ask(
        &mut self,
        command: Command,
        limit: Duration,
    ) -> Result<(Reply, Vec<u8>), DeviceError> {
        self.prepare()?;
        self.send(command)?;
        let answer = self.answer(command, limit);
        self.behind = answer.is_err();
        // Replies keep their order: those to earlier commands can no longer arrive.
        self.owed = if answer.is_ok() { 0 } else { self.owed };
        answer
    }

    /// Whether it was power-cycled since the flag was last cleared, as far as its dialect shows.
    pub(super) fn restarted(&self) -> bool {
        self.restarted
    }

    /// Clear the power-cycle flag.
    pub(super) fn forget_restart(&mut self) {
        self.restarted = false;
    }

    fn send(&mut self, command: Command) -> Result<(), DeviceError> {
        let told = announced(self.dialect);
        self.owed += u32::from(told.is_some() && command.answer == told);
        self.line.send(command.bytes)
    }

    /// Check whether a received line is unsolicited and means that the balance was power-cycled.
    fn note(&mut self, reply: &Reply) {
        let told = announced(self.dialect);
        if told.is_none() || reply.to.as_deref() != told || !matches!(reply.said, Said::Text(_)) {
            return;
        }
        match self.owed.checked_sub(1) {
            Some(left) => self.owed = left,
            None => self.restarted = true,
        }
    }

    /// Discard unsolicited input after checking it for a power cycle; returns whether there was
    /// any.
    fn discard(&mut self) -> Result<bool, DeviceError> {
        let mut bytes = self.line.discard_input()?;
        if bytes.last().is_some_and(|last| !matches!(last, b'\r' | b'\n')) {
            match self.line.receive(GLANCE) {
                Ok(rest) => bytes.extend(rest),
                Err(DeviceError::Silent { .. } | DeviceError::Garbled { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        for line in bytes.split(|byte| matches!(byte, b'\r' | b'\n')) {
            if let Ok(reply) = self.dialect.parse(line) {
                self.note(&reply);
            }
        }
        Ok(!bytes.is_empty())
    }

    /// Send a command that is not answered.
    pub(super) fn tell(&mut self, command: Command) -> Result<(), DeviceError> {
        self.prepare()?;
        self.send(command)
    }

    /// Make sure that nothing in flight or already received can be taken for the next reply.
    fn prepare(&mut self) -> Result<(), DeviceError> {
        if self.behind {
            self.catch_up()?;
            self.behind = false;
        }
        if self.discard()? {
            self.chatty = true;
        }
        Ok(())
    }

    /// Replies keep their order: once the barrier command is answered or refused, everything that
    /// was in flight has arrived. A balance that has never answered it must have been quiet for one
    /// reply timeout.
    fn catch_up(&mut self) -> Result<(), DeviceError> {
        self.discard()?;
        let Some(barrier) = self.dialect.commands().barrier else { return self.wait_for_quiet() };
        self.send(barrier)?;
        match self.after(barrier)? {
            After::Words => self.keeps_step = true,
            After::Refusal => {
                self.keeps_step = true;
                self.owed = 0;
                self.hear_refusals_out()?;
            }
            _ if self.keeps_step => return Err(DeviceError::Silent { device: DEVICE }),
            After::Lines => self.wait_for_quiet()?,
            After::Nothing => {}
        }
        Ok(())
    }

    fn after(&mut self, barrier: Command) -> Result<After, DeviceError> {
        let until = Instant::now() + self.limit;
        let mut after = After::Nothing;
        for _ in 0..LINES_MAX {
            let line = match self.receive(barrier, until.saturating_duration_since(Instant::now()))
            {
                Err(DeviceError::Silent { .. }) => return Ok(after),
                line => line?,
            };
            after = After::Lines;
            let Ok(reply) = self.dialect.parse(&line) else { continue };
            self.note(&reply);
            match (barrier.answer, reply.to.as_deref()) {
                (Some(answer), Some(to)) if answer == to => return Ok(After::Words),
                (None, _) if matches!(reply.said, Said::Text(_)) => return Ok(After::Words),
                (_, None) if is_refusal(&reply.said) => return Ok(After::Refusal),
                _ => {}
            }
        }
        Ok(after)
    }

    /// Drain refusals. A refusal does not identify its command: the first may belong to an earlier
    /// one.
    fn hear_refusals_out(&mut self) -> Result<(), DeviceError> {
        let mut until = Instant::now() + CHATTER;
        for _ in 0..LINES_MAX {
            match self.line.receive(until.saturating_duration_since(Instant::now())) {
                Err(DeviceError::Silent { .. }) => return Ok(()),
                Ok(line)
                    if self.dialect.parse(&line).is_ok_and(|reply| is_refusal(&reply.said)) =>
                {
                    until = Instant::now() + CHATTER;
                }
                Ok(_) | Err(DeviceError::Garbled { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn wait_for_quiet(&mut self) -> Result<(), DeviceError> {
        for _ in 0..LINES_MAX {
            match self.line.receive(self.limit) {
                Err(DeviceError::Silent { .. }) => return Ok(()),
                Ok(_) | Err(DeviceError::Garbled { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        Err(faulted("it never stops sending: switch auto-print and stream mode off".to_owned()))
    }

    /// The first line that can be the reply, or the last one where unsolicited lines occur.
    fn answer(
        &mut self,
        command: Command,
        limit: Duration,
    ) -> Result<(Reply, Vec<u8>), DeviceError> {
        let mut found = self.next_for(command, limit)?;
        let mut until = Instant::now() + if self.chatty { CHATTER } else { GLANCE };
        self.chatty = false;
        for _ in 0..LINES_MAX {
            match self.next_for(command, until.saturating_duration_since(Instant::now())) {
                Ok(newer) if self.chatty => found = newer,
                Ok(newer) => {
                    (found, self.chatty) = (newer, true);
                    until = Instant::now() + CHATTER;
                }
                Err(DeviceError::Silent { .. }) => break,
                Err(error) => return Err(error),
            }
        }
        Ok(found)
    }

    fn next_for(
        &mut self,
        command: Command,
        limit: Duration,
    ) -> Result<(Reply, Vec<u8>), DeviceError> {
        let until = Instant::now() + limit;
        for _ in 0..LINES_MAX {
            let raw = self.receive(command, until.saturating_duration_since(Instant::now()))?;
            let reply = self.dialect.parse(&raw).map_err(|_| garbled(&raw))?;
            self.note(&reply);
            if is_for(command, &reply) {
                return Ok((reply, raw));
            }
        }
        Err(DeviceError::Silent { device: DEVICE })
    }

    /// The next line that is not an echo of our own command: some wires and balances echo what they
    /// receive.
    fn receive(&mut self, command: Command, limit: Duration) -> Result<Vec<u8>, DeviceError> {
        let until = Instant::now() + limit;
        loop {
            let line = self.line.receive(until.saturating_duration_since(Instant::now()))?;
            if !command.is_echoed_by(&line) {
                return Ok(line);
            }
        }
    }
}

/// Whether the balance refuses a command, whichever that was.
fn is_refusal(said: &Said) -> bool {
    matches!(said, Said::Condition(Condition::Unknown | Condition::Fault(_)))
}

/// The query that a balance answers unsolicited on power-up: MT-SICS sends its serial number. No
/// such line is known for the other dialects.
fn announced(dialect: Dialect) -> Option<&'static str> {
    (dialect == Dialect::MtSics).then_some("I4")
}

/// Whether this line may be the reply to this command.
fn is_for(command: Command, reply: &Reply) -> bool {
    match (command.answer, reply.to.as_deref()) {
        (Some(answer), Some(to)) => answer == to,
        _ => match command.wants {
            Wants::Reading => reply.said != Said::Done,
            Wants::Words => !matches!(reply.said, Said::Weight(_) | Said::Done),
            Wants::Done => true,
        },
    }
}
