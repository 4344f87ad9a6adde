//! Simulates readings of the same design in which nothing is wrong.
//!
//! ```text
//! d_k = mu_k exp(c (e_k + sqrt(w) u + sqrt(v) (u_1 + .. + u_k)))         m_k = m_(k-1) + d_k         y = m_k + s (e + sqrt(r) f), shown to the display's step
//! ```
//!
//! with the scatter c of shakes, the share w common to a weighing, the share v by which each shake
//! changes those after it, the noise s of a reading and the share r of it correlated by the
//! balance's own filter, each drawn by its probability given the measured readings.

use super::design::Design;
use super::noise::Masses;
use flip_core::domain::seed::derive;
use flip_core::stats::normal;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// The bench's scatter when nothing is wrong.
pub(super) struct Scatter {
    /// SD of the balance's white noise, mg.
    pub reading_mg: f64,
    /// Odds of each share r of filtered noise and time of the filter, s.
    pub filtered: Vec<(f64, (f64, f64))>,
    /// Odds of each scatter c, share w and share v.
    pub shakes: Vec<(f64, [f64; 3])>,
}

/// SD of a balance's noise whose readings, shown in steps of `readability_mg`, scatter by
/// `shown_sd_mg` on average over the loads' positions within a step.
///
/// # Formula
/// ```text
/// shown^2 = integral over u in 0..1 of Var[round(u + (s / step) e)] step^2,   e ~ N(0, 1)
/// ```
/// solved for s by bisection; derived here.
pub(super) fn noise_behind(shown_sd_mg: f64, readability_mg: f64) -> f64 {
    if readability_mg <= 0.0 || shown_sd_mg <= 0.0 {
        return shown_sd_mg;
    }
    let wanted = (shown_sd_mg / readability_mg).powi(2);
    // Above half a step rounding adds its textbook twelfth.
    if wanted > 0.4 {
        return readability_mg * (wanted - 1.0 / 12.0).sqrt();
    }
    let variance = |s: f64| {
        let of = |u: f64| {
            let at = |j: i32| {
                normal::cdf((f64::from(j) + 0.5 - u) / s)
                    - normal::cdf((f64::from(j) - 0.5 - u) / s)
            };
            let (mean, square) = (-4..=5).fold((0.0, 0.0), |(mean, square), j| {
                let p = at(j);
                (mean + p * f64::from(j), square + p * f64::from(j * j))
            });
            square - mean * mean
        };
        (0..64).map(|k| of((f64::from(k) + 0.5) / 64.0)).sum::<f64>() / 64.0
    };
    let (mut low, mut high) = (1e-3, 1.0);
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if variance(middle) < wanted { low = middle } else { high = middle }
    }
    readability_mg * 0.5 * (low + high)
}

/// Readings of simulation `k`, `[readings]`, mg.
pub(super) fn readings(
    design: &Design,
    masses: Option<&Masses>,
    scatter: &Scatter,
    seed: u64,
    k: u64,
) -> Vec<f64> {
    let mut rng = Pcg64::seed_from_u64(derive(seed, &[k]));
    let (ratio, filter_s) = pick(&scatter.filtered, rng.random());
    let [own, common, step] = pick(&scatter.shakes, rng.random());
    let mut draw = || normal::quantile(rng.random::<f64>().max(f64::EPSILON));
    let mut levels = design.levels(&design.shown_mg);
    let measured = levels.clone();
    let step_mg = design.readability_mg;
    for log in &design.logs {
        // The position of a load within the display's step is not known.
        let shift = step_mg * (normal::cdf(draw()) - 0.5);
        log.plateaus.clone().for_each(|k| levels[k] += shift);
    }
    if let Some(masses) = masses {
        let (mut log, mut together) = (usize::MAX, 0.0);
        for (i, shake) in design.shakes.iter().enumerate() {
            if shake.log != log {
                (log, together) = (shake.log, own * f64::sqrt(common) * draw());
            }
            together += own * f64::sqrt(step) * draw();
            let mass = masses.nominal_mg[i] * (own * draw() + together).exp();
            // A shake that was not judged leaves the steps after it as they are.
            let skipped = shake.before.map_or(0.0, |before| levels[before]);
            levels[shake.after] = skipped + mass;
            let next = design.shakes.get(i + 1).and_then(|next| next.before);
            if next != Some(shake.after) {
                let end = design.logs[shake.log].plateaus.end;
                for k in shake.after + 1..end {
                    levels[k] = levels[k - 1] + measured[k] - measured[k - 1];
                }
            }
        }
    }
    let sd = scatter.reading_mg / (1.0 + ratio).sqrt();
    let mut shown = Vec::with_capacity(design.times_s.len());
    for log in &design.logs {
        let (mut filtered, mut last) = (draw(), f64::NEG_INFINITY);
        for k in log.plateaus.clone() {
            for i in design.plateaus[k].readings.clone() {
                let keeps = libm::exp(-(design.times_s[i] - last) / filter_s);
                filtered = keeps * filtered + (1.0 - keeps * keeps).max(0.0).sqrt() * draw();
                last = design.times_s[i];
                let value = levels[k] + sd * (draw() + ratio.sqrt() * filtered);
                shown.push(if step_mg > 0.0 { (value / step_mg).round() * step_mg } else { value });
            }
        }
    }
    shown
}

fn pick<T: Copy>(odds: &[(f64, T)], uniform: f64) -> T {
    let mut left = uniform * odds.iter().map(|(odds, _)| odds).sum::<f64>();
    let chosen = odds.iter().find(|(odds, _)| {
        left -= odds;
        left < 0.0
    });
    chosen.unwrap_or(&odds[odds.len() - 1]).1
}
