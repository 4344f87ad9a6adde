//! Everything FLIP can do, in plain Rust. REST, gRPC, the command line and the demonstration all
//! call this.

mod agent;
mod archive;
mod asked;
mod asm;
mod audit_search;
mod backup;
mod balance;
mod bench;
mod bench_requests;
mod benches;
mod calibrations;
mod caller_labels;
mod campaign_csv;
pub mod certificate;
mod characterisations;
mod check;
mod checklist;
mod comparison;
mod corrections;
mod counts;
mod csv_file;
mod current_simulator;
mod device;
pub mod document;
mod dose_list;
mod error;
mod evaluations;
mod events;
mod file_powders;
mod films;
mod humidity;
mod inference;
mod investigations;
mod job_times;
mod jobs;
mod judged_shakes;
mod keyring;
mod labels;
mod long_answers;
mod measurement_csv;
mod measurements;
mod nearest;
mod node_actions;
mod oidc;
mod policies;
mod powder_card;
mod powder_names;
mod powders;
mod provable;
mod readiness;
pub mod report_html;
mod repose;
mod retry;
mod shake_csv;
mod shakes;
mod simulators;
mod steepness;
mod stored_before;
mod tokens;
mod trace_csv;
mod trainings;
mod vials;
mod webhooks;
mod weighing_search;
mod weighings;
mod workers;

pub use crate::jobs::bench::Unwritten;
pub use crate::jobs::calibrate::{
    CalibrationResult, CalibrationSet, EmulatorUse, Marginal, Method as CalibrationMethod, Pair,
    Posterior, Shortfall,
};
pub use crate::jobs::evaluate::EvaluationResult;
pub use crate::jobs::film::{FilmHead, FilmResult, HeapHead, HeapRing, StepSeen};
pub use crate::jobs::observe::{Observed, Simulated};
pub use crate::jobs::repose::ReposeResult;
pub use crate::jobs::train::{Gradients, Order, PAPER_LEVELS_DEG, Preset, TrainingResult};
pub use crate::jobs::{
    Conditions, Crew, Functions, Workers, compute_on, give_way_to_the_bench, local_cards,
    local_engine,
};
pub(crate) use agent::agent;
pub use asked::asked_after;
pub use audit_search::{AUDIT_CSV_HEADER, AuditAsked, audit_csv};
pub use backup::{BackupError, back_up, move_store, restore};
pub use balance::{BalanceReading, BalanceRequest};
pub use bench::{BenchStatus, ClearRequest, RepeatabilityRequest, ResumeRequest};
pub use benches::{ANY_BENCH, LoadRequest, check_bench_name};
pub use calibrations::{Calibration, CalibrationRequest};
pub use characterisations::CharacterisationRequest;
pub use checklist::{Checklist, NewChecklist};
pub use comparison::{ComparedCalibration, Comparison, ParameterSpread};
pub use corrections::{Correction, WithdrawalRequest};
pub use csv_file::date::DateOrder;
pub use csv_file::{TABLE_BYTES_MAX, table_text};
pub use current_simulator::{CURRENT, ChosenSimulator, CurrentSimulator};
pub use dose_list::{DoseList, DoseListRequest, ListedDose};
pub use error::{Error, Result};
pub use evaluations::{Evaluation, EvaluationRequest};
pub use events::Topic;
pub use films::{Film, FilmRequest, FilmsAsked};
pub use flip_bench::emulate::lab::Settings as LaboratorySettings;
pub use flip_bench::hardware::camera::Upload as FrameUpload;
pub use flip_bench::hardware::stand::Procedure;
pub use flip_bench::pile::{Compared, Dimensions as PileDimensions, Limits as PileLimits};
pub use flip_bench::rig::{Awaited, PileInMaking};
pub use flip_core::domain::FieldError;
pub use flip_core::domain::bench_check::Repeatability;
pub use flip_core::domain::job::{JobKind, JobState, Progress, Subject};
pub use flip_core::domain::labels::{LabelWanted, Labels};
pub use flip_core::domain::observable::Observable;
pub use flip_core::domain::powder::{Flowability, Method};
pub use flip_core::domain::timestamp::Timestamp;
pub use flip_core::domain::vial::{Vial, VialCheck};
pub use flip_core::domain::weighing::{Asked, MeasuredMass, OnOverdose, Probe};
pub use flip_discover::names;
pub use flip_discover::reading::{ColumnRead, FileRead, LeftOut, NamedPowder, TakenAs};
pub use flip_discover::report::{Report, Row, Verdict};
pub use flip_policy::{Done, Observation};
pub use flip_store::Storage;
pub use flip_store::archive::LostArchive;
pub use flip_store::archiving::Archived;
pub use flip_store::artifacts::Disagreement;
pub use flip_store::audit::{AuditChain, AuditRecord, AuditVerification};
pub use flip_store::audit_search::{AuditFound, AuditWanted};
pub use flip_store::backup::Copied;
pub use flip_store::bench::{BENCH_TOPIC, Latch};
pub use flip_store::benches::{BenchRow, DEFAULT_BENCH, Loaded};
pub use flip_store::counts::Counts;
pub use flip_store::evaluations::{EvaluationRow, EvaluationSummary};
pub use flip_store::events::Event;
pub use flip_store::holds::Held;
pub use flip_store::jobs::{Job, JobsWanted};
pub use flip_store::labels::{ArchivedItems, Label, LabelKind, Shown};
pub use flip_store::migrate::{CopyProgress, Migrated};
pub use flip_store::node_actions::{Fate, NodeAction};
pub use flip_store::observations::PowderObservation;
pub use flip_store::page::{LIST_LIMIT_MAX, Page, PageQuery, SERIES_LIMIT_MAX};
pub use flip_store::pan::Reservation;
pub use flip_store::parameter_sets::CalibratedSet;
pub use flip_store::piles::{FrameFiles, Pile};
pub use flip_store::policies::{Policy, PolicyError};
pub use flip_store::powders::{Measurement, Powder};
pub use flip_store::said::{ChangedOther, RowOf};
pub use flip_store::simulators::SimulatorVersion;
pub use flip_store::spoonfuls::{Forgotten, ShakesWanted};
pub use flip_store::stops::Stopped;
pub use flip_store::tokens::{Role, TokenEntry};
pub use flip_store::trials::{Episode, Trial, TrialPhase};
pub use flip_store::verify::ChangedRow;
pub use flip_store::webhooks::{Webhook, WebhookRow};
pub use flip_store::weighing_search::{WeighingSort, WeighingsFound, WeighingsWanted};
pub use flip_store::weighings::{Waiting, Weighing};
pub use flip_store::who::{Who, acting, correlated};
pub use flip_store::withdrawals::Withdrawn;
pub use flip_store::workers::Worker;
pub use inference::{Driver, Driving, Proposal};
pub use investigations::{
    Investigation, InvestigationRequest, predictions_csv, predictions_of_csv,
};
pub use job_times::JobTimes;
pub use judged_shakes::StoredShakes;
pub use keyring::Holder;
pub use labels::{LabelChange, Labelled, Named};
pub use measurements::{Imported, Measured, NewMeasurement, NewObservation};
pub use oidc::{BegunLogIn, LogInAnswer, Oidc, OidcSettings};
pub use powder_card::{CardOfPowder, JudgedSpoon, LotOnCard};
pub use powders::{NewPowder, PowderDetail};
pub use readiness::{Checks, Readiness};
pub use repose::{ReposeMeasurement, ReposeRequest};
pub use shakes::{ForgottenShakes, ImportedShakes, KeptSpoonful};
pub use simulators::PredictionRequest;
pub use steepness::Steepness;
pub use tokens::NewToken;
pub use trainings::{Training, TrainingLevel, TrainingRequest};
pub use vials::{ReservationRequest, VialReadyRequest};
pub use webhooks::NewWebhook;
pub use weighing_search::WeighingsAsked;
pub use weighings::{IN_PORTIONS, Target, Tolerance, WeighingDetail, WeighingRequest};
pub use workers::Hired;

use crate::jobs::Jobs;
use flip_policy::{Shipped, all_shipped};
use flip_store::{self as store, Store};
use keyring::Keyring;
use readiness::LastLook;
use std::sync::Arc;

/// Options for opening an [`App`].
#[derive(Clone)]
pub struct Options {
    /// How jobs and weighings are carried out.
    pub workers: Workers,
    /// The functions that jobs and weighings compute with; tests use formulas here.
    pub functions: Functions,
    /// Name of the laboratory, as certificates have it.
    pub laboratory: Option<String>,
    /// Provider that people can log in with, if there is one.
    pub oidc: Option<Oidc>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            workers: Workers::Equal,
            functions: Functions::default(),
            laboratory: None,
            oidc: None,
        }
    }
}

impl Options {
    /// For queries and changes, while another process computes and weighs.
    pub fn without_workers() -> Self {
        Self { workers: Workers::None, ..Self::default() }
    }
}

impl std::fmt::Debug for Options {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Options").field("workers", &self.workers).finish_non_exhaustive()
    }
}

/// FLIP: an open data folder. Cheap to clone.
#[derive(Clone)]
pub struct App {
    inner: Arc<Inner>,
}

struct Inner {
    store: Store,
    /// `None` if opened read-only.
    jobs: Option<Jobs>,
    keyring: Arc<Keyring>,
    oidc: Option<Oidc>,
    /// Result of the last readiness check.
    readiness: LastLook,
    laboratory: Option<String>,
    installation: String,
}

impl App {
    /// Opens a data folder, or the database on a server, for reading and writing; creates, migrates
    /// and seeds it when needed. One process at a time.
    ///
    /// # Errors
    /// [`OpenError::Held`] while another process has it open.
    pub async fn open(
        storage: impl Into<Storage>,
        options: Options,
    ) -> std::result::Result<Self, OpenError> {
        let storage = storage.into();
        let failed = |error| OpenError::of(&storage, error);
        let store = Store::open(&storage).await.map_err(failed)?;
        store_shipped_policies(&store).await.map_err(failed)?;
        let jobs =
            Jobs::start(store.clone(), options.functions, options.workers).await.map_err(failed)?;
        Self::of(store, Some(jobs), options.laboratory, options.oidc).await.map_err(failed)
    }

    /// Opens what is stored for reading, even while `flip serve` holds it. Anything that would write
    /// returns `Unavailable`.
    ///
    /// What no process holds is opened for writing without workers instead, so that a new folder is
    /// migrated.
    ///
    /// # Errors
    /// [`OpenError::Failed`]
    pub async fn open_to_read(storage: impl Into<Storage>) -> std::result::Result<Self, OpenError> {
        let storage = storage.into();
        match Self::open_if_free(&storage).await? {
            Some(opened) => Ok(opened),
            None => Self::without_jobs(&storage, Store::open_to_read(&storage).await).await,
        }
    }

    /// Opens what is stored read-only and changes nothing, not even an older schema, after the
    /// checks that a start performs. None if nothing is there yet.
    ///
    /// # Errors
    /// [`OpenError::Failed`]
    pub async fn look_into(
        storage: impl Into<Storage>,
    ) -> std::result::Result<Option<Self>, OpenError> {
        let storage = storage.into();
        match Store::examine(&storage).await.transpose() {
            Some(store) => Ok(Some(Self::without_jobs(&storage, store).await?)),
            None => Ok(None),
        }
    }

    /// Opens what is stored for changes that affect no bench and no job, such as to tokens, even
    /// while `flip serve` holds it: its records and ours form one chain, because each is written in
    /// a transaction that waits for the other.
    ///
    /// What no process holds is opened without workers instead, so that a new folder is migrated.
    ///
    /// # Errors
    /// [`OpenError::Failed`]
    pub async fn open_beside(storage: impl Into<Storage>) -> std::result::Result<Self, OpenError> {
        let storage = storage.into();
        match Self::open_if_free(&storage).await? {
            Some(opened) => Ok(opened),
            None => Self::without_jobs(&storage, Store::open_beside(&storage).await).await,
        }
    }

    /// Opens it without workers unless another process holds it, or need not be kept from it: a
    /// server's database that is there waits for nobody.
    async fn open_if_free(storage: &Storage) -> std::result::Result<Option<Self>, OpenError> {
        if storage.is_served_ready().await.map_err(|error| OpenError::of(storage, error))? {
            return Ok(None);
        }
        match Self::open(storage, Options::without_workers()).await {
            Err(OpenError::Held(_)) => Ok(None),
            opened => opened.map(Some),
        }
    }

    async fn without_jobs(
        storage: &Storage,
        store: store::Result<Store>,
    ) -> std::result::Result<Self, OpenError> {
        let failed = |error| OpenError::of(storage, error);
        Self::of(store.map_err(failed)?, None, None, None).await.map_err(failed)
    }

    async fn of(
        store: Store,
        jobs: Option<Jobs>,
        laboratory: Option<String>,
        oidc: Option<Oidc>,
    ) -> store::Result<Self> {
        let keyring = Arc::new(Keyring::of(&store).await?);
        let installation = store.installation().await?;
        let readiness = LastLook::default();
        let inner = Inner { store, jobs, keyring, oidc, readiness, laboratory, installation };
        let app = Self { inner: Arc::new(inner) };
        app.keep_answering();
        Ok(app)
    }

    /// Stops the bench and levels the spoon, lets running jobs save a checkpoint and return to the
    /// queue, ends every event stream, and moves the write-ahead log into the database.
    pub async fn shutdown(&self) -> Result<()> {
        if let Some(jobs) = &self.inner.jobs {
            jobs.shutdown().await;
        }
        self.note_uses().await;
        self.inner.store.close().await;
        Ok(())
    }

    fn laboratory(&self) -> Option<&str> {
        self.inner.laboratory.as_deref()
    }

    fn store(&self) -> &Store {
        &self.inner.store
    }

    fn jobs_or_refuse(&self) -> Result<&Jobs> {
        self.inner.jobs.as_ref().ok_or_else(|| store::Error::ReadOnly.into())
    }
}

/// A weighing needs a policy before any has been trained.
async fn store_shipped_policies(store: &Store) -> store::Result<()> {
    let mut tx = store.write().await?;
    // Lists begin with the newest: the default.
    for Shipped { id, policy, bytes } in all_shipped().into_iter().rev() {
        let manifest = serde_json::to_string(&policy.manifest);
        let manifest = manifest.map_err(|error| store::Error::Corrupt(error.to_string()))?;
        tx.insert_policy(id, policy.manifest.kind.name(), None, &manifest, bytes).await?;
    }
    tx.commit().await
}

/// Why what is stored cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// Another process has it open; the command line exits 2.
    #[error("{0}")]
    Held(String),
    /// Anything else.
    #[error("cannot open {what}: {cause}")]
    Failed {
        /// The data folder, or the database on a server.
        what: String,
        /// Why.
        cause: String,
    },
}

impl OpenError {
    fn of(storage: &Storage, error: store::Error) -> Self {
        let kind = if storage.is_on_server() { "database" } else { "data folder" };
        match error {
            store::Error::Held(_) | store::Error::Served { .. } => Self::Held(error.to_string()),
            other => {
                Self::Failed { what: format!("the {kind} {storage}"), cause: other.to_string() }
            }
        }
    }
}
