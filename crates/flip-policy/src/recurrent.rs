//! Inference of the prior work's recurrent network in plain Rust.

use super::actor::{Carried, Layer, OUTPUTS, flatten, perceptron, taker};
use serde::{Deserialize, Serialize};

/// Two branches that merge: one sees only the observation, the other has memory.
///
/// ```text
/// x = encode(observation),  a' = the action of the step before
/// y = relu(seen(x))                                          [hidden]
/// (i, f, g, o) = W relu(recalled(x, a')) + b + U h' + d      [hidden] each
/// c = sigmoid(f) c' + sigmoid(i) tanh(g),   h = sigmoid(o) tanh(c)
/// outputs = perceptron(y, h)
/// ```
///
/// The perceptron has widths `[2 hidden, hidden, hidden, 4]`, with ReLU between its layers. Gates
/// are in libtorch's order, `W` and `U` are `[4 hidden, hidden]` by rows as in libtorch, and h' =
/// c' = a' = 0 before the first step.
///
/// Source: the public code of Kadokawa et al., IROS 2023
/// (github.com/omron-sinicx/robotic-powder-weighing). There a' is random before the first step;
/// zeros are its mean, and keep a weighing deterministic.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Recurrent {
    seen: Layer,
    recalled: Layer,
    lstm: [Vec<f32>; 4],
    trunk: Vec<Layer>,
}

/// Names and shapes of its tensors in the order of the flat block, for observations of `inputs`
/// numbers.
pub(super) fn tensors(inputs: usize, hidden: usize) -> Vec<(String, Vec<usize>)> {
    let gates = 4 * hidden;
    let named = |name: &str, shape: &[usize]| (name.to_owned(), shape.to_vec());
    let mut tensors = vec![
        named("seen.weight", &[inputs, hidden]),
        named("seen.bias", &[hidden]),
        named("recalled.weight", &[inputs + OUTPUTS, hidden]),
        named("recalled.bias", &[hidden]),
        named("lstm.weight_input", &[gates, hidden]),
        named("lstm.weight_hidden", &[gates, hidden]),
        named("lstm.bias_input", &[gates]),
        named("lstm.bias_hidden", &[gates]),
    ];
    tensors.extend(layers(&trunk(hidden)));
    tensors
}

/// Names and shapes of a perceptron's tensors: `layer<k>.weight` `[inputs, outputs]` and
/// `layer<k>.bias`.
pub(super) fn layers(widths: &[usize]) -> Vec<(String, Vec<usize>)> {
    let of = |(k, w): (usize, &[usize])| {
        [(format!("layer{k}.weight"), w.to_vec()), (format!("layer{k}.bias"), vec![w[1]])]
    };
    widths.windows(2).enumerate().flat_map(of).collect()
}

/// Layer widths after the branches merge.
fn trunk(hidden: usize) -> [usize; 4] {
    [2 * hidden, hidden, hidden, 2 * OUTPUTS]
}

impl Recurrent {
    /// Builds the network from a block of the length required by [`tensors`].
    pub fn from_flat(inputs: usize, hidden: usize, flat: &[f32]) -> Self {
        let mut take = taker(flat);
        let gates = 4 * hidden;
        Self {
            seen: Layer::taken(inputs, hidden, &mut take),
            recalled: Layer::taken(inputs + OUTPUTS, hidden, &mut take),
            lstm: [gates * hidden, gates * hidden, gates, gates].map(&mut take),
            trunk: trunk(hidden).windows(2).map(|w| Layer::taken(w[0], w[1], &mut take)).collect(),
        }
    }

    /// Returns the weights as one flat block.
    pub fn to_flat(&self) -> Vec<f32> {
        let branches = flatten(&[self.seen.clone(), self.recalled.clone()]);
        [branches, self.lstm.concat(), flatten(&self.trunk)].concat()
    }

    /// Units of each branch.
    pub fn hidden(&self) -> usize {
        self.seen.outputs
    }

    /// Computes the outputs of one step, `[4]`; advances the LSTM state in `carried`.
    pub fn forward(&self, x: &[f32], carried: &mut Carried) -> Vec<f32> {
        let mut y = self.seen.relu(x);
        let recalled = self.recalled.relu(&[x, &carried.last_action].concat());
        self.advance(&recalled, &mut carried.lstm);
        y.extend(&carried.lstm[0]);
        perceptron(&self.trunk, &y)
    }

    /// Advances the LSTM by one step on its input `x`.
    fn advance(&self, x: &[f32], [h, c]: &mut [Vec<f32>; 2]) {
        let hidden = self.hidden();
        let dot = |row: &[f32], x: &[f32]| {
            row.iter().zip(x).map(|(&w, &x)| f64::from(w) * f64::from(x)).sum::<f64>()
        };
        let [w, u, b, d] = &self.lstm;
        let gate = |k: usize| {
            let row = k * hidden..(k + 1) * hidden;
            f64::from(b[k]) + f64::from(d[k]) + dot(&w[row.clone()], x) + dot(&u[row], h)
        };
        let gates: Vec<f64> = (0..4 * hidden).map(gate).collect();
        let sigmoid = |v: f64| 1.0 / (1.0 + (-v).exp());
        for k in 0..hidden {
            let [i, f, g, o] = [0, 1, 2, 3].map(|part| gates[part * hidden + k]);
            let cell = sigmoid(f) * f64::from(c[k]) + sigmoid(i) * g.tanh();
            c[k] = cell as f32;
            h[k] = (sigmoid(o) * cell.tanh()) as f32;
        }
    }
}
