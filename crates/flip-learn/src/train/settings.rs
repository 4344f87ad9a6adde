//! All hyperparameters of a training.

use super::curriculum;
use flip_core::domain::conditions::{Patch, Under};
use flip_core::domain::{FieldError, bounded};
use flip_policy::{Encoding, Kind, OUTPUTS, Rules};
use flip_sim::{balance, dispense};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Angles of repose of the published curriculum's three levels, degrees.
pub const PAPER_LEVELS_DEG: [f64; 3] = [28.0, 33.0, 37.0];

/// Approximate number of surrogate episodes that take as long as one in the simulator.
pub(super) const SURROGATE_EPISODES: u32 = 50;

/// The defaults a training starts from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Preset {
    /// FLIP's own.
    #[default]
    Flip,
    /// The published robot's.
    Paper,
}

/// How the powder of an episode is chosen.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// From the lowest angle of repose to the highest, advancing when good enough.
    #[default]
    Curriculum,
    /// From the highest angle of repose to the lowest, by the same rule.
    Reverse,
    /// A random level for each episode.
    Random,
    /// A random parameter set from the whole published box for each episode; levels are not used.
    DomainRandomisation,
}

/// The network architecture.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Network {
    /// Two hidden layers, no memory. Learns from single transitions.
    #[default]
    FeedForward,
    /// The prior work's network with an LSTM memory. Learns from whole episodes.
    Recurrent {
        /// Initial LSTM state for the next observations.
        replayed: Replayed,
    },
}

/// Initial LSTM state of a replayed episode for its next observations, as seen by the critics.
///
/// The memory before each step starts from zero at the episode's first step either way, as in a
/// weighing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Replayed {
    /// The published code's: the actor's state after the first step was stored with the episode. It
    /// is passed to today's actor and also to the target critics, whose own states mean something
    /// else.
    StoredState,
    /// Ours: each network runs through the episode from its start. With 10 to 30 steps no burn-in
    /// or truncation is needed.
    Episodes,
}

/// Loss function of the critics.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CriticLoss {
    /// Half of the squared difference.
    #[default]
    Squared,
    /// Quadratic up to a difference of 1, linear beyond (Huber 1964).
    Huber,
}

/// What computes the gradients of an update. The losses are the same; sums are in another order, so
/// trainings differ from the last digits on, as between two kinds of processor with libtorch.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Gradients {
    /// libtorch, whose bits depend on the processor.
    #[default]
    Libtorch,
    /// Our own code: no dispatch, and the same bits on every processor.
    Fused,
}

/// The days of a training under an extended simulator; each episode has one. On the surrogate, only
/// their effect on a powder's parameters applies.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Extended {
    /// The version, and the conditions held fixed.
    pub under: Under,
    /// Changes of each day to a powder without its own list; at least one day.
    pub days: Vec<Patch>,
    /// Changes of each day to these powders.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub powders: BTreeMap<String, Vec<Patch>>,
}

impl Extended {
    /// The day of an episode with this seed.
    pub(super) fn drawn(&self, powder: Option<&str>, seed: u64) -> &Patch {
        let own = powder.and_then(|powder| self.powders.get(powder)).filter(|own| !own.is_empty());
        let days = own.unwrap_or(&self.days);
        &days[(seed % days.len() as u64) as usize]
    }

    /// Whether all days of each powder are equal, i.e. every condition is held.
    pub(super) fn is_held(&self) -> bool {
        self.powders
            .values()
            .chain([&self.days])
            .all(|days| days.windows(2).all(|pair| pair[0] == pair[1]))
    }

    fn check(&self, spoon: &dispense::Settings) -> Result<(), FieldError> {
        if self.days.is_empty() {
            return Err(FieldError::new("extended.days", "must hold at least one day"));
        }
        let all = self.days.iter().chain(self.powders.values().flatten());
        all.map(|patch| spoon.extensions.patched(patch)).find_map(Result::err).map_or(Ok(()), Err)
    }
}

/// A training that continues from a policy, for conditions new to it.
// Unknown fields are accepted: stored specifications may have `spoons`, used by an earlier version.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FineTuning {
    /// Id of the policy.
    pub policy: String,
    /// Updates of the critics alone. They start untrained; a policy that followed them would
    /// unlearn.
    pub held_updates: u32,
    /// Updates over which the final policy is an exponential mean of the actor (Polyak and Juditsky
    /// 1992): after so short a training the last actor is left to chance. Default 2000; 0 takes the
    /// last actor, as in earlier versions.
    #[serde(default, skip_serializing_if = "is_default")]
    pub averaged_updates: u32,
}

/// Settings of a training; stored with its job, its checkpoints and its policy.
///
/// Sources: "Haarnoja 2018" is arXiv:1812.05905; "prior work" is the public code of the published
/// robot and of the method it builds on (github.com/omron-sinicx/robotic-powder-weighing); "ours"
/// was measured, see `docs/decisions.md`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// The preset these settings started from.
    pub preset: Preset,
    /// How the powder of an episode is chosen.
    pub order: Order,
    /// Seed of all random draws.
    pub seed: u64,

    /// Episodes in the training. Default 4800 (ours), 4000 (paper), 720 when continuing from a
    /// policy.
    pub episodes: u32,
    /// Initial episodes played on a model of the spoon ([`super::Surrogate`]), a thousand times as
    /// fast as the simulator; their lessons stay, their steps are dropped. Default 0; a training
    /// requested without a number uses [`Settings::surrogate_by_default`].
    #[serde(default, skip_serializing_if = "is_default")]
    pub surrogate_episodes: u32,
    /// Episodes collected in parallel with one policy snapshot before updates. Fixed, so that the
    /// result does not depend on the number of threads. Default 4 (ours), 1 (paper).
    pub episodes_per_round: u32,
    /// Rounds between checkpoints. Default 5.
    pub rounds_per_checkpoint: u32,
    /// Share of the episodes with a parameter set from the whole published box, so that a new
    /// powder is not new in every way. They do not count towards a level. Default 0.25 (ours), 0
    /// (published).
    #[serde(default, skip_serializing_if = "is_default")]
    pub box_share: f64,
    /// Different heaps per parameter set; filled spoons are kept and cloned. Default 20 (ours), 2
    /// (paper).
    pub fills_per_set: u32,

    /// Steps, ending and pitch range of an episode. Default: at most 10 steps, ends on target.
    pub rules: Rules,
    /// Lowest training target, mg. Default 5 (published).
    pub target_mg_min: f64,
    /// Highest training target, mg. Default 15 (published).
    pub target_mg_max: f64,
    /// The simulated balance.
    pub balance: balance::Settings,
    /// The simulated spoon; its pitch range is replaced by the rules'.
    pub spoon: dispense::Settings,
    /// Simulator version and days of the training. Default the base version, whose days are alike.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub extended: Option<Extended>,

    /// The policy to continue from. Default none: a training starts with an untrained policy.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<FineTuning>,

    /// Inputs of the networks.
    pub encoding: Encoding,
    /// Network architecture. Default feed-forward (ours), recurrent with stored states (prior
    /// work).
    #[serde(default)]
    pub network: Network,
    /// Width of the hidden layers and of the LSTM. Default 128 (prior work).
    pub hidden: u32,
    /// Transitions per update; episodes if recurrent. Default 256 (ours), 16 (prior work).
    pub batch: u32,
    /// Updates per simulator step. Default 10 (ours: a step costs more than they do), 1 (prior
    /// work).
    pub updates_per_step: f64,
    /// Updates for each step on the surrogate. Default 1.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub surrogate_updates_per_step: f64,
    /// Episodes with random actions before the first update. Default 16 (ours), 20 (prior work).
    pub warmup_episodes: u32,
    /// Tilt of random actions: each warm-up episode draws a mean incline change from 0 to this
    /// share of 8 deg, so that some of them pour. Default 0.6 (ours), 0 (prior work).
    pub warmup_tilt: f64,
    /// Transitions kept; the oldest goes first. A recurrent network keeps as many full-length
    /// episodes as fit. Default 1 000 000 (prior work).
    pub replay_capacity: u32,
    /// Adam's step size for actor, critics and temperature. Default 3e-4 (ours), 1e-4 (prior work).
    pub learning_rate: f64,
    /// Loss function of the critics. Default squared (Haarnoja 2018), Huber (prior work).
    #[serde(default)]
    pub critic_loss: CriticLoss,
    /// What computes the gradients. Default libtorch, which stored trainings were made with.
    #[serde(default, skip_serializing_if = "is_default")]
    pub gradients: Gradients,
    /// Discount per step. Default 0.9 (ours: the ending counts for ten steps), 0.99 (prior work).
    pub gamma: f64,
    /// Share of the critic copied to the target network per update. Default 0.005 (Haarnoja 2018).
    pub tau: f64,
    /// Target entropy of the temperature, nats. Default -2: minus the number of actions (Haarnoja
    /// 2018).
    pub target_entropy: f64,
    /// Temperature at the start. Default 0.2 (ours), 1 (prior work).
    pub initial_alpha: f64,
    /// Factor on rewards in the losses; reports are unscaled. Default 0.1 (ours), 1 (prior work).
    pub reward_scale: f64,
    /// Whether an early ending is paid as if the last reward went on for ever (terminal reward
    /// `r / (1 - gamma)`), so that it is no escape from a bad dose. Default true (ours; the paper's
    /// never end early).
    pub absorbing_ending: bool,
    /// Factor on the true error in the training reward for an overdose of more than 1 mg, which
    /// cannot be undone. 1 is the published reward. Default 2 (ours).
    pub overdose_factor: f64,
    /// Share of each batch whose target is redrawn in hindsight (Andrychowicz 2017), as the
    /// powder's behaviour does not depend on it. Whole episodes if recurrent; must be 0 with stored
    /// states, which belong to the original target. Default 0.8 (ours), 0 (prior work).
    pub relabel_share: f64,
    /// Lowest relabelled target, mg. Default 2: endings are learned from small doses too.
    pub relabel_mg_min: f64,

    /// When the curriculum advances.
    pub curriculum: curriculum::Rule,
}

impl Settings {
    /// The settings of a preset.
    pub fn of(preset: Preset, order: Order, seed: u64) -> Self {
        let flip = Self {
            preset,
            order,
            seed,
            episodes: 4800,
            surrogate_episodes: 0,
            episodes_per_round: 4,
            rounds_per_checkpoint: 5,
            box_share: 0.25,
            fills_per_set: 20,
            rules: Rules::FLIP,
            target_mg_min: 5.0,
            target_mg_max: 15.0,
            balance: balance::Settings::default(),
            spoon: dispense::Settings::default(),
            extended: None,
            from: None,
            encoding: Encoding::Fall,
            network: Network::FeedForward,
            hidden: 128,
            batch: 256,
            updates_per_step: 10.0,
            surrogate_updates_per_step: 1.0,
            warmup_episodes: 16,
            warmup_tilt: 0.6,
            replay_capacity: 1_000_000,
            learning_rate: 3e-4,
            critic_loss: CriticLoss::Squared,
            gradients: Gradients::Libtorch,
            gamma: 0.9,
            tau: 0.005,
            target_entropy: -2.0,
            initial_alpha: 0.2,
            reward_scale: 0.1,
            absorbing_ending: true,
            overdose_factor: 2.0,
            relabel_share: 0.8,
            relabel_mg_min: 2.0,
            curriculum: curriculum::Rule::default(),
        };
        match preset {
            Preset::Flip => flip,
            Preset::Paper => Self {
                episodes: 4000,
                episodes_per_round: 1,
                box_share: 0.0,
                fills_per_set: 2,
                rounds_per_checkpoint: 20,
                rules: Rules::PAPER,
                encoding: Encoding::Paper,
                network: Network::Recurrent { replayed: Replayed::StoredState },
                batch: 16,
                updates_per_step: 1.0,
                warmup_episodes: 20,
                warmup_tilt: 0.0,
                learning_rate: 1e-4,
                critic_loss: CriticLoss::Huber,
                gamma: 0.99,
                initial_alpha: 1.0,
                reward_scale: 1.0,
                absorbing_ending: false,
                overdose_factor: 1.0,
                relabel_share: 0.0,
                relabel_mg_min: 5.0,
                ..flip
            },
        }
    }

    /// Adapts the settings to continue from a policy: it weighs from the first episode, explores as
    /// little as the policy does, and takes ten to thirty minutes on two cores.
    #[must_use]
    pub fn going_on_from(self, policy: String) -> Self {
        let from = Some(FineTuning { policy, held_updates: 2000, averaged_updates: 2000 });
        Self { from, episodes: 720, warmup_episodes: 0, initial_alpha: 0.02, ..self }
    }

    /// Validates the settings.
    ///
    /// # Errors
    /// The first setting that is out of range, by name.
    pub fn checked(self) -> Result<Self, FieldError> {
        let count = |field, value: u32, lower: u32, upper: u32| {
            bounded(field, f64::from(value), f64::from(lower), f64::from(upper), "")
        };
        count("episodes", self.episodes, 1, 1_000_000)?;
        count("surrogate_episodes", self.surrogate_episodes, 0, self.episodes)?;
        count("episodes_per_round", self.episodes_per_round, 1, 1024)?;
        count("rounds_per_checkpoint", self.rounds_per_checkpoint, 1, 1_000_000)?;
        count("fills_per_set", self.fills_per_set, 1, 1000)?;
        count("rules.steps_max", self.rules.steps_max, 1, 1000)?;
        bounded("target_mg_min", self.target_mg_min, 0.1, 1000.0, "mg")?;
        bounded("target_mg_max", self.target_mg_max, self.target_mg_min, 1000.0, "mg")?;
        count("hidden", self.hidden, 1, 4096)?;
        count("batch", self.batch, 1, 65_536)?;
        bounded("updates_per_step", self.updates_per_step, 0.0, 1000.0, "")?;
        bounded("surrogate_updates_per_step", self.surrogate_updates_per_step, 0.0, 1000.0, "")?;
        bounded("warmup_tilt", self.warmup_tilt, 0.0, 1.0, "")?;
        count("replay_capacity", self.replay_capacity, 1, 10_000_000)?;
        bounded("learning_rate", self.learning_rate, 1e-8, 1.0, "")?;
        bounded("gamma", self.gamma, 0.0, 0.9999, "")?;
        bounded("tau", self.tau, 0.0, 1.0, "")?;
        bounded("box_share", self.box_share, 0.0, 1.0, "")?;
        bounded("target_entropy", self.target_entropy, -100.0, 100.0, "nats")?;
        bounded("initial_alpha", self.initial_alpha, 1e-6, 1e3, "")?;
        bounded("reward_scale", self.reward_scale, 1e-6, 1e6, "")?;
        bounded("overdose_factor", self.overdose_factor, 0.0, 1000.0, "")?;
        bounded("relabel_share", self.relabel_share, 0.0, 1.0, "")?;
        if self.stores_states() && self.relabel_share > 0.0 {
            let advice = "must be 0 with stored states, which belong to the target that was asked for; replay `episodes`";
            return Err(FieldError::new("relabel_share", advice));
        }
        bounded("relabel_mg_min", self.relabel_mg_min, 0.1, self.target_mg_max, "mg")?;
        count("curriculum.queue", self.curriculum.queue, 1, 100_000)?;
        self.extended.as_ref().map_or(Ok(()), |extended| extended.check(&self.spoon))?;
        Ok(self)
    }

    /// Default surrogate episodes: four fifths for ours, none for the published settings. None when
    /// continuing from a policy: the surrogate lacks the conditions to learn, and unlearns the
    /// simulator's lessons.
    pub fn surrogate_by_default(&self) -> u32 {
        match (self.preset, &self.from) {
            (Preset::Flip, None) => self.episodes - self.episodes.div_ceil(5),
            (Preset::Flip, Some(_)) | (Preset::Paper, _) => 0,
        }
    }

    /// Share of the training's work done by now; a surrogate episode counts as a fiftieth.
    pub fn share_done(&self, episodes: u32) -> f64 {
        let work = |episodes: u32| {
            let on_surrogate = episodes.min(self.surrogate_episodes);
            f64::from(on_surrogate) / f64::from(SURROGATE_EPISODES)
                + f64::from(episodes - on_surrogate)
        };
        work(episodes) / work(self.episodes)
    }

    /// The kind recorded in the manifest of a policy trained with these settings.
    pub fn policy_kind(&self) -> Kind {
        match self.network {
            Network::FeedForward => {
                Kind::Learned { encoding: self.encoding, widths: self.actor_widths() }
            }
            Network::Recurrent { .. } => {
                Kind::Recurrent { encoding: self.encoding, hidden: self.hidden as usize }
            }
        }
    }

    /// Widths of the feed-forward actor, from the inputs to the outputs.
    pub(super) fn actor_widths(&self) -> Vec<usize> {
        let hidden = self.hidden as usize;
        vec![self.encoding.width(), hidden, hidden, 2 * OUTPUTS]
    }

    /// Whether episodes are stored with the actor's state after their first step.
    pub fn stores_states(&self) -> bool {
        self.network == Network::Recurrent { replayed: Replayed::StoredState }
    }

    /// Most episodes on one of `levels` levels with `episodes` in total: the published 1330, or an
    /// equal share of a smaller budget.
    ///
    /// ```text
    /// min(1330, ceil(episodes (1 - box_share) / levels))
    /// ```
    ///
    /// With the published three levels and 4000 episodes this is the published rule (the shares
    /// would be 1334); with a demonstration budget every level still gets its turn, on the
    /// surrogate and again in the simulator.
    pub fn level_episodes_max(&self, episodes: u32, levels: u32) -> u32 {
        let share = f64::from(episodes) * (1.0 - self.box_share) / f64::from(levels.max(1));
        self.curriculum.episodes_max.min(share.ceil() as u32)
    }
}

/// Default of settings that are 1 if omitted.
fn one() -> f64 {
    1.0
}

/// Whether the value is 1, the default, which is omitted.
fn is_one(value: &f64) -> bool {
    *value == 1.0
}

/// Whether the value is the default. It is then omitted, so that trainings older than the setting
/// are still found.
fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

#[cfg(test)]
mod tests;
