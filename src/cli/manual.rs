//! `flip completions` and `flip man`: shell completions and manual pages, generated from the
//! commands themselves.

use super::failure::Failure;
use super::{Cli, Common};
use clap::CommandFactory;
use clap_complete::Shell;
use serde::Serialize;
use std::io::Write;
use std::path::PathBuf;

/// Arguments of `flip completions`.
#[derive(Debug, clap::Args)]
pub(super) struct Completions {
    /// Shell to complete for, as in `flip completions bash > /etc/bash_completion.d/flip`.
    #[arg(value_enum, value_name = "SHELL")]
    shell: Shell,
}

/// Arguments of `flip man`.
#[derive(Debug, clap::Args)]
pub(super) struct Man {
    /// Folder for the pages, one per command, such as /usr/local/share/man/man1; created if
    /// missing.
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

#[derive(Debug, Serialize)]
struct Pages {
    folder: PathBuf,
    pages: usize,
}

/// Prints the completions of one shell.
pub(super) fn completions(arguments: &Completions) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut Cli::command(), "flip", &mut script);
    Ok(std::io::stdout().write_all(&script)?)
}

/// Writes a page for each command.
pub(super) fn man(common: &Common, arguments: &Man) -> Result<(), Failure> {
    std::fs::create_dir_all(&arguments.folder)?;
    clap_mangen::generate_to(Cli::command(), &arguments.folder)?;
    let pages = Pages {
        folder: arguments.folder.clone(),
        pages: std::fs::read_dir(&arguments.folder)?.count(),
    };
    common.print(&pages, || format!("{} pages in {}", pages.pages, pages.folder.display()))
}
