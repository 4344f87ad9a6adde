//! Hyperparameter choice: the most probable ones given the observations and a weak prior.

use super::{GaussianProcess, GaussianProcessError, Hyperparameters, factorise};
use crate::stats::minimise::{Evaluated, minimise};
use crate::stats::summary;
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;

/// Log-normal priors on the hyperparameters of standardised outputs (mean 0, SD 1): median and log
/// SD.
///
/// With few observations the evidence alone picks absurd lengthscales; the prior constrains them
/// until the data take over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prior {
    /// Prior of each lengthscale, in units of the inputs.
    pub lengthscale: (f64, f64),
    /// Prior of the signal's SD, in SD of the outputs.
    pub signal_sd: (f64, f64),
    /// Prior of the noise's SD, in SD of the outputs.
    pub noise_sd: (f64, f64),
}

impl Default for Prior {
    /// For inputs in the unit cube of which an unknown few matter: by default an input matters
    /// little (lengthscale three times the cube's side), the function explains the outputs, and the
    /// noise is a tenth of their spread.
    fn default() -> Self {
        Self { lengthscale: (3.0, 1.0), signal_sd: (1.5, 0.7), noise_sd: (0.1, 0.7) }
    }
}

impl Prior {
    /// `(median, log SD)` of each entry of theta, in its order.
    fn entries<const D: usize>(&self) -> impl Iterator<Item = (f64, f64)> {
        std::iter::repeat_n(self.lengthscale, D).chain([self.signal_sd, self.noise_sd])
    }
}

impl<const D: usize> GaussianProcess<D> {
    /// Conditions on observations with the hyperparameters that maximise evidence times prior
    /// (type-II maximum a posteriori; maximum likelihood with automatic relevance determination in
    /// the limit of a wide prior).
    ///
    /// ```text
    /// theta = (ln l_1 .. ln l_D, ln sf, ln sn) of outputs scaled to mean 0, SD 1;  L(theta) as in [`objective`]
    /// ```
    ///
    /// Deterministic: BFGS from the prior's median and from the median with lengthscales a third
    /// and three times as long; the best end is kept.
    ///
    /// # Errors
    /// [`GaussianProcessError`]
    pub fn fit(
        inputs: &[[f64; D]],
        outputs: &[f64],
        prior: &Prior,
    ) -> Result<Self, GaussianProcessError> {
        let noise = vec![1.0; inputs.len()];
        let fit = Fit::new(inputs, outputs, &noise, prior)?;
        fit.best(fit.starts().map(|start| fit.end(start)))
    }
}

/// A fit in steps, for a caller that computes the ends side by side.
#[derive(Debug)]
pub struct Fit<'a, const D: usize> {
    inputs: &'a [[f64; D]],
    outputs: &'a [f64],
    noise: &'a [f64],
    prior: &'a Prior,
    centre: f64,
    spread: f64,
    scaled: Vec<f64>,
}

impl<'a, const D: usize> Fit<'a, D> {
    /// Like [`GaussianProcess::fit`], but observation `i` has `noise[i]` times the noise variance,
    /// which is known only up to one factor.
    ///
    /// # Errors
    /// [`GaussianProcessError::Shape`] and [`GaussianProcessError::NotFinite`]
    pub fn new(
        inputs: &'a [[f64; D]],
        outputs: &'a [f64],
        noise: &'a [f64],
        prior: &'a Prior,
    ) -> Result<Self, GaussianProcessError> {
        if inputs.is_empty() || inputs.len() != outputs.len() || inputs.len() != noise.len() {
            return Err(GaussianProcessError::Shape);
        }
        if !inputs.iter().flatten().chain(outputs).chain(noise).all(|v| v.is_finite()) {
            return Err(GaussianProcessError::NotFinite);
        }
        let centre = summary::mean(outputs).unwrap_or(0.0);
        let spread = summary::sd(outputs).filter(|s| *s > 0.0).unwrap_or(1.0);
        let scaled = outputs.iter().map(|y| (y - centre) / spread).collect();
        Ok(Self { inputs, outputs, noise, prior, centre, spread, scaled })
    }

    /// Where the searches begin, as theta.
    pub fn starts(&self) -> [DVector<f64>; 3] {
        [1.0 / 3.0, 1.0, 3.0].map(|stretch| {
            let start = self
                .prior
                .entries::<D>()
                .enumerate()
                .map(|(j, (median, _))| if j < D { median * stretch } else { median });
            DVector::from_iterator(D + 2, start.map(f64::ln))
        })
    }

    /// Where the search from this start ends, and the objective there.
    pub fn end(&self, start: DVector<f64>) -> (DVector<f64>, f64) {
        let value = |theta: &_| objective(self.inputs, &self.scaled, self.noise, theta, self.prior);
        minimise(value, start, 1.0, 60)
    }

    /// The process with the best of these ends, the first of equals.
    ///
    /// # Errors
    /// [`GaussianProcessError::Singular`]
    pub fn best(
        &self,
        ends: impl IntoIterator<Item = (DVector<f64>, f64)>,
    ) -> Result<GaussianProcess<D>, GaussianProcessError> {
        let finite = ends.into_iter().filter(|end| end.1.is_finite());
        let best =
            finite.min_by(|a, b| a.1.total_cmp(&b.1)).ok_or(GaussianProcessError::Singular)?;
        let mut h = from_theta::<D>(&best.0);
        h.signal_sd *= self.spread;
        h.noise_sd *= self.spread;
        h.mean = self.centre;
        GaussianProcess::with_noise(self.inputs, self.outputs, self.noise, h)
    }
}

/// Minus log posterior density of `theta` up to a constant, and its gradient; infinite where the
/// covariance is singular.
///
/// ```text
/// J = y^T w / 2 + ln|K| / 2 + n ln(2 pi) / 2 + sum_j (theta_j - ln median_j)^2 / (2 s_j^2)
/// dJ/dtheta_j = -tr((w w^T - K^-1) dK/dtheta_j) / 2 + (theta_j - ln median_j) / s_j^2
/// dk/d ln l_j = sf^2 (5/3) (1 + a) exp(-a) (x_j - x'_j)^2 / l_j^2      dk/d ln sf = 2 k      dK/d ln sn = 2 sn^2 diag(q)
/// ```
///
/// Source: Rasmussen and Williams (2006), eq. 5.8-5.9; the kernel's derivative is elementary.
pub fn objective<const D: usize>(
    inputs: &[[f64; D]],
    scaled: &[f64],
    noise: &[f64],
    theta: &DVector<f64>,
    prior: &Prior,
) -> Evaluated {
    let n = inputs.len();
    let h = from_theta::<D>(theta);
    let undefined = (f64::INFINITY, DVector::zeros(D + 2));
    let Some(factor) = factorise(super::covariance(inputs, noise, &h), h.signal_sd.powi(2)) else {
        return undefined;
    };
    let y = DVector::from_column_slice(scaled);
    let weights = factor.solve(&y);
    let log_determinant = 2.0 * factor.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
    let mut value = 0.5 * (y.dot(&weights) + log_determinant + n as f64 * TAU.ln());

    let excess = &weights * weights.transpose() - factor.inverse();
    let mut gradient = evidence_gradient(inputs, noise, &h, &excess);
    for (j, (median, log_sd)) in prior.entries::<D>().enumerate() {
        let off = theta[j] - median.ln();
        value += 0.5 * (off / log_sd).powi(2);
        gradient[j] += off / log_sd.powi(2);
    }
    (value, gradient)
}

/// The trace terms; `excess` is `w w^T - K^-1`, symmetric, `[n, n]`. Each pair counts twice, which
/// cancels the half.
fn evidence_gradient<const D: usize>(
    inputs: &[[f64; D]],
    noise: &[f64],
    h: &Hyperparameters<D>,
    excess: &DMatrix<f64>,
) -> DVector<f64> {
    let variance = h.signal_sd.powi(2);
    let mut gradient = DVector::zeros(D + 2);
    for (i, xi) in inputs.iter().enumerate() {
        for (j, xj) in inputs[..i].iter().enumerate() {
            let a = 5f64.sqrt() * h.scaled_distance(xi, xj);
            let common = excess[(i, j)] * variance * 5.0 / 3.0 * (1.0 + a) * (-a).exp();
            for k in 0..D {
                gradient[k] -= common * ((xi[k] - xj[k]) / h.lengthscales[k]).powi(2);
            }
            gradient[D] -= excess[(i, j)] * 2.0 * variance * h.correlation(xi, xj);
        }
        gradient[D] -= excess[(i, i)] * variance;
        gradient[D + 1] -= excess[(i, i)] * noise[i] * h.noise_sd.powi(2);
    }
    gradient
}

fn from_theta<const D: usize>(theta: &DVector<f64>) -> Hyperparameters<D> {
    Hyperparameters {
        lengthscales: std::array::from_fn(|j| theta[j].exp()),
        signal_sd: theta[D].exp(),
        noise_sd: theta[D + 1].exp(),
        mean: 0.0,
    }
}
