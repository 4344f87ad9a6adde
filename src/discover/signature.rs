//! What a cause would do to the runs of a campaign, up to its size: one column common to all powders, and one for each powder's own deviation.

use nalgebra::DMatrix;

/// How much powders may differ in a cause, over what they share. A cause that acts on one powder alone is as likely as one that acts on all where this is 1.
pub const DEVIATIONS: [f64; 2] = [0.3, 1.0];
/// Most smooth functions of an uncatalogued covariate.
const SMOOTH_MAX: usize = 5;
/// Variance of a smooth function over that of the first, below which it is left out.
const SMOOTH_MIN: f64 = 1e-3;

/// Columns of a cause before powders: `[n, m]`, with mean 0 in each powder and, summed over columns, mean square 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Course(DMatrix<f64>);

impl Course {
    /// A cause whose strength is known in each run; `None` if it is the same in all runs of each powder.
    pub fn of_strength(strength: &[f64], powder: &[usize]) -> Option<Self> {
        Self::standardised(DMatrix::from_column_slice(strength.len(), 1, strength), powder)
    }

    /// A cause that differs between levels, nobody knows how.
    pub fn of_levels(level: &[usize], count: usize, powder: &[usize]) -> Option<Self> {
        let indicator = DMatrix::from_fn(level.len(), count, |i, k| f64::from(u8::from(level[i] == k)));
        Self::standardised(indicator, powder)
    }

    /// A smooth function of a covariate, nobody knows which: the principal functions of a Gaussian process with a Gaussian kernel whose length
    /// scale is this share of the covariate's range.
    pub fn smooth(values: &[f64], length_share: f64, powder: &[usize]) -> Option<Self> {
        let (low, high) =
            (values.iter().copied().fold(f64::MAX, f64::min), values.iter().copied().fold(f64::MIN, f64::max));
        let length = length_share * (high - low).max(f64::MIN_POSITIVE);
        let kernel = DMatrix::from_fn(values.len(), values.len(), |i, j| {
            (-0.5 * ((values[i] - values[j]) / length).powi(2)).exp()
        });
        let principal = kernel.symmetric_eigen();
        let mut order: Vec<usize> = (0..values.len()).collect();
        order.sort_by(|&a, &b| principal.eigenvalues[b].total_cmp(&principal.eigenvalues[a]));
        order.truncate(SMOOTH_MAX);
        let first = principal.eigenvalues[*order.first()?];
        order.retain(|&k| principal.eigenvalues[k] > SMOOTH_MIN * first);
        let mut columns = principal.eigenvectors.select_columns(&order);
        for (mut column, &k) in columns.column_iter_mut().zip(&order) {
            column *= principal.eigenvalues[k].sqrt();
        }
        Self::standardised(columns, powder)
    }

    fn standardised(mut columns: DMatrix<f64>, powder: &[usize]) -> Option<Self> {
        let before = columns.norm();
        let powders = powder.iter().max().map_or(0, |last| last + 1);
        for mut column in columns.column_iter_mut() {
            for of in 0..powders {
                let rows: Vec<usize> = (0..powder.len()).filter(|&i| powder[i] == of).collect();
                let mean = rows.iter().map(|&i| column[i]).sum::<f64>() / rows.len().max(1) as f64;
                rows.iter().for_each(|&i| column[i] -= mean);
            }
        }
        let norm = columns.norm();
        // Relative: a course that is constant in each powder leaves rounding behind.
        (norm > 1e-9 * before).then(|| Self(columns * ((powder.len() as f64).sqrt() / norm)))
    }

    /// The course for all powders alike, and for each powder its own deviation, `deviation` times as large: `[n, m (1 + powders)]`, the common
    /// columns first.
    pub fn with_powders(&self, powder: &[usize], deviation: f64) -> DMatrix<f64> {
        let powders = powder.iter().max().map_or(0, |last| last + 1);
        let m = self.0.ncols();
        DMatrix::from_fn(powder.len(), m * (1 + powders), |i, column| match (column / m, column % m) {
            (0, of) => self.0[(i, of)],
            (block, of) if powder[i] + 1 == block => deviation * self.0[(i, of)],
            _ => 0.0,
        })
    }
}
