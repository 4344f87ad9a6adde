//! What an extension is worth on runs it was not fitted to: the whole search is repeated without
//! them.
//!
//! ```text
//! by day      sessions in ten folds; a fold's angles are hidden, everything else is screened, and where something is found it predicts them
//! by powder   a powder's angles are hidden; of it the course over its runs is judged, its mean being a matter of calibration
//! by range    the runs in the lowest and the highest fifth of the covariate are hidden in turn
//! intervals   2000 resamples of the sessions that were left out
//! ```

use crate::causes::response::Responses;
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

/// Runs hidden together, in each of three ways.
struct Splits {
    days: Vec<Vec<usize>>,
    powders: Vec<Vec<usize>>,
    range: Vec<Vec<usize>>,
}

impl Splits {
    /// Returns `None` with too few sessions.
    fn of(campaign: &Campaign, covariate: Option<&str>) -> Option<Self> {
        let run = |i: usize| &campaign.runs[i];
        let mut sessions: Vec<usize> =
            campaign.measured().iter().map(|&i| run(i).session).collect();
        sessions.sort_unstable();
        sessions.dedup();
        if sessions.len() < HELD_OUT_SESSIONS_MIN {
            return None;
        }
        let folds = FOLDS.min(sessions.len());
        let fold_of = |session: usize| sessions.binary_search(&session).unwrap_or(0) % folds;
        let of_fold = |fold: usize| rows(campaign, |i| fold_of(run(i).session) == fold);
        let of_powder = |powder: usize| rows(campaign, |i| run(i).powder == powder);
        Some(Self {
            days: (0..folds).map(of_fold).collect(),
            powders: (0..campaign.powders.len()).map(of_powder).collect(),
            range: covariate.map_or(Vec::new(), |name| ends_of_range(campaign, name)),
        })
    }
}

/// Runs in the lowest and in the highest fifth of a covariate. Where a fifth of the runs share the
/// lowest value, nothing lies below it.
fn ends_of_range(campaign: &Campaign, covariate: &str) -> Vec<Vec<usize>> {
    let place = |share: f64| percentile(campaign, covariate, share);
    let (Some(low), Some(high)) = (place(0.2), place(0.8)) else { return Vec::new() };
    let values = campaign.numbers(covariate).unwrap_or_default();
    let ends = [rows(campaign, |i| values[i] < low), rows(campaign, |i| values[i] > high)];
    ends.into_iter().filter(|end| !end.is_empty()).collect()
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
    let Some(splits) = Splits::of(campaign, covariate) else { return Ok(None) };
    let all = splits.days.len() + splits.powders.len() + splits.range.len();
    let mut done = 0;
    let mut next = |hidden: &[usize], centred: bool| -> Result<Option<Vec<Hidden>>, Stopped> {
        let Ok(mut scored) = fold(campaign, responses, hidden, centred, settings) else {
            return Ok(None);
        };
        // A powder that is hidden completely has no angle, only its course.
        scored.retain(|run| run.errors.iter().all(|error| error.is_finite()));
        done += 1;
        if on_fold(f64::from(done) / all as f64).is_break() {
            Err(Stopped)
        } else {
            Ok(Some(scored))
        }
    };
    let (mut days, mut powders, mut range) = (Vec::new(), Vec::new(), Vec::new());
    for hidden in &splits.days {
        let Some(scored) = next(hidden, false)? else { return Ok(None) };
        days.extend(scored);
    }
    let is_one_of_several = |hidden: &&Vec<usize>| splits.powders.len() > 1 && !hidden.is_empty();
    for hidden in splits.powders.iter().filter(is_one_of_several) {
        powders.extend(next(hidden, true)?.into_iter().flatten());
    }
    for hidden in &splits.range {
        range.extend(next(hidden, false)?.into_iter().flatten());
    }
    Ok(Some(summary([&days, &powders, &range], campaign.quantity, settings.seed)))
}

/// The gain over hidden days, powders and ends of a range.
///
/// ```text
/// score of a run       log N(error; 0, SD), before and after
/// accepted             root mean square error after < before, and the 95 % interval of the mean
///                      score after less before lies above zero
/// ```
///
/// Errors alone may shrink by chance on a few days, or where SDs that were right become too narrow.
fn summary([days, powders, range]: [&[Hidden]; 3], quantity: Quantity, seed: u64) -> Gain {
    let held_out = |scored: &[Hidden]| held_out(scored, quantity, seed);
    let log_score = log_score(days, seed);
    let within = |k: usize| {
        let inside = days.iter().filter(|run| run.errors[k].abs() <= BAND * run.sds[k]).count();
        inside as f64 / days.len() as f64
    };
    let by_day = held_out(days);
    let accepted = by_day.rmse_after < by_day.rmse_before && log_score.ci95[0] > 0.0;
    Gain {
        held_out: by_day,
        by_powder: (!powders.is_empty()).then(|| held_out(powders)),
        by_range: (!range.is_empty()).then(|| held_out(range)),
        log_score,
        coverage90: Coverage { before: within(0), after: within(1) },
        weighing_error_mg: None,
        accepted,
    }
}

/// A stop was requested.
pub(crate) struct Stopped;

/// The measured runs among these.
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
    let angle = |i: usize| campaign.runs[i].value.unwrap_or(f64::NAN);
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
            false => [before, after].map(|it: Predicted| angle(i) - it.mean),
        };
        Hidden { session: campaign.runs[i].session, errors, sds: [before.sd, after.sd] }
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

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Deserialize)]
    struct References {
        held_out: Vec<Reference>,
    }

    /// Runs on four days; each end of an interval is given by the range in which resamples have it.
    #[derive(Deserialize)]
    struct Reference {
        session: Vec<usize>,
        errors: Vec<[f64; 2]>,
        sds: Vec<[f64; 2]>,
        rmse: [f64; 2],
        rmse_ci95: [[f64; 2]; 2],
        log_score: [f64; 2],
        log_score_ci95: [[f64; 2]; 2],
        coverage90: [f64; 2],
        accepted: bool,
    }

    fn is_in(ci95: [f64; 2], ranges: [[f64; 2]; 2]) -> bool {
        ci95.iter().zip(ranges).all(|(end, [low, high])| (low - 1e-9..=high + 1e-9).contains(end))
    }

    #[test]
    fn the_gain_is_that_of_every_resample_enumerated() {
        let text = include_str!("../../../../tests/reference/discovery.json");
        let References { held_out: references } = serde_json::from_str(text).unwrap();
        for reference in references {
            let run = |k: usize| Hidden {
                session: reference.session[k],
                errors: reference.errors[k],
                sds: reference.sds[k],
            };
            let days: Vec<Hidden> = (0..reference.session.len()).map(run).collect();
            let gain = summary([&days, &[], &[]], Quantity::Repose, 1);
            let HeldOut { rmse_before, rmse_after, ci95, .. } = gain.held_out;
            let close = |ours: f64, theirs: f64| (ours - theirs).abs() < 1e-9;
            assert!(close(rmse_before, reference.rmse[0]) && close(rmse_after, reference.rmse[1]));
            assert!(is_in(ci95, reference.rmse_ci95), "{ci95:?}");
            let LogScore { before, after, ci95 } = gain.log_score;
            assert!(close(before, reference.log_score[0]) && close(after, reference.log_score[1]));
            assert!(is_in(ci95, reference.log_score_ci95), "{ci95:?}");
            let Coverage { before, after } = gain.coverage90;
            assert_eq!([before, after], reference.coverage90);
            // The second has smaller errors, by less than days differ.
            assert_eq!(gain.accepted, reference.accepted);
        }
    }

    #[test]
    fn every_measured_run_is_left_out_once_with_its_day() {
        let mut campaign = crate::data::sample::campaign(1, |_| 0.0);
        campaign.runs[5].value = None;
        let splits = Splits::of(&campaign, Some("relative_humidity_pct")).unwrap();
        assert_eq!((splits.days.len(), splits.powders.len(), splits.range.len()), (FOLDS, 2, 2));
        let mut all = splits.days.concat();
        all.sort_unstable();
        assert_eq!(all, campaign.measured());
        let [low, high] = &splits.range[..] else { panic!() };
        let humidity = campaign.numbers("relative_humidity_pct").unwrap();
        assert!(low.iter().all(|&i| high.iter().all(|&j| humidity[i] < humidity[j])));
    }
}
