//! The training job: episodes are saved round by round, and a killed training continues from its
//! last checkpoint.
//!
//! Episodes after the last checkpoint are replayed on resuming, bit for bit the same; those already
//! stored are left unchanged.

use super::context::{JobContext, JobError};
use super::evaluate::load_policy;
use super::spec::TrainingSpec;
use flip_core::domain::job::Progress;
use flip_learn::train::{EpisodeRecord, Event, Flow, Start, TrainError, Trained};
use flip_policy::{self as policy, Actor, Controller};
use flip_store as store;
use flip_store::trials::Episode;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::sync::Arc;

pub use flip_learn::train::{
    Extended, FineTuning, Level, Order, PAPER_LEVELS_DEG, Preset, Settings,
};

/// Parameter sets in a level: the paper's number. The other sets of a calibration are left for
/// weighings and evaluations.
pub const SETS_PER_LEVEL: usize = 7;
/// Number of recent episodes whose mean error is shown as progress.
const RECENT: usize = 20;

/// A training as called by jobs: [`flip_learn::train::train`] in the product, a formula in tests.
pub type Train = Arc<
    dyn Fn(
            &[Level],
            &Settings,
            Start<'_>,
            &Flow<'_>,
            &mut Listener<'_>,
        ) -> Result<Trained, TrainError>
        + Send
        + Sync,
>;
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

/// Result of a training.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct TrainingResult {
    /// Policy id.
    pub policy: String,
    /// Episodes used.
    pub episodes: u32,
    /// Mean absolute error of the last 20 episodes, mg.
    pub final_error_mg: f64,
    /// The levels it trained on, in the order met, with the episodes on each.
    #[schema(value_type = Vec<Object>)]
    pub levels: Vec<serde_json::Value>,
}

pub(super) fn perform(
    context: &JobContext,
    spec: &TrainingSpec,
    checkpoint: Option<&str>,
) -> Result<(), JobError> {
    let resume = match checkpoint {
        Some(sha256) => saved(context, sha256)?,
        None => None,
    };
    let mut recorder =
        Recorder { context, spec, round: Vec::new(), recent: VecDeque::new(), unsaved: None };
    let from = resume.is_none().then(|| predecessor(context, spec)).transpose()?.flatten();
    let start = match (&resume, &from) {
        (Some(bytes), _) => Start::Checkpoint(bytes),
        (None, Some(actor)) => Start::Policy(actor),
        (None, None) => Start::Nothing,
    };
    let trained = (context.functions.train)(
        &spec.levels,
        &spec.settings,
        start,
        &|| context.flow(),
        &mut |event| recorder.hear(event),
    );
    recorder.flush();
    match (trained, recorder.unsaved) {
        (_, Some(error)) => Err(error.into()),
        (Ok(trained), None) => finish(context, &trained),
        (Err(TrainError::Stopped { checkpoint }), None) => {
            context.checkpoint(&checkpoint)?;
            Err(JobError::Stopped)
        }
        (Err(error), None) => Err(JobError::Fail(error.to_string())),
    }
}

/// Checkpoint of the last attempt; `None` if it is missing or damaged: the training then starts
/// over, and reports that.
fn saved(context: &JobContext, sha256: &str) -> Result<Option<Vec<u8>>, JobError> {
    let lost = match context.store.artifacts().get(sha256) {
        Ok(bytes) => return Ok(Some(bytes)),
        Err(error) if error.is_lost_part() => error,
        Err(error) => return Err(error.into()),
    };
    tracing::warn!(job = context.id(), %lost, "the checkpoint is lost: the training begins again");
    let why = format!("its checkpoint is lost ({lost}): the training begins again");
    context.save(async |tx| {
        context.tell(tx, "checkpoint_lost", &serde_json::json!({ "why": why })).await?;
        Ok(false)
    })?;
    context.report(&Progress { fraction: 0.0, message: why })?;
    Ok(None)
}

/// The policy that the training continues from.
fn predecessor(context: &JobContext, spec: &TrainingSpec) -> Result<Option<Actor>, JobError> {
    let Some(from) = &spec.settings.from else { return Ok(None) };
    match load_policy(context, &from.policy)?.controller {
        Controller::Learned(actor) => Ok(Some(actor)),
        _ => Err(JobError::Fail(format!(
            "from: policy `{}` has no network to go on with",
            from.policy
        ))),
    }
}

/// Saves the events of a training.
struct Recorder<'a> {
    context: &'a JobContext,
    spec: &'a TrainingSpec,
    /// Episodes of the current round: they arrive together, and one transaction stores them.
    round: Vec<Episode>,
    recent: VecDeque<f64>,
    unsaved: Option<store::Error>,
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
            Event::Checkpoint(bytes) => {
                self.flush();
                let saved = self.context.checkpoint(&bytes);
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
        self.round.push(to_row(record));
        let settings = &self.spec.settings;
        self.round.len() >= settings.episodes_per_round as usize
            || record.index + 1 == settings.episodes
    }

    fn flush(&mut self) {
        let episodes = std::mem::take(&mut self.round);
        if episodes.is_empty() || self.unsaved.is_some() {
            return;
        }
        let context = self.context;
        let saved = context.save(async |tx| {
            let mut any_new = false;
            for episode in &episodes {
                if tx.insert_episode(context.id(), episode).await? {
                    context.tell(tx, "episode", episode).await?;
                    any_new = true;
                }
            }
            Ok(any_new)
        });
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
        let told = self.context.report(&progress);
        self.note(told);
    }

    fn note(&mut self, saved: store::Result<()>) {
        if let Err(error) = saved {
            self.unsaved.get_or_insert(error);
        }
    }
}

fn finish(context: &JobContext, trained: &Trained) -> Result<(), JobError> {
    let id = policy::id(&trained.artifact);
    let json =
        |value| serde_json::to_value(value).map_err(|error| JobError::Fail(error.to_string()));
    let levels = json(&trained.levels)?;
    let manifest = serde_json::to_string(&trained.manifest)
        .map_err(|error| JobError::Fail(error.to_string()))?;
    let result = TrainingResult {
        policy: id.clone(),
        episodes: trained.episodes,
        final_error_mg: trained.final_error_mg,
        levels: levels.as_array().cloned().unwrap_or_default(),
    };
    context.succeed(&result, async |tx| {
        let kind = trained.manifest.kind.name();
        tx.insert_policy(&id, kind, Some(context.id()), &manifest, &trained.artifact).await
    })?;
    Ok(())
}

fn to_row(record: &EpisodeRecord) -> Episode {
    let losses = record.losses.as_ref();
    Episode {
        index: record.index,
        level: record.level,
        powder: record.powder.clone(),
        parameter_set: record.parameter_set.clone(),
        target_mg: record.target_mg,
        dispensed_mg: record.dispensed_mg,
        final_error_mg: record.final_error_mg,
        reward: record.reward,
        steps: record.steps,
        alpha: losses.map(|l| l.alpha),
        critic_loss: losses.map(|l| l.critic),
        actor_loss: losses.map(|l| l.actor),
    }
}
