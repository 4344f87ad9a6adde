//! What this design would find: the effect of each cause that four of five campaigns like this one
//! would show.

use crate::causes::hypothesis::{Cause, Hypothesis};
use crate::data::campaign::Campaign;
use crate::data::scenario::quantile;
use crate::judge::noise;
use crate::judge::posterior::Posterior;
use crate::judge::prepared::Prepared;
use crate::judge::screen::{Screening, Settings};
use crate::report::Detectable;
use crate::thresholds::POWER;
use nalgebra::DMatrix;

/// Simulated campaigns.
const CAMPAIGNS: u32 = 60;
/// Bounds of a cause's root mean square over the SD of a repeat, and the number of halvings between
/// them.
const BOUNDS: [f64; 2] = [0.02, 4.0];
const HALVINGS: u32 = 7;

/// Detectable effects of the mechanisms this campaign can judge. Mechanisms not shown even at the
/// upper bound are left out. Found effects are not noise and are subtracted first.
pub(crate) fn detectable(
    campaign: &Campaign,
    prepared: &Prepared,
    screening: &Screening,
    found: Option<&Posterior<'_>>,
    settings: &Settings,
) -> Vec<Detectable> {
    let Prepared { weights, noises, hypotheses, measured, .. } = prepared;
    let shifts = found.map(Posterior::shifts);
    let left: Vec<f64> = measured
        .iter()
        .zip(&prepared.observed)
        .map(|(&i, angle)| angle - shifts.as_ref().map_or(0.0, |shifts| shifts[i]))
        .collect();
    let drawn =
        noise::with_simulated(campaign, weights, noises, &left, settings.seed ^ 1, CAMPAIGNS);
    let drawn = drawn.columns(1, CAMPAIGNS as usize).into_owned();
    let threshold = quantile(&screening.null, 0.95).unwrap_or(0.0);
    let repeat_sd = prepared.repeat_sd(&left);
    let of = |hypothesis: &Hypothesis| {
        let Cause::Known(mechanism) = hypothesis.cause else { return None };
        let features = hypothesis.features[0].select_rows(measured);
        // For names, the first.
        let course = features.column(0).into_owned();
        let sign = hypothesis.sign.unwrap_or(1.0);
        let shows = |size: f64| {
            let moved = DMatrix::from_fn(drawn.nrows(), drawn.ncols(), |i, k| {
                drawn[(i, k)] + sign * size * course[i]
            });
            let odds = prepared.log_odds(hypothesis, &prepared.seen(&moved));
            let found =
                odds.iter().filter(|&&odds| odds + hypothesis.prior.ln() > threshold).count();
            found as f64 >= POWER * f64::from(CAMPAIGNS)
        };
        let [mut low, mut high] = BOUNDS;
        if !shows(high) {
            return None;
        }
        for _ in 0..HALVINGS {
            let middle = (low * high).sqrt();
            if shows(middle) { high = middle } else { low = middle }
        }
        let mut sorted: Vec<f64> = course.iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        let between =
            |low: f64, high: f64| Some(quantile(&sorted, high)? - quantile(&sorted, low)?);
        // A step passed by few runs has no range between the percentiles; then the full range is
        // used.
        let (range, all) = (between(0.05, 0.95)?, between(0.0, 1.0)?);
        let range = if range < all / 2.0 { all } else { range };
        let effect_deg = high * repeat_sd * range;
        Some(Detectable { mechanism: mechanism.name().0.to_owned(), effect_deg, power: POWER })
    };
    hypotheses.iter().filter_map(of).collect()
}
