//! Questions and answers over one wire: which line answers what, and how to get back into step.

use super::reply::{Condition, Reply, Said};
use super::{Command, DEVICE, Dialect, Wants, faulted, garbled};
use crate::hardware::DeviceError;
use crate::hardware::line::Line;
use std::time::{Duration, Instant};

/// How long the driver listens on after an answer while lines come unasked.
const CHATTER: Duration = Duration::from_millis(300);
/// How long it listens on after every other answer: what follows at once says that the line before it came unasked.
const GLANCE: Duration = Duration::from_millis(1);
/// Most lines that are looked at for one answer.
const LINES_MAX: usize = 64;

/// A wire to a balance.
pub(super) struct Dialogue {
    line: Line,
    dialect: Dialect,
    /// How long an answer may take.
    limit: Duration,
    /// Lines may come unasked.
    chatty: bool,
    /// An answer may be under way that nobody waits for.
    behind: bool,
    /// The balance has answered the question whose answer is no reading, be it by refusing it.
    keeps_step: bool,
    /// Answers to its question for the serial number that may still come.
    owed: u32,
    /// It told its serial number unasked, as it does when it is switched on.
    restarted: bool,
}

/// What came after that question.
enum After {
    /// Its answer.
    Words,
    /// The balance does not know it, and says so.
    Refusal,
    /// Lines, none of which answers it.
    Lines,
    /// Nothing.
    Nothing,
}

impl Dialogue {
    pub(super) fn new(line: Line, dialect: Dialect, limit: Duration) -> Self {
        Self { line, dialect, limit, chatty: true, behind: true, keeps_step: false, owed: 0, restarted: false }
    }

    /// The balance answers the question whose answer is no reading.
    pub(super) fn keeps_step(&self) -> bool {
        self.keeps_step
    }

    /// One question and its answer, with the line that it was read from.
    pub(super) fn ask(&mut self, command: Command, limit: Duration) -> Result<(Reply, Vec<u8>), DeviceError> {
        self.prepare()?;
        self.send(command)?;
        let answer = self.answer(command, limit);
        self.behind = answer.is_err();
        // Answers keep their order: what was asked for before this will not come any more.
        self.owed = if answer.is_ok() { 0 } else { self.owed };
        answer
    }

    /// Whether it was switched on again since this was last forgotten, as far as its dialect tells.
    pub(super) fn restarted(&self) -> bool {
        self.restarted
    }

    /// Whatever it did before does not matter any more.
    pub(super) fn forget_restart(&mut self) {
        self.restarted = false;
    }

    fn send(&mut self, command: Command) -> Result<(), DeviceError> {
        let told = announced(self.dialect);
        self.owed += u32::from(told.is_some() && command.answer == told);
        self.line.send(command.bytes)
    }

    /// A line came: is it one that nobody asked for and that says that the balance was switched on?
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

    /// Throw away what came unasked, but look at it first; whether anything did.
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

    /// Give an order that is not answered.
    pub(super) fn tell(&mut self, command: Command) -> Result<(), DeviceError> {
        self.prepare()?;
        self.send(command)
    }

    /// Nothing that is under way or has come may be taken for the next answer.
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

    /// Answers keep their order: what was under way has come when the question whose answer is no reading is answered, or refused. A balance that was
    /// never heard to answer it must have been quiet for as long as an answer may take.
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
            let line = match self.receive(barrier, until.saturating_duration_since(Instant::now())) {
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

    /// A refusal does not say what it refuses: the first may be that of an earlier question.
    fn hear_refusals_out(&mut self) -> Result<(), DeviceError> {
        let mut until = Instant::now() + CHATTER;
        for _ in 0..LINES_MAX {
            match self.line.receive(until.saturating_duration_since(Instant::now())) {
                Err(DeviceError::Silent { .. }) => return Ok(()),
                Ok(line) if self.dialect.parse(&line).is_ok_and(|reply| is_refusal(&reply.said)) => {
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

    /// The first line that can be the answer, or the last one where lines come unasked.
    fn answer(&mut self, command: Command, limit: Duration) -> Result<(Reply, Vec<u8>), DeviceError> {
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

    fn next_for(&mut self, command: Command, limit: Duration) -> Result<(Reply, Vec<u8>), DeviceError> {
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

    /// The next line that is not our own command: some wires and balances send back what they hear.
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

/// The balance cannot do what it was asked, whatever that was.
fn is_refusal(said: &Said) -> bool {
    matches!(said, Said::Condition(Condition::Unknown | Condition::Fault(_)))
}

/// The question that a balance answers unasked when it is switched on: MT-SICS tells its serial number. Of the other dialects no such line is known.
fn announced(dialect: Dialect) -> Option<&'static str> {
    (dialect == Dialect::MtSics).then_some("I4")
}

/// This line may answer this question.
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
