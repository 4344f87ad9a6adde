//! `flip bench probe`: identifies the connected balance.

use super::super::Common;
use super::super::failure::Failure;
use crate::telemetry;
use flip_bench::hardware::balance::Dialect;
use flip_bench::hardware::balance::probe::{Attempt, Probe, probe, usual_settings};
use flip_bench::hardware::line::{Parity, Serial};
use flip_bench::hardware::wire::{Direction, Exchange, Tap};
use flip_core::domain::FieldError;
use std::path::PathBuf;

/// Arguments of `flip bench probe`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Port of the balance: a path such as `/dev/ttyUSB0`, or `tcp://host:port`.
    #[arg(long, value_name = "PORT")]
    port: String,
    /// Baud rate; if given, only this setting is tried [default: 1200 to 115200 with 8N1, 7E1, 8O1
    /// and 7O1 in turn, for at most 90 s].
    #[arg(long, value_name = "N")]
    baud: Option<u32>,
    /// Data bits for `--baud`, 7 or 8.
    #[arg(long, value_name = "N", default_value_t = 8, requires = "baud")]
    data_bits: u8,
    /// Parity for `--baud`: none, odd or even.
    #[arg(long, value_name = "NAME", default_value = "none", requires = "baud", value_parser = parity)]
    parity: Parity,
    /// File for a log of the traffic, one message per line.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

fn parity(name: &str) -> Result<Parity, FieldError> {
    match name {
        "none" => Ok(Parity::None),
        "odd" => Ok(Parity::Odd),
        "even" => Ok(Parity::Even),
        _ => Err(FieldError::new("parity", format!("must be none, odd or even, got {name}"))),
    }
}

/// Queries every protocol, and prints which one answered. Nothing is tared, zeroed or set.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    if arguments.port.trim().is_empty() {
        return Err(
            FieldError::new("port", "must be a path, as /dev/ttyUSB0, or tcp://host:port").into()
        );
    }
    let settings = match arguments.baud {
        Some(baud) => vec![
            Serial { baud, data_bits: arguments.data_bits, parity: arguments.parity }.checked()?,
        ],
        None => usual_settings(),
    };
    let found =
        probe(&arguments.port, &settings, Tap::none(), |attempt| tell(&arguments.port, &attempt));
    if let Some(file) = &arguments.out {
        std::fs::write(file, transcript(&found.transcript))?;
    }
    common.print(&found, || text(&arguments.port, &found))?;
    match found.dialect {
        Some(_) => Ok(()),
        None if found.transcript.is_empty() => {
            Err(Failure::Found("the port cannot be opened".to_owned()))
        }
        None => Err(Failure::Found("no balance answered in a dialect that FLIP knows".to_owned())),
    }
}

/// Prints a line on stderr for each setting, if there are several.
fn tell(port: &str, Attempt { number, of, serial }: &Attempt) {
    if *of > 1 {
        let Serial { baud, data_bits, parity } = serial;
        telemetry::say(format_args!(
            "flip: {number} of {of}: asking {port} at {baud} bits/s {data_bits}{}1",
            parity.letter()
        ));
    }
}

/// `>` was sent to the balance, `<` was received from it.
fn transcript(exchanges: &[Exchange]) -> String {
    let line = |exchange: &Exchange| match exchange.direction {
        Direction::Sent => format!("> {}\n", exchange.text),
        Direction::Received => format!("< {}\n", exchange.text),
    };
    exchanges.iter().map(line).collect()
}

fn text(port: &str, found: &Probe) -> String {
    let mut lines = vec![format!("dialect    {}", found.dialect.map_or("unknown", Dialect::name))];
    if let Some(identity) = &found.identity {
        lines.push(format!("maker      {}", identity.maker));
        let told = [
            ("model", &identity.model),
            ("serial", &identity.serial),
            ("software", &identity.software),
        ];
        lines.extend(
            told.into_iter()
                .filter_map(|(what, it)| it.as_ref().map(|it| format!("{what:<10} {it}"))),
        );
    }
    // A TCP address has no such settings.
    if let Some(serial) = found.serial.filter(|_| !port.starts_with("tcp://")) {
        let Serial { baud, data_bits, parity } = serial;
        lines.push(
            format!("port       {baud} bits/s, {data_bits} data bits, parity {parity:?}")
                .to_lowercase(),
        );
    }
    lines.extend(found.notes.iter().map(|note| format!("note       {note}")));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_transcript_says_which_way_each_message_went() {
        let (keep, kept) = std::sync::mpsc::channel();
        let tap = Tap::new(move |exchange| keep.send(exchange).unwrap());
        tap.sent("the balance", "SI\\r\\n");
        tap.received("the balance", "S S 0.000 g");
        drop(tap);
        assert_eq!(transcript(&kept.iter().collect::<Vec<_>>()), "> SI\\r\\n\n< S S 0.000 g\n");
    }

    #[test]
    fn a_parity_is_read_by_name() {
        assert_eq!(parity("odd"), Ok(Parity::Odd));
        assert!(parity("mark").unwrap_err().message.contains("none, odd or even"));
    }
}
