//! What a job's body may ask of the outside.
//!
//! A body computes from its specification and from what earlier attempts saved. It sees neither a
//! database nor a lease, so it can run wherever somebody implements [`JobHost`]: over the store
//! (`leased.rs`), or in memory for tests.

use super::calibrate::CalibrationResult;
use super::evaluate::EvaluationResult;
use super::film::FilmResult;
use super::repose::ReposeResult;
use super::spec::{CalibrationSpec, ReposeSpec};
use super::train::TrainingResult;
use flip_bench::hardware::wire::Exchange;
use flip_core::domain::conditions::Under;
use flip_core::domain::job::Progress;
use flip_core::domain::parameters::ParameterSet;
use flip_discover::report::Report;
use flip_learn::calibrate::{Probe, Trial};
use flip_learn::train::evaluate::Dose;
use flip_learn::train::{EpisodeRecord, Trained};
use flip_store::piles::Pile;
use std::collections::HashMap;
use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;

/// Why a job's body did not succeed.
#[derive(Debug, thiserror::Error)]
pub(super) enum JobError {
    /// An external cause; retrying may help.
    #[error("{0}")]
    Retry(String),
    /// It would end the same way every time.
    #[error("{0}")]
    Fail(String),
    /// What it computed on failed. Its checkpoint is kept: it can go on elsewhere.
    #[error("{0}")]
    Device(String),
    /// It was asked to stop, or has lost the right to go on; its results so far are saved.
    #[error("stopped on request")]
    Stopped,
}

pub(super) type Result<T> = std::result::Result<T, JobError>;

/// The outside of one attempt at a job.
///
/// Once another attempt at the same job has begun, every method that writes returns
/// [`JobError::Stopped`] and has written nothing. [`JobHost::put`] alone may still store a file:
/// nothing names it then.
pub(super) trait JobHost: Sync {
    /// Job id.
    fn id(&self) -> &str;

    /// Whether to continue: not after a cancellation, at a shutdown, or without the right to write.
    fn flow(&self) -> ControlFlow<()>;

    /// The calibration's trials so far, in order.
    fn trials(&self) -> Result<Vec<Trial>>;

    /// The heaps so far of an emulator that calibrations share, in order.
    fn emulator_heaps(&self, emulator: &str) -> Result<Vec<Trial>>;

    /// The simulations so far of an observable, in order.
    fn probes(&self, owner: &str) -> Result<Vec<Probe>>;

    /// The evaluation's doses so far, by key.
    fn doses(&self) -> Result<HashMap<String, Dose>>;

    /// The measurement's piles so far, in order.
    fn piles(&self) -> Result<Vec<Pile>>;

    /// The newest checkpoint.
    fn checkpoint(&self) -> Result<Checkpoint>;

    /// The bytes of a policy, if there is one of this id.
    fn policy(&self, id: &str) -> Result<Option<Vec<u8>>>;

    /// The bytes of a network that a training kept, by their policy id.
    fn kept_policy(&self, id: &str) -> Result<Option<Vec<u8>>>;

    /// A calibrated set, if there is one of this id.
    fn parameter_set(&self, id: &str) -> Result<Option<ParameterSet>>;

    /// Why the bench is latched, if it is.
    fn latch(&self) -> Result<Option<String>>;

    /// Whether the bench is held after a stop: nothing on it starts.
    fn held(&self) -> &AtomicBool;

    /// Reports progress, at most four times a second except for the last report.
    fn report(&self, progress: &Progress) -> Result<()>;

    /// The same without waiting for it: for a caller that has opened a gate and must notice a stop.
    /// Returns the error of an earlier report; while one is in progress no other is sent.
    fn report_meanwhile(&self, progress: &Progress) -> Result<()>;

    /// Saves a piece of the work: all of it or nothing.
    fn save(&self, piece: Piece<'_>) -> Result<()>;

    /// Saves bytes to resume from, in place of the last checkpoint.
    fn save_checkpoint(&self, bytes: &[u8]) -> Result<()>;

    /// Stores bytes that a later piece or the result names by the returned SHA-256.
    fn put(&self, bytes: &[u8]) -> Result<String>;

    /// Saves the result and what belongs to it, and ends the job: all of it or nothing.
    fn finish(&self, finished: &Finished<'_>) -> Result<()>;
}

/// Where to resume from.
#[derive(Debug, PartialEq)]
pub(super) enum Checkpoint {
    /// No attempt has saved one.
    None,
    /// Its bytes.
    Saved(Vec<u8>),
    /// One was saved and cannot be read any more, for this reason.
    Lost(String),
}

/// Work that is saved as it is done, so that no later attempt repeats it.
#[derive(Debug, Clone, Copy)]
pub(super) enum Piece<'a> {
    /// The next trial of the calibration, and how long it took, s.
    Trial { trial: &'a Trial, seconds: Option<f64> },
    /// The next heap of an emulator, and how long it took, s.
    EmulatorHeap { emulator: &'a str, heap: &'a Trial, seconds: Option<f64> },
    /// The next simulation of an observable.
    Probe { owner: &'a str, probe: &'a Probe },
    /// A round of a training; episodes that are already saved stay as they are.
    Episodes(&'a [EpisodeRecord]),
    /// The network that played this episode, from 1, as a policy's bytes.
    Kept { episode: u32, policy: &'a [u8] },
    /// The training starts over, for this reason.
    CheckpointLost(&'a str),
    /// A dose of the evaluation.
    Dose { key: &'a str, dose: &'a Dose },
    /// What went over the wires while a pile was made, and the pile, unless that failed.
    Pile { powder: &'a str, exchanges: &'a [Exchange], pile: Option<&'a Pile> },
}

/// A result, and what is stored with it.
#[derive(Debug, Clone, Copy)]
pub(super) enum Finished<'a> {
    /// The sets of the result become sets of the powder.
    Calibration { spec: &'a CalibrationSpec, result: &'a CalibrationResult },
    /// The trained policy becomes available.
    Training { result: &'a TrainingResult, trained: &'a Trained },
    /// For each row, the policy for which it is evidence, if any: in weighings under this version.
    Evaluation {
        result: &'a EvaluationResult,
        evidence: &'a [Option<&'a str>],
        under: Option<&'a Under>,
    },
    /// With the version of the simulator that it makes, if any.
    Investigation { report: &'a Report, version: Option<NewVersion<'a>> },
    /// A registered result becomes a measurement of the powder, with its source.
    Repose { spec: &'a ReposeSpec, result: &'a ReposeResult, source: &'a str },
    /// The file was put before.
    Film { result: &'a FilmResult },
}

/// A version of the simulator to store.
#[derive(Debug, Clone, Copy)]
pub(super) struct NewVersion<'a> {
    /// Id.
    pub id: &'a str,
    /// The version that it extends.
    pub base: &'a str,
    /// Its description, JSON.
    pub body: &'a str,
}

impl Finished<'_> {
    /// The result as JSON.
    pub fn document(&self) -> Result<String> {
        let document = match self {
            Self::Calibration { result, .. } => serde_json::to_string(result),
            Self::Training { result, .. } => serde_json::to_string(result),
            Self::Evaluation { result, .. } => serde_json::to_string(result),
            Self::Investigation { report, .. } => serde_json::to_string(report),
            Self::Repose { result, .. } => serde_json::to_string(result),
            Self::Film { result } => serde_json::to_string(result),
        };
        document.map_err(|error| JobError::Fail(error.to_string()))
    }
}

/// Continues unless the job was asked to stop or something could not be saved, in which case the
/// error is left in `unsaved`: for callbacks that can only say whether to continue.
pub(super) fn go_on(
    host: &dyn JobHost,
    saved: Result<()>,
    unsaved: &mut Option<JobError>,
) -> ControlFlow<()> {
    match saved {
        Ok(()) => host.flow(),
        Err(error) => {
            unsaved.get_or_insert(error);
            ControlFlow::Break(())
        }
    }
}
