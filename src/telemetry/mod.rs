//! Structured logs on stderr: stdout is reserved for a command's output.
//!
//! Nothing waits for the reader of stderr, and nothing fails without one: a full or broken pipe
//! costs log lines, never a dose.

mod lines;

use lines::Lines;
use std::io::{self, IsTerminal, Write};
use std::sync::OnceLock;
use std::time::Duration;
use tracing_subscriber::EnvFilter;

/// How long an exiting process waits for its last lines to be written.
const LAST: Duration = Duration::from_secs(1);

/// Queue for everything written to stderr once logging has started.
static LINES: OnceLock<Lines> = OnceLock::new();

/// Format of log lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Format {
    /// Human-readable; coloured on a terminal.
    #[default]
    Text,
    /// One JSON object per line, for log collectors.
    Json,
}

/// Default filter of a service when `FLIP_LOG` is not set.
pub const SERVICE: &str = "info,sqlx=warn";
/// Default filter of a single command when `FLIP_LOG` is not set: its progress bars show the rest.
pub const COMMAND: &str = "warn";

/// Starts logging; `FLIP_LOG` sets the filter (e.g. `flip=debug,warn`), else `default` applies.
///
/// A filter that does not parse is reported on stderr and replaced by the default. Panics are
/// logged. Later calls in the same process do nothing, so tests may call it freely.
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
        // The standard hook blocks on the reader of stderr.
        std::panic::set_hook(Box::new(|panic| {
            tracing::error!(thread = std::thread::current().name(), "{panic}")
        }));
    }
}

/// From now on, queues lines for a writer thread; if the system cannot spawn one, the calling
/// thread writes them.
fn queue() {
    let tell = |lines| tracing::warn!(lines, "lines of the log were lost: nobody took them");
    if LINES.get().is_none()
        && let Ok(lines) = Lines::to(io::stderr(), tell)
    {
        let _already_there = LINES.set(lines);
    }
}

/// Writes a line to stderr, in order with log lines, without waiting for it to be read.
pub fn say(line: impl std::fmt::Display) {
    // This never fails.
    let _said = Stderr.write_all(format!("{line}\n").as_bytes());
}

/// Guard dropped at the end of the process: waits a moment for lines not yet written.
#[derive(Debug)]
pub struct LastLines;

impl Drop for LastLines {
    fn drop(&mut self) {
        if let Some(lines) = LINES.get() {
            lines.flush(LAST);
        }
    }
}

/// Writer that accepts every line, and each as a whole.
struct Stderr;

impl Write for Stderr {
    fn write(&mut self, line: &[u8]) -> io::Result<usize> {
        match LINES.get() {
            Some(lines) => lines.push(line),
            // There is nobody to report the error to.
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
