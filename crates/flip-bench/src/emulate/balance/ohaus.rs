//! An Ohaus balance's commands and frames. Not verified on a device.

use super::cell::Display;
use super::request::{Outcome, Request};

pub(super) fn understand(command: &str) -> Request {
    match command {
        "" => Request::Nothing,
        "IP" | "P" => Request::Now,
        "SP" => Request::WhenStable,
        "T" => Request::Tare { at_once: false },
        "Z" => Request::Zero { at_once: false },
        "V" => Request::Words("FLIP-E223 Sr 1.00"),
        "PSN" => Request::Words("E000000001"),
        _ => Request::Unknown,
    }
}

pub(super) fn say(request: Request, outcome: &Outcome, tared: bool) -> Option<String> {
    match (request, outcome) {
        (Request::Nothing, _) => None,
        (Request::Words(words), _) => Some(words.to_owned()),
        (Request::Unknown, _) => Some("ES".to_owned()),
        (_, Outcome::Shows(display)) => Some(frame(display, tared)),
        (Request::WhenStable, _) => Some("ES".to_owned()),
        (
            Request::Tare { .. } | Request::Zero { .. },
            Outcome::Tared(..) | Outcome::Done { .. },
        ) => Some("OK!".to_owned()),
        (_, _) => None,
    }
}

fn frame(display: &Display, tared: bool) -> String {
    match display {
        Display::Mass { number, unit, stable } => {
            let (mark, legend) = (if *stable { " " } else { "?" }, if tared { " NET" } else { "" });
            format!("{number:>11} {unit} {mark}{legend}").trim_end().to_owned()
        }
        Display::Overload => "Err8.3".to_owned(),
        Display::Underload => "Err8.4".to_owned(),
        Display::NotReady | Display::Adjusting => "ES".to_owned(),
    }
}
