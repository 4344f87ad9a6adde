//! The training loop.

use super::checkpoint;
use super::collect::{Round, Rounds, SideBySide, remembered};
use super::curriculum::Curriculum;
use super::environment::{Filling, Played, simulated};
use super::plan::{Planned, ordered, plan, stream};
use super::record::{
    EpisodeRecord, Event, Flow, KEPT, Level, Losses, RANDOMISED, Start, TrainError, Trained,
};
use super::replay::Replay;
use super::sac::Learner;
use super::settings::{Order, SURROGATE_EPISODES, Settings};
use super::spoons::Spoons;
use super::updates::Updating;
use flip_core::domain::FieldError;
use flip_core::domain::seed::derive;
use flip_policy::{Actor, Controller, LevelManifest, Manifest, Policy, SetManifest};
use flip_sim::batch::{Engine, Failed};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::ops::ControlFlow;

/// Trains a policy in the simulator.
///
/// `on_event` is called with every episode and checkpoint; if it returns `Break`, the training
/// stops with a checkpoint. If `flow` returns `Break`, it stops sooner: running episodes are played
/// to their end, and their round is dropped and played again on resumption. Resuming from a
/// checkpoint gives the same result, bit for bit, as an uninterrupted run.
///
/// # Errors
/// [`TrainError`].
pub fn train(
    levels: &[Level],
    settings: &Settings,
    start: Start<'_>,
    flow: &Flow<'_>,
    on_event: impl FnMut(Event) -> ControlFlow<()>,
) -> Result<Trained, TrainError> {
    train_on(&simulated(settings), levels, settings, start, flow, on_event)
}

/// [`train`] with the simulated doses of each round side by side on an engine, and with updates on it
/// where gradients are our own and it has something for the network. On one device and driver the same
/// inputs give the same bytes; on [`flip_sim::batch::Cores`] they are those of [`train`]. Where updates
/// are made changes no byte.
///
/// # Errors
/// [`TrainError`]; [`TrainError::Device`] if the engine fails.
pub fn train_beside(
    engine: &dyn Engine,
    levels: &[Level],
    settings: &Settings,
    start: Start<'_>,
    flow: &Flow<'_>,
    on_event: impl FnMut(Event) -> ControlFlow<()>,
) -> Result<Trained, TrainError> {
    let settings = &settings.clone().checked()?;
    let spoons = Spoons::new(simulated(settings), derive(settings.seed, &[stream::SPOONS]));
    let begun = SideBySide::new(engine, spoons, settings)
        .and_then(|rounds| Ok((rounds, Updating::on(engine, settings)?)));
    // Without room nothing has begun: what there was to resume from still is.
    let untouched = match start {
        Start::Checkpoint(bytes) => Some(bytes.to_vec()),
        Start::Nothing | Start::Policy(_) => None,
    };
    let (rounds, updating) =
        begun.map_err(|Failed(cause)| TrainError::Device { cause, checkpoint: untouched })?;
    learn((&rounds, updating), levels, settings, start, flow, on_event)
}

/// The mutable state of a training, as stored in a checkpoint.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct State {
    pub learner: Learner,
    pub replay: Replay,
    pub curriculum: Curriculum,
    pub progress: Progress,
}

/// Counters of a training.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Progress {
    pub rounds: u32,
    pub episodes: u32,
    /// Simulator steps since the warm-up.
    pub learning_steps: u64,
    /// Surrogate steps since the warm-up.
    pub surrogate_steps: u64,
    pub updates: u64,
    /// Errors of the last 20 episodes, mg.
    pub recent: VecDeque<f64>,
    /// Episodes by level.
    pub on_level: Vec<u32>,
}

/// A round that was played and learned from.
struct Rounded {
    /// [`Event::Kept`] of its episodes.
    kept: Vec<Event>,
    records: Vec<EpisodeRecord>,
}

/// Number of episodes in the final error.
const RECENT: usize = 20;

/// [`train`] on any kind of spoon.
///
/// # Errors
/// [`TrainError`].
pub fn train_on<F: Filling>(
    filling: &F,
    levels: &[Level],
    settings: &Settings,
    start: Start<'_>,
    flow: &Flow<'_>,
    on_event: impl FnMut(Event) -> ControlFlow<()>,
) -> Result<Trained, TrainError> {
    let spoons = Spoons::new(filling, derive(settings.seed, &[stream::SPOONS]));
    learn((&spoons, Updating::on_cores()), levels, settings, start, flow, on_event)
}

/// A training whose rounds are played by `rounds`, and learned from by `updating`.
fn learn(
    (rounds, mut updating): (&impl Rounds, Updating),
    levels: &[Level],
    settings: &Settings,
    start: Start<'_>,
    flow: &Flow<'_>,
    mut on_event: impl FnMut(Event) -> ControlFlow<()>,
) -> Result<Trained, TrainError> {
    let settings = &settings.clone().checked()?;
    let levels = &ordered(levels, settings)?;
    let mut state = match start {
        Start::Checkpoint(bytes) => {
            checkpoint::decode(bytes, levels, settings).map_err(TrainError::Checkpoint)?
        }
        Start::Nothing => State::new(levels, settings),
        Start::Policy(actor) => State::new(levels, settings).going_on_from(actor, settings)?,
    };
    while state.progress.episodes < settings.episodes {
        let by = (rounds, &mut updating);
        let Some(Rounded { kept, records }) = state.round(levels, settings, by, flow)? else {
            return Err(TrainError::Stopped {
                checkpoint: checkpoint::encode(&state, levels, settings),
            });
        };
        let mut stop = false;
        // Before the checkpoint: a training that resumes from it does not play these again.
        for event in kept {
            stop |= on_event(event).is_break();
        }
        for record in records {
            stop |= on_event(Event::Episode(Box::new(record))).is_break();
        }
        if state.progress.rounds.is_multiple_of(rounds_per_checkpoint(&state.progress, settings)) {
            stop |= on_event(Event::Checkpoint(checkpoint::encode(&state, levels, settings)))
                .is_break();
        }
        if state.progress.episodes == settings.episodes {
            break;
        }
        if stop {
            return Err(TrainError::Stopped {
                checkpoint: checkpoint::encode(&state, levels, settings),
            });
        }
        // The round was learned from to its end on the cores.
        if let Some(Failed(cause)) = updating.failed() {
            return Err(TrainError::Device {
                cause: cause.clone(),
                checkpoint: Some(checkpoint::encode(&state, levels, settings)),
            });
        }
    }
    state.finish(levels, settings)
}

/// Rounds between checkpoints at this point of the training: surrogate rounds take almost no time.
fn rounds_per_checkpoint(progress: &Progress, settings: &Settings) -> u32 {
    let on_surrogate = progress.episodes < settings.surrogate_episodes;
    settings.rounds_per_checkpoint.saturating_mul(if on_surrogate { SURROGATE_EPISODES } else { 1 })
}

impl State {
    fn new(levels: &[Level], settings: &Settings) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(derive(settings.seed, &[stream::INITIALISE]));
        let count = levels.len().max(1) as u32;
        // A random order has no level to advance from.
        let steps =
            if matches!(settings.order, Order::Curriculum | Order::Reverse) { count } else { 1 };
        let first = if settings.surrogate_episodes > 0 {
            settings.surrogate_episodes
        } else {
            settings.episodes
        };
        Self {
            learner: Learner::new(settings, &mut rng),
            replay: Replay::new(settings),
            curriculum: Curriculum::new(
                steps,
                &settings.curriculum,
                settings.level_episodes_max(first, count),
            ),
            progress: Progress { on_level: vec![0; count as usize], ..Progress::default() },
        }
    }

    /// Replaces the initial policy with a trained one.
    fn going_on_from(mut self, actor: &Actor, settings: &Settings) -> Result<Self, FieldError> {
        if actor.kind() != settings.policy_kind() {
            let advice =
                "is a policy of another network than this training's: take one of the same preset";
            return Err(FieldError::new("from", advice));
        }
        self.learner.take(actor.to_flat());
        Ok(self)
    }

    /// Plays a round, learns from it, and reports its episodes; None, with nothing changed, if
    /// `flow` requested a stop.
    fn round(
        &mut self,
        levels: &[Level],
        settings: &Settings,
        (rounds, updating): (&impl Rounds, &mut Updating),
        flow: &Flow<'_>,
    ) -> Result<Option<Rounded>, TrainError> {
        let first = self.progress.episodes;
        // A round is never split between the surrogate and the simulator.
        let on_surrogate = first < settings.surrogate_episodes;
        let end = if on_surrogate { settings.surrogate_episodes } else { settings.episodes };
        let count = settings.episodes_per_round.min(end - first);
        let planned = (first..first + count)
            .map(|index| plan(index, self.curriculum.level(), levels, settings))
            .collect();
        let diverged = TrainError::Diverged { episodes: first };
        let actor = self.learner.snapshot(settings).ok_or(diverged)?;
        let learns = first >= settings.warmup_episodes;
        let is_kept = |n: &u32| (first + 1..=first + count).contains(n) && *n < settings.episodes;
        let network = |episode| Event::Kept {
            episode,
            policy: flip_policy::encode(&self.policy(actor.clone(), levels, settings)),
        };
        let kept = KEPT.into_iter().filter(is_kept).map(network).collect();
        let round = Round { planned, actor: learns.then_some(&actor), settings };
        let played = rounds.play(round, flow).map_err(|Failed(cause)| TrainError::Device {
            cause,
            checkpoint: Some(checkpoint::encode(self, levels, settings)),
        })?;
        let Some(played) = played else {
            return Ok(None);
        };
        for (plan, played) in &played {
            self.replay.push(remembered(plan, played, &actor, settings));
            self.count(plan, played);
            let steps = if on_surrogate {
                &mut self.progress.surrogate_steps
            } else {
                &mut self.progress.learning_steps
            };
            *steps += if learns { played.steps.len() as u64 } else { 0 };
        }
        self.progress.rounds += 1;
        let losses = self.learn(settings, updating);
        let left = settings.episodes - self.progress.episodes;
        if on_surrogate && left > 0 && self.progress.episodes == settings.surrogate_episodes {
            // Surrogate steps would dominate every batch, and the simulator behaves differently.
            self.replay = Replay::new(settings);
            let count = self.progress.on_level.len() as u32;
            self.curriculum.begin_again(settings.level_episodes_max(left, count));
        }
        let records =
            played.iter().map(|(plan, played)| record(plan, played, levels, losses)).collect();
        Ok(Some(Rounded { kept, records }))
    }

    fn count(&mut self, plan: &Planned, played: &Played) {
        let error_mg = (played.target_mg - played.dispensed_mg).abs();
        self.progress.episodes += 1;
        if plan.randomised {
            self.curriculum.pass();
        } else {
            // In a random order every episode belongs to the curriculum's only level.
            self.curriculum.record(plan.level, error_mg);
            self.progress.on_level[plan.level as usize] += 1;
        }
        if self.progress.recent.len() == RECENT {
            self.progress.recent.pop_front();
        }
        self.progress.recent.push_back(error_mg);
    }

    /// Makes the updates that are due; returns the mean of their losses.
    fn learn(&mut self, settings: &Settings, updating: &mut Updating) -> Option<Losses> {
        let due = settings.updates_per_step * self.progress.learning_steps as f64
            + settings.surrogate_updates_per_step * self.progress.surrogate_steps as f64;
        let made = self.progress.updates;
        let all = made.max(due.floor() as u64);
        let sum = updating.make(made..all, &mut self.learner, &self.replay, settings);
        self.progress.updates = all;
        let n = (all - made) as f64;
        let mean = Losses {
            critic: sum.critic / n,
            actor: sum.actor / n,
            entropy: sum.entropy / n,
            alpha: sum.alpha / n,
        };
        (all > made).then_some(mean)
    }

    /// This network as a policy, with its origin so far.
    fn policy(&self, actor: Actor, levels: &[Level], settings: &Settings) -> Policy {
        let level = |(level, &episodes): (&Level, &u32)| LevelManifest {
            powder: level.powder.clone(),
            repose_deg: level.repose_deg,
            sets: level
                .sets
                .iter()
                .map(|set| SetManifest { id: set.id(), parameters: *set })
                .collect(),
            episodes,
        };
        let manifest = Manifest {
            kind: actor.kind(),
            rules: settings.rules,
            preset: match settings.preset {
                super::Preset::Flip => "flip".to_owned(),
                super::Preset::Paper => "paper".to_owned(),
            },
            settings: serde_json::to_value(settings).expect("settings are plain data"),
            seed: settings.seed,
            code_version: env!("CARGO_PKG_VERSION").to_owned(),
            simulator_version: flip_sim::VERSION.to_owned(),
            levels: levels.iter().zip(&self.progress.on_level).map(level).collect(),
            switches: self.curriculum.switches().to_vec(),
            episodes: self.progress.episodes,
            final_error_mg: (self.progress.episodes > 0).then(|| self.recent_error_mg()),
        };
        Policy { manifest, controller: Controller::Learned(actor) }
    }

    /// Mean error of the last episodes, mg.
    fn recent_error_mg(&self) -> f64 {
        let recent = &self.progress.recent;
        recent.iter().sum::<f64>() / recent.len().max(1) as f64
    }

    fn finish(self, levels: &[Level], settings: &Settings) -> Result<Trained, TrainError> {
        let episodes = self.progress.episodes;
        let actor = self.learner.outcome(settings).ok_or(TrainError::Diverged { episodes })?;
        let policy = self.policy(actor, levels, settings);
        Ok(Trained {
            artifact: flip_policy::encode(&policy),
            episodes,
            final_error_mg: self.recent_error_mg(),
            levels: policy.manifest.levels.clone(),
            manifest: policy.manifest,
        })
    }
}

fn record(
    plan: &Planned,
    played: &Played,
    levels: &[Level],
    losses: Option<Losses>,
) -> EpisodeRecord {
    EpisodeRecord {
        index: plan.index,
        level: plan.level,
        powder: if plan.randomised { RANDOMISED } else { &levels[plan.level as usize].powder }
            .to_owned(),
        parameter_set: plan.set.id(),
        target_mg: played.target_mg,
        dispensed_mg: played.dispensed_mg,
        final_error_mg: (played.target_mg - played.dispensed_mg).abs(),
        reward: played.reward,
        steps: played.steps.len() as u32,
        ending: played.ending,
        losses,
    }
}
