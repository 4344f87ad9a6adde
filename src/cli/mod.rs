//! The command line: a contract that scripts rely on.
//!
//! Every command takes `--data-dir`, `--seed` and `--json`. With `--json`, stdout holds one JSON
//! document and nothing else; progress and logs go to stderr. Exit status 0: done, whatever the
//! outcome; 2: bad input, with an error that names the field or the missing prerequisite; 1:
//! failure. Commands call the same [`crate::app::App`] as REST and gRPC, in this process, so there
//! is one path to every effect; or, with `--server`, that of a running service ([`lab::Lab`]).

mod audit;
mod backup;
mod bench;
mod benches;
mod calibrate;
mod characterise;
mod compare;
mod config;
mod demo;
mod device;
mod discover;
mod doctor;
mod emulate;
mod evaluate;
mod export;
mod failure;
mod film;
mod health;
mod heap;
mod jobs;
mod lab;
mod labels;
mod manual;
mod measure;
mod measurements;
mod observe;
mod oidc;
mod parameters;
mod policy;
mod reach;
mod serve;
mod server;
mod session;
mod shakes;
mod simulator;
mod table;
mod token;
mod train;
mod validate;
mod view;
mod watch;
mod weigh;
mod weigh_list;
mod worker;

use crate::app::{ArchivedItems, FieldError, LIST_LIMIT_MAX, PageQuery, Shown, Storage};
use crate::telemetry;
use clap::{Args, CommandFactory, FromArgMatches, Parser, Subcommand};
use failure::Failure;
use serde::Serialize;
use server::{Address, Server};
use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;

/// Flowability-informed powder weighing: measure how a powder piles, calibrate a simulator, learn
/// to weigh, weigh.
#[derive(Debug, Parser)]
#[command(
    name = "flip",
    bin_name = "flip",
    version,
    after_help = "Exit status: 0 done, 2 bad input, 1 failure."
)]
struct Cli {
    #[command(flatten)]
    common: Common,
    #[command(subcommand)]
    command: Command,
}

/// The command line as its parser has it.
pub fn command() -> clap::Command {
    Cli::command()
}

/// Options of every command.
#[derive(Debug, Clone, Args)]
struct Common {
    /// Folder for the database and its files; created if missing, migrated, and seeded with the
    /// published powders.
    #[arg(long, global = true, value_name = "DIR", default_value = "flip-data")]
    data_dir: PathBuf,
    /// Database on a server of PostgreSQL 15 or newer, such as postgres://flip@db.lab/flip, instead
    /// of a file in the data folder. A password belongs in ~/.pgpass or in this variable, not on a
    /// command line that others can see.
    #[arg(
        long,
        global = true,
        value_name = "URL",
        env = "FLIP_DATABASE_URL",
        hide_env_values = true
    )]
    database_url: Option<String>,
    /// Artifacts (checkpoints, traces, films, frames) in this folder instead of the data folder, or
    /// in a bucket of S3: a path, file:///path or s3://bucket/prefix. The server of the bucket and
    /// its keys are in AWS_ENDPOINT, AWS_REGION, AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY. Every
    /// process of a database needs the same.
    #[arg(
        long,
        global = true,
        value_name = "DIR|URL",
        env = "FLIP_ARTIFACTS",
        hide_env_values = true
    )]
    artifacts: Option<String>,
    /// Seed for every random choice: the same seed gives the same result on any number of threads.
    #[arg(long, global = true, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Print one JSON document to stdout and nothing else.
    #[arg(long, global = true)]
    json: bool,
    /// Settings file with defaults for each command's options; `flip config check` shows what it
    /// sets.
    #[arg(long, global = true, value_name = "FILE", env = config::VARIABLE)]
    settings: Option<PathBuf>,
    /// Ask the running `flip serve` at this address, such as http://127.0.0.1:8080, instead of
    /// opening a data folder; with a token from FLIP_TOKEN or `--token-file`.
    #[arg(long, global = true, value_name = "URL")]
    server: Option<Address>,
    /// File with the token for `--server`; it goes before FLIP_TOKEN.
    #[arg(long, global = true, value_name = "FILE")]
    token_file: Option<PathBuf>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Serve the web page, REST and gRPC on one port until SIGTERM or Ctrl-C.
    Serve(serve::Arguments),
    /// Compute the jobs of a database on a server, on this machine, until SIGTERM or Ctrl-C.
    Worker(worker::Arguments),
    /// Go from published measurements to doses: calibrate, train, weigh, print the table, keep
    /// serving.
    Demo(demo::Arguments),
    /// Simulate experiments other than the heap: flow through a hole, spoon shakes, a drained cup,
    /// heaps of other heights
    Observe(observe::Arguments),
    /// Pour a simulated powder and measure its angle of repose.
    Heap(heap::Arguments),
    /// The old name of `flip heap`.
    #[command(hide = true)]
    Repose(heap::Arguments),
    /// Check that the simulator obeys the laws of nature.
    Validate(validate::Arguments),
    /// Find simulated powders that pile like a measured one.
    Calibrate(calibrate::Arguments),
    /// Measure a powder's angle of repose by camera, on a bench with a stand for piles.
    Measure(measure::Arguments),
    /// Import and export measurements as CSV; compare those by camera with those by hand.
    Measurements(measurements::Arguments),
    /// List, export, import and forget what spoons let fall, shake by shake.
    Shakes(shakes::Arguments),
    /// Compare two calibrations.
    Compare(compare::Arguments),
    /// Learn to weigh on simulated powders.
    Train(train::Arguments),
    /// Measure a policy's errors and those of simple controllers.
    Evaluate(evaluate::Arguments),
    /// List and export policies, and get a policy's next action.
    Policy(policy::Arguments),
    /// Find out from measured angles of repose what the simulator gets wrong, and why.
    Discover(discover::Arguments),
    /// Weigh one dose on the simulator, on emulated devices or on a real bench.
    Weigh(weigh::Arguments),
    /// Probe a powder on the bench: a few spoonfuls that show how it flows, and the powder's card.
    Characterise(characterise::Arguments),
    /// Film the grains of a weighing, or of a heap: the simulator makes them move again.
    Film(film::Arguments),
    /// Inspect the bench, probe and check its devices, clear it; time the simulator, alone or
    /// against others.
    Bench(bench::Arguments),
    /// The bench's audit trail: verify it, export it, print certificates.
    Audit(audit::Arguments),
    /// Write every list into tables that other programs read, even while a server runs.
    Export(export::Arguments),
    /// Copy the whole data folder; works while a server runs.
    Backup(backup::Arguments),
    /// Restore a data folder from a backup.
    Restore(backup::RestoreArguments),
    /// Move everything between a data folder and an empty database on a server, to go on working
    /// there; the files of the latter are in `--data-dir`.
    Migrate(backup::MigrateArguments),
    /// Run emulated devices, singly or as a whole laboratory, until Ctrl-C.
    Emulate(emulate::Arguments),
    /// List calibrations, trainings, evaluations, investigations, camera measurements and films;
    /// works while a server runs.
    Jobs(jobs::Arguments),
    /// Create, list and revoke API tokens; works while a server runs.
    Token(token::Arguments),
    /// Check whether a service is alive; for a container's health check.
    Health(health::Arguments),
    /// Check whether FLIP can run on this machine, and report what to fix.
    Doctor(doctor::Arguments),
    /// Check a settings file for `--settings`.
    Config(config::Arguments),
    /// Print shell completions for commands and options.
    Completions(manual::Completions),
    /// Write manual pages, one per command.
    Man(manual::Man),
}

/// The longest list that fits on one page.
const FIRST_PAGE: PageQuery = PageQuery {
    limit: Some(LIST_LIMIT_MAX),
    after: None,
    shown: Shown { archived: ArchivedItems::Exclude, tag: None },
};

/// Parses the arguments, runs the command, and reports the result as exit status.
pub fn main() -> ExitCode {
    let arguments: Vec<OsString> = std::env::args_os().collect();
    let asks_json = arguments.iter().any(|it| it == "--json");
    let arguments = match config::completed(arguments) {
        Ok(arguments) => arguments,
        Err(failure) => return failure.report(asks_json),
    };
    let parsed = Cli::command()
        .try_get_matches_from(arguments)
        .and_then(|typed| Ok((Cli::from_arg_matches(&typed)?, typed)));
    let (cli, typed) = match parsed {
        Ok(parsed) => parsed,
        Err(error) => return failure::of_arguments(&error),
    };
    let json = cli.common.json;
    let _last = telemetry::LastLines;
    match reach::check(&typed).and_then(|()| run(&cli)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(json),
    }
}

fn run(cli: &Cli) -> Result<(), Failure> {
    let common = &cli.common;
    // A server chooses its own log; a second start does nothing.
    if !matches!(cli.command, Command::Serve(_) | Command::Worker(_)) {
        telemetry::start(telemetry::Format::Text, telemetry::COMMAND);
    }
    match &cli.command {
        Command::Serve(arguments) => serve::run(common, arguments),
        Command::Worker(arguments) => worker::run(common, arguments),
        Command::Demo(arguments) => demo::run(common, arguments),
        Command::Observe(arguments) => observe::run(common, arguments),
        Command::Compare(arguments) => compare::run(common, arguments),
        Command::Heap(arguments) => heap::run(common, arguments),
        Command::Repose(arguments) => {
            tracing::warn!(
                "`flip repose` is now `flip heap`, as it pours a simulated heap: use that name"
            );
            heap::run(common, arguments)
        }
        Command::Validate(arguments) => validate::run(common, arguments),
        Command::Calibrate(arguments) => calibrate::run(common, arguments),
        Command::Measure(arguments) => measure::run(common, arguments),
        Command::Measurements(arguments) => measurements::run(common, arguments),
        Command::Shakes(arguments) => shakes::run(common, arguments),
        Command::Train(arguments) => train::run(common, arguments),
        Command::Evaluate(arguments) => evaluate::run(common, arguments),
        Command::Policy(arguments) => policy::run(common, arguments),
        Command::Discover(arguments) => discover::run(common, arguments),
        Command::Characterise(arguments) => characterise::run(common, arguments),
        Command::Weigh(arguments) => weigh::run(common, arguments),
        Command::Film(arguments) => film::run(common, arguments),
        Command::Bench(arguments) => bench::run(common, arguments),
        Command::Emulate(arguments) => emulate::run(common, arguments),
        Command::Audit(arguments) => audit::run(common, arguments),
        Command::Export(arguments) => export::run(common, arguments),
        Command::Backup(arguments) => backup::run(common, arguments),
        Command::Restore(arguments) => backup::run_restore(common, arguments),
        Command::Migrate(arguments) => backup::run_migrate(common, arguments),
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
    /// Where everything is stored.
    fn storage(&self) -> Result<Storage, Failure> {
        let storage = match &self.database_url {
            None => Storage::in_folder(&self.data_dir),
            Some(url) => Storage::on_server(url, &self.data_dir)
                .map_err(|error| FieldError::new("database_url", error.to_string()))?,
        };
        with_artifacts(storage, "artifacts", self.artifacts.as_deref())
    }

    /// The server to ask, if one is named.
    fn server(&self) -> Result<Option<Server>, Failure> {
        let at = |address| Server::at(address, self.token_file.as_deref());
        self.server.as_ref().map(at).transpose()
    }

    /// Prints a result on stdout: as JSON if requested, else as `text`.
    fn print(
        &self,
        document: &impl Serialize,
        text: impl FnOnce() -> String,
    ) -> Result<(), Failure> {
        use std::io::Write;
        let text = if self.json { serde_json::to_string_pretty(document)? } else { text() };
        // A reader that has seen enough (`flip … | head`) closes the pipe: that is an error, not a
        // panic.
        Ok(writeln!(std::io::stdout(), "{}", text.trim_end())?)
    }
}

/// A storage with its artifacts where an option says, if it does.
fn with_artifacts(
    storage: Storage,
    field: &'static str,
    address: Option<&str>,
) -> Result<Storage, Failure> {
    let Some(address) = address else { return Ok(storage) };
    let storage = storage.with_artifacts(address);
    storage.map_err(|error| FieldError::new(field, error.to_string()).into())
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
