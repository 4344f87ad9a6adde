//! MT-SICS on the balance's side.

use super::cell::Display;
use super::request::{Outcome, Request};

/// Replies to queries about itself.
const WORDS: [(&str, &str); 5] = [
    ("I1", r#"I1 A "01" "2.30" "2.20" "" """#),
    ("I2", r#"I2 A "FLIP-E223 Emulated 220.0000 g""#),
    ("I3", r#"I3 A "1.00 00.0.0.000.000""#),
    ("I4", r#"I4 A "E000000001""#),
    ("I11", r#"I11 A "FLIP-E223""#),
];

pub(super) fn understand(command: &str) -> Request {
    match command {
        "" => Request::Nothing,
        "SI" => Request::Now,
        "S" => Request::WhenStable,
        "T" => Request::Tare { at_once: false },
        "TI" => Request::Tare { at_once: true },
        "Z" => Request::Zero { at_once: false },
        "ZI" => Request::Zero { at_once: true },
        "TA" => Request::TareValue,
        "TAC" => Request::ClearTare,
        "@" => understand("I4"),
        _ => WORDS
            .iter()
            .find(|(name, _)| *name == command)
            .map_or(Request::Unknown, |(_, words)| Request::Words(words)),
    }
}

pub(super) fn say(request: Request, outcome: &Outcome) -> Option<String> {
    let name = match request {
        Request::Now | Request::WhenStable => "S",
        Request::Tare { at_once: false } => "T",
        Request::Tare { at_once: true } => "TI",
        Request::Zero { at_once: false } => "Z",
        Request::Zero { at_once: true } => "ZI",
        Request::TareValue => "TA",
        Request::ClearTare => "TAC",
        Request::Words(words) => return Some(words.to_owned()),
        Request::Unknown => return Some("ES".to_owned()),
        Request::Nothing => return None,
    };
    let status = match outcome {
        Outcome::Shows(Display::Mass { number, unit, stable }) => {
            return Some(format!("{name} {} {number:>10} {unit}", if *stable { "S" } else { "D" }));
        }
        Outcome::Tared(number, unit) => {
            return Some(format!(
                "{name} {} {number:>10} {unit}",
                if name == "TA" { "A" } else { "S" }
            ));
        }
        Outcome::Shows(Display::Overload) | Outcome::OutOfRange => "+",
        Outcome::Shows(Display::Underload) => "-",
        Outcome::Shows(Display::NotReady | Display::Adjusting) | Outcome::NotStable => "I",
        Outcome::Done { stable } if name == "ZI" => {
            return Some(format!("ZI {}", if *stable { "S" } else { "D" }));
        }
        Outcome::Done { .. } | Outcome::AsAsked => "A",
    };
    Some(format!("{name} {status}"))
}
