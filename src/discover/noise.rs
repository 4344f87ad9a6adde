//! What angles do when nothing is wrong: repeats, days, and days that treat powders differently.

use super::campaign::{Campaign, Run};
use crate::domain::seed::derive;
use crate::stats::mixed_model::{Group, MixedModelError, Whitening};
use crate::stats::normal;
use nalgebra::{Cholesky, DMatrix, Dyn};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;

/// Variance of what a day does to all powders, over that of a repeat.
const DAY_RATIOS: [f64; 5] = [0.0, 0.05, 0.2, 0.6, 1.5];
/// Variance of what a day does to one powder, over that of a repeat.
const DAY_POWDER_RATIOS: [f64; 3] = [0.0, 0.05, 0.2];
/// Robust SD from a powder's median beyond which an angle is drawn in to that distance.
const OUTLIER_SD: f64 = 3.5;
/// Degrees of freedom that the pooled SD of repeats has in a powder's own.
const POOLED_FREEDOM: f64 = 4.0;

/// A noise model and its ratios.
pub struct Noise {
    /// Ready to judge, over the measured runs.
    pub model: Whitening,
    /// Factor of V over the measured runs.
    pub factor: Cholesky<f64, Dyn>,
    /// Variance of a day over that of a repeat.
    pub day: f64,
    /// Variance of a day in one powder over that of a repeat.
    pub day_powder: f64,
}

/// SD of each run's own noise over the root mean square of all measured ones: of a powder's repeats within days, drawn towards that of all
/// powders.
pub fn weights(campaign: &Campaign) -> Vec<f64> {
    let powders = campaign.powders.len();
    let (mut squares, mut freedom) = (vec![0.0; powders], vec![0.0; powders]);
    let mut days: std::collections::BTreeMap<(usize, usize), Vec<f64>> = std::collections::BTreeMap::new();
    for run in &campaign.runs {
        if let Some(angle) = run.repose_deg {
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
    let pooled = if all_freedom > 0.0 && all_squares > 0.0 { all_squares / all_freedom } else { 1.0 };
    let variance = |run: &Run| (squares[run.powder] + POOLED_FREEDOM * pooled) / (freedom[run.powder] + POOLED_FREEDOM);
    let variances: Vec<f64> = campaign.runs.iter().map(variance).collect();
    let measured = campaign.measured();
    let mean = measured.iter().map(|&i| variances[i]).sum::<f64>() / measured.len() as f64;
    variances.iter().map(|variance| (variance / mean).sqrt()).collect()
}

/// Angles of the measured runs less their powder's median, outliers drawn in; and each powder's median.
pub fn drawn_in(campaign: &Campaign) -> (Vec<f64>, Vec<f64>) {
    let middle = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2].midpoint(values[(values.len() - 1) / 2])
    };
    let of_powder = |powder: usize| {
        let runs = campaign.runs.iter().filter(|run| run.powder == powder);
        let angles: Vec<f64> = runs.filter_map(|run| run.repose_deg).collect();
        if angles.is_empty() {
            return (0.0, 0.0);
        }
        let centre = middle(angles.clone());
        // 1.4826: SD of a normal distribution over its median absolute deviation.
        (centre, OUTLIER_SD * 1.4826 * middle(angles.iter().map(|angle| (angle - centre).abs()).collect()))
    };
    let known: Vec<(f64, f64)> = (0..campaign.powders.len()).map(of_powder).collect();
    let run = |run: &Run| {
        let (centre, reach) = known[run.powder];
        let angle = run.repose_deg? - centre;
        // More than half of the angles are the same: there is no telling what is far.
        Some(if reach == 0.0 { angle } else { angle.clamp(-reach, reach) })
    };
    (campaign.runs.iter().filter_map(run).collect(), known.into_iter().map(|(centre, _)| centre).collect())
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
    let both: Vec<usize> = measured.iter().zip(&session).map(|(&i, session)| session * powders + powder[i]).collect();
    let weights: Vec<f64> = measured.iter().map(|&i| weights[i]).collect();
    let means = powder_means(campaign).select_rows(&measured);
    let ratios: Vec<(f64, f64)> =
        DAY_RATIOS.iter().flat_map(|&day| DAY_POWDER_RATIOS.map(|day_powder| (day, day_powder))).collect();
    let noise = |(day, day_powder)| {
        let groups = [Group { of: &session, ratio: day }, Group { of: &both, ratio: day_powder }];
        let (model, factor) = Whitening::with_factor(&weights, &groups, &means)?;
        Ok(Noise { model, factor, day, day_powder })
    };
    ratios.into_par_iter().map(noise).collect()
}

/// The observed campaign in the first column, simulated ones of the same design in the others: `[measured, 1 + simulations]`.
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
            (0..count).map(|_| variance.sqrt() * normal::quantile(rng.random::<f64>().max(f64::EPSILON))).collect()
        };
        let (day, day_powder) = (draws(sessions, noise.day), draws(sessions * powders, noise.day_powder));
        let own = draws(measured.len(), 1.0);
        for (row, &i) in measured.iter().enumerate() {
            let run = &campaign.runs[i];
            all[(row, k)] = day[run.session] + day_powder[run.session * powders + run.powder] + weights[i] * own[row];
        }
    }
    all
}
