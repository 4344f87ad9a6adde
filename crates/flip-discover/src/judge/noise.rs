//! How angles vary when nothing is wrong: repeats, days, and days that treat powders differently.

use crate::data::campaign::{Campaign, Run};
use flip_core::domain::seed::derive;
use flip_core::stats::mixed_model::{Group, MixedModelError, Whitening};
use flip_core::stats::normal;
use nalgebra::{Cholesky, DMatrix, Dyn};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;

/// Variance of the day effect common to all powders, over that of a repeat.
const DAY_RATIOS: [f64; 5] = [0.0, 0.05, 0.2, 0.6, 1.5];
/// Variance of the day effect on one powder, over that of a repeat.
const DAY_POWDER_RATIOS: [f64; 3] = [0.0, 0.05, 0.2];
/// Robust SD from a powder's median beyond which an angle is clamped to that distance.
const OUTLIER_SD: f64 = 3.5;
/// Degrees of freedom given to the pooled SD of repeats in estimating a powder's own.
const POOLED_FREEDOM: f64 = 4.0;

/// A noise model and its ratios.
pub struct Noise {
    /// Whitening over the measured runs.
    pub model: Whitening,
    /// Factor of V over the measured runs.
    pub factor: Cholesky<f64, Dyn>,
    /// Variance of a day over that of a repeat.
    pub day: f64,
    /// Variance of a day in one powder over that of a repeat.
    pub day_powder: f64,
}

/// SD of each run's own noise over the root mean square of all measured ones: that of a powder's
/// repeats within days, shrunk towards that of all powders.
pub fn weights(campaign: &Campaign) -> Vec<f64> {
    let powders = campaign.powders.len();
    let (mut squares, mut freedom) = (vec![0.0; powders], vec![0.0; powders]);
    let mut days: std::collections::BTreeMap<(usize, usize), Vec<f64>> =
        std::collections::BTreeMap::new();
    for run in &campaign.runs {
        if let Some(angle) = run.value {
            days.entry((run.session, run.powder)).or_default().push(angle);
        }
    }
    for ((_, powder), angles) in &days {
        let mean = angles.iter().sum::<f64>() / angles.len() as f64;
        squares[*powder] += angles.iter().map(|angle| (angle - mean).powi(2)).sum::<f64>();
        freedom[*powder] += (angles.len() - 1) as f64;
    }
    let (all_squares, all_freedom) = (squares.iter().sum::<f64>(), freedom.iter().sum::<f64>());
    // Without any repeats all runs count alike.
    let pooled =
        if all_freedom > 0.0 && all_squares > 0.0 { all_squares / all_freedom } else { 1.0 };
    let variance = |run: &Run| {
        (squares[run.powder] + POOLED_FREEDOM * pooled) / (freedom[run.powder] + POOLED_FREEDOM)
    };
    let variances: Vec<f64> = campaign.runs.iter().map(variance).collect();
    let measured = campaign.measured();
    let mean = measured.iter().map(|&i| variances[i]).sum::<f64>() / measured.len() as f64;
    variances.iter().map(|variance| (variance / mean).sqrt()).collect()
}

/// Angles of the measured runs less their powder's median, outliers clamped; and each powder's
/// median.
pub fn drawn_in(campaign: &Campaign) -> (Vec<f64>, Vec<f64>) {
    let middle = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2].midpoint(values[(values.len() - 1) / 2])
    };
    let of_powder = |powder: usize| {
        let runs = campaign.runs.iter().filter(|run| run.powder == powder);
        let angles: Vec<f64> = runs.filter_map(|run| run.value).collect();
        if angles.is_empty() {
            return (0.0, 0.0);
        }
        let centre = middle(angles.clone());
        // 1.4826: SD of a normal distribution over its median absolute deviation.
        (
            centre,
            OUTLIER_SD
                * 1.4826
                * middle(angles.iter().map(|angle| (angle - centre).abs()).collect()),
        )
    };
    let known: Vec<(f64, f64)> = (0..campaign.powders.len()).map(of_powder).collect();
    let run = |run: &Run| {
        let (centre, reach) = known[run.powder];
        let angle = run.value? - centre;
        // More than half of the angles are equal: outliers cannot be identified.
        Some(if reach == 0.0 { angle } else { angle.clamp(-reach, reach) })
    };
    (
        campaign.runs.iter().filter_map(run).collect(),
        known.into_iter().map(|(centre, _)| centre).collect(),
    )
}

/// Columns of the powders that have an angle, over all runs: `[runs, powders with an angle]`.
pub fn powder_means(campaign: &Campaign) -> DMatrix<f64> {
    let powder = campaign.powder_of();
    let mut known: Vec<usize> = campaign.measured().iter().map(|&i| powder[i]).collect();
    known.sort_unstable();
    known.dedup();
    DMatrix::from_fn(powder.len(), known.len(), |i, k| f64::from(u8::from(powder[i] == known[k])))
}

/// The grid of noise models over the measured runs.
pub fn noises(campaign: &Campaign, weights: &[f64]) -> Result<Vec<Noise>, MixedModelError> {
    let measured = campaign.measured();
    let (powder, session) = (campaign.powder_of(), campaign.session_of());
    let powders = campaign.powders.len();
    let session: Vec<usize> = measured.iter().map(|&i| session[i]).collect();
    let both: Vec<usize> =
        measured.iter().zip(&session).map(|(&i, session)| session * powders + powder[i]).collect();
    let weights: Vec<f64> = measured.iter().map(|&i| weights[i]).collect();
    let means = powder_means(campaign).select_rows(&measured);
    let ratios: Vec<(f64, f64)> = DAY_RATIOS
        .iter()
        .flat_map(|&day| DAY_POWDER_RATIOS.map(|day_powder| (day, day_powder)))
        .collect();
    let noise = |(day, day_powder)| {
        let groups = [Group { of: &session, ratio: day }, Group { of: &both, ratio: day_powder }];
        let (model, factor) = Whitening::with_factor(&weights, &groups, &means)?;
        Ok(Noise { model, factor, day, day_powder })
    };
    ratios.into_par_iter().map(noise).collect()
}

/// The observed campaign in the first column, simulated ones of the same design in the others:
/// `[measured, 1 + simulations]`.
pub fn with_simulated(
    campaign: &Campaign,
    weights: &[f64],
    noises: &[Noise],
    observed: &[f64],
    seed: u64,
    simulations: u32,
) -> DMatrix<f64> {
    let alone = DMatrix::from_column_slice(observed.len(), 1, observed);
    let log_of = |noise: &Noise| noise.model.log_null(noise.model.squares(&alone)[0]);
    let log_noises: Vec<f64> = noises.iter().map(log_of).collect();
    let best = log_noises.iter().copied().fold(f64::MIN, f64::max);
    let odds: Vec<f64> = log_noises.iter().map(|log| (log - best).exp()).collect();
    let total: f64 = odds.iter().sum();
    let powders = campaign.powders.len();
    let sessions = campaign.runs.iter().map(|run| run.session).max().map_or(0, |last| last + 1);
    let measured = campaign.measured();
    let mut all = DMatrix::zeros(observed.len(), 1 + simulations as usize);
    all.column_mut(0).copy_from_slice(observed);
    for k in 1..all.ncols() {
        let mut rng = Pcg64::seed_from_u64(derive(seed, &[k as u64]));
        let mut left = rng.random::<f64>() * total;
        let chosen = odds.iter().position(|odds| {
            left -= odds;
            left < 0.0
        });
        let noise = &noises[chosen.unwrap_or(noises.len() - 1)];
        let mut draws = |count: usize, variance: f64| -> Vec<f64> {
            (0..count)
                .map(|_| variance.sqrt() * normal::quantile(rng.random::<f64>().max(f64::EPSILON)))
                .collect()
        };
        let (day, day_powder) =
            (draws(sessions, noise.day), draws(sessions * powders, noise.day_powder));
        let own = draws(measured.len(), 1.0);
        for (row, &i) in measured.iter().enumerate() {
            let run = &campaign.runs[i];
            all[(row, k)] = day[run.session]
                + day_powder[run.session * powders + run.powder]
                + weights[i] * own[row];
        }
    }
    all
}

/// Departures of days, of cells (a powder on a day) and of repeats, scaled to the size of the
/// effects behind them: signs are drawn for each level separately, so a mean that kept the noise of
/// its members would contain it twice.
///
/// ```text
/// r = repeat sqrt(n / (n - 1))     c = cell sqrt(m / (m - 1)) sqrt(1 - <sum r^2 / n^2> / <c^2>)     d = day sqrt(1 - <sum c^2 (n / N)^2 + sum r^2 / N^2> / <d^2>)
/// ```
///
/// with n runs in a cell, m cells and N runs on a day, and means over runs; the root of a negative
/// number is taken as zero.
fn as_components(
    days: &[f64],
    cells: &[f64],
    repeats: &[f64],
    cell: &dyn Fn(usize) -> (usize, usize),
) -> [Vec<f64>; 3] {
    let mut runs_in: std::collections::BTreeMap<(usize, usize), f64> =
        std::collections::BTreeMap::new();
    (0..days.len()).for_each(|row| *runs_in.entry(cell(row)).or_default() += 1.0);
    let of_day = |day: usize| runs_in.range((day, 0)..(day + 1, 0));
    let (cells_on, runs_on): (Vec<f64>, Vec<f64>) = (0..days.len())
        .map(|row| {
            (
                of_day(cell(row).0).count() as f64,
                of_day(cell(row).0).map(|runs| runs.1).sum::<f64>(),
            )
        })
        .unzip();
    let unbiased = |n: f64| if n > 1.0 { (n / (n - 1.0)).sqrt() } else { 1.0 };
    let mean = |of: &dyn Fn(usize) -> f64| (0..days.len()).map(of).sum::<f64>() / days.len() as f64;
    let share = |noise: f64, all: f64| if all > noise { (1.0 - noise / all).sqrt() } else { 0.0 };
    let n = |row: usize| runs_in[&cell(row)];
    let repeats: Vec<f64> = (0..days.len()).map(|row| repeats[row] * unbiased(n(row))).collect();
    let cells: Vec<f64> = (0..days.len()).map(|row| cells[row] * unbiased(cells_on[row])).collect();
    // A sum over the runs of a cell or a day, averaged over runs, is n or N times its average over
    // them.
    let noise_of_cells = mean(&|row| repeats[row].powi(2) / n(row));
    let share_of_cells = share(noise_of_cells, mean(&|row| cells[row].powi(2)));
    let cells: Vec<f64> = cells.iter().map(|cell| cell * share_of_cells).collect();
    let noise_of_days =
        mean(&|row| (cells[row].powi(2) * n(row) + repeats[row].powi(2)) / runs_on[row]);
    let share_of_days = share(noise_of_days, mean(&|row| days[row].powi(2)));
    [days.iter().map(|day| day * share_of_days).collect(), cells, repeats]
}

/// Campaigns of the same design: this one with signs redrawn for each day, for each day's departure
/// in a powder, and for each repeat in it. They scatter as these angles do, wherever that is more
/// than elsewhere, and no covariate moves them: `[measured, simulations]`.
///
/// Source: the wild bootstrap with Rademacher weights, here at each level of the noise.
pub fn with_signs_redrawn(
    campaign: &Campaign,
    observed: &[f64],
    seed: u64,
    simulations: u32,
) -> DMatrix<f64> {
    let measured = campaign.measured();
    let run = |row: usize| &campaign.runs[measured[row]];
    let rows = observed.len();
    // Departure of each level from the one above it.
    let mean_of = |values: &[f64], of: &dyn Fn(usize) -> (usize, usize)| -> Vec<f64> {
        let mut sums: std::collections::BTreeMap<(usize, usize), (f64, f64)> =
            std::collections::BTreeMap::new();
        for (row, value) in values.iter().enumerate() {
            let sum = sums.entry(of(row)).or_default();
            *sum = (sum.0 + value, sum.1 + 1.0);
        }
        (0..rows).map(|row| sums[&of(row)].0 / sums[&of(row)].1).collect()
    };
    let less = |a: &[f64], b: &[f64]| -> Vec<f64> { a.iter().zip(b).map(|(a, b)| a - b).collect() };
    let centred = less(observed, &mean_of(observed, &|row| (run(row).powder, 0)));
    let of_days = mean_of(&centred, &|row| (run(row).session, 0));
    let within = less(&centred, &of_days);
    let of_cells = mean_of(&within, &|row| (run(row).session, run(row).powder));
    let of_repeats = less(&within, &of_cells);
    let cell = |row: usize| (run(row).session, run(row).powder);
    let [of_days, of_cells, of_repeats] = as_components(&of_days, &of_cells, &of_repeats, &cell);
    let sessions = campaign.runs.iter().map(|run| run.session + 1).max().unwrap_or(0);
    let powders = campaign.powders.len();
    let mut all = DMatrix::zeros(rows, simulations as usize);
    for (k, mut column) in all.column_iter_mut().enumerate() {
        let mut rng = Pcg64::seed_from_u64(derive(seed, &[0x5349_474e, k as u64]));
        let mut signs = |count: usize| -> Vec<f64> {
            (0..count).map(|_| if rng.random::<bool>() { 1.0 } else { -1.0 }).collect()
        };
        let (day, cell, own) = (signs(sessions), signs(sessions * powders), signs(rows));
        for row in 0..rows {
            let (session, powder) = (run(row).session, run(row).powder);
            column[row] = day[session] * of_days[row]
                + cell[session * powders + powder] * of_cells[row]
                + own[row] * of_repeats[row];
        }
    }
    all
}
