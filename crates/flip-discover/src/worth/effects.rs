//! How large an effect is, on which powders, and its course over the recorded covariates.

use crate::causes::hypothesis::Cause;
use crate::causes::response::Responses;
use crate::data::campaign::{Campaign, Covariate, Values};
use crate::data::scenario::{Conditions, Setting, extended, levels, percentile};
use crate::judge::claim::Told;
use crate::judge::posterior::Posterior;
use crate::judge::prepared::Prepared;
use crate::report::names::{quantity, rounded};
use crate::report::printed::is_told;
use crate::report::{Curve, Finding, PowderEffect};
use crate::thresholds::LEVELS_MAX;
use flip_core::domain::FieldError;
use std::cmp::Ordering;

/// Shares of runs below the two ends of the range over which an effect is reported, and those of
/// the full range.
const PERCENTILES: [f64; 2] = [0.05, 0.95];
const ENDS: [f64; 2] = [0.0, 1.0];
/// Grid points of a course.
const PLACES: usize = 21;
/// Normal deviate of a two-sided 90 % interval.
const BAND: f64 = 1.645;

/// These causes, each with its effect on all powders and on each one.
pub(crate) fn told(
    campaign: &Campaign,
    responses: &Responses,
    causes: &[Cause],
) -> Result<Vec<Told>, FieldError> {
    let of = |cause: &Cause| {
        Ok(Told { cause: cause.clone(), finding: finding(campaign, responses, cause)? })
    };
    causes.iter().map(of).collect()
}

/// The largest effect of a cause over its spans, preferring one that is distinguishable from zero.
fn finding(
    campaign: &Campaign,
    responses: &Responses,
    cause: &Cause,
) -> Result<Option<Finding>, FieldError> {
    let mut best: Option<Finding> = None;
    for shares in [PERCENTILES, ENDS] {
        for span in spans(campaign, cause, shares) {
            let rank =
                |finding: &Finding| (is_told(finding.ci95, &finding.unit), finding.effect.abs());
            let finding = over(campaign, responses, cause, span)?;
            best = best
                .into_iter()
                .chain(finding)
                .max_by(|a, b| rank(a).partial_cmp(&rank(b)).unwrap_or(Ordering::Equal));
        }
        // A step passed by few runs lies beyond the percentiles; names have none.
        let is_of_names = cause.covariates().iter().any(|name| levels(campaign, name).is_some());
        if is_of_names || best.as_ref().is_none_or(|finding| is_told(finding.ci95, &finding.unit)) {
            break;
        }
    }
    Ok(best)
}

/// The effect of a cause over one span; `None` if no powder was measured at both of two names, or
/// no component of the posterior contains the cause.
fn over(
    campaign: &Campaign,
    responses: &Responses,
    cause: &Cause,
    (span, ends): (String, [Conditions; 2]),
) -> Result<Option<Finding>, FieldError> {
    let powders = measured_with(campaign, &ends);
    let [low, high] = &ends;
    let runs: Vec<_> =
        powders.iter().flat_map(|&p| [(p, low.clone(), None), (p, high.clone(), None)]).collect();
    let session = campaign.runs.iter().map(|run| run.session).max().unwrap_or(0);
    let (with_runs, first) = extended(campaign, session, &runs);
    let prepared = Prepared::new(&with_runs, responses)?;
    let posterior = Posterior::new(&prepared);
    let pairs: Vec<(usize, usize)> =
        (0..powders.len()).map(|k| (first + 2 * k, first + 2 * k + 1)).collect();
    let of = |pairs: &[(usize, usize)]| {
        let mixture = posterior.effect(cause, pairs).filter(|_| !pairs.is_empty())?;
        let told = |change: f64| campaign.quantity.told(change);
        Some((told(mixture.moments().0), mixture.interval(0.95).map(told)))
    };
    let Some(average) = of(&pairs) else { return Ok(None) };
    let on_powder = |(k, &powder): (usize, &usize)| {
        let (effect, ci95) = of(&pairs[k..=k])?;
        Some(PowderEffect { powder: campaign.powders[powder].clone(), effect, ci95 })
    };
    let by_powder: Vec<PowderEffect> = powders.iter().enumerate().filter_map(on_powder).collect();
    let unit = campaign.quantity.unit();
    let shows: Vec<&PowderEffect> = by_powder.iter().filter(|on| is_told(on.ci95, unit)).collect();
    let (powder, (effect, ci95)) = match clearest(&shows).filter(|_| !is_told(average.1, unit)) {
        Some(on) => (Some(on.powder.clone()), (on.effect, on.ci95)),
        None => (None, average),
    };
    Ok(Some(Finding {
        channel: campaign.quantity.channel(),
        covariate: covariate_of(cause),
        powders: shows.iter().map(|on| on.powder.clone()).collect(),
        effect,
        ci95,
        unit: unit.to_owned(),
        span,
        powder,
        by_powder,
    }))
}

/// The powder with the largest effect relative to the width of its interval.
fn clearest<'a>(of: &[&'a PowderEffect]) -> Option<&'a PowderEffect> {
    let clear =
        |on: &PowderEffect| on.effect.abs() / (on.ci95[1] - on.ci95[0]).max(f64::MIN_POSITIVE);
    of.iter().copied().max_by(|a, b| clear(a).total_cmp(&clear(b)))
}

/// Powders on which a change between these ends was seen; for names, those measured with both.
fn measured_with(campaign: &Campaign, ends: &[Conditions; 2]) -> Vec<usize> {
    let is_at =
        |i: usize, (name, setting): (&String, &Setting)| match (campaign.values(name), setting) {
            (Some(Values::Levels { of, .. }), Setting::Level(level)) => of[i] == Some(*level),
            _ => true,
        };
    let measured = campaign.measured();
    let was_at = |powder: usize, end: &Conditions| {
        let mut runs = measured.iter().filter(|&&i| campaign.runs[i].powder == powder);
        runs.any(|&i| end.iter().all(|at| is_at(i, at)))
    };
    (0..campaign.powders.len())
        .filter(|&powder| ends.iter().all(|end| was_at(powder, end)))
        .collect()
}

/// The covariate of a cause; both of an interaction.
pub(crate) fn covariate_of(cause: &Cause) -> Option<String> {
    let covariates = cause.covariates();
    (!covariates.is_empty()).then(|| covariates.join(" and "))
}

/// The conditions between which the effect of a cause is reported, and their wording, at these
/// shares of the runs. With more than two names, every pair; the largest counts.
fn spans(campaign: &Campaign, cause: &Cause, shares: [f64; 2]) -> Vec<(String, [Conditions; 2])> {
    let covariates = cause.covariates();
    if let Some(names) = covariates.first().and_then(|name| levels(campaign, name)) {
        let at =
            |level: usize| Conditions::from([(covariates[0].to_owned(), Setting::Level(level))]);
        let pairs = (0..names.len()).flat_map(|a| (a + 1..names.len()).map(move |b| (a, b)));
        return pairs
            .map(|(a, b)| (format!("from {} to {}", names[a], names[b]), [at(a), at(b)]))
            .collect();
    }
    let at = |share: f64| -> Conditions {
        let value = |name: &&str| {
            Some(((*name).to_owned(), Setting::Number(percentile(campaign, name, share)?)))
        };
        covariates.iter().filter_map(value).collect()
    };
    let words = |name: &&str| {
        let [low, high] = shares.map(|share| percentile(campaign, name, share).unwrap_or(0.0));
        let (quantity, unit) = quantity(name);
        format!("from {} to {}{unit} {quantity}", rounded(low), rounded(high))
    };
    let span = covariates.iter().map(words).collect::<Vec<_>>().join(" and ");
    if covariates.is_empty() { Vec::new() } else { vec![(span, shares.map(at))] }
}

/// Course of the residuals over every recorded covariate.
pub(crate) fn curves(campaign: &Campaign, responses: &Responses) -> Result<Vec<Curve>, FieldError> {
    let session = campaign.runs.iter().map(|run| run.session).max().unwrap_or(0);
    let powders = campaign.powders.len();
    // Covariates with too many names to be judged have no course either.
    let few = |covariate: &&Covariate| {
        levels(campaign, &covariate.name).is_none_or(|names| names.len() <= LEVELS_MAX)
    };
    let covariates: Vec<&Covariate> = campaign.covariates.iter().filter(few).collect();
    let places = |covariate: &str| -> Vec<f64> {
        match levels(campaign, covariate) {
            Some(names) => (0..names.len()).map(|level| level as f64).collect(),
            None => match [0.0, 1.0].map(|share| percentile(campaign, covariate, share)) {
                [Some(low), Some(high)] => (0..PLACES)
                    .map(|k| low + (high - low) * k as f64 / (PLACES - 1) as f64)
                    .collect(),
                _ => Vec::new(),
            },
        }
    };
    let mut runs = Vec::new();
    for covariate in &covariates {
        for place in places(&covariate.name) {
            let setting = match covariate.values {
                Values::Numbers(_) => Setting::Number(place),
                Values::Levels { .. } => Setting::Level(place as usize),
            };
            let conditions = Conditions::from([(covariate.name.clone(), setting)]);
            runs.extend((0..powders).map(|powder| (powder, conditions.clone(), None)));
        }
    }
    let (with_runs, first) = extended(campaign, session, &runs);
    let prepared = Prepared::new(&with_runs, responses)?;
    let posterior = Posterior::new(&prepared);
    let shifts = posterior.shifts();
    let predicted = posterior.predict(&with_runs);
    let mut next = first;
    let mut curves = Vec::new();
    for covariate in &covariates {
        let mut course = Vec::new();
        for place in places(&covariate.name) {
            let of_place = next..next + powders;
            let mean =
                |of: &dyn Fn(usize) -> f64| of_place.clone().map(of).sum::<f64>() / powders as f64;
            course.push([place, mean(&|i| shifts[i]), BAND * mean(&|i| predicted[i][1].sd)]);
            next += powders;
        }
        // The course is of this covariate alone: the average contribution of the others is
        // subtracted.
        let middle = course.iter().map(|place| place[1]).sum::<f64>() / course.len().max(1) as f64;
        course.iter_mut().for_each(|place| place[1] -= middle);
        let at = match &covariate.values {
            Values::Numbers(values) => row_values(campaign, |i| values[i]),
            Values::Levels { of, .. } => row_values(campaign, |i| of[i].map(|level| level as f64)),
        };
        let names = levels(campaign, &covariate.name).map_or(Vec::new(), <[String]>::to_vec);
        curves.push(Curve { covariate: covariate.name.clone(), levels: names, at, course });
    }
    Ok(curves)
}

/// One value for each row of the file: repeats behind a summary share one.
fn row_values(campaign: &Campaign, of: impl Fn(usize) -> Option<f64>) -> Vec<Option<f64>> {
    let starts = |i: &usize| *i == 0 || campaign.runs[*i].row != campaign.runs[i - 1].row;
    (0..campaign.runs.len()).filter(starts).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::sample;

    #[test]
    fn a_course_is_of_its_covariate_alone() {
        let campaign = sample::campaign(1, |at| 0.08 * at.humidity + 1.5 * at.operator as f64);
        let curves = curves(&campaign, &Responses::new()).unwrap();
        for curve in &curves {
            let course: Vec<f64> = curve.course.iter().map(|place| place[1]).collect();
            let middle = course.iter().sum::<f64>() / course.len() as f64;
            assert!(middle.abs() < 1e-9, "{}: {middle}", curve.covariate);
        }
        // From 20 to 64 % by 0.08 deg a percent, and 1.5 deg from Ada to Ben.
        let rise = |curve: &Curve| curve.course[curve.course.len() - 1][1] - curve.course[0][1];
        assert!((2.5..4.5).contains(&rise(&curves[0])), "{}", rise(&curves[0]));
        assert!((1.0..2.0).contains(&rise(&curves[2])), "{}", rise(&curves[2]));
    }
}
