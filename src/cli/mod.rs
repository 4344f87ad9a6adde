//! The command line: a contract that scripts rely on.
//!
//! Every command takes `--data-dir`, `--seed` and `--json`. With `--json`, stdout holds one JSON document and nothing
//! else; progress and logs go to stderr. Exit status 0: done, whatever the outcome; 2: bad input, which names the
//! field or the missing prerequisite; 1: failure. Commands call the same [`crate::app::App`] as REST and gRPC, in
//! this process, so there is one path to every effect.

mod audit;
mod backup;
mod bench;
mod benches;
mod calibrate;
mod compare;
mod config;
mod demo;
mod discover;
mod doctor;
mod emulate;
mod evaluate;
mod failure;
mod health;
mod jobs;
mod manual;
mod measure;
mod measurements;
mod observe;
mod parameters;
mod policy;
mod repose;
mod serve;
mod session;
mod simulator;
mod table;
mod token;
mod train;
mod validate;
mod view;
mod watch;
mod weigh;

use crate::app::{LIST_LIMIT_MAX, PageQuery};
use crate::telemetry;
use clap::{Args, Parser, Subcommand};
use failure::Failure;
use serde::Serialize;
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;

/// Flowability-informed powder weighing: measure how a powder piles, calibrate a simulator, learn to weigh, weigh.
#[derive(Debug, Parser)]
#[command(name = "flip", version, after_help = "Exit status: 0 done, 2 bad input, 1 failure.")]
struct Cli {
    #[command(flatten)]
    common: Common,
    #[command(subcommand)]
    command: Command,
}

/// What every command takes.
#[derive(Debug, Clone, Args)]
struct Common {
    /// Folder of the database and its files; made, migrated and seeded with the published powders when absent.
    #[arg(long, global = true, value_name = "DIR", default_value = "flip-data")]
    data_dir: PathBuf,
    /// Seed of every random choice: the same seed gives the same result on any number of threads.
    #[arg(long, global = true, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Print one JSON document on stdout and nothing else there.
    #[arg(long, global = true)]
    json: bool,
    /// Settings for what is not given here, by command; `flip config check` says what a file sets.
    #[arg(long, global = true, value_name = "FILE", env = config::VARIABLE)]
    settings: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Serve the page, REST and gRPC on one port until SIGTERM or Ctrl-C.
    Serve(serve::Arguments),
    /// From published measurements to weighed doses: calibrate, train, weigh, print the table, keep serving.
    Demo(demo::Arguments),
    /// Simulate experiments beside the heap: flow through a hole, shakes of a spoon, a drained cup, heaps of other heights
    Observe(observe::Arguments),
    /// Pour a simulated powder and measure its angle of repose.
    Repose(repose::Arguments),
    /// Check that the simulator keeps the laws of nature.
    Validate(validate::Arguments),
    /// Find simulated powders that pile like a measured one.
    Calibrate(calibrate::Arguments),
    /// Measure a powder's angle of repose by camera, on a bench with a stand for piles.
    Measure(measure::Arguments),
    /// Read measurements from a CSV file, write them to one, compare those by camera and by hand.
    Measurements(measurements::Arguments),
    /// Compare two calibrations.
    Compare(compare::Arguments),
    /// Learn to weigh on simulated powders.
    Train(train::Arguments),
    /// Measure a policy's errors beside those of simple controllers.
    Evaluate(evaluate::Arguments),
    /// List and export policies, and ask one for its next action.
    Policy(policy::Arguments),
    /// Ask measured angles of repose what the simulator gets wrong, and why.
    Discover(discover::Arguments),
    /// Weigh one dose, on the simulator, on emulated devices or on a real bench.
    Weigh(weigh::Arguments),
    /// The bench: look at it, probe and check its devices, clear it; and time the simulator, also beside others.
    Bench(bench::Arguments),
    /// The record of all that happened on the bench: verify it, export it, print certificates.
    Audit(audit::Arguments),
    /// Copy the data folder whole, also while a server runs.
    Backup(backup::Arguments),
    /// Make a data folder of a backup.
    Restore(backup::RestoreArguments),
    /// Run emulated devices, or a whole laboratory of them, until Ctrl-C.
    Emulate(emulate::Arguments),
    /// List calibrations, trainings, evaluations, investigations and measurements by camera, also while a server runs.
    Jobs(jobs::Arguments),
    /// Make, list and end API tokens, also while a server runs.
    Token(token::Arguments),
    /// Ask a service whether it is alive; a container's health check.
    Health(health::Arguments),
    /// Look whether FLIP can do its work on this machine, and say what to mend.
    Doctor(doctor::Arguments),
    /// Check a settings file, as `--settings` takes one.
    Config(config::Arguments),
    /// Print what a shell needs to complete commands and options.
    Completions(manual::Completions),
    /// Write manual pages, one for each command.
    Man(manual::Man),
}

/// As much of a list as one page holds.
const FIRST_PAGE: PageQuery = PageQuery { limit: Some(LIST_LIMIT_MAX), after: None };

/// Parse the arguments, run the command, and say how it ended by the exit status.
pub fn main() -> ExitCode {
    let arguments: Vec<OsString> = std::env::args_os().collect();
    let asks_json = arguments.iter().any(|it| it == "--json");
    let arguments = match config::completed(arguments) {
        Ok(arguments) => arguments,
        Err(failure) => return failure.report(asks_json),
    };
    let cli = match Cli::try_parse_from(arguments) {
        Ok(cli) => cli,
        Err(error) => return failure::of_arguments(&error),
    };
    let json = cli.common.json;
    let _last = telemetry::LastLines;
    match run(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(json),
    }
}

fn run(cli: &Cli) -> Result<(), Failure> {
    let common = &cli.common;
    // A server chooses its own log; a second start does nothing.
    if !matches!(cli.command, Command::Serve(_)) {
        telemetry::start(telemetry::Format::Text, telemetry::COMMAND);
    }
    match &cli.command {
        Command::Serve(arguments) => serve::run(common, arguments),
        Command::Demo(arguments) => demo::run(common, arguments),
        Command::Observe(arguments) => observe::run(common, arguments),
        Command::Compare(arguments) => compare::run(common, arguments),
        Command::Repose(arguments) => repose::run(common, arguments),
        Command::Validate(arguments) => validate::run(common, arguments),
        Command::Calibrate(arguments) => calibrate::run(common, arguments),
        Command::Measure(arguments) => measure::run(common, arguments),
        Command::Measurements(arguments) => measurements::run(common, arguments),
        Command::Train(arguments) => train::run(common, arguments),
        Command::Evaluate(arguments) => evaluate::run(common, arguments),
        Command::Policy(arguments) => policy::run(common, arguments),
        Command::Discover(arguments) => discover::run(common, arguments),
        Command::Weigh(arguments) => weigh::run(common, arguments),
        Command::Bench(arguments) => bench::run(common, arguments),
        Command::Emulate(arguments) => emulate::run(common, arguments),
        Command::Audit(arguments) => audit::run(common, arguments),
        Command::Backup(arguments) => backup::run(common, arguments),
        Command::Restore(arguments) => backup::run_restore(common, arguments),
        Command::Jobs(arguments) => jobs::run(common, arguments),
        Command::Token(arguments) => token::run(common, arguments),
        Command::Health(arguments) => health::run(common, arguments),
        Command::Doctor(arguments) => doctor::run(common, arguments),
        Command::Config(arguments) => config::run(common, arguments),
        Command::Completions(arguments) => manual::completions(arguments),
        Command::Man(arguments) => manual::man(common, arguments),
    }
}

impl Common {
    /// Print a result on stdout: as JSON when asked, else as `text`.
    fn print(&self, document: &impl Serialize, text: impl FnOnce() -> String) -> Result<(), Failure> {
        use std::io::Write;
        let text = if self.json { serde_json::to_string_pretty(document)? } else { text() };
        // A reader that has seen enough (`flip … | head`) closes the pipe: that is an error, not a panic.
        Ok(writeln!(std::io::stdout(), "{}", text.trim_end())?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_definition_of_the_command_line_is_sound() {
        Cli::command().debug_assert();
    }
}
