//! What a command works on: the data folder of this process, or a running server.
//!
//! The operations have the names and types of [`App`]; each says beside the other how it is done
//! here and how there. A command that has no operation here stays on this computer
//! ([`super::reach`]).

mod bench;
mod jobs;
mod records;
mod weighings;

use super::server::Server;
use crate::app::App;
use flip_core::domain::FieldError;
use std::time::Duration;

/// The application of this process, or that of a server.
#[derive(Clone)]
pub(super) enum Lab {
    /// In this process.
    Here(App),
    /// Behind `--server`.
    There(Server),
}

/// How long to wait before looking again.
#[derive(Debug, Clone, Copy)]
pub(super) struct Look {
    /// At a row of this process: a read costs a fraction of a millisecond.
    pub(super) here: Duration,
    /// At a server, s: it answers earlier if what is waited for ends.
    pub(super) there_s: u32,
}

impl Lab {
    /// The application of this process.
    ///
    /// # Errors
    /// There is only a server.
    pub(super) fn here(&self) -> Result<&App, FieldError> {
        match self {
            Self::Here(app) => Ok(app),
            Self::There(_) => Err(FieldError::new("server", "cannot do this: leave --server out")),
        }
    }

    /// Whether other people's requests come to it as well.
    pub(super) fn is_shared(&self) -> bool {
        matches!(self, Self::There(_))
    }
}

impl From<&App> for Lab {
    fn from(app: &App) -> Self {
        Self::Here(app.clone())
    }
}
