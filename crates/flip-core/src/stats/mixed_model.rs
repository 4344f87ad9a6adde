//! Evidence of a linear model with grouped noise, in closed form.
//!
//! ```text
//! y = X beta + F b + e,   e ~ N(0, s^2 V),   V = diag(w_i^2) + sum_g r_g Z_g Z_g^T
//! p(beta) constant,   p(s) = 1 / s,   b ~ N(0, t^2 s^2 I)
//!
//! L L^T = V,   Q R = L^-1 X,   P = (I - Q Q^T) L^-1,   y* = P y,   F* = P F,   n - p = rows less columns of X
//! q(t) = y*^T F* (I / t^2 + F*^T F*)^-1 F*^T y*
//! log p(y) = log Gamma((n - p) / 2) - log 2 - (n - p) / 2 log pi - log |L| - log |R|
//!            - 1/2 log |I + t^2 F*^T F*| - (n - p) / 2 log(y*^T y* - q(t))
//! ```
//!
//! | symbol | name | shape | unit |
//! |--------|------|-------|------|
//! | y | `observations` | `[n]` | of the observation |
//! | X | `fixed` | `[n, p]` | 1; for example one column per powder: effects in its span are ignored |
//! | F | `features` | `[n, k]` | 1; a cause's signature |
//! | w | `weights` | `[n]` | 1; SD of each observation's own noise over s |
//! | r, Z | `groups` | | ratio of variances, and which rows share one draw: those of one day |
//! | t | `amplitude` | | SD of the signature's coefficients over s |
//!
//! One factor of V serves all features and all observations with the same noise, and one
//! eigendecomposition of F*^T F* serves all amplitudes. An evidence then costs n k, which makes a
//! null distribution over thousands of simulated campaigns affordable.
//!
//! Source: derived here by integrating beta, b and s out of the normal density in turn; checked
//! against quadrature by a script that shares no algebra with this file
//! (`tests/reference/mixed_model.py`).

use nalgebra::{Cholesky, DMatrix, DVector, DVectorView, Dyn, SymmetricEigen};
use statrs::distribution::{ContinuousCDF, StudentsT};
use statrs::function::gamma::ln_gamma;
use std::f64::consts::{LN_2, PI};

/// Directions with eigenvalues below this share of the largest are explained by the fixed part.
const RANK_TOLERANCE: f64 = 1e-10;

/// Why a noise model cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum MixedModelError {
    /// V has no Cholesky factor: a weight is zero, negative or not finite.
    #[error("the covariance of the noise is not positive definite")]
    Covariance,
    /// The columns of X depend on each other, or there are not more rows than columns.
    #[error("the fixed part is not of full rank, or leaves no freedom")]
    Fixed,
}

/// Groups of observations that share one draw of the noise, and the size of that draw.
#[derive(Debug, Clone, Copy)]
pub struct Group<'a> {
    /// Group index of each row.
    pub of: &'a [usize],
    /// Variance of the shared draw over s^2.
    pub ratio: f64,
}

/// A noise model, ready for evaluation: P and the determinants of the module's equations.
#[derive(Debug, Clone)]
pub struct Whitening {
    /// P, `[n, n]`.
    project: DMatrix<f64>,
    /// The terms common to every signature and every observation with this noise.
    log_base: f64,
    /// n - p.
    freedom: f64,
}

/// Features under a noise model: the directions in which they can differ, `A = P^T F* U`, with
/// `F*^T F* = U diag(lambda) U^T`.
#[derive(Debug, Clone)]
pub struct Signature {
    /// `[n, k]`.
    directions: DMatrix<f64>,
    eigenvalues: DVector<f64>,
    /// U, `[features, k]`: contribution of each direction to each feature's coefficient.
    rotation: DMatrix<f64>,
}

impl Whitening {
    /// Builds the noise model with these weights and groups around this fixed part.
    ///
    /// # Errors
    /// [`MixedModelError`]
    pub fn new(
        weights: &[f64],
        groups: &[Group<'_>],
        fixed: &DMatrix<f64>,
    ) -> Result<Self, MixedModelError> {
        Self::with_factor(weights, groups, fixed).map(|(new, _)| new)
    }

    /// Like [`Self::new`], and also returns V's Cholesky factor for further solves.
    ///
    /// # Errors
    /// [`MixedModelError`]
    pub fn with_factor(
        weights: &[f64],
        groups: &[Group<'_>],
        fixed: &DMatrix<f64>,
    ) -> Result<(Self, Cholesky<f64, Dyn>), MixedModelError> {
        let n = weights.len();
        let mut covariance =
            DMatrix::from_diagonal(&DVector::from_iterator(n, weights.iter().map(|w| w * w)));
        for group in groups {
            for i in 0..n {
                for j in 0..n {
                    if group.of[i] == group.of[j] {
                        covariance[(i, j)] += group.ratio;
                    }
                }
            }
        }
        let cholesky = Cholesky::new(covariance).ok_or(MixedModelError::Covariance)?;
        let factor = cholesky.l();
        let log_factor: f64 = factor.diagonal().iter().map(|x| x.ln()).sum();
        let inverse = factor
            .solve_lower_triangular(&DMatrix::identity(n, n))
            .ok_or(MixedModelError::Covariance)?;
        if fixed.ncols() >= n {
            return Err(MixedModelError::Fixed);
        }
        let split = (&inverse * fixed).qr();
        let diagonal = split.r().diagonal().map(f64::abs);
        let is_singular =
            diagonal.iter().any(|&x| x.is_nan() || x <= RANK_TOLERANCE * diagonal.max());
        if is_singular {
            return Err(MixedModelError::Fixed);
        }
        let q = split.q();
        let project = &inverse - &q * q.tr_mul(&inverse);
        let freedom = (n - fixed.ncols()) as f64;
        let log_fixed: f64 = diagonal.iter().map(|x| x.ln()).sum();
        let constant = ln_gamma(freedom / 2.0) - LN_2 - freedom / 2.0 * PI.ln();
        let log_base = constant - log_factor - log_fixed;
        if !log_base.is_finite() {
            return Err(MixedModelError::Covariance);
        }
        Ok((Self { project, log_base, freedom }, cholesky))
    }

    /// Projects features under this noise; `None` if the fixed part explains all of them.
    pub fn signature(&self, features: &DMatrix<f64>) -> Option<Signature> {
        let seen = &self.project * features;
        // Relative to the features before the fixed part was removed: if nothing is left, all of it
        // is rounding.
        let before =
            features.norm_squared() * self.project.norm_squared() / features.nrows() as f64;
        // Columns explained by the fixed part are not directions, and the decomposition of a matrix
        // with many of them need not converge.
        let is_seen = |k: &usize| seen.column(*k).norm_squared() > RANK_TOLERANCE * before;
        let columns: Vec<usize> = (0..features.ncols()).filter(is_seen).collect();
        if columns.is_empty() {
            return None;
        }
        let seen = seen.select_columns(&columns);
        let gram = SymmetricEigen::new(seen.tr_mul(&seen));
        let largest = gram.eigenvalues.max();
        let kept: Vec<usize> = (0..columns.len())
            .filter(|&k| {
                gram.eigenvalues[k] > RANK_TOLERANCE * largest
                    && gram.eigenvalues[k] > RANK_TOLERANCE * before
            })
            .collect();
        if kept.is_empty() {
            return None;
        }
        let of_seen = gram.eigenvectors.select_columns(&kept);
        let mut rotation = DMatrix::zeros(features.ncols(), kept.len());
        columns
            .iter()
            .enumerate()
            .for_each(|(row, &column)| rotation.row_mut(column).copy_from(&of_seen.row(row)));
        Some(Signature {
            directions: self.project.tr_mul(&(seen * of_seen)),
            eigenvalues: gram.eigenvalues.select_rows(&kept),
            rotation,
        })
    }

    /// Returns `y*^T y*` for each column of `observations`.
    pub fn squares(&self, observations: &DMatrix<f64>) -> Vec<f64> {
        (&self.project * observations).column_iter().map(|column| column.norm_squared()).collect()
    }

    /// Log evidence of the noise alone, given [`Self::squares`].
    pub fn log_null(&self, squares: f64) -> f64 {
        self.log_base - self.freedom / 2.0 * squares.ln()
    }

    /// Log evidence of noise and signature.
    ///
    /// `seen` is the observation's column of [`Signature::seen`], `squares` its [`Self::squares`].
    /// `signs` lists the features whose coefficient is known to be positive (or negative): its
    /// normal prior loses one half and the other doubles, so the evidence gains twice the posterior
    /// probability of that sign, which is Student's t. For two features the two probabilities are
    /// treated as independent.
    pub fn log_evidence(
        &self,
        signature: &Signature,
        seen: DVectorView<'_, f64>,
        squares: f64,
        amplitude: f64,
        signs: &[(usize, f64)],
    ) -> f64 {
        let shrink = |eigenvalue: f64| 1.0 / (1.0 / (amplitude * amplitude) + eigenvalue);
        let (mut explained, mut log_volume) = (0.0, 0.0);
        for (k, &eigenvalue) in signature.eigenvalues.iter().enumerate() {
            explained += shrink(eigenvalue) * seen[k] * seen[k];
            log_volume += (amplitude * amplitude * eigenvalue).ln_1p();
        }
        let left = squares - explained;
        let log_evidence = self.log_base - 0.5 * log_volume - self.freedom / 2.0 * left.ln();
        let log_sign = |&(feature, sign): &(usize, f64)| {
            let (mut mean, mut variance) = (0.0, 0.0);
            for (k, &eigenvalue) in signature.eigenvalues.iter().enumerate() {
                let rotated = signature.rotation[(feature, k)];
                mean += rotated * shrink(eigenvalue) * seen[k];
                variance += rotated.powi(2) * shrink(eigenvalue);
            }
            // A feature invisible under this noise has either sign with equal probability.
            if variance == 0.0 {
                return 0.0;
            }
            let statistic = sign * mean / (variance * left / self.freedom).sqrt();
            (2.0 * student_below(statistic, self.freedom)).max(f64::MIN_POSITIVE).ln()
        };
        log_evidence + signs.iter().map(log_sign).sum::<f64>()
    }

    /// n - p: degrees of freedom of the estimate of s.
    pub fn freedom(&self) -> f64 {
        self.freedom
    }
}

impl Signature {
    /// Projects each column of `observations` onto the signature's directions, `[k, columns]`.
    pub fn seen(&self, observations: &DMatrix<f64>) -> DMatrix<f64> {
        self.directions.tr_mul(observations)
    }
}

/// Log of the mean of numbers given by their logs; minus infinity if there are none.
pub fn log_mean_exp(logs: &[f64]) -> f64 {
    let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if largest == f64::NEG_INFINITY {
        return largest;
    }
    largest + (logs.iter().map(|log| (log - largest).exp()).sum::<f64>() / logs.len() as f64).ln()
}

/// Probability that Student's t with this many degrees of freedom is below `statistic`.
fn student_below(statistic: f64, freedom: f64) -> f64 {
    StudentsT::new(0.0, 1.0, freedom).map_or(0.5, |distribution| distribution.cdf(statistic))
}

#[cfg(test)]
mod tests;
