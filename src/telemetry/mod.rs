//! Structured logs, on stderr: stdout belongs to a command's answer.
//!
//! Nobody waits for whoever reads stderr, and nothing ends because nobody does: a full or broken pipe costs lines, never a dose.

mod lines;

use lines::Lines;
use std::io::{self, IsTerminal, Write};
use std::sync::OnceLock;
use std::time::Duration;
use tracing_subscriber::EnvFilter;

/// How long the end of a process waits for its last lines.
const LAST: Duration = Duration::from_secs(1);

/// What is said on stderr from the start of the log on.
static LINES: OnceLock<Lines> = OnceLock::new();

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Format {
    /// For people; coloured on a terminal.
    #[default]
    Text,
    /// One JSON object a line, for log collectors.
    Json,
}

/// What a service shows when `FLIP_LOG` does not say.
pub const SERVICE: &str = "info,apalis=warn,sqlx=warn";
/// What a single command shows when `FLIP_LOG` does not say: its progress bars tell the rest.
pub const COMMAND: &str = "warn";

/// Starts logging; `FLIP_LOG` chooses what is shown (e.g. `flip=debug,warn`), else `default` does.
///
/// A filter that does not parse is said on stderr and replaced by the default. Panics become lines of the log. Later calls in one process do nothing,
/// so that tests may call it freely.
pub fn start(format: Format, default: &str) {
    queue();
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter(default))
        .with_writer(|| Stderr)
        .log_internal_errors(false)
        .with_ansi(io::stderr().is_terminal());
    let started = match format {
        Format::Text => subscriber.with_target(false).try_init(),
        Format::Json => subscriber.json().flatten_event(true).try_init(),
    };
    if started.is_ok() {
        // The standard hook waits for whoever reads stderr.
        std::panic::set_hook(Box::new(|panic| tracing::error!(thread = std::thread::current().name(), "{panic}")));
    }
}

/// Lines wait for a thread from now on; where the system gives none they are written by whoever has them.
fn queue() {
    let tell = |lines| tracing::warn!(lines, "lines of the log were lost: nobody took them");
    if LINES.get().is_none()
        && let Ok(lines) = Lines::to(io::stderr(), tell)
    {
        let _already_there = LINES.set(lines);
    }
}

/// Says a line on stderr, in order with those of the log; nobody who reads it is waited for.
pub fn say(line: impl std::fmt::Display) {
    // Nothing is refused.
    let _said = Stderr.write_all(format!("{line}\n").as_bytes());
}

/// Dropped where a process ends: waits a moment for lines that are not written yet.
#[derive(Debug)]
pub struct LastLines;

impl Drop for LastLines {
    fn drop(&mut self) {
        if let Some(lines) = LINES.get() {
            lines.flush(LAST);
        }
    }
}

/// Takes each line whole, and every line.
struct Stderr;

impl Write for Stderr {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        match LINES.get() {
            Some(lines) => lines.push(line),
            // Nobody to tell.
            None => drop(io::stderr().write_all(line)),
        }
        Ok(line.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

fn filter(default: &str) -> EnvFilter {
    let default = || EnvFilter::new(default);
    match std::env::var("FLIP_LOG") {
        Err(_) => default(),
        Ok(text) => EnvFilter::try_new(&text).unwrap_or_else(|error| {
            say(format_args!("FLIP_LOG is ignored: {error}"));
            default()
        }),
    }
}
