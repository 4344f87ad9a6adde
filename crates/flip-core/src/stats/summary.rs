//! Summary statistics of samples: mean, spread and uncertainty of the mean.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Arithmetic mean; `None` for an empty slice.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Sample standard deviation; `None` for fewer than two values.
///
/// ```text
/// s = sqrt( sum (x - mean)^2 / (n - 1) )
/// ```
pub fn sd(values: &[f64]) -> Option<f64> {
    let centre = mean(values)?;
    let squares: f64 = values.iter().map(|x| (x - centre).powi(2)).sum();
    (values.len() > 1).then(|| (squares / (values.len() - 1) as f64).sqrt())
}

/// Standard error of the mean, `s / sqrt n`; `None` for fewer than two values.
pub fn standard_error(values: &[f64]) -> Option<f64> {
    Some(sd(values)? / (values.len() as f64).sqrt())
}

/// Standard deviation within cells, pooled over cells that each have their own mean.
///
/// ```text
/// s_w = sqrt( sum over cells sum over x of (x - mean of its cell)^2 / (N - number of cells) )
/// ```
///
/// The spread of repeats when conditions (powder, target) differ between cells; `None` if no cell
/// holds two values. Cells with one value carry no information on spread and count on neither side.
pub fn sd_within_cells<'a>(cells: impl IntoIterator<Item = &'a [f64]>) -> Option<f64> {
    let (mut squares, mut freedom) = (0.0, 0);
    for cell in cells {
        let Some(centre) = mean(cell) else { continue };
        squares += cell.iter().map(|x| (x - centre).powi(2)).sum::<f64>();
        freedom += cell.len() - 1;
    }
    (freedom > 0).then(|| (squares / freedom as f64).sqrt())
}

/// Percentile bootstrap interval of the mean: the `(1 - level) / 2` and `(1 + level) / 2` quantiles
/// of the means of `resamples` samples drawn with replacement. `None` for an empty slice; `[x, x]`
/// for one value.
///
/// | argument | range | typical |
/// |----------|-------|---------|
/// | `level` | 0 to 1 | 0.95 |
/// | `resamples` | at least 1 | 10 000 |
///
/// The same values and seed give the same interval. With few values (n < 10) the interval is too
/// narrow, as with every percentile bootstrap.
///
/// Source: Efron, Tibshirani, An Introduction to the Bootstrap (1993), chapter 13.
pub fn bootstrap_mean_interval(
    values: &[f64],
    level: f64,
    resamples: usize,
    seed: u64,
) -> Option<[f64; 2]> {
    bootstrap_interval(values, mean, level, resamples, seed)
}

/// The same of any statistic of the values. Samples of which it is `None` do not count; `None` if it
/// is of all.
pub fn bootstrap_interval<T: Clone>(
    values: &[T],
    statistic: impl Fn(&[T]) -> Option<f64>,
    level: f64,
    resamples: usize,
    seed: u64,
) -> Option<[f64; 2]> {
    if values.is_empty() {
        return None;
    }
    let mut rng = Pcg64::seed_from_u64(seed);
    let n = values.len();
    let mut draw = || values[rng.random_range(0..n as u64) as usize].clone();
    let mut found: Vec<f64> = (0..resamples.max(1))
        .filter_map(|_| statistic(&(0..n).map(|_| draw()).collect::<Vec<T>>()))
        .collect();
    found.sort_unstable_by(f64::total_cmp);
    let ends = [(1.0 - level) / 2.0, (1.0 + level) / 2.0];
    (!found.is_empty()).then(|| ends.map(|p| quantile_of_sorted(&found, p)))
}

/// First quartile, median and third quartile; `None` of no values.
pub fn quartiles(mut values: Vec<f64>) -> Option<[f64; 3]> {
    values.sort_unstable_by(f64::total_cmp);
    (!values.is_empty()).then(|| [0.25, 0.5, 0.75].map(|p| quantile_of_sorted(&values, p)))
}

/// Interpolates linearly between order statistics (type 7 of Hyndman and Fan 1996); `sorted` must
/// not be empty.
fn quantile_of_sorted(sorted: &[f64], p: f64) -> f64 {
    let position = p.clamp(0.0, 1.0) * (sorted.len() - 1) as f64;
    let (below, part) = (position.floor() as usize, position.fract());
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + part * (sorted[above] - sorted[below])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stats::normal;

    #[test]
    fn textbook_numbers_come_out() {
        assert_eq!(quartiles(vec![5.0, 1.0, 2.0, 4.0, 3.0]), Some([2.0, 3.0, 4.0]));
        assert_eq!(quartiles(Vec::new()), None);
        let values = [2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0];
        assert_eq!(mean(&values), Some(5.0));
        assert!((sd(&values).unwrap() - (32.0f64 / 7.0).sqrt()).abs() < 1e-15);
        assert!((standard_error(&values).unwrap() - (32.0f64 / 56.0).sqrt()).abs() < 1e-15);
    }

    #[test]
    fn what_cannot_be_known_is_none() {
        assert_eq!(mean(&[]), None);
        assert_eq!((sd(&[1.0]), standard_error(&[1.0])), (None, None));
        assert_eq!(sd_within_cells([[1.0].as_slice(), &[], &[7.0]]), None);
        assert_eq!(bootstrap_mean_interval(&[], 0.95, 100, 1), None);
        assert_eq!(bootstrap_mean_interval(&[3.0], 0.95, 100, 1), Some([3.0, 3.0]));
    }

    #[test]
    fn the_spread_within_cells_ignores_differences_between_them() {
        let cells: [&[f64]; 3] = [&[0.0, 2.0], &[100.0, 102.0, 104.0], &[-50.0]];
        // Sum of squares 2 + 8 over 1 + 2 degrees of freedom.
        assert!((sd_within_cells(cells).unwrap() - (10.0f64 / 3.0).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn the_bootstrap_interval_covers_the_mean_about_as_often_as_it_says() {
        let mut rng = Pcg64::seed_from_u64(11);
        let trials = 400;
        let covered = (0..trials)
            .filter(|&trial| {
                let sample: Vec<f64> =
                    (0..30).map(|_| normal::quantile(rng.random::<f64>())).collect();
                let [low, high] = bootstrap_mean_interval(&sample, 0.95, 500, trial).unwrap();
                low <= 0.0 && 0.0 <= high
            })
            .count() as f64
            / trials as f64;
        // Expected 0.93-0.95 at n = 30; 4 binomial standard errors of 400 trials are 0.044.
        assert!((0.89..=0.985).contains(&covered), "covered {covered}");
        assert_eq!(
            bootstrap_mean_interval(&[1.0, 2.0, 4.0], 0.9, 200, 3),
            bootstrap_mean_interval(&[1.0, 2.0, 4.0], 0.9, 200, 3)
        );
    }
}
