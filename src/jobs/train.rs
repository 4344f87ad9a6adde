//! The training job: episodes are saved round by round, and a killed training continues from its
//! last checkpoint.
//!
//! Episodes after the last checkpoint are replayed on resuming, bit for bit the same; those already
//! stored are left unchanged.

use super::Functions;
use super::card;
use super::evaluate::load_policy;
use super::host::{Checkpoint, Finished, JobError, JobHost, Piece, Result};
use super::spec::TrainingSpec;
use flip_core::domain::job::Progress;
use flip_learn::train::{EpisodeRecord, Event, Flow, Start, TrainError, Trained};
use flip_policy::{self as policy, Actor, Controller};
use flip_sim::batch::Engine;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::sync::Arc;

pub use flip_learn::train::{
    Extended, FineTuning, Gradients, Level, Order, PAPER_LEVELS_DEG, Preset, Settings,
};

/// Parameter sets in a level: the paper's number. The other sets of a calibration are left for
/// weighings and evaluations.
pub const SETS_PER_LEVEL: usize = 7;
/// Number of recent episodes whose mean error is shown as progress.
const RECENT: usize = 20;

/// A training as called by jobs: [`flip_learn::train::train`] in the product, a formula in tests.
pub type Train = Arc<Learn<'static>>;
/// The function in a [`Train`].
pub type Learn<'a> = dyn Fn(
        &[Level],
        &Settings,
        Start<'_>,
        &Flow<'_>,
        &mut Listener<'_>,
    ) -> std::result::Result<Trained, TrainError>
    + Send
    + Sync
    + 'a;
/// Receives the events of a training; returns `Break` when one could not be recorded.
pub type Listener<'a> = dyn FnMut(Event) -> ControlFlow<()> + 'a;

/// The simulator's training.
#[cfg(feature = "learn")]
pub fn simulated() -> Train {
    Arc::new(|levels, settings, start, flow, listener| {
        flip_learn::train::train(levels, settings, start, flow, listener)
    })
}

/// The training of a build without libtorch.
#[cfg(not(feature = "learn"))]
pub fn simulated() -> Train {
    Arc::new(|_, _, _, _, _| Err(TrainError::Unavailable))
}

/// The simulator's training on an engine.
#[cfg(feature = "learn")]
fn beside(
    engine: &dyn Engine,
    levels: &[Level],
    settings: &Settings,
    start: Start<'_>,
    flow: &Flow<'_>,
    listener: &mut Listener<'_>,
) -> std::result::Result<Trained, TrainError> {
    flip_learn::train::train_beside(engine, levels, settings, start, flow, listener)
}

/// That of a build without libtorch.
#[cfg(not(feature = "learn"))]
fn beside(
    _: &dyn Engine,
    _: &[Level],
    _: &Settings,
    _: Start<'_>,
    _: &Flow<'_>,
    _: &mut Listener<'_>,
) -> std::result::Result<Trained, TrainError> {
    Err(TrainError::Unavailable)
}

/// Result of a training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrainingResult {
    /// Policy id.
    pub policy: String,
    /// Episodes used.
    pub episodes: u32,
    /// Mean absolute error of the last 20 episodes, mg.
    pub final_error_mg: f64,
    /// The levels it trained on, in the order met, with the episodes on each.
    pub levels: Vec<serde_json::Value>,
    /// The graphics card that simulated; absent for the processor.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub card: Option<String>,
}

pub(super) fn perform(
    host: &dyn JobHost,
    functions: &Functions,
    spec: &TrainingSpec,
) -> Result<()> {
    let resume = resumed(host)?;
    let mut recorder =
        Recorder { host, spec, round: Vec::new(), recent: VecDeque::new(), unsaved: None };
    let from = resume.is_none().then(|| predecessor(host, spec)).transpose()?.flatten();
    let start = match (&resume, &from) {
        (Some(bytes), _) => Start::Checkpoint(bytes),
        (None, Some(actor)) => Start::Policy(actor),
        (None, None) => Start::Nothing,
    };
    let card = card::engine_of(&*functions.card, spec.device)?;
    let train: &Learn<'_> = match &card {
        None => &*functions.train,
        Some(card) => &|levels, settings, start, flow, listener| {
            beside(&**card, levels, settings, start, flow, listener)
        },
    };
    let trained = train(&spec.levels, &spec.settings, start, &|| host.flow(), &mut |event| {
        recorder.hear(event)
    });
    recorder.flush();
    match (trained, recorder.unsaved) {
        (_, Some(error)) => Err(error),
        (Ok(trained), None) => {
            let begun = spec.goes_on_from.as_ref().map(|_| "a card, until it failed".to_owned());
            finish(host, &trained, card.map(|card| card.name()).or(begun))
        }
        (Err(TrainError::Stopped { checkpoint }), None) => {
            host.save_checkpoint(&checkpoint)?;
            Err(JobError::Stopped)
        }
        (Err(TrainError::Device { cause, checkpoint }), None) => {
            if let Some(checkpoint) = checkpoint {
                host.save_checkpoint(&checkpoint)?;
            }
            Err(JobError::Device(format!(
                "{cause}. Its checkpoint is kept: start it again with `device: cpu`, and it goes on from there"
            )))
        }
        (Err(error), None) => Err(JobError::Fail(error.to_string())),
    }
}

/// Checkpoint of the last attempt; `None` if it is missing or damaged: the training then starts
/// over, and reports that.
fn resumed(host: &dyn JobHost) -> Result<Option<Vec<u8>>> {
    let lost = match host.checkpoint()? {
        Checkpoint::None => return Ok(None),
        Checkpoint::Saved(bytes) => return Ok(Some(bytes)),
        Checkpoint::Lost(cause) => cause,
    };
    tracing::warn!(job = host.id(), lost, "the checkpoint is lost: the training begins again");
    let why = format!("its checkpoint is lost ({lost}): the training begins again");
    host.save(Piece::CheckpointLost(&why))?;
    host.report(&Progress { fraction: 0.0, message: why })?;
    Ok(None)
}

/// The policy that the training continues from.
fn predecessor(host: &dyn JobHost, spec: &TrainingSpec) -> Result<Option<Actor>> {
    let Some(from) = &spec.settings.from else { return Ok(None) };
    match load_policy(host, &from.policy)?.controller {
        Controller::Learned(actor) => Ok(Some(actor)),
        _ => Err(JobError::Fail(format!(
            "from: policy `{}` has no network to go on with",
            from.policy
        ))),
    }
}

/// Saves the events of a training.
struct Recorder<'a> {
    host: &'a dyn JobHost,
    spec: &'a TrainingSpec,
    /// Episodes of the current round: they arrive together, and one transaction stores them.
    round: Vec<EpisodeRecord>,
    recent: VecDeque<f64>,
    unsaved: Option<JobError>,
}

impl Recorder<'_> {
    fn hear(&mut self, event: Event) -> ControlFlow<()> {
        match event {
            Event::Episode(record) => {
                let round_is_full = self.remember(&record);
                if round_is_full {
                    self.flush();
                    self.report(&record);
                }
            }
            Event::Kept { episode, policy } => {
                let saved = self.host.save(Piece::Kept { episode, policy: &policy });
                self.note(saved);
            }
            Event::Checkpoint(bytes) => {
                self.flush();
                let saved = self.host.save_checkpoint(&bytes);
                self.note(saved);
            }
        }
        if self.unsaved.is_some() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    /// Adds an episode; returns whether the round is complete.
    fn remember(&mut self, record: &EpisodeRecord) -> bool {
        if self.recent.len() == RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back(record.final_error_mg);
        self.round.push(record.clone());
        let settings = &self.spec.settings;
        self.round.len() >= settings.episodes_per_round as usize
            || record.index + 1 == settings.episodes
    }

    fn flush(&mut self) {
        let episodes = std::mem::take(&mut self.round);
        if episodes.is_empty() || self.unsaved.is_some() {
            return;
        }
        let saved = self.host.save(Piece::Episodes(&episodes));
        self.note(saved);
    }

    fn report(&mut self, record: &EpisodeRecord) {
        let (done, all) = (record.index + 1, self.spec.settings.episodes);
        let error_mg = self.recent.iter().sum::<f64>() / self.recent.len() as f64;
        let message = format!(
            "episode {done} of {all}, level {} ({}), mean error of the last {} {error_mg:.2} mg",
            record.level + 1,
            record.powder,
            self.recent.len()
        );
        let progress = Progress { fraction: self.spec.settings.share_done(done), message };
        let told = self.host.report(&progress);
        self.note(told);
    }

    fn note(&mut self, saved: Result<()>) {
        if let Err(error) = saved {
            self.unsaved.get_or_insert(error);
        }
    }
}

fn finish(host: &dyn JobHost, trained: &Trained, card: Option<String>) -> Result<()> {
    let levels: serde_json::Result<_> = trained.levels.iter().map(serde_json::to_value).collect();
    let result = TrainingResult {
        policy: policy::id(&trained.artifact),
        episodes: trained.episodes,
        final_error_mg: trained.final_error_mg,
        levels: levels.map_err(|error| JobError::Fail(error.to_string()))?,
        card,
    };
    host.finish(&Finished::Training { result: &result, trained })
}
