//! The networks' forward passes on flat blocks of parameters.
//!
//! A small network's time goes into dispatching tensor operations, not into arithmetic. So a network is one flat f32 block
//! (cut into views by a single operation, with a single backward), and both critics are computed by one batched product.
//! Feed-forward with two hidden layers; the recurrent network of the prior work is a later step of the project.

use rand::{Rng, RngExt};
use tch::Tensor;

/// Initial parameters of `copies` networks of these widths, one after another: uniform in +-1 / sqrt(inputs), libtorch's
/// own initialisation of linear layers, with the last layer scaled down so that first outputs are near zero.
pub fn initialise(widths: &[usize], copies: usize, rng: &mut impl Rng) -> Vec<f32> {
    let mut flat = Vec::new();
    for _ in 0..copies {
        for (depth, pair) in widths.windows(2).enumerate() {
            let last = depth + 2 == widths.len();
            let bound = if last { 3e-3 } else { 1.0 / (pair[0] as f32).sqrt() };
            flat.extend((0..(pair[0] + 1) * pair[1]).map(|_| bound * (2.0 * rng.random::<f32>() - 1.0)));
        }
    }
    flat
}

/// Lengths of a network's blocks: weight, bias, weight, bias...
fn blocks(widths: &[usize]) -> Vec<i64> {
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

/// Two networks of the same shape at once: `flat` `[2, parameters]`, `x` `[batch, widths[0]]` -> `[2, batch]`.
pub fn forward_twins(flat: &Tensor, widths: &[usize], x: &Tensor) -> Tensor {
    let parts = flat.split_with_sizes(blocks(widths), 1);
    let mut y = x.unsqueeze(0).expand([2, -1, -1], false);
    for (depth, w) in widths.windows(2).enumerate() {
        let weight = parts[2 * depth].view([2, w[0] as i64, w[1] as i64]);
        let bias = parts[2 * depth + 1].view([2, 1, w[1] as i64]);
        y = bias.baddbmm(&y, &weight, 1.0, 1.0);
        if depth + 2 < widths.len() {
            y = y.relu_();
        }
    }
    y.squeeze_dim(2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::{Actor, Encoding};
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn the_pure_forward_pass_equals_libtorchs() {
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        for (encoding, hidden) in [(Encoding::Missing, 128), (Encoding::Paper, 128), (Encoding::Missing, 7)] {
            let widths = [encoding.width(), hidden, hidden, 4];
            // Weights as large as a trained network's: uniform, not scaled down in the last layer.
            let flat: Vec<f32> =
                (0..Actor::flat_len(&widths)).map(|_| 0.3 * (2.0 * rng.random::<f32>() - 1.0)).collect();
            let actor = Actor::from_flat(encoding, &widths, &flat).unwrap();
            for _ in 0..20 {
                let x: Vec<f32> = (0..widths[0]).map(|_| 4.0 * rng.random::<f32>() - 2.0).collect();
                let y = forward(&Tensor::from_slice(&flat), &widths, &Tensor::from_slice(&x).unsqueeze(0));
                let y = Vec::<f32>::try_from(y.squeeze_dim(0)).unwrap();
                let head = actor.forward(&x);
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
        let flat = initialise(&widths, 2, &mut rng);
        let x = Tensor::from_slice(&[0.3f32, -1.0, 0.5, 2.0, 0.1, 1.0, 0.0, -0.5, 0.2, 0.9]).view([2, 5]);
        let both = Tensor::from_slice(&flat).view([2, -1]);
        let twins = forward_twins(&both, &widths, &x);
        for k in 0..2 {
            let one = forward(&both.get(k), &widths, &x).squeeze_dim(1);
            assert!(f64::try_from((twins.get(k) - one).abs().max()).unwrap() < 1e-7);
        }
    }
}
