//! The gradients of an update, by libtorch.

use super::networks::{Networks, Seen};
use super::recurrent::Course;
use super::replay::Batch;
use super::sac::{Blocks, Differentiate, Drawn, actor_loss, critic_loss, squash, td_target};
use flip_policy::OUTPUTS;
use tch::Tensor;

/// A batch as tensors.
#[derive(Debug)]
pub(super) struct ByLibtorch<'a> {
    networks: &'a Networks,
    pub now: Seen,
    pub action: Tensor,
    pub next: Seen,
    /// `[2, rows, 2]`.
    pub noise: Tensor,
}

impl<'a> ByLibtorch<'a> {
    /// Converts a batch to tensors: observations and actions, next observations, and noise.
    pub(super) fn new(networks: &'a Networks, batch: &Batch, noise: &[f32]) -> Self {
        // Set on every thread that ever updates: libtorch stores the number per thread, and one is
        // reproducible.
        tch::set_num_threads(1);
        let n = batch.reward.len() as i64;
        let now = Tensor::from_slice(&batch.now).view([n, -1]);
        let next = Tensor::from_slice(&batch.next).view([n, -1]);
        let state = next.size()[1];
        let action = now.narrow(1, state, OUTPUTS as i64);
        let [before, after] = match (networks, &batch.courses) {
            (Networks::Recurrent { actor, .. }, Some(courses)) => {
                Course::pair(courses, actor).map(Some)
            }
            _ => [None, None],
        };
        Self {
            networks,
            now: Seen { rows: now.narrow(1, 0, state), course: before },
            action,
            next: Seen { rows: next, course: after },
            noise: Tensor::from_slice(noise).view([2, -1, OUTPUTS as i64]),
        }
    }

    /// The critics' targets, from the target networks: `[rows]`.
    pub(super) fn target(&self, of: Blocks, drawn: Drawn) -> Tensor {
        let Drawn { batch, alpha, settings, .. } = drawn;
        let actor = Tensor::from_slice(of.actor);
        let head = self.networks.head(&actor, &self.next);
        let (action, log_prob) = squash(&head, &self.noise.get(0));
        let targets = Tensor::from_slice(of.targets).view([2, -1]);
        let next_q = self.networks.values(&targets, &self.next, &action);
        let (reward, goes_on) =
            (Tensor::from_slice(&batch.reward), Tensor::from_slice(&batch.goes_on));
        td_target(&reward, &goes_on, &next_q, &log_prob, alpha, settings.gamma)
    }
}

impl Differentiate for ByLibtorch<'_> {
    fn critics(&mut self, of: Blocks, drawn: Drawn, gradient: &mut Vec<f32>) -> f64 {
        let y = tch::no_grad(|| self.target(of, drawn));
        let critics = Tensor::from_slice(of.critics).view([2, -1]).set_requires_grad(true);
        let q = self.networks.values(&critics, &self.now, &self.action);
        let loss = critic_loss(&q, &y, drawn.settings.critic_loss);
        gradient_of(&loss, &critics, gradient);
        loss.double_value(&[])
    }

    fn actor(&mut self, of: Blocks, drawn: Drawn, gradient: Option<&mut Vec<f32>>) -> (f64, f64) {
        let actor = Tensor::from_slice(of.actor).set_requires_grad(true);
        let head = self.networks.head(&actor, &self.now);
        let (action, log_prob) = squash(&head, &self.noise.get(1));
        let critics = Tensor::from_slice(of.critics).view([2, -1]);
        let q = self.networks.values(&critics, &self.now, &action);
        let loss = actor_loss(&q, &log_prob, drawn.alpha);
        let mean_log_prob = log_prob.mean(None).double_value(&[]);
        if let Some(gradient) = gradient {
            gradient_of(&loss, &actor, gradient);
        }
        (loss.double_value(&[]), mean_log_prob)
    }
}

/// The gradient of a scalar with respect to one block, flat.
fn gradient_of(loss: &Tensor, block: &Tensor, flat: &mut Vec<f32>) {
    let gradient = &Tensor::run_backward(&[loss], &[block], false, false)[0];
    flat.resize(gradient.numel(), 0.0);
    gradient.contiguous().copy_data(flat, gradient.numel());
}
