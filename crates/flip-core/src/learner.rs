//! A learner of Soft Actor-Critic as plain numbers: what its updates start from, need and leave,
//! wherever they are made.
//!
//! All networks have two hidden layers of one width. A block of parameters is flat: weights
//! `[inputs, outputs]` by rows, then biases, layer by layer.

use serde::{Deserialize, Serialize};

/// Numbers in an action.
pub const ACTIONS: usize = 2;

/// Sizes and rates of a learner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Steps in a batch.
    pub rows: usize,
    /// Numbers that the actor sees.
    pub inputs: usize,
    /// Numbers that the critics see beside the actions, which begin with those.
    pub state: usize,
    /// Units in each hidden layer.
    pub hidden: usize,
    /// Whether the critics' loss is Huber's; else it is the squared difference.
    pub huber: bool,
    /// Discount per step.
    pub gamma: f32,
    /// Share of a critic that its slow copy takes over in an update.
    pub tau: f32,
    /// Target entropy of the temperature, nats.
    pub target_entropy: f64,
    /// Adam's step size.
    pub learning_rate: f64,
}

impl Shape {
    /// Parameters of the actor.
    pub fn actor(&self) -> usize {
        (self.inputs + 1) * self.hidden + (self.hidden + 1) * (self.hidden + 2 * ACTIONS)
    }

    /// Parameters of one critic.
    pub fn critic(&self) -> usize {
        (self.state + ACTIONS + 1) * self.hidden + (self.hidden + 1) * (self.hidden + 1)
    }

    /// Numbers of a batch with its noise ([`Drawn`]).
    pub fn drawn(&self) -> usize {
        self.rows * (2 * self.state + ACTIONS + 2 + 2 * ACTIONS)
    }
}

/// The learnable state of a training.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Learned {
    /// Actor's parameters, and Adam's two means of their gradient.
    pub actor: [Vec<f32>; 3],
    /// Both critics' parameters, one after the other, likewise.
    pub critics: [Vec<f32>; 3],
    /// The slow copies of the critics.
    pub targets: Vec<f32>,
    /// Logarithm of the temperature, likewise.
    pub log_alpha: [f32; 3],
    /// Steps of Adam so far: of the critics, and of actor and temperature.
    pub steps: [u64; 2],
}

/// The batch of one update.
#[derive(Debug, Clone, Copy)]
pub struct Drawn<'a> {
    /// `[rows, state + 2]`: observations, parameters, actions.
    pub now: &'a [f32],
    /// `[rows, state]`: next observations and parameters.
    pub next: &'a [f32],
    /// `[rows]`.
    pub reward: &'a [f32],
    /// `[rows]`: 0 where the episode ended.
    pub goes_on: &'a [f32],
    /// `[2, rows, 2]` standard normal numbers: for the next actions, then for the present ones.
    pub noise: &'a [f32],
}

/// Losses and statistics of one update.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Losses {
    /// Loss of both critics.
    pub critic: f64,
    /// Loss of the actor.
    pub actor: f64,
    /// Entropy of the policy, nats.
    pub entropy: f64,
    /// Temperature before the update.
    pub alpha: f64,
}
