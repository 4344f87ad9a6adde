//! Adam on one flat block of parameters.

use super::fused::Descent;

/// Adam's state for a block of parameters (Kingma and Ba 2015, algorithm 1).
///
/// ```text
/// m = b1 m + (1 - b1) g            v = b2 v + (1 - b2) g^2
/// theta -= lr * (m / (1 - b1^t)) / (sqrt(v / (1 - b2^t)) + eps)
/// ```
///
/// with b1 = 0.9, b2 = 0.999 and eps = 1e-8, libtorch's defaults. One loop over flat memory:
/// libtorch's optimiser keeps its moments out of a checkpoint's reach, and for small networks its
/// dispatch costs more than the arithmetic.
#[derive(Debug, Clone, PartialEq)]
pub struct Adam {
    /// Running mean of the gradient.
    pub m: Vec<f32>,
    /// Running mean of the squared gradient.
    pub v: Vec<f32>,
    /// Number of steps so far.
    pub t: u64,
}

const B1: f32 = 0.9;
const B2: f32 = 0.999;
const EPS: f32 = 1e-8;
/// Moments below this are flushed to zero. A unit that is never active has no gradient, and its
/// moments decay into denormals (below 1.2e-38), where they stay and each operation takes a hundred
/// cycles. A root of 1e-35 is lost next to `EPS` in single precision, and a mean of 1e-35 moves a
/// parameter by less than 1e-27 learning rates.
const TINY: f32 = 1e-35;

impl Adam {
    /// State for `parameters` parameters, before the first step.
    pub fn new(parameters: usize) -> Self {
        Self { m: vec![0.0; parameters], v: vec![0.0; parameters], t: 0 }
    }

    /// Takes one step of size `learning_rate` down `gradient`.
    ///
    /// # Panics
    /// If the lengths differ.
    pub fn step(&mut self, theta: &mut [f32], gradient: &[f32], learning_rate: f64) {
        assert!(theta.len() == self.m.len() && gradient.len() == self.m.len());
        self.t += 1;
        let correct1 = 1.0 - f64::from(B1).powf(self.t as f64);
        let correct2 = 1.0 - f64::from(B2).powf(self.t as f64);
        let size = (learning_rate / correct1) as f32;
        let scale = (1.0 / correct2.sqrt()) as f32;
        let Self { m, v, .. } = self;
        let decays = [B1, B2];
        Descent { theta, gradient, m, v, decays, size, scale, eps: EPS, tiny: TINY }.take_step();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn every_number_steps_as_the_formula_says_bit_for_bit() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        // A length that is no multiple of a vector's.
        let start: Vec<f32> = (0..45).map(|_| 2.0 * rng.random::<f32>() - 1.0).collect();
        let (mut theta, mut adam) = (start.clone(), Adam::new(start.len()));
        let (mut expected, mut m, mut v) = (start, [0.0f32; 45], [0.0f32; 45]);
        for t in 1..=50 {
            let gradient: Vec<f32> =
                (0..45).map(|k| (rng.random::<f32>() - 0.5) * 10f32.powi(8 - k)).collect();
            adam.step(&mut theta, &gradient, 3e-4);
            let correct = |decay: f32| 1.0 - f64::from(decay).powf(f64::from(t));
            let size = (3e-4 / correct(B1)) as f32;
            let scale = (1.0 / correct(B2).sqrt()) as f32;
            let flushed = |x: f32| if x.abs() < TINY { 0.0 } else { x };
            for (k, g) in gradient.iter().enumerate() {
                m[k] = flushed(B1 * m[k] + (1.0 - B1) * g);
                v[k] = flushed(B2 * v[k] + (1.0 - B2) * g * g);
                expected[k] -= size * m[k] / (v[k].sqrt() * scale + EPS);
            }
            assert_eq!((&theta, &adam.m, &adam.v), (&expected, &m.to_vec(), &v.to_vec()));
        }
    }

    #[test]
    fn the_first_step_has_the_size_of_the_learning_rate_whatever_the_gradient() {
        let mut theta = [1.0, 1.0, 1.0];
        Adam::new(3).step(&mut theta, &[1e-3, -50.0, 0.0], 0.01);
        for (theta, expected) in theta.iter().zip([0.99, 1.01, 1.0]) {
            assert!((theta - expected).abs() < 1e-6);
        }
    }

    #[test]
    fn a_bowl_is_descended_to_its_bottom() {
        let (mut theta, mut adam) = ([3.0, -2.0], Adam::new(2));
        for _ in 0..2000 {
            let gradient = [2.0 * (theta[0] - 1.0), 20.0 * (theta[1] - 0.5)];
            adam.step(&mut theta, &gradient, 0.01);
        }
        assert!((theta[0] - 1.0).abs() < 1e-3 && (theta[1] - 0.5).abs() < 1e-3, "{theta:?}");
    }

    #[test]
    fn moments_of_a_silent_parameter_end_at_zero_and_are_never_subnormal() {
        let (mut theta, mut adam) = ([1.0f32], Adam::new(1));
        adam.step(&mut theta, &[1e-3], 0.01);
        // 0.999^k brings 1e-9 below 1e-35 after sixty thousand steps.
        for _ in 0..70_000 {
            adam.step(&mut theta, &[0.0], 0.01);
            assert!(!adam.m[0].is_subnormal() && !adam.v[0].is_subnormal());
        }
        assert_eq!((adam.m[0], adam.v[0]), (0.0, 0.0));
    }
}
