//! `flip shakes`: what spoons let fall in the weighings of the folder and in imported files.

use super::Common;
use super::failure::Failure;
use super::measurements::read;
use super::session::{beside, with_reader};
use super::table::table;
use crate::app::{ForgottenShakes, ImportedShakes, KeptSpoonful, ShakesWanted};
use clap::Subcommand;
use flip_core::domain::bench::BenchKind;
use serde_json::json;
use std::path::PathBuf;

/// Arguments of `flip shakes`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// List spoonfuls, those of weighings first.
    List(Filter),
    /// Print shakes as a CSV file that `import` can read.
    Export(Filter),
    /// Store the spoonfuls in a CSV file, all or none.
    ///
    /// Columns: weighing; powder; pitch_deg; shake_mm, 0 where the step only changed the pitch;
    /// fell_mg, also 0 and below; sd_mg or readability_mg; optionally spoonful, step, lot, session,
    /// acceleration_m_s2, spoon_mg (before the step) and since_filled_s. A row is one step; rows of
    /// one powder, weighing and spoonful belong together. In place of fell_mg, balance_mg is the
    /// reading after the step, as in the traces of `discover`. Spoonfuls that are listed already,
    /// with the same shakes, are skipped.
    Import {
        /// CSV file, UTF-8 or UTF-16, with a header.
        file: PathBuf,
        /// Where the numbers come from; up to 500 characters.
        #[arg(long, default_value = "")]
        source: String,
        /// Register powders in the file that FLIP does not know, each under an id made from its
        /// name.
        #[arg(long)]
        create: bool,
    },
    /// Neither use nor list the shakes of a powder until now. Weighings and their traces stay.
    Forget {
        /// Powder id.
        #[arg(long, value_name = "ID")]
        powder: String,
        /// Only of this lot; without it of all lots, and of unknown ones.
        #[arg(long)]
        lot: Option<String>,
    },
}

/// Which shakes.
#[derive(Debug, clap::Args)]
struct Filter {
    /// Only of this powder.
    #[arg(long, value_name = "ID")]
    powder: Option<String>,
    /// Only of this lot.
    #[arg(long)]
    lot: Option<String>,
    /// Only of weighings on this bench, and imported ones.
    #[arg(long, value_enum)]
    bench: Option<Bench>,
}

/// A kind of bench.
#[derive(Debug, Clone, Copy, clap::ValueEnum)]
pub(super) enum Bench {
    Simulated,
    Emulated,
    Devices,
}

impl Bench {
    pub(super) fn kind(self) -> BenchKind {
        match self {
            Self::Simulated => BenchKind::Simulated,
            Self::Emulated => BenchKind::Emulated,
            Self::Devices => BenchKind::Devices,
        }
    }
}

impl Filter {
    fn wanted(&self) -> ShakesWanted {
        let bench = self.bench.map(Bench::kind);
        ShakesWanted { powder: self.powder.clone(), lot: self.lot.clone(), bench }
    }
}

/// Lists, exports, imports or forgets.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.action {
        Action::List(filter) => {
            let kept = listed(common, filter)?;
            common.print(&json!({ "items": kept }), || list(&kept))
        }
        Action::Export(filter) if common.json => {
            common.print(&json!({ "items": listed(common, filter)? }), String::new)
        }
        Action::Export(filter) => {
            let csv = with_reader(common, async |lab| Ok(lab.shakes_csv(filter.wanted()).await?))?;
            common.print(&csv, || csv.trim_end().to_owned())
        }
        Action::Import { file, source, create } => {
            let csv = read("file", file)?;
            let imported =
                beside(common, async |lab| Ok(lab.import_shakes(&csv, source, *create).await?))?;
            common.print(&imported, || imported_text(&imported))
        }
        Action::Forget { powder, lot } => {
            let forgotten =
                beside(common, async |lab| Ok(lab.forget_shakes(powder, lot.as_deref()).await?))?;
            common.print(&forgotten, || forgotten_text(&forgotten))
        }
    }
}

fn listed(common: &Common, filter: &Filter) -> Result<Vec<KeptSpoonful>, Failure> {
    with_reader(common, async |lab| Ok(lab.kept_spoonfuls(&filter.wanted()).await?))
}

fn list(kept: &[KeptSpoonful]) -> String {
    let header = ["powder", "lot", "session", "weighing", "spoonful", "steps", "fell mg", "from"];
    let row = |it: &KeptSpoonful| {
        let of = &it.spoonful;
        let known = |text: &Option<String>| text.clone().unwrap_or_else(|| "-".to_owned());
        let from = match it.bench {
            Some(BenchKind::Simulated) => "simulated bench",
            Some(BenchKind::Emulated) => "emulated bench",
            Some(BenchKind::Devices) => "devices",
            None => "import",
        };
        vec![
            of.powder.clone(),
            known(&of.lot),
            known(&of.session),
            of.weighing.clone(),
            of.spoonful.to_string(),
            of.shakes.len().to_string(),
            format!("{:.2}", of.fell_mg()),
            from.to_owned(),
        ]
    };
    table(&header, &kept.iter().map(row).collect::<Vec<_>>())
}

fn imported_text(imported: &ImportedShakes) -> String {
    let ImportedShakes { powders, named, spoonfuls, shakes, already_stored } = imported;
    let mut text = format!("{spoonfuls} spoonfuls with {shakes} shakes added");
    if !powders.is_empty() {
        text += &format!("; powders registered: {}", powders.join(", "));
    }
    if *already_stored > 0 {
        text += &format!("; {already_stored} left out, which were stored already");
    }
    for powder in named {
        text += &format!("\npowder `{}` is {}", powder.name, powder.id);
    }
    text
}

fn forgotten_text(made: &ForgottenShakes) -> String {
    let ForgottenShakes { forgotten, spoonfuls } = made;
    let lot = forgotten.lot.as_deref().map_or_else(String::new, |lot| format!(", lot {lot}"));
    format!(
        "{spoonfuls} spoonfuls of {}{lot} are forgotten: what was shaken until {} is no longer used",
        forgotten.powder, forgotten.at
    )
}
