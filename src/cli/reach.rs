//! How far `--server` reaches: which commands and options a server has no part in, and why.
//!
//! A new command goes to a server unless it is listed here; a test runs each one to see.

use super::config::is_given;
use super::failure::Failure;
use clap::ArgMatches;
use clap::parser::ValueSource;
use flip_core::domain::FieldError;

const COMPUTES: &str = "computes on this computer";
const IS_OF_THE_FOLDER: &str = "works on a data folder: run it on the server's computer";
const IS_OF_DEVICES: &str = "speaks to devices of this computer";
const IS_OF_THE_BINARY: &str = "is about this program, not about a server";

/// Commands without a counterpart in a server.
const HERE: [(&str, &str); 22] = [
    ("serve", "is a server itself"),
    ("worker", COMPUTES),
    ("demo", "is a server itself"),
    ("observe", COMPUTES),
    ("heap", COMPUTES),
    ("repose", COMPUTES),
    ("validate", COMPUTES),
    ("policy infer", COMPUTES),
    ("bench probe", IS_OF_DEVICES),
    ("bench check", IS_OF_DEVICES),
    ("bench calibrate-shake", IS_OF_DEVICES),
    ("bench sim", COMPUTES),
    ("bench bed", COMPUTES),
    ("audit archive", IS_OF_THE_FOLDER),
    ("backup", IS_OF_THE_FOLDER),
    ("restore", IS_OF_THE_FOLDER),
    ("migrate", IS_OF_THE_FOLDER),
    ("emulate", "runs devices on this computer"),
    ("doctor", "examines this computer"),
    ("config check", "reads a file of this computer"),
    ("completions", IS_OF_THE_BINARY),
    ("man", IS_OF_THE_BINARY),
];

/// Options for which a server has something of its own.
const OWN: [(&str, &str); 7] = [
    ("data_dir", "the server has its own data folder: leave --data-dir out"),
    ("database_url", "the server has its own database: leave --database-url out"),
    ("artifacts", "the server has its own artifacts: leave --artifacts out"),
    ("bench", "the server has its own bench: leave --bench out"),
    ("emulated_hidden", "the server has its own bench: leave --emulated-hidden out"),
    ("laboratory", "the server names its own laboratory: leave --laboratory out"),
    ("listen", "--server says already where the service is: leave --listen out"),
];

/// Commands whose `--bench` is what moves; that of others is a filter, or a file with a spoon, which
/// is sent.
const MOVES: [&str; 8] = [
    "weigh",
    "characterise",
    "measure",
    "bench clear",
    "bench vial-ready",
    "bench read",
    "bench tare",
    "bench zero",
];

/// Why a command, by its words, goes to no server.
fn here(command: &str) -> Option<&'static str> {
    let is_it = |name: &str| {
        command.strip_prefix(name).is_some_and(|rest| rest.is_empty() || rest.starts_with(' '))
    };
    HERE.iter().find(|(name, _)| is_it(name)).map(|(_, why)| *why)
}

/// Why an option of a command, by its id, goes to no server.
fn own(command: &str, option: &str) -> Option<&'static str> {
    let (_, why) = OWN.iter().find(|(id, _)| *id == option)?;
    (option != "bench" || MOVES.contains(&command)).then_some(why)
}

/// Whether a setting of a file, by its long option, applies to what was typed; `asks_server` if the
/// file names a server.
pub(super) fn fits(option: &str, typed: &ArgMatches, asks_server: bool) -> bool {
    let (command, last) = called(typed);
    match option {
        "server" => here(&command).is_none() && refused(&command, last).is_empty(),
        _ if asks_server || is_given(last, "server") => {
            own(&command, &option.replace('-', "_")).is_none()
        }
        _ => true,
    }
}

/// Checks that what was typed can be asked of a server, if one is named.
///
/// # Errors
/// The command, or each option that is not the server's.
pub(super) fn check(typed: &ArgMatches) -> Result<(), Failure> {
    let (command, last) = called(typed);
    if !is_given(last, "server") {
        return Ok(());
    }
    if let Some(why) = here(&command) {
        let message = format!("`flip {command}` {why}: leave --server out");
        return Err(FieldError::new("server", message).into());
    }
    match refused(&command, last) {
        refused if refused.is_empty() => Ok(()),
        refused => Err(Failure::BadInput(refused)),
    }
}

/// What was typed and is not the server's. What the environment says of every call gives way.
fn refused(command: &str, typed: &ArgMatches) -> Vec<FieldError> {
    let is_typed =
        |id: &clap::Id| typed.value_source(id.as_str()) == Some(ValueSource::CommandLine);
    let refused = |id: &clap::Id| {
        let why = own(command, id.as_str()).filter(|_| is_typed(id))?;
        Some(FieldError::new(id.as_str(), why))
    };
    typed.ids().filter_map(refused).collect()
}

/// The words of the called command, and its arguments.
fn called(mut typed: &ArgMatches) -> (String, &ArgMatches) {
    let mut words = Vec::new();
    while let Some((name, inner)) = typed.subcommand() {
        words.push(name);
        typed = inner;
    }
    (words.join(" "), typed)
}
