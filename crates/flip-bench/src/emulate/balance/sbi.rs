//! SBI on the balance's side: frames with an identification, commands without a reply.

use super::cell::Display;
use super::request::{Outcome, Request};

pub(super) fn understand(command: &str) -> Request {
    match command.strip_prefix('\u{1b}') {
        Some("P") => Request::Now,
        Some("T" | "U") => Request::Tare { at_once: false },
        Some("V") => Request::Zero { at_once: false },
        Some("x1_") => Request::Words("FLIP-E223"),
        Some("x2_") => Request::Words("0000000001"),
        Some("x3_") => Request::Words("00-00-01.00"),
        _ => Request::Nothing,
    }
}

pub(super) fn say(request: Request, outcome: &Outcome) -> Option<String> {
    let display = match (request, outcome) {
        (Request::Words(words), _) => return Some(words.to_owned()),
        (Request::Now, Outcome::Shows(display)) => display,
        _ => return None,
    };
    Some(match display {
        Display::Mass { number, unit, stable } => {
            let (sign, digits) =
                number.strip_prefix('-').map_or(('+', number.as_str()), |digits| ('-', digits));
            format!("N     {sign}{digits:>9} {:<3}", if *stable { unit } else { "" })
        }
        Display::Overload => special("High"),
        Display::Underload => special("Low"),
        Display::NotReady => special("- -"),
        Display::Adjusting => special("Cal.Int."),
    })
}

fn special(text: &str) -> String {
    format!("Stat  {:<14}", format!("    {text}"))
}
