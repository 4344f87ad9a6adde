//! One round of episodes, played with one snapshot of the policy: a batch of experiments.

use super::environment::{Filling, Played, Simulated, Spoon, play};
use super::episodes::Episode;
use super::plan::Planned;
use super::record::Flow;
use super::replay::Memory;
use super::settings::Settings;
use super::spoons::Spoons;
use flip_policy::{Actor, Carried, OUTPUTS};
use flip_sim::batch::{Batch, Engine, Failed, Place, side_by_side};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use std::ops::ControlFlow;
use std::sync::{Mutex, PoisonError};

/// The episodes of a round.
pub struct Round<'a> {
    /// They are played independently of each other.
    pub planned: Vec<Planned>,
    /// The policy; without one the actions are random.
    pub actor: Option<&'a Actor>,
    /// Settings of the training.
    pub settings: &'a Settings,
}

/// Episodes that were played, in their order; none if a stop was requested before all were.
pub type PlayedRound = Option<Vec<(Planned, Played)>>;

/// Where the rounds of a training are played: on this machine's cores by [`Spoons`], on an engine by
/// [`SideBySide`].
pub trait Rounds {
    /// Plays a round; results are in order and depend on nothing else. None if `flow` requested a
    /// stop before all were played.
    ///
    /// # Errors
    /// What computes the spoons failed.
    fn play(&self, round: Round<'_>, flow: &Flow<'_>) -> Result<PlayedRound, Failed>;
}

impl<F: Filling> Rounds for Spoons<F> {
    fn play(&self, round: Round<'_>, flow: &Flow<'_>) -> Result<PlayedRound, Failed> {
        let Round { planned, actor, settings } = round;
        let play = |mut plan: Planned| {
            if flow().is_break() {
                return None;
            }
            let played = if plan.index < settings.surrogate_episodes {
                let spoon = plan.surrogate(settings);
                play_planned(&mut plan, spoon, actor, settings)
            } else {
                let spoon = plan.spoon(self, settings);
                play_planned(&mut plan, spoon, actor, settings)
            };
            Some((plan, played))
        };
        Ok(planned.into_par_iter().map(play).collect())
    }
}

/// Plays the doses of a round side by side on one batch, each step of all of them at once. Those on the
/// surrogate are of this machine's cores.
pub struct SideBySide {
    spoons: Spoons<Simulated>,
    batch: Mutex<Box<dyn Batch>>,
}

impl SideBySide {
    /// Room on an engine for the rounds of these settings.
    ///
    /// # Errors
    /// A device that fails, or has too little memory.
    pub fn new(
        engine: &dyn Engine,
        spoons: Spoons<Simulated>,
        settings: &Settings,
    ) -> Result<Self, Failed> {
        let places = engine.places().min(settings.episodes_per_round as usize);
        Ok(Self { spoons, batch: Mutex::new(engine.batch(places)?) })
    }
}

impl Rounds for SideBySide {
    fn play(&self, round: Round<'_>, flow: &Flow<'_>) -> Result<PlayedRound, Failed> {
        let Round { planned, actor, settings } = round;
        if planned.iter().any(|plan| plan.index < settings.surrogate_episodes) {
            return self.spoons.play(Round { planned, actor, settings }, flow);
        }
        let waiting: Vec<_> = planned.into_iter().map(|plan| Mutex::new(Some(plan))).collect();
        let mut played: Vec<_> = waiting.iter().map(|_| None).collect();
        let procedure = |k: usize, place: &mut Place| {
            if flow().is_break() {
                return None;
            }
            let mut plan = waiting[k].lock().unwrap_or_else(PoisonError::into_inner).take()?;
            // Why it cannot be filled is what the batch returns.
            let seat = place.settle(plan.loose(&self.spoons)).ok()?;
            let played = play_planned(&mut plan, seat, actor, settings);
            Some((plan, played))
        };
        let mut each = |k: usize, given| {
            played[k] = given;
            ControlFlow::Continue(())
        };
        let mut batch = self.batch.lock().unwrap_or_else(PoisonError::into_inner);
        side_by_side(&mut **batch, waiting.len(), procedure, &mut each)?;
        Ok(played.into_iter().collect())
    }
}

fn play_planned(
    plan: &mut Planned,
    mut spoon: impl Spoon,
    actor: Option<&Actor>,
    settings: &Settings,
) -> Played {
    let (target_mg, seed, rng) = (plan.target_mg, plan.seed, &mut plan.rng);
    let begun = actor.map(Actor::begin).unwrap_or_default();
    let mut carried = Carried { repose_deg: plan.repose_deg, ..begun };
    let tilt = settings.warmup_tilt as f32 * rng.random::<f32>();
    play(&mut spoon, &settings.rules, &settings.balance, target_mg, seed, |seen| match actor {
        Some(actor) => actor.sample(seen, &mut carried, rng),
        None => random_action(tilt, rng),
    })
}

/// Uniform over all actions, with the incline change shifted by `tilt`.
fn random_action(tilt: f32, rng: &mut Pcg64Mcg) -> [f32; OUTPUTS] {
    let mut uniform = || 2.0 * rng.random::<f32>() - 1.0;
    [(uniform() + tilt).clamp(-1.0, 1.0), uniform()]
}

/// Converts an episode for the replay memory; `actor` is the current one, whether or not it played.
pub fn remembered(plan: &Planned, played: &Played, actor: &Actor, settings: &Settings) -> Episode {
    let parameters = plan.set.to_unit().map(|x| x as f32);
    let (target_mg, repose_deg) = (played.target_mg as f32, plan.repose_deg.unwrap_or(0.0) as f32);
    let steps = played
        .steps
        .iter()
        .map(|&step| Memory { step, target_mg, repose_deg, parameters })
        .collect();
    Episode::new(steps, actor, settings)
}
