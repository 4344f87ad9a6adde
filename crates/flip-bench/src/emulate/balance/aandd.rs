//! An A&D balance's commands and frames. Not verified on a device.

use super::cell::Display;
use super::request::{Outcome, Request};

pub(super) fn understand(command: &str) -> Request {
    match command {
        "" => Request::Nothing,
        "Q" | "SI" => Request::Now,
        "S" => Request::WhenStable,
        "T" => Request::Tare { at_once: false },
        "Z" | "R" => Request::Zero { at_once: false },
        "?TN" => Request::Words("TN,FLIP-E223"),
        "?SN" => Request::Words("SN,E0000001"),
        _ => Request::Unknown,
    }
}

pub(super) fn say(request: Request, outcome: &Outcome) -> Option<String> {
    match (request, outcome) {
        (Request::Words(words), _) => Some(words.to_owned()),
        (Request::Unknown, _) => Some("EC,E01".to_owned()),
        (Request::Now | Request::WhenStable, Outcome::Shows(display)) => Some(frame(display)),
        (_, Outcome::Shows(Display::NotReady | Display::Adjusting)) => Some("EC,E02".to_owned()),
        (Request::WhenStable, _) => Some("EC,E03".to_owned()),
        _ => None,
    }
}

fn frame(display: &Display) -> String {
    match display {
        Display::Mass { number, unit, stable } => {
            let (sign, digits) =
                number.strip_prefix('-').map_or(('+', number.as_str()), |digits| ('-', digits));
            format!("{},{sign}{digits:0>9}{unit:>3}", if *stable { "ST" } else { "US" })
        }
        Display::Overload => "OL,+9999999E+19".to_owned(),
        Display::Underload => "OL,-9999999E+19".to_owned(),
        Display::NotReady | Display::Adjusting => "EC,E02".to_owned(),
    }
}
