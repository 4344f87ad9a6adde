//! `--bench`: the bench that weighs.

use super::failure::Failure;
use crate::app::{Functions, LaboratorySettings, Options};
use crate::telemetry;
use flip_bench::hardware::bench_file::BenchFile;
use flip_bench::rig::{Devices, Emulated, Rig, Simulated};
use flip_core::domain::FieldError;
use flip_core::domain::bench::BenchKind;
use flip_core::domain::spoon::{FilledBy, Spoon};
use std::path::Path;
use std::sync::Arc;

/// The chosen bench.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct BenchArguments {
    /// Bench to use: `simulated` (the simulator itself), `emulated` (devices with their real
    /// protocols around the simulator), or the file of a real bench.
    #[arg(long, value_name = "BENCH", default_value = "simulated")]
    bench: String,
    /// With `--bench emulated`: seed of a mechanism hidden in every powder, which FLIP does not know
    /// of [default: none].
    #[arg(long, value_name = "SEED")]
    emulated_hidden: Option<u64>,
}

impl BenchArguments {
    /// Whether it is a bench file.
    pub(super) fn is_file(&self) -> bool {
        !matches!(self.bench.as_str(), "simulated" | "emulated")
    }

    /// What kind of bench it is.
    pub(super) fn kind(&self) -> BenchKind {
        match self.bench.as_str() {
            "simulated" => BenchKind::Simulated,
            "emulated" => BenchKind::Emulated,
            _ => BenchKind::Devices,
        }
    }

    /// Options for an application with this bench.
    pub(super) fn options(&self) -> Result<Options, Failure> {
        if self.emulated_hidden.is_some() && self.bench != "emulated" {
            let message = format!("needs `--bench emulated`, got `--bench {}`", self.bench);
            return Err(FieldError::new("emulated_hidden", message).into());
        }
        let rig: Arc<dyn Rig> = match self.bench.as_str() {
            "simulated" => Arc::new(Simulated),
            "emulated" => Arc::new(Emulated::new(self.laboratory())),
            file => {
                let file = read("bench", Path::new(file))?;
                remind(&file);
                Arc::new(Devices::new(file))
            }
        };
        Ok(Options { functions: Functions { rig, ..Functions::default() }, ..Options::default() })
    }
}

impl BenchArguments {
    /// The emulated laboratory.
    fn laboratory(&self) -> LaboratorySettings {
        let hidden = self.emulated_hidden.unwrap_or_default();
        LaboratorySettings { hidden, ..LaboratorySettings::default() }
    }
}

/// Reminds the user of what only a person does on this bench.
fn remind(file: &BenchFile) {
    if file.spoon.filled_by == FilledBy::Hand {
        telemetry::say(
            "flip: this bench's arm does not fill its spoon: fill it by hand before each dose begins",
        );
    }
}

/// Reads the bench file at this path, given in `field`.
pub(super) fn read(field: &str, path: &Path) -> Result<BenchFile, Failure> {
    let text = std::fs::read_to_string(path).map_err(|error| {
        let kinds = if field == "bench" { "`simulated`, `emulated` or " } else { "" };
        FieldError::new(
            field,
            format!("must be {kinds}a file that can be read; {}: {error}", path.display()),
        )
    })?;
    Ok(BenchFile::parse(&text)?)
}

/// The spoon in the bench file at this path, if there is one.
pub(super) fn spoon(file: Option<&Path>) -> Result<Option<Spoon>, Failure> {
    file.map(|file| read("bench", file).map(|bench| bench.spoon)).transpose()
}
