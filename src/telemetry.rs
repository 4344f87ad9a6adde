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

/// What a service shows when `FLIP_LOG` does not say.
pub const SERVICE: &str = "info,apalis=warn,sqlx=warn";
/// What a single command shows when `FLIP_LOG` does not say: its progress bars tell the rest.
pub const COMMAND: &str = "warn";

/// Starts logging; `FLIP_LOG` chooses what is shown (e.g. `flip=debug,warn`), else `default` does.
///
/// A filter that does not parse is said on stderr and replaced by the default. Later calls in one process do nothing,
/// so that tests may call it freely.
pub fn start(format: Format, default: &str) {
    let subscriber = tracing_subscriber::fmt()
        .with_env_filter(filter(default))
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal());
    let _already_started = match format {
        Format::Text => subscriber.with_target(false).try_init(),
        Format::Json => subscriber.json().flatten_event(true).try_init(),
    };
}

fn filter(default: &str) -> EnvFilter {
    let default = || EnvFilter::new(default);
    match std::env::var("FLIP_LOG") {
        Err(_) => default(),
        Ok(text) => EnvFilter::try_new(&text).unwrap_or_else(|error| {
            eprintln!("FLIP_LOG is ignored: {error}");
            default()
        }),
    }
}
