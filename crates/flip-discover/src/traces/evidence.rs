//! The evidence of [`mixed_model`](flip_core::stats::mixed_model) for noise that is independent between
//! weighings.
//!
//! ```text
//! V = diag(V_1, .., V_B),   X = (X_own, X_all),   X_own = diag(X_1, .., X_B)
//! L_b L_b^T = V_b,   Q_b R_b = L_b^-1 X_b,   P_b = (I - Q_b Q_b^T) L_b^-1
//! Q R = diag(P_b) X_all,   P = (I - Q Q^T) diag(P_b)
//! |X^T V^-1 X| = prod_b |R_b|^2 |R|^2
//! ```
//!
//! and the rest as there. The n^3 cost there is the sum over blocks here, so thousands of readings
//! take seconds. Shakes, readings and scatter are all judged by it: `own` are the levels of
//! plateaus, say, and `all` a powder's response.
//!
//! Source: derived here, from the module named above by removing the fixed part in two steps.

use flip_core::stats::normal;
use nalgebra::{Cholesky, DMatrix, DVector, DVectorView, SymmetricEigen};
use std::ops::{AddAssign, Range};

/// Columns shorter than this share of their length before the fixed part was removed are rounding.
const RANK_TOLERANCE: f64 = 1e-6;
/// Root mean squares of a signature over the SD of one row's noise.
pub(super) const AMPLITUDES: [f64; 6] = [0.02, 0.06, 0.2, 0.6, 2.0, 6.0];

/// A noise model, ready to judge.
pub(super) struct Whitening {
    blocks: Vec<Range<usize>>,
    /// P_b of each block.
    own: Vec<DMatrix<f64>>,
    /// Q, `[n, remaining columns of X_all]`.
    all: DMatrix<f64>,
    log_base: f64,
    /// Rows less columns of X.
    pub freedom: f64,
}

/// The terms of a signature and of observations that the evidence needs: F*^T F* = U diag(lambda)
/// U^T, and U^T F*^T y*.
pub(super) struct Signature {
    eigenvalues: DVector<f64>,
    /// `[k, observations]`.
    seen: DMatrix<f64>,
    /// First row of U.
    first: DVector<f64>,
}

/// F*^T F* and F*^T y* of a course's parts, one for each group of blocks.
pub(super) struct Course {
    /// `[groups, groups]`.
    gram: DMatrix<f64>,
    /// `[groups, observations]`.
    seen: DMatrix<f64>,
}

/// Evidence of one amplitude and the estimate of the signature's first coefficient.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    pub log_evidence: f64,
    pub first: f64,
    /// Along directions that the readings can see: how a course divides into its common part and
    /// equal parts of all groups is not among them.
    pub first_sd: f64,
    /// Part of the squares that the signature leaves.
    pub left: f64,
}

impl Whitening {
    /// The noise whose block `b` has covariance `covariance(b)`, around `own(b)` `[rows of b, p_b]`
    /// and `all` `[n, g]`; `None` if it has no factor or leaves no freedom. Columns explained by
    /// others are left out.
    pub fn new(
        blocks: &[Range<usize>],
        covariance: impl Fn(usize) -> DMatrix<f64>,
        own: impl Fn(usize) -> DMatrix<f64>,
        all: &DMatrix<f64>,
    ) -> Option<Self> {
        let n = blocks.last()?.end;
        let (mut operators, mut log_root, mut columns) = (Vec::with_capacity(blocks.len()), 0.0, 0);
        for (b, block) in blocks.iter().enumerate() {
            let factor = Cholesky::new(covariance(b))?.unpack();
            log_root += factor.diagonal().iter().map(|x| x.ln()).sum::<f64>();
            let inverse =
                factor.solve_lower_triangular(&DMatrix::identity(block.len(), block.len()))?;
            let basis = basis(&inverse * own(b));
            log_root += basis.log_volume;
            columns += basis.vectors.ncols();
            operators.push(&inverse - &basis.vectors * basis.vectors.tr_mul(&inverse));
        }
        let left = apply(blocks, &operators, all);
        let basis = basis(left);
        columns += basis.vectors.ncols();
        let freedom = n.checked_sub(columns).filter(|&left| left > 2)? as f64;
        let log_base = -log_root - basis.log_volume;
        let is_sound = log_base.is_finite();
        is_sound.then(|| Self {
            blocks: blocks.to_vec(),
            own: operators,
            all: basis.vectors,
            log_base,
            freedom,
        })
    }

    /// P m, `[n, columns]`.
    pub fn apply(&self, m: &DMatrix<f64>) -> DMatrix<f64> {
        let seen = apply(&self.blocks, &self.own, m);
        &seen - &self.all * self.all.tr_mul(&seen)
    }

    /// tr(P diag(kernel(b)) P^T) before the part common to all blocks is removed.
    pub fn trace(&self, kernel: impl Fn(usize) -> DMatrix<f64>) -> f64 {
        self.own.iter().enumerate().map(|(b, own)| (own * kernel(b)).component_mul(own).sum()).sum()
    }

    /// Log evidence of the noise alone, up to terms common to all noises; `squares` is y*^T y*.
    pub fn log_null(&self, squares: f64) -> f64 {
        self.log_base - self.freedom / 2.0 * squares.ln()
    }

    /// A course `[n]` against `seen`, observations passed through [`Self::apply`], group by group;
    /// each block is of one group.
    pub fn course(&self, course: &[f64], group: &[usize], seen: &DMatrix<f64>) -> Course {
        let count = group.iter().max().map_or(0, |last| last + 1);
        let mut new = Course {
            gram: DMatrix::zeros(count, count),
            seen: DMatrix::zeros(count, seen.ncols()),
        };
        let mut along = DMatrix::zeros(count, self.all.ncols());
        for (block, own) in self.blocks.iter().zip(&self.own) {
            let through = own * DVectorView::from_slice(&course[block.clone()], block.len());
            let of = group[block.start];
            new.gram[(of, of)] += through.norm_squared();
            let rows =
                |m: &DMatrix<f64>| m.rows(block.start, block.len()).tr_mul(&through).transpose();
            new.seen.row_mut(of).add_assign(&rows(seen));
            along.row_mut(of).add_assign(&rows(&self.all));
        }
        new.gram -= &along * along.transpose();
        new
    }

    /// Evidence of noise and signature for observation `k`; with a `sign` the first coefficient has
    /// it, as in [`mixed_model`](flip_core::stats::mixed_model::Whitening::log_evidence), with the
    /// normal distribution in place of Student's t with so many degrees of freedom.
    pub fn fit(
        &self,
        signature: &Signature,
        k: usize,
        squares: f64,
        amplitude: f64,
        sign: Option<f64>,
    ) -> Fit {
        let (mut explained, mut log_volume, mut first, mut variance) = (0.0, 0.0, 0.0, 0.0);
        for (j, &eigenvalue) in signature.eigenvalues.iter().enumerate() {
            let (shrunk, seen) =
                (1.0 / (1.0 / (amplitude * amplitude) + eigenvalue), signature.seen[(j, k)]);
            explained += shrunk * seen * seen;
            log_volume += (amplitude * amplitude * eigenvalue).ln_1p();
            first += signature.first[j] * shrunk * seen;
            variance += signature.first[j].powi(2) * shrunk;
        }
        let left = (squares - explained).max(f64::MIN_POSITIVE);
        let first_sd = (variance * left / self.freedom).sqrt();
        let log_evidence = self.log_base - 0.5 * log_volume - self.freedom / 2.0 * left.ln();
        let log_sign =
            sign.map_or(0.0, |sign| (2.0 * normal::cdf(sign * first / first_sd)).max(1e-300).ln());
        Fit { log_evidence: log_evidence + log_sign, first, first_sd, left }
    }
}

impl Course {
    /// The course for all groups alike and, where they differ by this share of it, one more column
    /// for each; `None` if the fixed part explains it.
    pub fn signature(&self, differ: Option<f64>) -> Option<Signature> {
        let groups = self.gram.nrows();
        let columns = DMatrix::from_fn(groups, 1 + differ.map_or(0, |_| groups), |i, k| match k {
            0 => 1.0,
            k if k == i + 1 => differ.unwrap_or(0.0),
            _ => 0.0,
        });
        let gram = SymmetricEigen::new(columns.tr_mul(&self.gram) * &columns);
        let largest = gram.eigenvalues.max();
        let kept: Vec<usize> = (0..columns.ncols())
            .filter(|&k| gram.eigenvalues[k] > RANK_TOLERANCE * largest.max(1e-12))
            .collect();
        if kept.is_empty() {
            return None;
        }
        let rotation = gram.eigenvectors.select_columns(&kept);
        let seen = (columns * &rotation).tr_mul(&self.seen);
        Some(Signature {
            eigenvalues: gram.eigenvalues.select_rows(&kept),
            seen,
            first: rotation.row(0).transpose(),
        })
    }
}

fn apply(blocks: &[Range<usize>], operators: &[DMatrix<f64>], m: &DMatrix<f64>) -> DMatrix<f64> {
    let mut out = DMatrix::zeros(m.nrows(), m.ncols());
    for (block, operator) in blocks.iter().zip(operators) {
        out.rows_mut(block.start, block.len()).gemm(
            1.0,
            operator,
            &m.rows(block.start, block.len()),
            0.0,
        );
    }
    out
}

struct Basis {
    /// Orthonormal columns.
    vectors: DMatrix<f64>,
    /// Log of the volume that the columns span.
    log_volume: f64,
}

/// Gram-Schmidt, twice for accuracy; columns that depend on those before them, or that an earlier
/// projection removed, are left out.
fn basis(columns: DMatrix<f64>) -> Basis {
    let (mut kept, mut log_volume): (Vec<DVector<f64>>, f64) = (Vec::new(), 0.0);
    for column in columns.column_iter() {
        let before = column.norm();
        let mut vector = column.into_owned();
        for _ in 0..2 {
            for other in &kept {
                let along = other.dot(&vector);
                vector.axpy(-along, other, 1.0);
            }
        }
        let norm = vector.norm();
        if norm > RANK_TOLERANCE * before.max(RANK_TOLERANCE) {
            log_volume += norm.ln();
            kept.push(vector / norm);
        }
    }
    let vectors = if kept.is_empty() {
        DMatrix::zeros(columns.nrows(), 0)
    } else {
        DMatrix::from_columns(&kept)
    };
    Basis { vectors, log_volume }
}
