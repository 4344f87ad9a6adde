//! `flip token create`, and the token that a first start prints.

use super::Common;
use super::failure::Failure;
use super::session::with_writer;
use crate::app::{App, Role};
use clap::{Subcommand, ValueEnum};
use serde::Serialize;

/// Arguments of `flip token`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Make an API token and print it; it is shown this once and stored only as a hash.
    Create {
        /// What its holder may do: read; also start and stop work; everything.
        #[arg(long, value_enum)]
        role: RoleFlag,
        /// A name to know it by.
        #[arg(long, default_value = "command line")]
        name: String,
    },
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum RoleFlag {
    Viewer,
    Operator,
    Admin,
}

/// The document of `flip token create`.
#[derive(Debug, Serialize)]
struct Document {
    token: String,
    role: Role,
    name: String,
}

/// Make a token.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let Action::Create { role, name } = &arguments.action;
    let role = Role::from(*role);
    let token = with_writer(common, async |app| Ok(app.create_token(name, role).await?))?;
    let document = Document { token, role, name: name.clone() };
    common.print(&document, || document.token.clone())
}

/// An operator's token if this data folder has none yet.
pub(super) async fn first(app: &App) -> Result<Option<String>, Failure> {
    if app.has_tokens().await? {
        return Ok(None);
    }
    Ok(Some(app.create_token("first start", Role::Operator).await?))
}

impl From<RoleFlag> for Role {
    fn from(flag: RoleFlag) -> Self {
        match flag {
            RoleFlag::Viewer => Self::Viewer,
            RoleFlag::Operator => Self::Operator,
            RoleFlag::Admin => Self::Admin,
        }
    }
}
