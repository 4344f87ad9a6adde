//! Inference of a learned policy in plain Rust.

use super::manifest::Kind;
use super::observation::{Encoding, Known, Observation};
use super::recurrent::Recurrent;
use flip_core::domain::bench::Action;
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

/// Outputs of a policy: incline change and shake amplitude, each in -1..=1.
pub const OUTPUTS: usize = 2;
/// Lower clamp of the log standard deviation (Haarnoja's code, and the prior work's).
pub const LOG_STD_MIN: f32 = -20.0;
/// Upper clamp of the log standard deviation.
pub const LOG_STD_MAX: f32 = 2.0;

/// A squashed Gaussian policy.
///
/// ```text
/// (mean, log_std) = network(encode(observation), what came before)
/// a = tanh(mean + exp(log_std) * noise),  noise ~ N(0, 1)
/// ```
///
/// The network is a multilayer perceptron with ReLU between its layers, which ignores earlier
/// steps, or the recurrent one of [`Recurrent`]. Numerics: f32 weights, f64 sums, so that the
/// result agrees with libtorch's to about 1e-6.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Actor {
    encoding: Encoding,
    network: Network,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
enum Network {
    FeedForward(Vec<Layer>),
    Recurrent(Box<Recurrent>),
}

/// State an actor carries from one step of a weighing to the next; a feed-forward actor ignores it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Carried {
    /// The LSTM's output and cell, `hidden` numbers each; zeros before the first step.
    pub lstm: [Vec<f32>; 2],
    /// The previous action, in -1..=1; zeros before the first step.
    pub last_action: [f32; OUTPUTS],
    /// The previous reading, mg; 0, the tare, before the first step.
    pub last_reading_mg: f64,
    /// The powder's angle of repose, degrees, if measured.
    pub repose_deg: Option<f64>,
}

impl Carried {
    /// The LSTM's output followed by its cell, `[2 * hidden]`; empty for a feed-forward actor.
    pub fn to_flat(&self) -> Vec<f32> {
        self.lstm.concat()
    }
}

/// One affine layer: `y[k] = bias[k] + sum_j weight[j * outputs + k] x[j]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Layer {
    pub inputs: usize,
    pub outputs: usize,
    pub weight: Vec<f32>,
    pub bias: Vec<f32>,
}

impl Layer {
    /// Builds the next layer of this size from `take`, which hands out the flat block piece by
    /// piece.
    pub fn taken(inputs: usize, outputs: usize, take: &mut impl FnMut(usize) -> Vec<f32>) -> Self {
        Self { inputs, outputs, weight: take(inputs * outputs), bias: take(outputs) }
    }

    /// Computes `y` for these `inputs` numbers.
    pub fn sums(&self, x: &[f32]) -> Vec<f64> {
        let mut y: Vec<f64> = self.bias.iter().map(|&b| f64::from(b)).collect();
        for (&xj, row) in x.iter().zip(self.weight.chunks_exact(self.outputs)) {
            for (yk, &w) in y.iter_mut().zip(row) {
                *yk += f64::from(xj) * f64::from(w);
            }
        }
        y
    }

    /// Computes `max(y, 0)`.
    pub fn relu(&self, x: &[f32]) -> Vec<f32> {
        self.sums(x).into_iter().map(|v| v.max(0.0) as f32).collect()
    }
}

/// Applies the layers in sequence, with ReLU between them.
pub(super) fn perceptron(layers: &[Layer], inputs: &[f32]) -> Vec<f32> {
    let mut x = inputs.to_vec();
    for (depth, layer) in layers.iter().enumerate() {
        let last = depth + 1 == layers.len();
        x = if last {
            layer.sums(&x).into_iter().map(|v| v as f32).collect()
        } else {
            layer.relu(&x)
        };
    }
    x
}

/// The Gaussian over actions before squashing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Head {
    /// Means.
    pub mean: [f32; OUTPUTS],
    /// Log standard deviations, clamped.
    pub log_std: [f32; OUTPUTS],
}

/// The weights do not form an actor.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("these weights are no actor: {0}")]
pub struct Malformed(pub String);

impl Actor {
    /// Builds an actor from one flat block of weights: for each layer its weight
    /// `[inputs, outputs]` by rows, then its bias.
    ///
    /// `widths` are the layer sizes from the inputs to the outputs, e.g. `[4, 128, 128, 4]`; the
    /// last is [`OUTPUTS`] means and as many log standard deviations.
    ///
    /// # Errors
    /// [`Malformed`] when the widths do not fit the encoding, the block has another length, or a
    /// weight is not finite.
    pub fn from_flat(
        encoding: Encoding,
        widths: &[usize],
        flat: &[f32],
    ) -> Result<Self, Malformed> {
        let refuse = |text: String| Err(Malformed(text));
        if widths.len() < 2 || widths.len() > 9 || widths.iter().any(|&w| w == 0 || w > 4096) {
            return refuse(format!("widths {widths:?} must be 2 to 9 numbers from 1 to 4096"));
        }
        if widths[0] != encoding.width() {
            return refuse(format!(
                "the encoding gives {} inputs, the first layer takes {}",
                encoding.width(),
                widths[0]
            ));
        }
        if widths[widths.len() - 1] != 2 * OUTPUTS {
            return refuse(format!(
                "the last layer must have {} outputs, has {}",
                2 * OUTPUTS,
                widths[widths.len() - 1]
            ));
        }
        check_flat(flat, Self::flat_len(widths), &format!("widths {widths:?}"))?;
        let mut take = taker(flat);
        let layers = widths.windows(2).map(|w| Layer::taken(w[0], w[1], &mut take)).collect();
        Ok(Self { encoding, network: Network::FeedForward(layers) })
    }

    /// Builds the recurrent actor of width `hidden` from one flat block: the tensors of its kind
    /// ([`Kind::tensors`]), one after another.
    ///
    /// # Errors
    /// [`Malformed`] when the block has another length, a weight is not finite, or `hidden` is not
    /// from 1 to 4096.
    pub fn recurrent(encoding: Encoding, hidden: usize, flat: &[f32]) -> Result<Self, Malformed> {
        if !(1..=4096).contains(&hidden) {
            return Err(Malformed(format!("`hidden` must be from 1 to 4096, is {hidden}")));
        }
        let kind = Kind::Recurrent { encoding, hidden };
        let needed = kind.tensors().iter().map(|(_, shape)| shape.iter().product::<usize>()).sum();
        check_flat(flat, needed, &format!("{hidden} hidden units"))?;
        let network = Recurrent::from_flat(encoding.width(), hidden, flat);
        Ok(Self { encoding, network: Network::Recurrent(Box::new(network)) })
    }

    /// Number of weights of a network with these widths.
    pub fn flat_len(widths: &[usize]) -> usize {
        widths.windows(2).map(|w| (w[0] + 1) * w[1]).sum()
    }

    /// A randomly initialised actor: a policy before any training.
    ///
    /// Weights and biases are uniform in +-1 / sqrt(inputs), as libtorch initialises its linear
    /// layers.
    pub fn untrained(encoding: Encoding, hidden: &[usize], rng: &mut impl Rng) -> Self {
        let widths: Vec<usize> = [&[encoding.width()], hidden, &[2 * OUTPUTS]].concat();
        let mut flat = Vec::with_capacity(Self::flat_len(&widths));
        for pair in widths.windows(2) {
            let bound = 1.0 / (pair[0] as f32).sqrt();
            flat.extend(
                (0..(pair[0] + 1) * pair[1]).map(|_| bound * (2.0 * rng.random::<f32>() - 1.0)),
            );
        }
        Self::from_flat(encoding, &widths, &flat).expect("widths and weights are made to fit")
    }

    /// The actor's kind, as recorded in a manifest.
    pub fn kind(&self) -> Kind {
        let encoding = self.encoding;
        match &self.network {
            Network::FeedForward(layers) => {
                let widths = [encoding.width()]
                    .into_iter()
                    .chain(layers.iter().map(|layer| layer.outputs))
                    .collect();
                Kind::Learned { encoding, widths }
            }
            Network::Recurrent(network) => Kind::Recurrent { encoding, hidden: network.hidden() },
        }
    }

    /// The weights in the order of [`Actor::from_flat`] or [`Actor::recurrent`].
    pub fn to_flat(&self) -> Vec<f32> {
        match &self.network {
            Network::FeedForward(layers) => flatten(layers),
            Network::Recurrent(network) => network.to_flat(),
        }
    }

    /// The carried state before the first step of a weighing.
    pub fn begin(&self) -> Carried {
        match &self.network {
            Network::FeedForward(_) => Carried::default(),
            Network::Recurrent(network) => {
                let zeros = || vec![0.0; network.hidden()];
                Carried { lstm: [zeros(), zeros()], ..Carried::default() }
            }
        }
    }

    /// Whether its actions depend on the current observation alone.
    pub fn is_memoryless(&self) -> bool {
        matches!(self.network, Network::FeedForward(_)) && self.encoding.is_memoryless()
    }

    /// Computes the Gaussian over unsquashed actions for these inputs; advances the carried state
    /// by one step, except for its last action.
    ///
    /// # Panics
    /// If `inputs` does not match the width of the first layer, or `carried` belongs to another
    /// actor.
    pub fn forward(&self, inputs: &[f32], carried: &mut Carried) -> Head {
        assert_eq!(inputs.len(), self.encoding.width());
        let x = match &self.network {
            Network::FeedForward(layers) => perceptron(layers, inputs),
            Network::Recurrent(network) => network.forward(inputs, carried),
        };
        Head {
            mean: std::array::from_fn(|k| x[k]),
            log_std: std::array::from_fn(|k| x[OUTPUTS + k].clamp(LOG_STD_MIN, LOG_STD_MAX)),
        }
    }

    /// Computes the Gaussian for the current observation; advances the carried state, except for
    /// its last action.
    fn look(&self, observation: &Observation, carried: &mut Carried) -> Head {
        let known = Known {
            fell_mg: observation.reading_mg - carried.last_reading_mg,
            repose_deg: carried.repose_deg,
        };
        carried.last_reading_mg = observation.reading_mg;
        self.forward(&observation.encode(self.encoding, &known), carried)
    }

    /// Returns the action at the centre of the policy, for weighing: `tanh(mean)`. Call once per
    /// step.
    pub fn act(&self, observation: &Observation, carried: &mut Carried) -> Action {
        let head = self.look(observation, carried);
        carried.last_action = head.mean.map(f32::tanh);
        Action::from_unit(carried.last_action.map(f64::from))
    }

    /// Draws an action in -1..=1, for exploration: `tanh(mean + std * noise)`. Consumes two normal
    /// numbers.
    pub fn sample(
        &self,
        observation: &Observation,
        carried: &mut Carried,
        rng: &mut impl Rng,
    ) -> [f32; OUTPUTS] {
        let head = self.look(observation, carried);
        carried.last_action =
            std::array::from_fn(|k| (head.mean[k] + head.log_std[k].exp() * normal(rng)).tanh());
        carried.last_action
    }
}

/// The weights of these layers, one after another.
pub(super) fn flatten(layers: &[Layer]) -> Vec<f32> {
    layers.iter().flat_map(|layer| layer.weight.iter().chain(&layer.bias)).copied().collect()
}

/// Hands out a flat block piece by piece; it must be long enough.
pub(super) fn taker(flat: &[f32]) -> impl FnMut(usize) -> Vec<f32> {
    let mut rest = flat;
    move |count| {
        let (head, tail) = rest.split_at(count);
        rest = tail;
        head.to_vec()
    }
}

fn check_flat(flat: &[f32], needed: usize, of: &str) -> Result<(), Malformed> {
    if flat.len() != needed {
        return Err(Malformed(format!("{of} need {needed} weights, got {}", flat.len())));
    }
    match flat.iter().position(|w| !w.is_finite()) {
        Some(index) => Err(Malformed(format!("weight {index} is not a finite number"))),
        None => Ok(()),
    }
}

/// A standard normal number (Box and Muller 1958); consumes two uniform numbers.
pub fn normal(rng: &mut impl Rng) -> f32 {
    let radius = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    (radius * (std::f64::consts::TAU * rng.random::<f64>()).cos()) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn a_network_small_enough_to_do_by_hand() {
        // Four inputs straight to four outputs: mean0 = 2 x0 + 1, mean1 = -x3, log_std0 = 5
        // (clamped to 2), log_std1 = -3.
        let mut flat = vec![0.0; Actor::flat_len(&[4, 4])];
        flat[0] = 2.0;
        flat[3 * 4 + 1] = -1.0;
        flat[16..].copy_from_slice(&[1.0, 0.0, 5.0, -3.0]);
        let actor = Actor::from_flat(Encoding::Missing, &[4, 4], &flat).unwrap();
        let head = actor.forward(&[0.5, 9.0, 9.0, 0.25], &mut actor.begin());
        assert_eq!(head, Head { mean: [2.0, -0.25], log_std: [2.0, -3.0] });
        let kind = Kind::Learned { encoding: Encoding::Missing, widths: vec![4, 4] };
        assert_eq!((actor.to_flat(), actor.kind()), (flat, kind));
    }

    #[test]
    fn wrong_weights_are_refused_with_the_reason() {
        let check = |widths: &[usize], flat: Vec<f32>, part: &str| {
            let error = Actor::from_flat(Encoding::Missing, widths, &flat).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        };
        check(&[4], vec![], "2 to 9");
        check(&[4, 0, 4], vec![], "1 to 4096");
        check(&[3, 4], vec![0.0; 16], "encoding");
        check(&[4, 3], vec![0.0; 15], "outputs");
        check(&[4, 4], vec![0.0; 19], "need 20");
        check(&[4, 4], vec![f32::NAN; 20], "weight 0");
    }

    #[test]
    fn samples_scatter_about_the_action_and_stay_in_range() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let actor = Actor::untrained(Encoding::Missing, &[16], &mut rng);
        let seen = Observation { reading_mg: 2.0, target_mg: 10.0, pitch_deg: 5.0 };
        let samples: Vec<f32> =
            (0..2000).map(|_| actor.sample(&seen, &mut actor.begin(), &mut rng)[1]).collect();
        assert!(samples.iter().all(|a| (-1.0..=1.0).contains(a)));
        let centre = actor
            .forward(&seen.encode(Encoding::Missing, &Known::default()), &mut actor.begin())
            .mean[1]
            .tanh();
        let below = samples.iter().filter(|&&a| a < centre).count();
        // tanh keeps the median: 1000 +- 4 sd of 22.
        assert!((911..=1089).contains(&below), "{below} of 2000 below the median");
    }

    #[test]
    fn normal_numbers_have_mean_zero_and_variance_one() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let n = 20_000;
        let draws: Vec<f32> = (0..n).map(|_| normal(&mut rng)).collect();
        let mean = draws.iter().sum::<f32>() / n as f32;
        let variance = draws.iter().map(|x| x * x).sum::<f32>() / n as f32;
        // 4 standard errors: 4 / sqrt(n) and 4 sqrt(2 / n).
        assert!(mean.abs() < 0.028 && (variance - 1.0).abs() < 0.04, "{mean} {variance}");
    }
}
