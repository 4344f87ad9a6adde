//! `flip measurements`: measurements of powders, imported from and exported to CSV files, and those
//! by camera compared with those by hand.

use super::Common;
use super::failure::Failure;
use super::session::{with_reader, with_writer};
use super::table::table;
use crate::app::{Compared, Imported, NamedPowder, table_text};
use clap::Subcommand;
use flip_core::domain::FieldError;
use std::path::{Path, PathBuf};

/// Arguments of `flip measurements`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Register the measurements in a CSV file, all or none.
    ///
    /// Columns: powder; method; repose_deg, or height_mm with base_diameter_mm and optionally
    /// funnel_height_mm; flow_time_s with poured_mass_g and orifice_mm; shake_mg with
    /// spoon_pitch_deg and shake_mm; drained_deg; pile_height_mm with base_diameter_mm and fall_mm;
    /// source. A row is one repeat, and repeats are combined; with n and the SD it is a summary.
    /// Empty cells, NA and the like are missing values. Separators are commas, semicolons or tabs;
    /// decimals take a point or a comma; a powder is given by its id or its name.
    Import {
        /// CSV file, UTF-8 or UTF-16, with a header.
        file: PathBuf,
        /// Register powders in the file that FLIP does not know, each under an id made from its
        /// name.
        #[arg(long)]
        create: bool,
    },
    /// Print all measurements as a CSV file that `import` can read.
    Export {
        /// Only this powder.
        #[arg(long, value_name = "ID")]
        powder: Option<String>,
    },
    /// Compare angles of repose by camera and by hand, for every powder measured both ways.
    Compare,
}

/// Imports, exports or compares.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.action {
        Action::Import { file, create } => {
            let csv = read("file", file)?;
            let imported = with_writer(common, async |lab| {
                Ok(lab.import_measurements(&csv, *create).await?)
            })?;
            common.print(&imported, || text(&imported))
        }
        Action::Export { powder } => {
            let powder = powder.as_deref();
            if common.json {
                let all = with_reader(common, async |lab| Ok(lab.measured(powder).await?))?;
                return common.print(&all, String::new);
            }
            let csv = with_reader(common, async |lab| Ok(lab.measured_csv(powder).await?))?;
            common.print(&csv, || csv.clone())
        }
        Action::Compare => {
            let compared = with_reader(common, async |lab| Ok(lab.compare_methods().await?))?;
            common.print(&compared, || comparison(&compared))
        }
    }
}

/// The text of the file given in `field`.
pub(super) fn read(field: &str, file: &Path) -> Result<String, Failure> {
    let unreadable =
        |error| FieldError::new(field, format!("{} cannot be read: {error}", file.display()));
    Ok(table_text(&std::fs::read(file).map_err(unreadable)?)?)
}

fn comparison(compared: &[Compared]) -> String {
    let row = |it: &Compared| {
        let error =
            it.standard_error_deg.map_or_else(|| "-".to_owned(), |error| format!("{error:.2}"));
        let angle = |of: crate::app::Flowability| {
            let sd = if of.n > 1 { format!("{:.2}", of.sd_deg) } else { "-".to_owned() };
            [format!("{:.2}", of.repose_deg), sd, of.n.to_string()]
        };
        let angles = [it.automated, it.manual].map(angle).concat();
        [vec![it.powder.clone()], angles, vec![format!("{:+.2}", it.difference_deg), error]]
            .concat()
    };
    let header = [
        "powder",
        "camera deg",
        "SD",
        "n",
        "by hand deg",
        "SD",
        "n",
        "difference deg",
        "its standard error",
    ];
    table(&header, &compared.iter().map(row).collect::<Vec<_>>())
}

fn text(imported: &Imported) -> String {
    let Imported { powders, named, measurements, observations, already_stored } = imported;
    let mut text = format!(
        "{} measurements and {} observations added",
        measurements.len(),
        observations.len()
    );
    if !powders.is_empty() {
        text += &format!("; powders registered: {}", powders.join(", "));
    }
    if *already_stored > 0 {
        text += &format!(
            "; {already_stored} left out, which were stored already with the same powder, values and source"
        );
    }
    for NamedPowder { name, id } in named {
        text += &format!("\npowder `{name}` is {id}");
    }
    text
}
