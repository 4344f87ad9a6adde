//! Which balance is this? Asks in every dialect for a serial number and a reading, and keeps what came.
//!
//! Nothing is sent that tares, zeroes, adjusts or sets anything. The order is that in which a wrong guess does least: words that other dialects refuse or
//! ignore come first, escape sequences after them. At a wrong speed a balance hears noise, which it drops.

use super::reply::{Condition, Said};
use super::{Command, DEVICE, Dialect, Identity, maker};
use crate::hardware::DeviceError;
use crate::hardware::line::{Line, Serial};
use crate::hardware::wire::{Direction, Exchange, Tap};
use serde::Serialize;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How long an answer may take.
const ANSWER: Duration = Duration::from_millis(500);
/// How long the whole probe may take, however many settings are to be tried.
const PROBE: Duration = Duration::from_secs(60);
/// Lines that are read after one question.
const LINES_MAX: usize = 8;

/// The order of asking.
const ORDER: [Dialect; 4] = [Dialect::MtSics, Dialect::Ohaus, Dialect::Aandd, Dialect::Sbi];

/// What was found out.
#[derive(Debug, Clone, Serialize)]
pub struct Probe {
    /// The dialect in which the balance gave a reading, or said why there is none.
    pub dialect: Option<Dialect>,
    /// Who it says it is.
    pub identity: Option<Identity>,
    /// How the port was set when it answered.
    pub serial: Option<Serial>,
    /// Everything that passed, whether or not it was understood.
    pub transcript: Vec<Exchange>,
    /// What a person should know.
    pub notes: Vec<String>,
}

/// How ports of balances are usually set, the likeliest first.
pub fn usual_settings() -> Vec<Serial> {
    let mut usual = Vec::new();
    for serial in Dialect::ALL.map(Dialect::factory_serial) {
        if !usual.contains(&serial) {
            usual.push(serial);
        }
    }
    usual
}

/// Ask at each of these settings in each dialect, until one answers; for a TCP address once, whatever the settings.
pub fn probe(port: &str, settings: &[Serial], tap: Tap) -> Probe {
    let (tap, transcript) = recording(tap);
    let tried = if port.starts_with("tcp://") { &settings[..settings.len().min(1)] } else { settings };
    let mut found = Probe { dialect: None, identity: None, serial: None, transcript: Vec::new(), notes: Vec::new() };
    let until = Instant::now() + PROBE;
    for serial in tried {
        if found.dialect.is_some() {
            break;
        }
        if Instant::now() >= until {
            found.notes.push("not every setting was tried: the probe took too long".to_owned());
            break;
        }
        if let Err(error) = probe_at(port, serial, &tap, &mut found) {
            found.notes.push(error.to_string());
        }
    }
    found.transcript = std::mem::take(&mut *transcript.lock().unwrap_or_else(PoisonError::into_inner));
    found.notes.push(summary(&found));
    found
}

/// Hand on what passes, and keep it.
fn recording(tap: Tap) -> (Tap, Arc<Mutex<Vec<Exchange>>>) {
    let kept = Arc::new(Mutex::new(Vec::new()));
    let keep = kept.clone();
    let both = Tap::new(move |exchange: Exchange| {
        match exchange.direction {
            Direction::Sent => tap.sent(&exchange.device, exchange.text.clone()),
            Direction::Received => tap.received(&exchange.device, exchange.text.clone()),
        }
        keep.lock().unwrap_or_else(PoisonError::into_inner).push(exchange);
    });
    (both, kept)
}

fn probe_at(port: &str, serial: &Serial, tap: &Tap, found: &mut Probe) -> Result<(), DeviceError> {
    let mut line = Line::open(DEVICE, port, serial, tap.clone())?;
    for dialect in ORDER {
        let commands = dialect.commands();
        let serial_number = first_words(&mut line, dialect, commands.serial.as_slice())?;
        if weighs(&mut line, dialect, commands.immediate)? {
            let model = first_words(&mut line, dialect, commands.model)?;
            let software = first_words(&mut line, dialect, commands.software.as_slice())?;
            let maker = maker(dialect).to_owned();
            (found.dialect, found.serial) = (Some(dialect), Some(*serial));
            found.identity = Some(Identity { maker, model, serial: serial_number, software });
            return Ok(());
        }
    }
    Ok(())
}

/// The words that answer the first of these questions which is answered with words.
fn first_words(line: &mut Line, dialect: Dialect, commands: &[Command]) -> Result<Option<String>, DeviceError> {
    for command in commands {
        let text = words(line, dialect, *command)?;
        if text.is_some() {
            return Ok(text);
        }
    }
    Ok(None)
}

/// The words that answer a question in this dialect.
fn words(line: &mut Line, dialect: Dialect, command: Command) -> Result<Option<String>, DeviceError> {
    let mut text = None;
    hear(line, dialect, command, |said| {
        if let Said::Text(words) = said {
            text = Some(words).filter(|words| !words.is_empty());
        }
        text.is_some()
    })?;
    Ok(text)
}

/// The answer is a reading in this dialect, or a reason for none that no other dialect gives in these words.
fn weighs(line: &mut Line, dialect: Dialect, command: Command) -> Result<bool, DeviceError> {
    let mut weighs = false;
    hear(line, dialect, command, |said| {
        weighs = match said {
            Said::Weight(_) => true,
            Said::Condition(condition) => condition != Condition::Unknown,
            Said::Done | Said::Text(_) => false,
        };
        weighs
    })?;
    Ok(weighs)
}

/// Ask, and look at what comes until something suits or nothing comes.
fn hear(
    line: &mut Line,
    dialect: Dialect,
    command: Command,
    mut suits: impl FnMut(Said) -> bool,
) -> Result<(), DeviceError> {
    line.discard_input()?;
    line.send(command.bytes)?;
    let until = Instant::now() + ANSWER;
    for _ in 0..LINES_MAX {
        let raw = match line.receive(until.saturating_duration_since(Instant::now())) {
            Ok(raw) => raw,
            Err(DeviceError::Silent { .. } | DeviceError::Garbled { .. }) => return Ok(()),
            Err(error) => return Err(error),
        };
        let Ok(reply) = dialect.parse(&raw) else { continue };
        let for_another = command.answer.is_some() && reply.to.as_deref() != command.answer;
        if !for_another && suits(reply.said) {
            return Ok(());
        }
    }
    Ok(())
}

fn summary(found: &Probe) -> String {
    match found.dialect {
        Some(dialect) => format!("{} answers; FLIP's part of it: {}", dialect.name(), dialect.verified()),
        None if found.transcript.iter().any(|exchange| exchange.direction == Direction::Received) => {
            "something came, but no reading in a dialect that FLIP knows: see the transcript".to_owned()
        }
        None => "nothing came: check power, cable, port and the balance's interface menu".to_owned(),
    }
}
