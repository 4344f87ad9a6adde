//! What an extension is worth on runs it was not fitted to: the whole search is repeated without
//! them.
//!
//! ```text
//! by day      sessions in ten folds; a fold's angles are hidden, everything else is screened, and where something is found it predicts them
//! by powder   a powder's angles are hidden; of it the course over its runs is judged, its mean being a matter of calibration
//! by range    the runs in the lowest and the highest fifth of the covariate are hidden in turn
//! intervals   2000 resamples of the sessions that were left out
//! ```

use crate::causes::hypothesis::Responses;
use crate::data::campaign::{Campaign, Quantity};
use crate::data::scenario::{percentile, quantile};
use crate::judge::posterior::{Posterior, Predicted};
use crate::judge::prepared::Prepared;
use crate::judge::screen::{Settings, screen_prepared};
use crate::report::{Coverage, Gain, HeldOut, LogScore};
use crate::thresholds::{HELD_OUT_SESSIONS_MIN, SIGNIFICANCE};
use flip_core::domain::FieldError;
use flip_core::domain::seed::derive;
use flip_core::stats::normal;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::ops::ControlFlow;

/// Folds of days.
const FOLDS: usize = 10;
/// Simulated campaigns in which nothing is wrong, in each fold.
const SIMULATIONS: u32 = 99;
const RESAMPLES: usize = 2000;
/// Normal deviate of a two-sided 90 % interval.
const BAND: f64 = 1.645;

/// One hidden run.
struct Hidden {
    session: usize,
    /// Measured less predicted, before and after.
    errors: [f64; 2],
    sds: [f64; 2],
}

/// The gain on left-out data; `None` with too few sessions, or if the rest of a fold cannot be
/// judged.
pub(crate) fn gain(
    campaign: &Campaign,
    responses: &Responses,
    covariate: Option<&str>,
    settings: &Settings,
    mut on_fold: impl FnMut(f64) -> ControlFlow<()>,
) -> Result<Option<Gain>, Stopped> {
    let mut sessions: Vec<usize> =
        campaign.measured().iter().map(|&i| campaign.runs[i].session).collect();
    sessions.sort_unstable();
    sessions.dedup();
    if sessions.len() < HELD_OUT_SESSIONS_MIN {
        return Ok(None);
    }
    let folds = FOLDS.min(sessions.len());
    let fold_of = |session: usize| sessions.binary_search(&session).unwrap_or(0) % folds;
    let of_days =
        (0..folds).map(|fold| rows(campaign, |i| fold_of(campaign.runs[i].session) == fold));
    let of_powders = (0..campaign.powders.len())
        .map(|powder| rows(campaign, |i| campaign.runs[i].powder == powder));
    let ends = covariate.and_then(|name| {
        Some((name, percentile(campaign, name, 0.2)?, percentile(campaign, name, 0.8)?))
    });
    let of_range: Vec<Vec<usize>> = ends.map_or(Vec::new(), |(name, low, high)| {
        let values = campaign.numbers(name).unwrap_or_default();
        let ends = [rows(campaign, |i| values[i] < low), rows(campaign, |i| values[i] > high)];
        // Where a fifth of the runs share the lowest value, nothing lies below it.
        ends.into_iter().filter(|end| !end.is_empty()).collect()
    });
    let all = folds + campaign.powders.len() + of_range.len();
    let mut done = 0;
    let mut next =
        |hidden: Vec<usize>, centred: bool, scored: &mut Vec<Hidden>| -> Result<bool, Stopped> {
            let Ok(of_fold) = fold(campaign, responses, &hidden, centred, settings) else {
                return Ok(false);
            };
            // A powder that is hidden completely has no angle, only its course.
            scored.extend(
                of_fold.into_iter().filter(|it| it.errors.iter().all(|error| error.is_finite())),
            );
            done += 1;
            if on_fold(f64::from(done) / all as f64).is_break() { Err(Stopped) } else { Ok(true) }
        };
    let (mut days, mut powders, mut range) = (Vec::new(), Vec::new(), Vec::new());
    for hidden in of_days {
        if !next(hidden, false, &mut days)? {
            return Ok(None);
        }
    }
    for hidden in of_powders.filter(|hidden| campaign.powders.len() > 1 && !hidden.is_empty()) {
        next(hidden, true, &mut powders)?;
    }
    for hidden in of_range {
        next(hidden, false, &mut range)?;
    }
    let held_out = |scored: &[Hidden]| held_out(scored, campaign.quantity, settings.seed);
    let log_score = log_score(&days, settings.seed);
    let within = |k: usize| {
        let inside = days.iter().filter(|it| it.errors[k].abs() <= BAND * it.sds[k]).count();
        inside as f64 / days.len() as f64
    };
    let by_day = held_out(&days);
    // A win: errors become smaller, and the better log score is not an accident of these days.
    let accepted = by_day.rmse_after < by_day.rmse_before && log_score.ci95[0] > 0.0;
    Ok(Some(Gain {
        held_out: by_day,
        by_powder: (!powders.is_empty()).then(|| held_out(&powders)),
        by_range: (!range.is_empty()).then(|| held_out(&range)),
        log_score,
        coverage90: Coverage { before: within(0), after: within(1) },
        weighing_error_mg: None,
        accepted,
    }))
}

/// A stop was requested.
pub(crate) struct Stopped;

fn rows(campaign: &Campaign, which: impl Fn(usize) -> bool) -> Vec<usize> {
    campaign.measured().into_iter().filter(|&i| which(i)).collect()
}

/// Hides these runs, searches in the rest, and predicts them. `centred`: only the course within
/// each powder counts.
fn fold(
    campaign: &Campaign,
    responses: &Responses,
    hidden: &[usize],
    centred: bool,
    settings: &Settings,
) -> Result<Vec<Hidden>, FieldError> {
    let rest = campaign.without(hidden).checked()?;
    let prepared = Prepared::new(&rest, responses)?;
    let settings =
        Settings { simulations: SIMULATIONS, seed: derive(settings.seed, &[hidden[0] as u64]) };
    let never = |_: f64| ControlFlow::Continue(());
    let posterior = Posterior::new(&prepared);
    let shifts = posterior.shifts();
    let screening = screen_prepared(&prepared, &rest, &shifts, &settings, never);
    let is_found = screening.is_some_and(|it| it.p_value <= SIGNIFICANCE);
    let predicted = posterior.predict(&rest);
    let angle = |i: usize| campaign.runs[i].repose_deg.unwrap_or(f64::NAN);
    let mean = |of: &dyn Fn(usize) -> f64| {
        hidden.iter().map(|&i| of(i)).sum::<f64>() / hidden.len() as f64
    };
    let (mean_angle, mean_shift) = (mean(&angle), mean(&|i| shifts[i]));
    let score = |&i: &usize| {
        let [before, after] = predicted[i];
        let after = if is_found { after } else { before };
        let errors = match centred {
            true => {
                let shift = if is_found { shifts[i] - mean_shift } else { 0.0 };
                [angle(i) - mean_angle, angle(i) - mean_angle - shift]
            }
            false => [before, after].map(|it: Predicted| angle(i) - it.mean_deg),
        };
        Hidden { session: campaign.runs[i].session, errors, sds: [before.sd_deg, after.sd_deg] }
    };
    Ok(hidden.iter().map(score).collect())
}

fn held_out(scored: &[Hidden], quantity: Quantity, seed: u64) -> HeldOut {
    let rmse = |of: &[&Hidden], k: usize| {
        (of.iter().map(|it| it.errors[k].powi(2)).sum::<f64>() / of.len().max(1) as f64).sqrt()
    };
    let all: Vec<&Hidden> = scored.iter().collect();
    HeldOut {
        rmse_before: rmse(&all, 0),
        rmse_after: rmse(&all, 1),
        ci95: resampled(scored, seed, |of| rmse(of, 0) - rmse(of, 1)),
        unit: quantity.unit().to_owned(),
        n: scored.len() as u32,
    }
}

fn log_score(scored: &[Hidden], seed: u64) -> LogScore {
    let score = |it: &Hidden, k: usize| {
        (normal::pdf(it.errors[k] / it.sds[k]) / it.sds[k]).max(1e-300).ln()
    };
    let mean = |of: &[&Hidden], k: usize| {
        of.iter().map(|it| score(it, k)).sum::<f64>() / of.len().max(1) as f64
    };
    let all: Vec<&Hidden> = scored.iter().collect();
    let ci95 = resampled(scored, seed, |of| mean(of, 1) - mean(of, 0));
    LogScore { before: mean(&all, 0), after: mean(&all, 1), ci95 }
}

/// 95 % interval of a statistic over resamples of whole sessions.
fn resampled(scored: &[Hidden], seed: u64, statistic: impl Fn(&[&Hidden]) -> f64) -> [f64; 2] {
    let mut days: std::collections::BTreeMap<usize, Vec<&Hidden>> =
        std::collections::BTreeMap::new();
    scored.iter().for_each(|it| days.entry(it.session).or_default().push(it));
    let days: Vec<Vec<&Hidden>> = days.into_values().collect();
    let mut rng = Pcg64::seed_from_u64(derive(seed, &[0x4845_4c44]));
    let mut draws: Vec<f64> = (0..RESAMPLES)
        .map(|_| {
            let drawn: Vec<&Hidden> = (0..days.len())
                .flat_map(|_| days[rng.random_range(0..days.len())].iter().copied())
                .collect();
            statistic(&drawn)
        })
        .collect();
    draws.sort_by(f64::total_cmp);
    [0.025, 0.975].map(|share| quantile(&draws, share).unwrap_or(0.0))
}
