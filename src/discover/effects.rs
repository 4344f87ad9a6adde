//! How large an effect is, on which powders, and its course over what was recorded.

use super::campaign::{Campaign, Covariate, LEVELS_MAX, Values};
use super::hypothesis::{Cause, Responses};
use super::names;
use super::posterior::Posterior;
use super::report::{Curve, Finding, PowderEffect};
use super::scenario::{Conditions, Setting, extended, levels, percentile};
use super::screen::Prepared;
use crate::domain::FieldError;

/// Places of a course.
const PLACES: usize = 21;
/// Normal deviate that 90 % of values are within, on either side.
const BAND: f64 = 1.645;

/// The findings that these causes make: each one's effect on all powders and on each.
pub(super) fn findings(
    campaign: &Campaign,
    responses: &Responses,
    causes: &[Cause],
) -> Result<Vec<Finding>, FieldError> {
    let mut found = Vec::new();
    for cause in causes {
        let spans = spans(campaign, cause);
        let mut best: Option<Finding> = None;
        for (span, [low, high]) in spans {
            let powders = 0..campaign.powders.len();
            let runs: Vec<_> =
                powders.clone().flat_map(|p| [(p, low.clone(), None), (p, high.clone(), None)]).collect();
            let session = campaign.runs.iter().map(|run| run.session).max().unwrap_or(0);
            let (with_runs, first) = extended(campaign, session, &runs);
            let prepared = Prepared::new(&with_runs, responses)?;
            let posterior = Posterior::new(&prepared);
            let pair = |powder: usize| (first + 2 * powder, first + 2 * powder + 1);
            let of = |pairs: &[(usize, usize)]| {
                let mixture = posterior.effect(cause, pairs)?;
                let told = |change: f64| campaign.quantity.told(change);
                Some((told(mixture.moments().0), mixture.interval(0.95).map(told)))
            };
            let Some((effect, ci95)) = of(&powders.clone().map(pair).collect::<Vec<_>>()) else { continue };
            let by_powder: Vec<PowderEffect> = powders
                .filter_map(|powder| {
                    let (effect, ci95) = of(&[pair(powder)])?;
                    Some(PowderEffect { powder: campaign.powders[powder].clone(), effect, ci95 })
                })
                .collect();
            let shows = by_powder.iter().filter(|it| it.ci95[0] * it.ci95[1] > 0.0);
            let finding = Finding {
                channel: campaign.quantity.channel(),
                covariate: covariate_of(cause),
                powders: shows.map(|it| it.powder.clone()).collect(),
                effect,
                ci95,
                unit: campaign.quantity.unit().to_owned(),
                span,
                by_powder,
            };
            if best.as_ref().is_none_or(|best| finding.effect.abs() > best.effect.abs()) {
                best = Some(finding);
            }
        }
        found.extend(best);
    }
    Ok(found)
}

/// The covariate of a cause; of an interaction, both.
pub(super) fn covariate_of(cause: &Cause) -> Option<String> {
    let covariates = cause.covariates();
    (!covariates.is_empty()).then(|| covariates.join(" and "))
}

/// From which conditions to which the effect of a cause is told, and how that reads. Of more than two names every pair; the largest counts.
fn spans(campaign: &Campaign, cause: &Cause) -> Vec<(String, [Conditions; 2])> {
    let covariates = cause.covariates();
    if let Some(names) = covariates.first().and_then(|name| levels(campaign, name)) {
        let at = |level: usize| Conditions::from([(covariates[0].to_owned(), Setting::Level(level))]);
        let pairs = (0..names.len()).flat_map(|a| (a + 1..names.len()).map(move |b| (a, b)));
        return pairs.map(|(a, b)| (format!("from {} to {}", names[a], names[b]), [at(a), at(b)])).collect();
    }
    let at = |share: f64| -> Conditions {
        let value = |name: &&str| Some(((*name).to_owned(), Setting::Number(percentile(campaign, name, share)?)));
        covariates.iter().filter_map(value).collect()
    };
    let words = |name: &&str| {
        let [low, high] = [0.05, 0.95].map(|share| percentile(campaign, name, share).unwrap_or(0.0));
        let (quantity, unit) = quantity(name);
        format!("from {} to {}{unit} {quantity}", rounded(low), rounded(high))
    };
    let span = covariates.iter().map(words).collect::<Vec<_>>().join(" and ");
    if covariates.is_empty() { Vec::new() } else { vec![(span, [at(0.05), at(0.95)])] }
}

/// A number for a reader: three digits.
pub(super) fn rounded(value: f64) -> String {
    let digits = (2.0 - value.abs().max(1e-9).log10().floor()).clamp(0.0, 6.0) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// What a column holds, for the middle of a sentence, and its unit, with a space before.
pub(super) fn quantity(covariate: &str) -> (String, String) {
    let (label, unit) = names::column(covariate);
    (names::lower(&label), names::with_unit("", unit))
}

/// Residuals' course over every recorded covariate.
pub(super) fn curves(campaign: &Campaign, responses: &Responses) -> Result<Vec<Curve>, FieldError> {
    let session = campaign.runs.iter().map(|run| run.session).max().unwrap_or(0);
    let powders = campaign.powders.len();
    // Names that are too many to be judged have no course either.
    let few = |it: &&Covariate| levels(campaign, &it.name).is_none_or(|names| names.len() <= LEVELS_MAX);
    let covariates: Vec<&Covariate> = campaign.covariates.iter().filter(few).collect();
    let places = |covariate: &str| -> Vec<f64> {
        match levels(campaign, covariate) {
            Some(names) => (0..names.len()).map(|level| level as f64).collect(),
            None => match [0.0, 1.0].map(|share| percentile(campaign, covariate, share)) {
                [Some(low), Some(high)] => {
                    (0..PLACES).map(|k| low + (high - low) * k as f64 / (PLACES - 1) as f64).collect()
                }
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
            let mean = |of: &dyn Fn(usize) -> f64| of_place.clone().map(of).sum::<f64>() / powders as f64;
            course.push([place, mean(&|i| shifts[i]), BAND * mean(&|i| predicted[i][1].sd_deg)]);
            next += powders;
        }
        // The course is of this covariate alone: what others add on average is taken from it.
        let middle = course.iter().map(|it| it[1]).sum::<f64>() / course.len().max(1) as f64;
        course.iter_mut().for_each(|it| it[1] -= middle);
        let at = match &covariate.values {
            Values::Numbers(values) => row_values(campaign, |i| values[i]),
            Values::Levels { of, .. } => row_values(campaign, |i| of[i].map(|level| level as f64)),
        };
        let names = levels(campaign, &covariate.name).map_or(Vec::new(), <[String]>::to_vec);
        curves.push(Curve { covariate: covariate.name.clone(), levels: names, at, course });
    }
    Ok(curves)
}

/// One value for each row of the file: repeats behind a summary share theirs.
fn row_values(campaign: &Campaign, of: impl Fn(usize) -> Option<f64>) -> Vec<Option<f64>> {
    let starts = |i: &usize| *i == 0 || campaign.runs[*i].row != campaign.runs[i - 1].row;
    (0..campaign.runs.len()).filter(starts).map(of).collect()
}
