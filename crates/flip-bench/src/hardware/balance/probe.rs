//! Find out which balance is connected: request a reading in every dialect, at every usual port
//! setting, and record the replies.
//!
//! Nothing is sent that tares, zeroes, adjusts or sets anything. The order is the one in which a
//! wrong guess does least harm: words that other dialects refuse or ignore come first, escape
//! sequences after them. At a wrong baud rate a balance receives noise, which it drops. Its
//! identity is queried once the dialect is known; it need not answer.

use super::identity::maker;
use super::reply::{Condition, Said, is_standby};
use super::{Command, DEVICE, Dialect, Identity};
use crate::hardware::DeviceError;
use crate::hardware::line::{Line, Parity, Serial};
use crate::hardware::wire::{Direction, Exchange, Tap};
use serde::Serialize;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Reply timeout at factory settings, and everywhere once anything was received.
const ANSWER: Duration = Duration::from_millis(500);
/// Reply timeout at any other setting, in addition to the transmission time of the bits.
const GLANCE: Duration = Duration::from_millis(220);
/// Bits of a command and a frame, with their start, parity and stop bits.
const FRAME_BITS: u32 = 300;
/// Time limit of the whole probe, however many settings are to be tried.
const PROBE: Duration = Duration::from_secs(90);
/// Lines read after one command.
const LINES_MAX: usize = 8;

/// Order in which dialects are tried.
const ORDER: [Dialect; 4] = [Dialect::MtSics, Dialect::Ohaus, Dialect::Aandd, Dialect::Sbi];

/// Baud rates of balances, likeliest first.
const SPEEDS: [u32; 8] = [9600, 19_200, 2400, 4800, 1200, 38_400, 57_600, 115_200];
/// Data bits and parities of balances, likeliest first.
const FRAMINGS: [(u8, Parity); 4] =
    [(8, Parity::None), (7, Parity::Even), (8, Parity::Odd), (7, Parity::Odd)];

/// Result of a probe.
#[derive(Debug, Clone, Serialize)]
pub struct Probe {
    /// The dialect in which the balance returned a reading, or a reason for having none.
    pub dialect: Option<Dialect>,
    /// The identity it reported.
    pub identity: Option<Identity>,
    /// The port settings at which it answered.
    pub serial: Option<Serial>,
    /// The complete traffic, understood or not.
    pub transcript: Vec<Exchange>,
    /// Notes for the operator.
    pub notes: Vec<String>,
}

/// Usual port settings of balances, likeliest first: factory settings, then every usual baud rate
/// and framing.
pub fn usual_settings() -> Vec<Serial> {
    let others = SPEEDS
        .iter()
        .flat_map(|&baud| FRAMINGS.map(|(data_bits, parity)| Serial { baud, data_bits, parity }));
    let mut usual = Vec::new();
    for serial in Dialect::ALL.map(Dialect::factory_serial).into_iter().chain(others) {
        if !usual.contains(&serial) {
            usual.push(serial);
        }
    }
    usual
}

/// What a probe is about to try.
#[derive(Debug, Clone, Copy)]
pub struct Attempt {
    /// Number of the attempt, from 1.
    pub number: usize,
    /// Total number of attempts.
    pub of: usize,
    /// The setting it tries.
    pub serial: Serial,
}

/// Try each of these settings in each dialect until the balance answers; a TCP address is tried
/// once, whatever the settings. `progress` is called before each setting.
pub fn probe(
    port: &str,
    settings: &[Serial],
    tap: Tap,
    mut progress: impl FnMut(Attempt),
) -> Probe {
    let (tap, transcript) = recording(tap);
    let is_tcp = port.starts_with("tcp://");
    let settings = if is_tcp { &settings[..settings.len().min(1)] } else { settings };
    let mut found = Probe {
        dialect: None,
        identity: None,
        serial: None,
        transcript: Vec::new(),
        notes: Vec::new(),
    };
    let (mut tried, mut refused) = (Vec::new(), Vec::new());
    let until = Instant::now() + PROBE;
    for (k, serial) in settings.iter().enumerate() {
        if found.dialect.is_some() || Instant::now() >= until {
            break;
        }
        progress(Attempt { number: k + 1, of: settings.len(), serial: *serial });
        match probe_at(port, serial, &tap, &mut found) {
            Ok(()) => tried.push(*serial),
            Err(error @ DeviceError::Lost { .. }) if tried.is_empty() && !is_setting(&error) => {
                found.notes.push(format!("{error}: {}", error.advice()));
                return found;
            }
            Err(error) => refused.push((*serial, error)),
        }
    }
    found.transcript =
        std::mem::take(&mut *transcript.lock().unwrap_or_else(PoisonError::into_inner));
    found.notes.extend(refusals(&refused));
    found.notes.push(summary(&found, is_tcp, &tried, settings.len() - refused.len()));
    found
}

/// Whether the port exists but does not accept this setting: a pseudo-terminal has no parity, and
/// an adapter does not support every baud rate.
fn is_setting(error: &DeviceError) -> bool {
    let words = error.to_string();
    words.contains("did not apply") || words.contains("Invalid argument")
}

/// Each reason once, with the settings it applies to.
fn refusals(refused: &[(Serial, DeviceError)]) -> Vec<String> {
    let mut causes: Vec<String> = refused.iter().map(|(_, error)| error.to_string()).collect();
    causes.sort();
    causes.dedup();
    let with = |cause: &String| -> Vec<Serial> {
        refused.iter().filter(|(_, error)| error.to_string() == *cause).map(|it| it.0).collect()
    };
    causes.iter().map(|cause| format!("not tried, {}: {cause}", listed(&with(cause)))).collect()
}

/// A tap that forwards the traffic and records it.
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
    let is_factory = Dialect::ALL.map(Dialect::factory_serial).contains(serial);
    let wire = Duration::from_secs_f64(f64::from(FRAME_BITS) / f64::from(serial.baud.max(1)));
    let mut wait = if is_factory { ANSWER } else { ANSWER.min(GLANCE + wire) };
    for dialect in ORDER {
        let commands = dialect.commands();
        if weighs(&mut line, dialect, commands.immediate, &mut wait)? {
            let mut told = |commands: &[Command]| first_words(&mut line, dialect, commands);
            let (model, serial_number) = (told(commands.model)?, told(commands.serial.as_slice())?);
            let software = told(commands.software.as_slice())?;
            let maker = maker(dialect).to_owned();
            (found.dialect, found.serial) = (Some(dialect), Some(*serial));
            found.identity = Some(Identity { maker, model, serial: serial_number, software });
            return Ok(());
        }
    }
    Ok(())
}

/// The text reply to the first of these queries that gets one.
fn first_words(
    line: &mut Line,
    dialect: Dialect,
    commands: &[Command],
) -> Result<Option<String>, DeviceError> {
    for command in commands {
        let text = words(line, dialect, *command)?;
        if text.is_some() {
            return Ok(text);
        }
    }
    Ok(None)
}

/// The text reply to a query in this dialect.
fn words(
    line: &mut Line,
    dialect: Dialect,
    command: Command,
) -> Result<Option<String>, DeviceError> {
    let mut text = None;
    hear(line, dialect, command, &mut { ANSWER }, |said| {
        if let Said::Text(words) = said {
            text = Some(words).filter(|words| !words.is_empty());
        }
        text.is_some()
    })?;
    Ok(text)
}

/// Whether the reply is a reading in this dialect, or a reason for having none that no other
/// dialect words this way.
fn weighs(
    line: &mut Line,
    dialect: Dialect,
    command: Command,
    wait: &mut Duration,
) -> Result<bool, DeviceError> {
    let mut weighs = false;
    hear(line, dialect, command, wait, |said| {
        weighs = match said {
            Said::Weight(_) => true,
            Said::Condition(condition) => {
                !matches!(condition, Condition::Unknown | Condition::Standby)
            }
            Said::Done | Said::Text(_) => false,
        };
        weighs
    })?;
    Ok(weighs)
}

/// Send a command and read lines until one fits or nothing more arrives. Once anything was
/// received, later replies are waited for longer.
fn hear(
    line: &mut Line,
    dialect: Dialect,
    command: Command,
    wait: &mut Duration,
    mut suits: impl FnMut(Said) -> bool,
) -> Result<(), DeviceError> {
    line.discard_input()?;
    line.send(command.bytes)?;
    let until = Instant::now() + *wait;
    for _ in 0..LINES_MAX {
        let raw = match line.receive(until.saturating_duration_since(Instant::now())) {
            Ok(raw) => raw,
            Err(DeviceError::Silent { .. } | DeviceError::Garbled { .. }) => return Ok(()),
            Err(error) => return Err(error),
        };
        if command.is_echoed_by(&raw) {
            continue;
        }
        *wait = ANSWER;
        let Ok(reply) = dialect.parse(&raw) else { continue };
        // A refusal names no command.
        let for_another =
            command.answer.is_some() && reply.to.is_some() && reply.to.as_deref() != command.answer;
        if !for_another && suits(reply.said) {
            return Ok(());
        }
    }
    Ok(())
}

fn summary(found: &Probe, is_tcp: bool, tried: &[Serial], settings: usize) -> String {
    if let Some(dialect) = found.dialect {
        return format!("{} answers; FLIP's part of it: {}", dialect.name(), dialect.verified());
    }
    let sent: Vec<&str> =
        texts(found, Direction::Sent).map(|text| text.trim_end_matches("\\r\\n")).collect();
    let with = if is_tcp { String::new() } else { format!(" with {}", listed(tried)) };
    let left = settings - tried.len();
    let left = if left > 0 {
        format!("; {left} more were not tried, for want of time")
    } else {
        String::new()
    };
    let other = if is_tcp {
        "the port number, and how the converter's own port is set"
    } else {
        "and the balance's interface menu; another setting is tried with --baud N --data-bits N --parity NAME"
    };
    if texts(found, Direction::Received).next().is_none() {
        return format!(
            "nothing came{with}{left}: switch the balance on (it may be in standby), check the cable, {other}"
        );
    }
    if texts(found, Direction::Received).any(is_standby) {
        return format!("it is in standby{with}: switch it on and probe again");
    }
    if texts(found, Direction::Received).all(|text| sent.contains(&text)) {
        return format!(
            "nothing but our own questions came back{with}{left}: is the cable plugged into the balance, and is it on? Check {other}"
        );
    }
    format!(
        "something came{with}{left}, but no reading in a dialect that FLIP knows: see the transcript"
    )
}

fn texts(found: &Probe, direction: Direction) -> impl Iterator<Item = &str> {
    found
        .transcript
        .iter()
        .filter(move |exchange| exchange.direction == direction)
        .map(|exchange| exchange.text.as_str())
}

/// `9600, 19200 bits/s 8N1, 8O1; 2400 bits/s 7E1`: framings grouped by the baud rates they were
/// tried with.
fn listed(settings: &[Serial]) -> String {
    let mut parts: Vec<(String, Vec<String>)> = Vec::new();
    for framing in framings(settings) {
        let with = settings.iter().filter(|serial| (serial.data_bits, serial.parity) == framing);
        let mut speeds: Vec<u32> = with.map(|serial| serial.baud).collect();
        speeds.sort_unstable();
        let speeds = speeds.iter().map(u32::to_string).collect::<Vec<_>>().join(", ");
        let named = format!("{}{}1", framing.0, framing.1.letter());
        match parts.iter_mut().find(|part| part.0 == speeds) {
            Some(part) => part.1.push(named),
            None => parts.push((speeds, vec![named])),
        }
    }
    let part = |(speeds, framings): &(String, Vec<String>)| {
        format!("{speeds} bits/s {}", framings.join(", "))
    };
    parts.iter().map(part).collect::<Vec<_>>().join("; ")
}

/// Each framing once, in the order of its first setting.
fn framings(settings: &[Serial]) -> Vec<(u8, Parity)> {
    let mut framings = Vec::new();
    for framing in settings.iter().map(|serial| (serial.data_bits, serial.parity)) {
        if !framings.contains(&framing) {
            framings.push(framing);
        }
    }
    framings
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_usual_speed_is_tried_with_every_usual_framing_the_factorys_first() {
        let usual = usual_settings();
        assert_eq!(usual[0], Serial::default());
        assert_eq!(usual.len(), SPEEDS.len() * FRAMINGS.len());
        let every = "1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200 bits/s 8N1, 8O1, 7E1, 7O1";
        assert_eq!(listed(&usual), every);
        let few = [
            usual[0],
            Serial { baud: 1200, ..usual[0] },
            Serial { baud: 2400, data_bits: 7, parity: Parity::Even },
        ];
        assert_eq!(listed(&few), "1200, 9600 bits/s 8N1; 2400 bits/s 7E1");
    }
}
