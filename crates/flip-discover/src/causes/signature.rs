//! The effect a cause would have on the runs of a campaign, up to its size: one column common to
//! all powders, and one for each powder's own deviation.

use crate::data::campaign::Campaign;
use crate::data::scenario::quantile;
use nalgebra::DMatrix;

/// How much powders may differ in a cause, relative to their common part. At 1, a cause that acts
/// on one powder alone is as likely as one that acts on all.
pub const DEVIATIONS: [f64; 2] = [0.3, 1.0];
/// Most smooth functions of an uncatalogued covariate.
const SMOOTH_MAX: usize = 5;
/// Grid points of a covariate at which smooth functions are computed.
const KNOTS: usize = 40;
/// Variance of a smooth function, relative to the first, below which it is left out.
const SMOOTH_MIN: f64 = 1e-3;

/// Columns of a cause before powders: `[runs, m]`. Over the measured runs they have mean 0 in each
/// powder and, summed over columns, mean square 1; runs without an angle have values on the same
/// scale.
#[derive(Debug, Clone, PartialEq)]
pub struct Course(DMatrix<f64>);

impl Course {
    /// A cause whose strength is known in each run; `None` if it is the same in all measured runs
    /// of each powder. For unmeasured runs it may exceed the measured range by at most the width of
    /// that range: if a form hardly begins within the range, its continuation is unknown.
    pub fn of_strength(strength: &[f64], campaign: &Campaign) -> Option<Self> {
        let measured = campaign.measured();
        let of = |pick: fn(f64, f64) -> f64, from: f64| {
            measured.iter().map(|&i| strength[i]).fold(from, pick)
        };
        let (low, high) = (of(f64::min, f64::INFINITY), of(f64::max, f64::NEG_INFINITY));
        let range = (high - low).max(0.0);
        let within = DMatrix::from_fn(strength.len(), 1, |i, _| {
            strength[i].clamp(low - range, high + range)
        });
        Self::standardised(within, campaign)
    }

    /// A wave of this period, with unknown phase.
    pub fn wave(values: &[f64], period: f64, campaign: &Campaign) -> Option<Self> {
        let columns = DMatrix::from_fn(values.len(), 2, |i, k| {
            let (sin, cos) = (std::f64::consts::TAU * values[i] / period).sin_cos();
            if k == 0 { sin } else { cos }
        });
        Self::standardised(columns, campaign)
    }

    /// A cause that differs between levels in an unknown way.
    pub fn of_levels(level: &[usize], count: usize, campaign: &Campaign) -> Option<Self> {
        let indicator =
            DMatrix::from_fn(level.len(), count, |i, k| f64::from(u8::from(level[i] == k)));
        Self::standardised(indicator, campaign)
    }

    /// An unknown smooth function of a covariate: the principal functions of a Gaussian process
    /// with a Gaussian kernel whose length scale is this share of the covariate's range, at up to
    /// [`KNOTS`] quantiles of the measured runs; elsewhere extended through the kernel (Nystrom).
    pub fn smooth(values: &[f64], length_share: f64, campaign: &Campaign) -> Option<Self> {
        let mut known: Vec<f64> = campaign.measured().iter().map(|&i| values[i]).collect();
        known.sort_by(f64::total_cmp);
        let (low, high) = (*known.first()?, *known.last()?);
        let mut knots: Vec<f64> =
            (0..KNOTS).filter_map(|k| quantile(&known, (k as f64 + 0.5) / KNOTS as f64)).collect();
        knots.dedup();
        let length = length_share * (high - low).max(f64::MIN_POSITIVE);
        let kernel = |a: f64, b: f64| (-0.5 * ((a - b) / length).powi(2)).exp();
        let among = DMatrix::from_fn(knots.len(), knots.len(), |i, j| kernel(knots[i], knots[j]));
        let principal = among.symmetric_eigen();
        let mut order: Vec<usize> = (0..knots.len()).collect();
        order.sort_by(|&a, &b| principal.eigenvalues[b].total_cmp(&principal.eigenvalues[a]));
        order.truncate(SMOOTH_MAX);
        let first = principal.eigenvalues[*order.first()?];
        order.retain(|&k| principal.eigenvalues[k] > SMOOTH_MIN * first);
        let to_knots =
            DMatrix::from_fn(values.len(), knots.len(), |i, j| kernel(values[i], knots[j]));
        let mut columns = to_knots * principal.eigenvectors.select_columns(&order);
        for (mut column, &k) in columns.column_iter_mut().zip(&order) {
            column /= principal.eigenvalues[k].sqrt();
        }
        Self::standardised(columns, campaign)
    }

    /// The same with each powder's runs scaled by the simulator's response for that powder; 1 is
    /// the usual response.
    pub fn scaled(&self, response: &[f64], powder: &[usize]) -> Self {
        let mut columns = self.0.clone();
        for (i, mut row) in columns.row_iter_mut().enumerate() {
            row *= response[powder[i]];
        }
        Self(columns)
    }

    fn standardised(mut columns: DMatrix<f64>, campaign: &Campaign) -> Option<Self> {
        let measured = campaign.measured();
        let (before, of_all) = (columns.norm(), campaign.powder_of());
        for mut column in columns.column_iter_mut() {
            let overall =
                measured.iter().map(|&i| column[i]).sum::<f64>() / measured.len().max(1) as f64;
            for powder in 0..campaign.powders.len() {
                let rows: Vec<usize> =
                    measured.iter().copied().filter(|&i| of_all[i] == powder).collect();
                // A powder that was never measured has no mean of its own.
                let mean = match rows.is_empty() {
                    true => overall,
                    false => rows.iter().map(|&i| column[i]).sum::<f64>() / rows.len() as f64,
                };
                (0..of_all.len()).filter(|&i| of_all[i] == powder).for_each(|i| column[i] -= mean);
            }
        }
        let norm = measured.iter().map(|&i| columns.row(i).norm_squared()).sum::<f64>().sqrt();
        // Relative: a course that is constant in each powder leaves only rounding errors.
        (norm > 1e-9 * before).then(|| Self(columns * ((measured.len() as f64).sqrt() / norm)))
    }

    /// The course for all powders alike, and each powder's own deviation, `deviation` times as
    /// large: `[runs, m (1 + powders)]`, the common columns first.
    pub fn with_powders(&self, powder: &[usize], deviation: f64) -> DMatrix<f64> {
        let powders = powder.iter().max().map_or(0, |last| last + 1);
        let m = self.0.ncols();
        DMatrix::from_fn(powder.len(), m * (1 + powders), |i, column| {
            match (column / m, column % m) {
                (0, of) => self.0[(i, of)],
                (block, of) if powder[i] + 1 == block => deviation * self.0[(i, of)],
                _ => 0.0,
            }
        })
    }
}
