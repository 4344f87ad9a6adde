//! `flip export`: every list of a data folder, or of a server, in tables that other programs read.

use super::Common;
use super::failure::Failure;
use super::server::{Request, Server};
use super::session::{StopSignals, interrupted, runtime};
use crate::api::rest::tables::export::{ExportError, Exported, Folder, Format, Source, export};
use crate::app::App;
use crate::telemetry;
use clap::ValueEnum;
use flip_core::domain::FieldError;
use std::path::PathBuf;

/// Arguments of `flip export`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Folder to create; must not exist yet, or be empty.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Form of the tables.
    #[arg(long, value_enum, default_value_t = FormatFlag::Csv)]
    format: FormatFlag,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum FormatFlag {
    /// Text that every program reads.
    Csv,
    /// Arrow IPC files, for pandas, polars and DuckDB.
    Arrow,
}

/// Writes the tables.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let format = match arguments.format {
        FormatFlag::Csv => Format::Csv,
        FormatFlag::Arrow => Format::Arrow,
    };
    let out = &arguments.out;
    let exported = runtime()?.block_on(async {
        if let Some(address) = &common.server {
            let server = Server::at(address, common.token_file.as_deref())?;
            return written(export(There(server), out, format, told)).await;
        }
        let app = App::open_to_read(common.storage()?).await?;
        let exported = written(export(Folder::of(app.clone()), out, format, told)).await;
        app.shutdown().await?;
        exported
    })?;
    common.print(&exported, || text(&exported))
}

/// What was written, unless it is interrupted.
async fn written(
    export: impl Future<Output = Result<Exported, ExportError>>,
) -> Result<Exported, Failure> {
    let mut signals = StopSignals::catch()?;
    tokio::select! {
        exported = export => exported.map_err(failure),
        signal = signals.received() => Err(interrupted(signal)),
    }
}

fn told(file: &str) {
    telemetry::say(format_args!("{file}"));
}

/// The lists of a server.
struct There(Server);

impl Source for There {
    async fn get(&self, target: &str) -> Result<(u16, Vec<u8>), ExportError> {
        let answer = self.0.found_or_not(Request::outside(target)).await;
        let answer = answer.map_err(|error| ExportError::Broken(error.into()))?;
        Ok((answer.status, answer.body))
    }
}

fn failure(error: ExportError) -> Failure {
    match error {
        ExportError::NotEmpty(_) => {
            FieldError::new("out", format!("{error}: name a folder that does not exist")).into()
        }
        ExportError::Unwritable(..) => FieldError::new("out", error.to_string()).into(),
        other => Failure::Failed(anyhow::Error::new(other)),
    }
}

fn text(exported: &Exported) -> String {
    let rows: usize = exported.rows.values().sum();
    let mut text = format!(
        "{} holds {} tables, {rows} rows, and {} policy files; columns.json names the columns",
        exported.out.display(),
        exported.rows.len(),
        exported.policies
    );
    if !exported.lost.is_empty() {
        text += &format!("\nlost or damaged here: {}", exported.lost.join(", "));
    }
    text
}
