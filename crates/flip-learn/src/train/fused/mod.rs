//! The gradients of an update, by our own code.
//!
//! libtorch computes them operation by operation, each on tensors that it allocates and dispatches.
//! Here both passes are written out on slices, in room that is allocated once. What they compute is
//! defined by the losses of [`super::sac`] and the networks of [`super::networks`] and
//! [`super::recurrent`], which stay the reference: the tests compare every gradient with libtorch's.
//!
//! The bits are the same on every processor and at any number of threads ([`lanes`], [`product`],
//! [`curves`]). They are not libtorch's, which adds up in another order, itself one that depends on
//! the processor.

mod curves;
mod dense;
mod lanes;
mod memory;
mod network;
mod product;
mod squash;
mod steps;

use super::networks::Networks;
use super::replay::Batch;
use super::sac::{Blocks, Differentiate, Drawn};
use super::settings::{CriticLoss, Settings};
pub(super) use curves::exponential;
use dense::Kit;
use flip_policy::OUTPUTS;
use lanes::Path;
use network::{Episodes, Head, Network, Recalled, When};
use product::View;
use squash::Squashed;
pub(super) use steps::{Approach, Descent};

/// Computes the gradients of an update; keeps its room between updates, and nothing else.
#[derive(Debug)]
pub(super) struct Fused {
    kit: Kit,
    actor: Network,
    critic: Network,
    /// The actor before the steps, and after them.
    actor_recalled: [Recalled; 2],
    actor_heads: [Head; 2],
    /// The critic that computes, and the heads of both.
    critic_recalled: Recalled,
    critic_heads: [Head; 2],
    squashed: Squashed,
    /// Observations and parameters with actions that the actor would take, `[rows, inputs + 9 + 2]`.
    with_actions: Vec<f32>,
    /// Values by both critics, `[rows]` each.
    values: [Vec<f32>; 2],
    /// The critics' targets, `[rows]`.
    y: Vec<f32>,
    /// Gradient for a network's outputs.
    outputs_back: Vec<f32>,
    /// Gradient for the actions by either critic, `[rows, 2]`.
    actions_back: [Vec<f32>; 2],
}

impl Fused {
    /// Room for these networks, on the widest vectors that the processor has.
    pub(super) fn new(networks: &Networks) -> Self {
        Self::on(Path::best(), networks)
    }

    fn on(path: Path, networks: &Networks) -> Self {
        let (actor, critic) = match networks {
            Networks::FeedForward { actor, critic } => {
                (Network::feed_forward(actor), Network::feed_forward(critic))
            }
            Networks::Recurrent { actor, critic } => {
                (Network::recurrent(actor), Network::recurrent(critic))
            }
        };
        Self {
            kit: Kit::new(path),
            actor,
            critic,
            actor_recalled: Default::default(),
            actor_heads: Default::default(),
            critic_recalled: Recalled::default(),
            critic_heads: Default::default(),
            squashed: Squashed::default(),
            with_actions: Vec::new(),
            values: Default::default(),
            y: Vec::new(),
            outputs_back: Vec::new(),
            actions_back: Default::default(),
        }
    }

    /// The episodes of a batch for recurrent networks.
    fn episodes<'a>(&self, batch: &'a Batch) -> Option<Episodes<'a>> {
        let courses = batch.courses.as_ref().filter(|courses| courses.episodes > 0)?;
        let width = match &self.actor {
            Network::FeedForward(_) => return None,
            Network::Recurrent(net) => net.recalls(),
        };
        let count = courses.episodes;
        let state = |stored: &'a Vec<f32>| View::new(stored, count, stored.len() / count);
        Some(Episodes {
            inputs: View::new(&courses.inputs, courses.inputs.len() / width, width),
            count,
            stored: courses.stored.as_ref().map(state),
            at: &courses.at,
        })
    }

    /// Puts the squashed actions behind these observations and parameters.
    fn act_in(&mut self, states: View) {
        self.with_actions.clear();
        for row in 0..states.rows {
            let from = row * states.down;
            self.with_actions.extend(&states.data[from..from + states.columns]);
            self.with_actions.extend(self.squashed.action.iter().map(|action| action[row]));
        }
    }

    /// Values of the squashed actions by the `k`-th critic of these parameters.
    fn value(&mut self, flat: &[f32], when: When, episodes: Option<Episodes>, of: Shape, k: usize) {
        let seen = (View::new(&self.with_actions, of.rows, of.state + OUTPUTS), when);
        let (recalled, head) = (&mut self.critic_recalled, &mut self.critic_heads[k]);
        self.critic.forward(&mut self.kit, flat, seen, episodes, (recalled, head));
        self.values[k].clear();
        self.values[k].extend(self.critic_heads[k].outputs());
    }

    /// The critics' targets from the values of the next actions, as [`super::sac::td_target`].
    fn target(&mut self, drawn: Drawn) {
        let Drawn { batch, alpha, settings, .. } = drawn;
        let (alpha, gamma) = (alpha as f32, settings.gamma as f32);
        let [a, b] = &self.values;
        self.y.clear();
        self.y.extend((0..batch.reward.len()).map(|row| {
            let least = if b[row] < a[row] { b[row] } else { a[row] };
            let value = least - self.squashed.log_prob[row] * alpha;
            batch.reward[row] + batch.goes_on[row] * value * gamma
        }));
    }
}

impl Differentiate for Fused {
    fn critics(&mut self, of: Blocks, drawn: Drawn, gradient: &mut Vec<f32>) -> f64 {
        let Drawn { batch, noise, settings, .. } = drawn;
        let sizes = Shape::of(batch);
        let (rows, next) = (sizes.rows, View::new(&batch.next, sizes.rows, sizes.state));
        let now = View::new(&batch.now, rows, sizes.state + OUTPUTS);
        let episodes = self.episodes(batch);
        let inputs = settings.encoding.width();
        self.actor.forward_both(
            &mut self.kit,
            of.actor,
            [now.some_columns(0, inputs), next.some_columns(0, inputs)],
            episodes,
            (&mut self.actor_recalled, &mut self.actor_heads),
        );
        let noise = &noise[..rows * OUTPUTS];
        self.squashed.compute(self.kit.path, self.actor_heads[1].outputs(), noise);
        self.act_in(next);
        let of_one = self.critic.parameters();
        for k in 0..2 {
            self.value(&of.targets[k * of_one..][..of_one], When::After, episodes, sizes, k);
        }
        self.target(drawn);

        gradient.resize(2 * of_one, 0.0);
        let mut loss = 0.0;
        for k in 0..2 {
            let flat = &of.critics[k * of_one..][..of_one];
            let (recalled, head) = (&mut self.critic_recalled, &mut self.critic_heads[k]);
            let seen = (now, When::Before);
            self.critic.forward(&mut self.kit, flat, seen, episodes, (recalled, head));
            loss += differences(head.outputs(), &self.y, settings, &mut self.outputs_back);
            self.critic.backward(
                &mut self.kit,
                flat,
                now,
                episodes,
                (recalled, head),
                (&self.outputs_back, &mut gradient[k * of_one..][..of_one]),
            );
        }
        loss / (2 * rows) as f64
    }

    fn actor(&mut self, of: Blocks, drawn: Drawn, gradient: Option<&mut Vec<f32>>) -> (f64, f64) {
        let Drawn { batch, noise, alpha, settings } = drawn;
        let sizes = Shape::of(batch);
        let (rows, state) = (sizes.rows, sizes.state);
        let now = View::new(&batch.now, rows, state + OUTPUTS);
        let episodes = self.episodes(batch);
        let noise = &noise[rows * OUTPUTS..];
        self.squashed.compute(self.kit.path, self.actor_heads[0].outputs(), noise);
        self.act_in(now.some_columns(0, state));
        let of_one = self.critic.parameters();
        for k in 0..2 {
            self.value(&of.critics[k * of_one..][..of_one], When::Before, episodes, sizes, k);
        }
        let mean = |sum: f64| sum / rows as f64;
        let [a, b] = &self.values;
        let least = a.iter().zip(b).map(|(a, b)| f64::from(a.min(*b)));
        let log_probs = self.squashed.log_prob.iter().map(|x| f64::from(*x));
        let loss = log_probs.clone().zip(least).map(|(log_prob, q)| log_prob * alpha - q).sum();
        let result = (mean(loss), mean(log_probs.sum()));
        let Some(gradient) = gradient else {
            return result;
        };

        for k in 0..2 {
            // Only the smaller value counts; equal ones share it.
            let (own, other) = (&self.values[k], &self.values[1 - k]);
            let share = |(own, other): (&f32, &f32)| match own == other {
                true => -0.5 / rows as f32,
                false if other < own => 0.0,
                false => -1.0 / rows as f32,
            };
            self.outputs_back.clear();
            self.outputs_back.extend(own.iter().zip(other).map(share));
            self.actions_back[k].resize(rows * OUTPUTS, 0.0);
            let seen = View::new(&self.with_actions, rows, state + OUTPUTS);
            self.critic.back_to_inputs(
                &mut self.kit,
                &of.critics[k * of_one..][..of_one],
                seen,
                &mut self.critic_heads[k],
                (&self.outputs_back, &mut self.actions_back[k]),
                (state, OUTPUTS),
            );
        }
        let [first, second] = &mut self.actions_back;
        first.iter_mut().zip(second).for_each(|(sum, other)| *sum += *other);
        self.outputs_back.resize(rows * 2 * OUTPUTS, 0.0);
        let weight = (alpha / rows as f64) as f32;
        self.squashed.backward(weight, first, &mut self.outputs_back);
        gradient.resize(self.actor.parameters(), 0.0);
        let [recalled, _] = &mut self.actor_recalled;
        let [head, _] = &mut self.actor_heads;
        self.actor.backward(
            &mut self.kit,
            of.actor,
            now.some_columns(0, settings.encoding.width()),
            episodes,
            (recalled, head),
            (&self.outputs_back, gradient),
        );
        result
    }
}

/// Sizes of a batch: rows, and numbers in an observation with parameters.
#[derive(Debug, Clone, Copy)]
struct Shape {
    rows: usize,
    state: usize,
}

impl Shape {
    fn of(batch: &Batch) -> Self {
        let rows = batch.reward.len();
        Self { rows, state: batch.next.len() / rows.max(1) }
    }
}

/// One critic's part of [`super::sac::critic_loss`], as a sum over its rows that is still to be
/// divided by twice their number; writes the gradient for its values.
fn differences(q: &[f32], y: &[f32], settings: &Settings, back: &mut Vec<f32>) -> f64 {
    let rows = q.len() as f32;
    let difference = q.iter().zip(y).map(|(q, y)| q - y);
    back.clear();
    match settings.critic_loss {
        CriticLoss::Squared => {
            back.extend(difference.clone().map(|d| d / rows));
            difference.map(|d| f64::from(d * d)).sum()
        }
        CriticLoss::Huber => {
            back.extend(difference.clone().map(|d| d.clamp(-1.0, 1.0) / rows));
            let of = |d: f32| if d.abs() < 1.0 { d * d } else { 2.0 * d.abs() - 1.0 };
            difference.map(|d| f64::from(of(d))).sum()
        }
    }
}

#[cfg(test)]
#[path = "fused_tests.rs"]
mod tests;
