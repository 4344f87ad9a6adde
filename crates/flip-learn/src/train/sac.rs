//! Soft Actor-Critic: losses and one update, in reading order.
//!
//! Haarnoja et al., "Soft Actor-Critic Algorithms and Applications", arXiv:1812.05905 (2018). Twin
//! critics with target networks, a squashed Gaussian actor, a learned temperature. Only the critics
//! see the nine parameters of the simulated powder, since only training needs them (asymmetric
//! actor and critic: Pinto et al., RSS 2018).
//!
//! | call            | arguments                                    | returns           |
//! |-----------------|----------------------------------------------|-------------------|
//! | `squash`        | head `[batch, 4]`, noise `[batch, 2]`        | action, log-prob  |
//! | `td_target`     | reward, goes on, next Q and log-prob         | y `[batch]`       |
//! | `critic_loss`   | Q `[2, batch]`, y `[batch]`, which           | scalar            |
//! | `actor_loss`    | Q `[2, batch]`, log-prob `[batch]`           | scalar            |
//! | `Learner::update` | batch, noise                               | one step of each  |

use super::adam::Adam;
use super::by_libtorch::ByLibtorch;
use super::fused::{Approach, Fused, exponential};
use super::networks::Networks;
use super::record::Losses;
use super::replay::Batch;
use super::settings::{CriticLoss, Gradients, Network, Settings};
use flip_core::domain::parameters::COUNT;
use flip_core::learner::{Learned, Shape};
use flip_policy::{Actor, LOG_STD_MAX, LOG_STD_MIN, OUTPUTS};
use rand::Rng;
use tch::Tensor;

/// Converts a network's outputs to actions and their log-probabilities.
///
/// ```text
/// u = mean + exp(log_std) * noise,   a = tanh(u)
/// log pi = sum_k [ -noise^2 / 2 - log_std - ln(2 pi) / 2 - 2 (ln 2 - u - softplus(-2 u)) ]
/// ```
///
/// The last term is ln(1 - tanh(u)^2) of eq. 26, rewritten so that it stays finite where tanh
/// rounds to one. Shapes: head `[batch, 4]`, noise `[batch, 2]` -> action `[batch, 2]`,
/// log-probability `[batch]`.
pub fn squash(head: &Tensor, noise: &Tensor) -> (Tensor, Tensor) {
    let parts = head.split_with_sizes([OUTPUTS as i64, OUTPUTS as i64], 1);
    let log_std = parts[1].clamp(f64::from(LOG_STD_MIN), f64::from(LOG_STD_MAX));
    let u = &parts[0] + log_std.exp() * noise;
    let gauss = noise.square() * -0.5 - log_std - 0.5 * (2.0 * std::f64::consts::PI).ln();
    let slope = (std::f64::consts::LN_2 - &u - (&u * -2.0).softplus()) * 2.0;
    let log_prob = (gauss - slope).sum_dim_intlist([1i64].as_slice(), false, None);
    (u.tanh(), log_prob)
}

/// The critics' target (eq. 3 and 5): `y = r + gamma * goes_on * (min Q' - alpha log pi')`, all
/// `[batch]`.
///
/// `goes_on` is 0 only where the episode terminated. Where it was cut off by its step limit the
/// future still has value, so the target bootstraps through a time-out (Pardo et al., ICML 2018).
pub fn td_target(
    reward: &Tensor,
    goes_on: &Tensor,
    next_q: &Tensor,
    next_log_prob: &Tensor,
    alpha: f64,
    gamma: f64,
) -> Tensor {
    let value = next_q.amin(0, false) - next_log_prob * alpha;
    reward + goes_on * value * gamma
}

/// Eq. 5 for both critics: the sum over the twins of `mean d^2 / 2` with `d = Q - y`, or of Huber's
/// `mean |d| - 1/2` where `|d| > 1`. Q `[2, batch]`, y `[batch]`.
pub fn critic_loss(q: &Tensor, y: &Tensor, which: CriticLoss) -> Tensor {
    // The mean over 2 * batch entries is half the sum of the two means.
    match which {
        CriticLoss::Squared => (q - y).square().mean(None),
        CriticLoss::Huber => q.smooth_l1_loss(&y.expand_as(q), tch::Reduction::Mean, 1.0) * 2.0,
    }
}

/// Eq. 9: `mean (alpha log pi - min Q)`. Q `[2, batch]`, log-probability `[batch]`.
pub fn actor_loss(q: &Tensor, log_prob: &Tensor, alpha: f64) -> Tensor {
    (log_prob * alpha - q.amin(0, false)).mean(None)
}

/// Derivative with respect to `ln alpha` of eq. 18, `mean (-alpha (log pi + target entropy))`.
pub fn temperature_gradient(alpha: f64, mean_log_prob: f64, target_entropy: f64) -> f64 {
    -alpha * (mean_log_prob + target_entropy)
}

/// All learnable state: networks, targets, temperature and their optimisers.
///
/// Parameters live in flat vectors; what computes gradients ([`Gradients`]) only reads them. A
/// snapshot or a checkpoint is a copy.
#[derive(Debug, Clone, PartialEq)]
pub struct Learner {
    /// Actor's parameters.
    pub actor: Vec<f32>,
    /// Their mean over the last updates if the settings request averaging; otherwise equal to
    /// `actor`.
    pub averaged: Vec<f32>,
    /// Both critics' parameters, one after the other.
    pub critics: Vec<f32>,
    /// The slow copies of the critics.
    pub targets: Vec<f32>,
    /// Logarithm of the temperature.
    pub log_alpha: Vec<f32>,
    /// Optimiser of the actor.
    pub actor_adam: Adam,
    /// Optimiser of the critics.
    pub critics_adam: Adam,
    /// Optimiser of the temperature.
    pub alpha_adam: Adam,
    networks: Networks,
    room: Room,
}

impl Learner {
    /// Creates newly initialised networks.
    pub fn new(settings: &Settings, rng: &mut impl Rng) -> Self {
        let networks = Networks::new(settings);
        let (actor, critics) = networks.initialise(rng);
        Self {
            actor_adam: Adam::new(actor.len()),
            critics_adam: Adam::new(critics.len()),
            alpha_adam: Adam::new(1),
            targets: critics.clone(),
            log_alpha: vec![settings.initial_alpha.ln() as f32],
            averaged: actor.clone(),
            actor,
            critics,
            networks,
            room: Room::default(),
        }
    }

    /// The temperature.
    pub fn alpha(&self) -> f64 {
        f64::from(self.log_alpha[0]).exp()
    }

    /// The current actor in plain Rust; `None` if its weights are no longer finite.
    pub fn snapshot(&self, settings: &Settings) -> Option<Actor> {
        self.networks.snapshot(settings.encoding, &self.actor)
    }

    /// The final actor of a training, likewise.
    pub fn outcome(&self, settings: &Settings) -> Option<Actor> {
        self.networks.snapshot(settings.encoding, &self.averaged)
    }

    /// Continues with this actor.
    pub fn take(&mut self, actor: Vec<f32>) {
        self.averaged.clone_from(&actor);
        self.actor = actor;
    }

    /// Sizes and rates of a learner of these settings that is no more than its [`Learned`] and makes
    /// its updates by our own gradients: with perceptrons, and without an actor that is held or
    /// averaged.
    pub fn shape(settings: &Settings) -> Option<Shape> {
        let is_plain = settings.network == Network::FeedForward
            && settings.gradients == Gradients::Fused
            && settings.from.is_none();
        let inputs = settings.encoding.width();
        is_plain.then(|| Shape {
            rows: settings.batch as usize,
            inputs,
            state: inputs + COUNT,
            hidden: settings.hidden as usize,
            huber: settings.critic_loss == CriticLoss::Huber,
            gamma: settings.gamma as f32,
            tau: settings.tau as f32,
            target_entropy: settings.target_entropy,
            learning_rate: settings.learning_rate,
        })
    }

    /// Its state as plain numbers.
    pub fn learned(&self) -> Learned {
        let Self { actor_adam, critics_adam, alpha_adam, .. } = self;
        Learned {
            actor: [self.actor.clone(), actor_adam.m.clone(), actor_adam.v.clone()],
            critics: [self.critics.clone(), critics_adam.m.clone(), critics_adam.v.clone()],
            targets: self.targets.clone(),
            log_alpha: [self.log_alpha[0], alpha_adam.m[0], alpha_adam.v[0]],
            steps: [critics_adam.t, actor_adam.t],
        }
    }

    /// Replaces its state; the final actor is the last one.
    pub fn put(&mut self, state: Learned) {
        let Learned { actor, critics, targets, log_alpha, steps } = state;
        let [log_alpha, m, v] = log_alpha.map(|number| vec![number]);
        self.alpha_adam = Adam { m, v, t: steps[1] };
        self.log_alpha = log_alpha;
        self.targets = targets;
        let [critics, m, v] = critics;
        self.critics_adam = Adam { m, v, t: steps[0] };
        self.critics = critics;
        let [actor, m, v] = actor;
        self.actor_adam = Adam { m, v, t: steps[1] };
        self.averaged.clone_from(&actor);
        self.actor = actor;
    }

    /// Makes one update of critics, actor, temperature and targets from one batch; of critics and
    /// targets only while the settings hold the actor fixed.
    ///
    /// `noise` holds `[2, rows, 2]` standard normal numbers: for the next actions, then for the
    /// present ones.
    pub fn update(&mut self, batch: &Batch, noise: &[f32], settings: &Settings) -> Losses {
        let alpha = match settings.gradients {
            Gradients::Libtorch => self.alpha(),
            // The same bits with every C library.
            Gradients::Fused => f64::from(exponential(self.log_alpha[0])),
        };
        let drawn = Drawn { batch, noise, alpha, settings };
        let mut room = std::mem::take(&mut self.room);
        let losses = match settings.gradients {
            Gradients::Libtorch => {
                let networks = self.networks.clone();
                let mut torch = ByLibtorch::new(&networks, batch, noise);
                self.step(&mut torch, drawn, &mut room.gradient)
            }
            Gradients::Fused => {
                let fused = room.fused.get_or_insert_with(|| Box::new(Fused::new(&self.networks)));
                self.step(fused.as_mut(), drawn, &mut room.gradient)
            }
        };
        self.room = room;
        losses
    }

    /// [`Learner::update`] with these gradients, for which there is room in `gradient`.
    fn step(
        &mut self,
        by: &mut impl Differentiate,
        drawn: Drawn,
        gradient: &mut Vec<f32>,
    ) -> Losses {
        let (settings, alpha) = (drawn.settings, drawn.alpha);
        let critic = by.critics(self.blocks(), drawn, gradient);
        self.critics_adam.step(&mut self.critics, gradient, settings.learning_rate);

        let held = settings.from.as_ref().map_or(0, |from| from.held_updates.into());
        let steps = self.critics_adam.t > held;
        let (actor, mean_log_prob) =
            by.actor(self.blocks(), drawn, steps.then_some(&mut *gradient));
        if steps {
            self.actor_adam.step(&mut self.actor, gradient, settings.learning_rate);
            let gradient = temperature_gradient(alpha, mean_log_prob, settings.target_entropy);
            self.alpha_adam.step(&mut self.log_alpha, &[gradient as f32], settings.learning_rate);
            self.average(settings);
        }
        Approach { slow: &mut self.targets, fast: &self.critics, tau: settings.tau as f32 }
            .take_step();
        Losses { critic, actor, entropy: -mean_log_prob, alpha }
    }

    /// What gradients are computed from.
    fn blocks(&self) -> Blocks<'_> {
        Blocks { actor: &self.actor, critics: &self.critics, targets: &self.targets }
    }

    /// Adds the current actor to the average: `mean <- mean + (now - mean) / n` over n updates;
    /// without averaging, takes the current one.
    fn average(&mut self, settings: &Settings) {
        match settings.from.as_ref().map_or(0, |from| from.averaged_updates) {
            0 | 1 => self.averaged.clone_from(&self.actor),
            n => {
                for (mean, now) in self.averaged.iter_mut().zip(&self.actor) {
                    *mean += (now - *mean) / n as f32;
                }
            }
        }
    }
}

/// The blocks of parameters that an update reads.
#[derive(Debug, Clone, Copy)]
pub(super) struct Blocks<'a> {
    /// The actor's.
    pub actor: &'a [f32],
    /// Both critics', one after the other.
    pub critics: &'a [f32],
    /// Those of their slow copies.
    pub targets: &'a [f32],
}

/// A batch with what else the losses depend on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Drawn<'a> {
    /// The batch.
    pub batch: &'a Batch,
    /// `[2, rows, 2]` standard normal numbers: for the next actions, then for the present ones.
    pub noise: &'a [f32],
    /// Temperature.
    pub alpha: f64,
    /// Discount and loss function.
    pub settings: &'a Settings,
}

/// What computes the gradients of an update.
pub(super) trait Differentiate {
    /// The critics' loss; writes its gradient `[2 * parameters]`.
    fn critics(&mut self, of: Blocks, drawn: Drawn, gradient: &mut Vec<f32>) -> f64;
    /// The actor's loss with the critics after their step, and the mean log-probability of its
    /// actions; writes the gradient `[parameters]` if asked for. Called after `critics` with the same batch.
    fn actor(&mut self, of: Blocks, drawn: Drawn, gradient: Option<&mut Vec<f32>>) -> (f64, f64);
}

/// Room that updates compute in; it holds nothing between them, so two are always equal.
#[derive(Debug, Default)]
struct Room {
    gradient: Vec<f32>,
    fused: Option<Box<Fused>>,
}

impl Clone for Room {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl PartialEq for Room {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

#[cfg(test)]
#[path = "sac_tests.rs"]
mod tests;

#[cfg(test)]
#[path = "lq_tests.rs"]
mod lq_tests;
