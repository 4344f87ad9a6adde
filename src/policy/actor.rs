//! The network of a learned policy, run forward in plain Rust.

use super::observation::{Encoding, Observation};
use crate::domain::bench::Action;
use rand::{Rng, RngExt};

/// Outputs of a policy: incline change and shake amplitude, each in -1..=1.
pub const OUTPUTS: usize = 2;
/// Lower clamp of the logarithm of the standard deviation (Haarnoja's code, and the prior work's).
pub const LOG_STD_MIN: f32 = -20.0;
/// Upper clamp of the logarithm of the standard deviation.
pub const LOG_STD_MAX: f32 = 2.0;

/// A squashed Gaussian policy: a multilayer perceptron with ReLU between its layers.
///
/// ```text
/// (mean, log_std) = MLP(encode(observation))       a = tanh(mean + exp(log_std) * noise),  noise ~ N(0, 1)
/// ```
///
/// Numerics: f32 weights, f64 sums, so that the result agrees with libtorch's to about 1e-6.
#[derive(Debug, Clone, PartialEq)]
pub struct Actor {
    encoding: Encoding,
    layers: Vec<Layer>,
}

/// One affine layer: `y[k] = bias[k] + sum_j weight[j * outputs + k] x[j]`.
#[derive(Debug, Clone, PartialEq)]
struct Layer {
    inputs: usize,
    outputs: usize,
    weight: Vec<f32>,
    bias: Vec<f32>,
}

/// The Gaussian before squashing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Head {
    /// Means.
    pub mean: [f32; OUTPUTS],
    /// Logarithms of the standard deviations, clamped.
    pub log_std: [f32; OUTPUTS],
}

/// Weights that are no actor.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("these weights are no actor: {0}")]
pub struct Malformed(pub String);

impl Actor {
    /// An actor from one flat block of weights: for each layer its weight `[inputs, outputs]` by rows, then its bias.
    ///
    /// `widths` are the sizes from the inputs to the outputs, e.g. `[4, 128, 128, 4]`; the last is [`OUTPUTS`] means and
    /// as many log standard deviations.
    ///
    /// # Errors
    /// [`Malformed`] when the widths do not fit the encoding, the block has another length, or a weight is not finite.
    pub fn from_flat(encoding: Encoding, widths: &[usize], flat: &[f32]) -> Result<Self, Malformed> {
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
        if flat.len() != Self::flat_len(widths) {
            return refuse(format!("widths {widths:?} need {} weights, got {}", Self::flat_len(widths), flat.len()));
        }
        if let Some(index) = flat.iter().position(|w| !w.is_finite()) {
            return refuse(format!("weight {index} is not a finite number"));
        }
        let mut rest = flat;
        let mut take = |count: usize| {
            let (head, tail) = rest.split_at(count);
            rest = tail;
            head.to_vec()
        };
        let layers = widths
            .windows(2)
            .map(|w| Layer { inputs: w[0], outputs: w[1], weight: take(w[0] * w[1]), bias: take(w[1]) })
            .collect();
        Ok(Self { encoding, layers })
    }

    /// Number of weights of a network with these widths.
    pub fn flat_len(widths: &[usize]) -> usize {
        widths.windows(2).map(|w| (w[0] + 1) * w[1]).sum()
    }

    /// A randomly initialised actor: what a policy is before any training.
    ///
    /// Weights and biases are uniform in +-1 / sqrt(inputs), as libtorch initialises its linear layers.
    pub fn untrained(encoding: Encoding, hidden: &[usize], rng: &mut impl Rng) -> Self {
        let widths: Vec<usize> = [&[encoding.width()], hidden, &[2 * OUTPUTS]].concat();
        let mut flat = Vec::with_capacity(Self::flat_len(&widths));
        for pair in widths.windows(2) {
            let bound = 1.0 / (pair[0] as f32).sqrt();
            flat.extend((0..(pair[0] + 1) * pair[1]).map(|_| bound * (2.0 * rng.random::<f32>() - 1.0)));
        }
        Self::from_flat(encoding, &widths, &flat).expect("widths and weights are made to fit")
    }

    /// How observations become inputs.
    pub fn encoding(&self) -> Encoding {
        self.encoding
    }

    /// Sizes from the inputs to the outputs.
    pub fn widths(&self) -> Vec<usize> {
        let mut widths = vec![self.layers[0].inputs];
        widths.extend(self.layers.iter().map(|layer| layer.outputs));
        widths
    }

    /// The weights in the order of [`Actor::from_flat`].
    pub fn to_flat(&self) -> Vec<f32> {
        self.layers.iter().flat_map(|layer| layer.weight.iter().chain(&layer.bias)).copied().collect()
    }

    /// The Gaussian over unsquashed actions for these inputs.
    ///
    /// # Panics
    /// When `inputs` is not as long as the first layer is wide.
    pub fn forward(&self, inputs: &[f32]) -> Head {
        assert_eq!(inputs.len(), self.layers[0].inputs);
        let mut x = inputs.to_vec();
        let last = self.layers.len() - 1;
        for (depth, layer) in self.layers.iter().enumerate() {
            let mut y: Vec<f64> = layer.bias.iter().map(|&b| f64::from(b)).collect();
            for (&xj, row) in x.iter().zip(layer.weight.chunks_exact(layer.outputs)) {
                for (yk, &w) in y.iter_mut().zip(row) {
                    *yk += f64::from(xj) * f64::from(w);
                }
            }
            x = y.into_iter().map(|v| if depth < last { v.max(0.0) as f32 } else { v as f32 }).collect();
        }
        Head {
            mean: std::array::from_fn(|k| x[k]),
            log_std: std::array::from_fn(|k| x[OUTPUTS + k].clamp(LOG_STD_MIN, LOG_STD_MAX)),
        }
    }

    /// The action at the centre of the policy, for weighing: `tanh(mean)`.
    pub fn act(&self, observation: &Observation) -> Action {
        let head = self.forward(&observation.encode(self.encoding));
        Action::from_unit(head.mean.map(|mean| f64::from(mean.tanh())))
    }

    /// A drawn action in -1..=1, for exploring: `tanh(mean + std * noise)`. Two normal numbers are consumed.
    pub fn sample(&self, observation: &Observation, rng: &mut impl Rng) -> [f32; OUTPUTS] {
        let head = self.forward(&observation.encode(self.encoding));
        std::array::from_fn(|k| (head.mean[k] + head.log_std[k].exp() * normal(rng)).tanh())
    }
}

/// A standard normal number (Box and Muller 1958); two uniform numbers are consumed.
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
        // Four inputs straight to four outputs: mean0 = 2 x0 + 1, mean1 = -x3, log_std0 = 5 (clamped to 2), log_std1 = -3.
        let mut flat = vec![0.0; Actor::flat_len(&[4, 4])];
        flat[0] = 2.0;
        flat[3 * 4 + 1] = -1.0;
        flat[16..].copy_from_slice(&[1.0, 0.0, 5.0, -3.0]);
        let actor = Actor::from_flat(Encoding::Missing, &[4, 4], &flat).unwrap();
        let head = actor.forward(&[0.5, 9.0, 9.0, 0.25]);
        assert_eq!(head, Head { mean: [2.0, -0.25], log_std: [2.0, -3.0] });
        assert_eq!((actor.to_flat(), actor.widths()), (flat, vec![4, 4]));
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
        let samples: Vec<f32> = (0..2000).map(|_| actor.sample(&seen, &mut rng)[1]).collect();
        assert!(samples.iter().all(|a| (-1.0..=1.0).contains(a)));
        let below =
            samples.iter().filter(|&&a| a < actor.forward(&seen.encode(Encoding::Missing)).mean[1].tanh()).count();
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
