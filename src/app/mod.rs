//! What FLIP can do, in plain Rust. REST, gRPC, the command line and the demonstration all call this.

mod calibrations;
mod error;
mod evaluations;
mod events;
mod jobs;
mod policies;
mod powders;
mod tokens;
mod trainings;
mod weighings;

pub use crate::domain::FieldError;
pub use crate::domain::timestamp::Timestamp;
pub use crate::store::evaluations::{EvaluationRow, EvaluationSummary};
pub use crate::store::events::Event;
pub use crate::store::jobs::Job;
pub use crate::store::page::{LIST_LIMIT_MAX, Page, PageQuery, SERIES_LIMIT_MAX};
pub use crate::store::parameter_sets::CalibratedSet;
pub use crate::store::policies::{Policy, PolicyError};
pub use crate::store::powders::{Measurement, Powder};
pub use crate::store::tokens::Role;
pub use crate::store::trials::{Episode, Trial, TrialPhase};
pub use crate::store::weighings::Weighing;
pub use calibrations::{Calibration, CalibrationRequest, CalibrationResult, CalibrationSet};
pub use error::{Error, Result};
pub use evaluations::{Evaluation, EvaluationRequest, EvaluationResult};
pub use events::Topic;
pub use powders::{NewMeasurement, NewPowder, PowderDetail};
pub use trainings::{Order, Preset, Training, TrainingLevel, TrainingRequest, TrainingResult};
pub use weighings::{Target, Tolerance, WeighingDetail, WeighingRequest};

use std::path::Path;
use std::sync::Arc;

/// What an [`App`] is opened for.
#[derive(Debug, Clone)]
pub struct Options {
    /// Run queued jobs and weighings in this process.
    pub workers: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { workers: true }
    }
}

/// FLIP: one data folder, opened. Cheap to clone.
#[derive(Clone)]
pub struct App {
    _inner: Arc<()>,
}

impl App {
    /// Open a data folder for reading and writing: create, migrate and seed it when needed. One process at a time.
    ///
    /// # Errors
    /// [`OpenError::Held`] while another process has it open.
    pub async fn open(_data_dir: &Path, _options: Options) -> std::result::Result<Self, OpenError> {
        Ok(Self { _inner: Arc::new(()) })
    }

    /// Open a data folder to read it, also while `flip serve` holds it. Whatever would write answers `Unavailable`.
    pub async fn open_to_read(data_dir: &Path) -> std::result::Result<Self, OpenError> {
        Self::open(data_dir, Options { workers: false }).await
    }

    /// Stop taking work, checkpoint running jobs and put them back in the queue, stop the bench, checkpoint the
    /// write-ahead log.
    pub async fn shutdown(&self) -> Result<()> {
        Ok(())
    }

    fn stub<T>(&self) -> Result<T> {
        Err(Error::Unavailable("under construction".into()))
    }
}

/// Why a data folder cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// Another process has it open; the command line exits 2.
    #[error("{0}")]
    Held(String),
    /// Anything else.
    #[error("cannot open the data folder {path}: {cause}")]
    Failed {
        /// The folder.
        path: String,
        /// Why.
        cause: String,
    },
}
