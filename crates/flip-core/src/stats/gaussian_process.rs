//! Gaussian process regression with the Matern-5/2 kernel: theory here, fitting in [`evidence`].
//!
//! ```text
//! y_i = f(x_i) + e_i,   e_i ~ N(0, q_i sn^2),   f ~ GP(m, k)
//! k(x, x') = sf^2 (1 + a + a^2 / 3) exp(-a),   a = sqrt(5) r,   r^2 = sum_j (x_j - x'_j)^2 / l_j^2
//! K = [k(x_i, x_j)] + diag(q_i sn^2 + jitter),   w = K^-1 (y - m)
//! mean(x) = m + k(x)^T w          var(x) = sf^2 - k(x)^T K^-1 k(x)
//! ```
//!
//! | symbol | field | shape | unit |
//! |--------|-------|-------|------|
//! | l_j | `lengthscales` | `[D]` | of input j |
//! | sf, sn | `signal_sd`, `noise_sd` | | of the output |
//! | m | `mean` | | of the output |
//! | q_i | `noise` | `[n]` | 1; the mean of four observations has 1/4 |
//!
//! Numerics: Cholesky factor of K; the jitter starts at 1e-10 sf^2 and grows tenfold until the
//! factor exists. Cost: n^3 / 6 for a factor, n D for a mean, n^2 for a variance; meant for n up to
//! a few hundred.
//!
//! Source: Rasmussen, Williams, Gaussian Processes for Machine Learning (2006), eq. 2.23-2.24,
//! 4.17, algorithm 2.1.

pub mod evidence;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// The hyperparameters of a Gaussian process; see the table above.
#[derive(Debug, Clone, PartialEq)]
pub struct Hyperparameters<const D: usize> {
    /// Distance over which the function changes, per input; long where an input does nothing.
    pub lengthscales: [f64; D],
    /// Standard deviation of the function around its mean.
    pub signal_sd: f64,
    /// Standard deviation of one observation around the function.
    pub noise_sd: f64,
    /// Value far from all data.
    pub mean: f64,
}

impl<const D: usize> Hyperparameters<D> {
    /// Distance in lengthscales, `r` above.
    pub fn scaled_distance(&self, a: &[f64; D], b: &[f64; D]) -> f64 {
        (0..D).map(|j| ((a[j] - b[j]) / self.lengthscales[j]).powi(2)).sum::<f64>().sqrt()
    }

    /// Correlation of the function at two points, 0 to 1.
    pub fn correlation(&self, a: &[f64; D], b: &[f64; D]) -> f64 {
        let a = 5f64.sqrt() * self.scaled_distance(a, b);
        (1.0 + a + a * a / 3.0) * (-a).exp()
    }
}

/// Prediction at one point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// Posterior mean.
    pub mean: f64,
    /// Posterior standard deviation of the function itself, without the noise of an observation.
    pub sd: f64,
}

/// Why no Gaussian process could be built.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum GaussianProcessError {
    /// No observation, or inputs and outputs differ in number.
    #[error("needs at least one observation, and one output per input")]
    Shape,
    /// An input, an output or a hyperparameter is not a usable number.
    #[error("inputs, outputs and hyperparameters must be finite, lengthscales and signal positive")]
    NotFinite,
    /// No jitter up to a tenth of the signal's variance makes the covariance positive definite.
    #[error("the covariance matrix is singular")]
    Singular,
}

/// A Gaussian process conditioned on observations.
#[derive(Debug, Clone)]
pub struct GaussianProcess<const D: usize> {
    hyperparameters: Hyperparameters<D>,
    inputs: Vec<[f64; D]>,
    outputs: Vec<f64>,
    noise: Vec<f64>,
    factor: Cholesky<f64, Dyn>,
    /// K^-1 (y - m), `[n]`.
    weights: DVector<f64>,
}

impl<const D: usize> GaussianProcess<D> {
    /// Conditions on `outputs[i]` observed at `inputs[i]` with given hyperparameters. Inputs may
    /// repeat.
    ///
    /// # Errors
    /// [`GaussianProcessError`]
    pub fn new(
        inputs: &[[f64; D]],
        outputs: &[f64],
        hyperparameters: Hyperparameters<D>,
    ) -> Result<Self, GaussianProcessError> {
        Self::with_noise(inputs, outputs, &vec![1.0; inputs.len()], hyperparameters)
    }

    /// Like [`Self::new`], but observation `i` has the variance `noise[i]` times `noise_sd`
    /// squared.
    ///
    /// # Errors
    /// [`GaussianProcessError`]
    pub fn with_noise(
        inputs: &[[f64; D]],
        outputs: &[f64],
        noise: &[f64],
        hyperparameters: Hyperparameters<D>,
    ) -> Result<Self, GaussianProcessError> {
        if inputs.is_empty() || inputs.len() != outputs.len() || inputs.len() != noise.len() {
            return Err(GaussianProcessError::Shape);
        }
        let h = &hyperparameters;
        let positive = h
            .lengthscales
            .iter()
            .chain([&h.signal_sd])
            .chain(noise)
            .all(|v| v.is_finite() && *v > 0.0);
        let finite = inputs
            .iter()
            .flatten()
            .chain(outputs)
            .chain([&h.mean, &h.noise_sd])
            .all(|v| v.is_finite());
        if !positive || !finite {
            return Err(GaussianProcessError::NotFinite);
        }
        let covariance = covariance(inputs, noise, h);
        let factor =
            factorise(covariance, h.signal_sd.powi(2)).ok_or(GaussianProcessError::Singular)?;
        let weights = factor
            .solve(&DVector::from_iterator(outputs.len(), outputs.iter().map(|y| y - h.mean)));
        let (inputs, outputs, noise) = (inputs.to_vec(), outputs.to_vec(), noise.to_vec());
        Ok(Self { hyperparameters, inputs, outputs, noise, factor, weights })
    }

    /// Posterior mean at `x`.
    pub fn mean(&self, x: &[f64; D]) -> f64 {
        let h = &self.hyperparameters;
        let sum: f64 =
            self.inputs.iter().zip(&self.weights).map(|(xi, w)| h.correlation(xi, x) * w).sum();
        h.mean + h.signal_sd.powi(2) * sum
    }

    /// Posterior at `x`.
    pub fn predict(&self, x: &[f64; D]) -> Prediction {
        let h = &self.hyperparameters;
        let variance = h.signal_sd.powi(2);
        let n = self.inputs.len();
        let covariances =
            DVector::from_iterator(n, self.inputs.iter().map(|xi| variance * h.correlation(xi, x)));
        let mean = h.mean + covariances.dot(&self.weights);
        let explained = match self.factor.l_dirty().solve_lower_triangular(&covariances) {
            Some(v) => v.norm_squared(),
            None => 0.0,
        };
        // Rounding can leave a tiny negative variance at an observed point.
        Prediction { mean, sd: (variance - explained).max(0.0).sqrt() }
    }

    /// Returns this process with its own mean at `x` added as an observation (kriging believer),
    /// i.e. its state if `x` were evaluated without a surprise. Unchanged if the point cannot be
    /// added.
    ///
    /// Source: Ginsbourger, Le Riche, Carraro, Computational Intelligence in Expensive Optimization
    /// Problems (2010).
    pub fn believe(&self, x: &[f64; D]) -> Self {
        self.observe(&[(*x, self.predict(x).mean, 1.0)])
    }

    /// Returns this process with more observations, each an input, an output and its noise as in
    /// [`Self::with_noise`], and the same hyperparameters. Unchanged if they cannot be added.
    pub fn observe(&self, more: &[([f64; D], f64, f64)]) -> Self {
        let (mut inputs, mut outputs, mut noise) =
            (self.inputs.clone(), self.outputs.clone(), self.noise.clone());
        for (x, y, q) in more {
            inputs.push(*x);
            outputs.push(*y);
            noise.push(*q);
        }
        let grown = Self::with_noise(&inputs, &outputs, &noise, self.hyperparameters.clone());
        grown.unwrap_or_else(|_| self.clone())
    }

    /// The hyperparameters in use.
    pub fn hyperparameters(&self) -> &Hyperparameters<D> {
        &self.hyperparameters
    }
}

/// `K` above without jitter, `[n, n]`.
fn covariance<const D: usize>(
    inputs: &[[f64; D]],
    noise: &[f64],
    h: &Hyperparameters<D>,
) -> DMatrix<f64> {
    let (variance, unit) = (h.signal_sd.powi(2), h.noise_sd.powi(2));
    let n = inputs.len();
    let mut k = DMatrix::zeros(n, n);
    for i in 0..n {
        for j in 0..i {
            let value = variance * h.correlation(&inputs[i], &inputs[j]);
            (k[(i, j)], k[(j, i)]) = (value, value);
        }
        k[(i, i)] = variance + unit * noise[i];
    }
    k
}

/// Cholesky factor with the least jitter of 1e-10, 1e-9 ... 0.1 times `variance` that works.
fn factorise(mut k: DMatrix<f64>, variance: f64) -> Option<Cholesky<f64, Dyn>> {
    let mut added = 0.0;
    (-10..=-1).find_map(|exponent| {
        let jitter = 10f64.powi(exponent) * variance;
        for i in 0..k.nrows() {
            k[(i, i)] += jitter - added;
        }
        added = jitter;
        Cholesky::new(k.clone())
    })
}

#[cfg(test)]
mod tests;
