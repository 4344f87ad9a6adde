//! The networks' forward passes on flat blocks of parameters.
//!
//! A small network spends its time on dispatching tensor operations, not on arithmetic. Each
//! network is therefore one flat f32 block (split into views by a single operation, with a single
//! backward pass), and both critics are computed by one batched product.

use super::recurrent::{self, Course};
use super::settings::{Network, Settings};
use flip_core::domain::parameters::COUNT;
use flip_policy::{Actor, Encoding, OUTPUTS};
use rand::{Rng, RngExt};
use tch::Tensor;

/// The networks to train, by their layer sizes.
#[derive(Debug, Clone, PartialEq)]
pub enum Networks {
    /// Perceptrons; widths from the inputs to the outputs.
    FeedForward {
        /// Widths of the actor.
        actor: Vec<usize>,
        /// Widths of each critic.
        critic: Vec<usize>,
    },
    /// The prior work's recurrent networks.
    Recurrent {
        /// Sizes of the actor.
        actor: recurrent::Sizes,
        /// Sizes of each critic.
        critic: recurrent::Sizes,
    },
}

/// Inputs of the networks.
#[derive(Debug)]
pub struct Seen {
    /// `[rows, inputs + 9]`: encoded observations and the powder's parameters.
    pub rows: Tensor,
    /// The steps that led to each row; required by recurrent networks.
    pub course: Option<Course>,
}

/// Initial bound of the actor's last layer, so that first actions are near the middle.
const LAST_BOUND: f32 = 3e-3;

impl Networks {
    /// The networks for these settings.
    pub fn new(settings: &Settings) -> Self {
        let (inputs, hidden) = (settings.encoding.width(), settings.hidden as usize);
        let with_action = inputs + COUNT + OUTPUTS;
        match settings.network {
            Network::FeedForward => Self::FeedForward {
                actor: settings.actor_widths(),
                critic: vec![with_action, hidden, hidden, 1],
            },
            Network::Recurrent { .. } => {
                let recalled = inputs + OUTPUTS;
                let sizes = |seen, trunk| recurrent::Sizes { seen, recalled, hidden, trunk };
                Self::Recurrent {
                    actor: sizes(inputs, vec![2 * hidden, hidden, hidden, 2 * OUTPUTS]),
                    critic: sizes(with_action, vec![2 * hidden, hidden, 1]),
                }
            }
        }
    }

    /// Draws the parameters of a new actor, and of two critics one after the other.
    ///
    /// Uniform in +-1 / sqrt(inputs), libtorch's own initialisation of linear layers (+-1 /
    /// sqrt(hidden) in an LSTM), except for the last layer: +-3e-3, but not in the prior work's
    /// critics.
    pub fn initialise(&self, rng: &mut impl Rng) -> (Vec<f32>, Vec<f32>) {
        match self {
            Self::FeedForward { actor, critic } => (
                draw(&bounds(actor, LAST_BOUND), 1, rng),
                draw(&bounds(critic, LAST_BOUND), 2, rng),
            ),
            Self::Recurrent { actor, critic } => {
                let last = 1.0 / (critic.hidden as f32).sqrt();
                (draw(&actor.bounds(LAST_BOUND), 1, rng), draw(&critic.bounds(last), 2, rng))
            }
        }
    }

    /// The actor's outputs `[rows, 4]` for its parameters `[parameters]`.
    ///
    /// # Panics
    /// If a recurrent network is not given the preceding steps.
    pub fn head(&self, actor: &Tensor, seen: &Seen) -> Tensor {
        match self {
            Self::FeedForward { actor: widths, .. } => {
                forward(actor, widths, &seen.rows.narrow(1, 0, widths[0] as i64))
            }
            Self::Recurrent { actor: sizes, .. } => {
                let rows = seen.rows.narrow(1, 0, sizes.seen as i64);
                recurrent::forward(&actor.unsqueeze(0), sizes, &rows, course(seen)).squeeze_dim(0)
            }
        }
    }

    /// Values of these actions `[rows, 2]` from two critics with parameters `[2, parameters]`:
    /// `[2, rows]`.
    ///
    /// # Panics
    /// If a recurrent network is not given the preceding steps.
    pub fn values(&self, critics: &Tensor, seen: &Seen, action: &Tensor) -> Tensor {
        let rows = Tensor::cat(&[&seen.rows, action], 1);
        match self {
            Self::FeedForward { critic, .. } => forward_twins(critics, critic, &rows),
            Self::Recurrent { critic, .. } => {
                recurrent::forward(critics, critic, &rows, course(seen)).squeeze_dim(2)
            }
        }
    }

    /// Builds the actor with these parameters in plain Rust; `None` if one of them is not finite.
    pub fn snapshot(&self, encoding: Encoding, actor: &[f32]) -> Option<Actor> {
        match self {
            Self::FeedForward { actor: widths, .. } => {
                Actor::from_flat(encoding, widths, actor).ok()
            }
            Self::Recurrent { actor: sizes, .. } => {
                Actor::recurrent(encoding, sizes.hidden, actor).ok()
            }
        }
    }
}

fn course(seen: &Seen) -> &Course {
    seen.course.as_ref().expect("a recurrent network is given courses")
}

/// The number of parameters of each layer, and the bound within which they are drawn.
pub(super) fn bounds(widths: &[usize], last_bound: f32) -> Vec<(usize, f32)> {
    let of = |(depth, w): (usize, &[usize])| {
        let last = depth + 2 == widths.len();
        ((w[0] + 1) * w[1], if last { last_bound } else { 1.0 / (w[0] as f32).sqrt() })
    };
    widths.windows(2).enumerate().map(of).collect()
}

/// Draws the parameters of `copies` networks, one after another.
fn draw(bounds: &[(usize, f32)], copies: usize, rng: &mut impl Rng) -> Vec<f32> {
    let mut flat = Vec::new();
    for _ in 0..copies {
        for &(count, bound) in bounds {
            flat.extend((0..count).map(|_| bound * (2.0 * rng.random::<f32>() - 1.0)));
        }
    }
    flat
}

/// Lengths of a network's blocks: weight, bias, weight, bias...
pub(super) fn blocks(widths: &[usize]) -> Vec<i64> {
    widths.windows(2).flat_map(|w| [(w[0] * w[1]) as i64, w[1] as i64]).collect()
}

/// One network: `flat` `[parameters]`, `x` `[batch, widths[0]]` -> `[batch, widths[last]]`.
pub fn forward(flat: &Tensor, widths: &[usize], x: &Tensor) -> Tensor {
    let parts = flat.split_with_sizes(blocks(widths), 0);
    let mut y = x.shallow_clone();
    for (depth, w) in widths.windows(2).enumerate() {
        let weight = parts[2 * depth].view([w[0] as i64, w[1] as i64]);
        y = parts[2 * depth + 1].addmm(&y, &weight);
        if depth + 2 < widths.len() {
            y = y.relu_();
        }
    }
    y
}

/// Two networks of the same shape at once: `flat` `[2, parameters]`, `x` `[batch, widths[0]]` ->
/// `[2, batch]`.
pub fn forward_twins(flat: &Tensor, widths: &[usize], x: &Tensor) -> Tensor {
    let parts = flat.split_with_sizes(blocks(widths), 1);
    perceptrons(&parts, widths, x.unsqueeze(0).expand([2, -1, -1], false)).squeeze_dim(2)
}

/// `n` perceptrons at once: weights and biases `[n, ...]`, `x` `[n, batch, widths[0]]` ->
/// `[n, batch, widths[last]]`.
pub(super) fn perceptrons(parts: &[Tensor], widths: &[usize], x: Tensor) -> Tensor {
    let mut y = x;
    for (depth, w) in widths.windows(2).enumerate() {
        let weight = parts[2 * depth].view([-1, w[0] as i64, w[1] as i64]);
        let bias = parts[2 * depth + 1].view([-1, 1, w[1] as i64]);
        y = bias.baddbmm(&y, &weight, 1.0, 1.0);
        if depth + 2 < widths.len() {
            y = y.relu_();
        }
    }
    y
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn the_pure_forward_pass_equals_libtorchs() {
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        for (encoding, hidden) in
            [(Encoding::Missing, 128), (Encoding::Paper, 128), (Encoding::Missing, 7)]
        {
            let widths = [encoding.width(), hidden, hidden, 4];
            // Weights as large as a trained network's: uniform, not scaled down in the last layer.
            let flat: Vec<f32> = (0..Actor::flat_len(&widths))
                .map(|_| 0.3 * (2.0 * rng.random::<f32>() - 1.0))
                .collect();
            let actor = Actor::from_flat(encoding, &widths, &flat).unwrap();
            for _ in 0..20 {
                let x: Vec<f32> = (0..widths[0]).map(|_| 4.0 * rng.random::<f32>() - 2.0).collect();
                let y = forward(
                    &Tensor::from_slice(&flat),
                    &widths,
                    &Tensor::from_slice(&x).unsqueeze(0),
                );
                let y = Vec::<f32>::try_from(y.squeeze_dim(0)).unwrap();
                let head = actor.forward(&x, &mut actor.begin());
                for (k, pure) in head.mean.iter().chain(&head.log_std).enumerate() {
                    let torch = if k < 2 { y[k] } else { y[k].clamp(-20.0, 2.0) };
                    assert!((pure - torch).abs() < 1e-5, "{pure} {torch}");
                }
            }
        }
    }

    #[test]
    fn twins_are_two_networks_side_by_side() {
        let mut rng = Pcg64Mcg::seed_from_u64(6);
        let widths = [5, 8, 8, 1];
        let flat = draw(&bounds(&widths, LAST_BOUND), 2, &mut rng);
        let x = Tensor::from_slice(&[0.3f32, -1.0, 0.5, 2.0, 0.1, 1.0, 0.0, -0.5, 0.2, 0.9])
            .view([2, 5]);
        let both = Tensor::from_slice(&flat).view([2, -1]);
        let twins = forward_twins(&both, &widths, &x);
        for k in 0..2 {
            let one = forward(&both.get(k), &widths, &x).squeeze_dim(1);
            assert!(f64::try_from((twins.get(k) - one).abs().max()).unwrap() < 1e-7);
        }
    }
}
