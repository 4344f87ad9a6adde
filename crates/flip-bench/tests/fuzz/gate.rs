//! The gate's lines in both directions.

use crate::engine::{Seen, Target, bounded, outcome};
use flip_bench::emulate::gate::{self as emulated, Order};
use flip_bench::hardware::gate::{
    self, GateStatus, Refusal, Said, State, Why, framed, number, unframed,
};

const WORDS: &[&str] = &[
    "HELLO", "OPEN ", "CLOSE", "STATUS", "BEAT", "OK ", "HI 1 ", "ERR ", "CLOSED", "MOVING",
    "STUCK", "CHECKSUM", "OLD", " C ", " O ", " - ", " B ", "RESET", "ASKED", "BEATS", " ", "*",
    "\u{e9}",
];

pub const REPLY: Target = line("gate_reply", check_reply);
pub const REQUEST: Target = line("gate_request", check_request);

const fn line(name: &'static str, check: fn(&[u8]) -> Result<Seen, String>) -> Target {
    Target { name, check, repair: Some(repair), words: WORDS, bytes_max: 128 }
}

fn check_reply(line: &[u8]) -> Result<Seen, String> {
    let Ok(reply) = bounded(64 * line.len() + 512, || gate::parse(line))? else {
        return Ok(refused(line));
    };
    let seq = reply.seq;
    let (text, kind) = match reply.said {
        Said::Ok(status) => {
            (format!("{seq} OK {}", print(&status)?), outcome(without_digits(print(&status)?)))
        }
        Said::Hi(version, status) => {
            (format!("{seq} HI {version} {}", print(&status)?), outcome(("hi", version > 1)))
        }
        Said::Err(refusal) => (format!("{seq} ERR {}", name(refusal)), outcome(name(refusal))),
    };
    let written = framed(&text);
    if gate::parse(written.trim_end().as_bytes()) != Ok(reply) {
        return Err(format!("written as {written:?} it is not {reply:?}"));
    }
    check_flips(line, |flipped| gate::parse(flipped).is_ok())?;
    Ok(Seen::Read(kind))
}

fn check_request(line: &[u8]) -> Result<Seen, String> {
    let request = match bounded(64 * line.len() + 512, || emulated::parse(line))? {
        Ok(request) => request,
        Err(_) => return Ok(refused(line)),
    };
    let seq = request.seq;
    if seq == 0 {
        return Err("a request has number 0".to_owned());
    }
    let (words, kind) = match request.order {
        Ok(Order::Hello) => ("HELLO".to_owned(), 0),
        Ok(Order::Close) => ("CLOSE".to_owned(), 1),
        Ok(Order::Status) => ("STATUS".to_owned(), 2),
        Ok(Order::Beat) => ("BEAT".to_owned(), 3),
        Ok(Order::Open(permille)) if !(1..=1000).contains(&permille) => {
            return Err(format!("an opening of {permille} permille"));
        }
        Ok(Order::Open(permille)) => (format!("OPEN {permille}"), 4),
        Err(refusal) => ("OPEN".to_owned(), outcome(name(refusal))),
    };
    let written = framed(&format!("{seq} {words}"));
    let again = emulated::parse(written.trim_end().as_bytes());
    if request.order.is_ok() && again != Ok(request) {
        return Err(format!("written as {written:?} it is not {request:?}"));
    }
    check_flips(line, |flipped| emulated::parse(flipped).is_ok())?;
    Ok(Seen::Read(kind))
}

/// A refusal, distinguished by how far the line was parsed.
fn refused(line: &[u8]) -> Seen {
    let words = unframed(line)
        .map(|text| (text.split(' ').count(), text.split(' ').next().and_then(number).is_some()));
    Seen::Refused(outcome(words))
}

fn check_flips(line: &[u8], is_read: impl Fn(&[u8]) -> bool) -> Result<(), String> {
    for bit in 0..8 * line.len() {
        let mut flipped = line.to_vec();
        flipped[bit / 8] ^= 1 << (bit % 8);
        if is_read(&flipped) {
            return Err(format!(
                "bit {bit} was flipped and the line is read: {:?}",
                String::from_utf8_lossy(&flipped)
            ));
        }
    }
    Ok(())
}

/// Openings are not outcomes of their own.
fn without_digits(text: String) -> String {
    text.chars().filter(|c| !c.is_ascii_digit()).collect()
}

/// A state in the format of the protocol.
fn print(status: &GateStatus) -> Result<String, String> {
    let opening = status.opening_permille;
    if opening > 1000 {
        return Err(format!("an opening of {opening} permille"));
    }
    let state = match status.state {
        State::Closed => "CLOSED",
        State::Open => "OPEN",
        State::Moving => "MOVING",
        State::Stuck => "STUCK",
    };
    let stops = match (status.closed_stop, status.open_stop) {
        (true, false) => "C",
        (false, true) => "O",
        (false, false) => "-",
        (true, true) => "B",
    };
    let why = match status.closed_for {
        Some(Why::Reset) => "RESET",
        Some(Why::Asked) => "ASKED",
        Some(Why::Beats) => "BEATS",
        None => "-",
    };
    Ok(format!("{state} {opening} {stops} {why}"))
}

fn name(refusal: Refusal) -> &'static str {
    match refusal {
        Refusal::Checksum => "CHECKSUM",
        Refusal::Form => "FORM",
        Refusal::Command => "COMMAND",
        Refusal::Argument => "ARGUMENT",
        Refusal::Old => "OLD",
        Refusal::Hello => "HELLO",
    }
}

/// Appends the right checksum to the text before the last `*`.
fn repair(line: Vec<u8>) -> Vec<u8> {
    let text = line.rsplitn(2, |byte| *byte == b'*').last().unwrap_or_default();
    // A checksum covers text; other bytes stay as they are.
    match std::str::from_utf8(text) {
        Ok(text) => framed(text).trim_end().as_bytes().to_vec(),
        Err(_) => line,
    }
}
