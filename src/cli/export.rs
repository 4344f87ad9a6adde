//! `flip export`: every list of a data folder in tables that other programs read.

use super::Common;
use super::failure::Failure;
use super::session::{StopSignals, interrupted, runtime};
use crate::api::rest::tables::export::{ExportError, Exported, Format, export};
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
    let exported = runtime()?.block_on(async {
        let mut signals = StopSignals::catch()?;
        let app = App::open_to_read(&common.data_dir).await?;
        let told = |file: &str| telemetry::say(format_args!("{file}"));
        let result = tokio::select! {
            result = export(app.clone(), &arguments.out, format, told) => result.map_err(failure),
            signal = signals.received() => Err(interrupted(signal)),
        };
        app.shutdown().await?;
        result
    })?;
    common.print(&exported, || text(&exported))
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
