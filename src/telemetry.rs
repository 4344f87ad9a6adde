//! Structured logs, on stderr: stdout belongs to a command's answer.

use std::io::IsTerminal;
use tracing_subscriber::EnvFilter;

/// How log lines look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Format {
    /// For people; coloured on a terminal.
    #[default]
    Text,
    /// One JSON object a line, for log collectors.
    Json,
}

/// Starts logging; `FLIP_LOG` chooses what is shown (default `info`; e.g. `flip=debug,warn`).
///
/// A filter that does not parse is said on stderr and replaced by the default. Later calls in one process do nothing,
/// so that tests may call it freely.
pub fn start(format: Format) {
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter())
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal());
    let _already_started = match format {
        Format::Text => subscriber.with_target(false).try_init(),
        Format::Json => subscriber.json().flatten_event(true).try_init(),
    };
}

fn filter() -> EnvFilter {
    let default = || EnvFilter::new("info,apalis=warn,sqlx=warn");
    match std::env::var("FLIP_LOG") {
        Err(_) => default(),
        Ok(text) => EnvFilter::try_new(&text).unwrap_or_else(|error| {
            eprintln!("FLIP_LOG is ignored: {error}");
            default()
        }),
    }
}
