//! Turns what an investigation claims into an extension of the simulator.
//!
//! Effects come from the posterior, between the covariate values at which a cause's mechanism is
//! weakest and strongest: the 5th and the 95th percentile where the catalogue has a form, the
//! extremes of names and of an unknown's course. Angles alone favour no parameter for a cause
//! without a mechanism; it acts through `cohesion`, which moves angles most evenly, over the value
//! where they are lowest: a law on a parameter.

use super::extension::{AtReference, Extended, Extension, Form, Hook, OnPowder, Through};
use crate::causes::catalogue::Mechanism;
use crate::causes::follows;
use crate::causes::hypothesis::{Cause, Responses};
use crate::causes::response::{amplitude, hook};
use crate::data::campaign::{Campaign, Values};
use crate::data::scenario::{Conditions as Places, Setting, extended, levels, percentile};
use crate::judge::posterior::Posterior;
use crate::judge::prepared::Prepared;
use crate::report::{Channel, ParameterReport, Report};
use flip_core::domain::FieldError;
use flip_core::domain::conditions::{Condition, Conditions};
use flip_core::domain::powder::Flowability;
use std::collections::BTreeMap;

/// Grid points of the course of a cause without a form.
const PLACES: usize = 21;
/// Number of stored quantiles of a covariate, less one.
const QUANTILES: usize = 20;
/// Upper bound on a powder's amplitude relative to the average.
const FACTOR_MAX: f64 = 4.0;

/// What the causes claimed in a report add to the simulator; `None` if no claimed cause was
/// recorded.
///
/// # Errors
/// A campaign whose runs carry no information about their noise.
pub fn extend(
    campaign: &Campaign,
    responses: &Responses,
    report: &Report,
) -> Result<Option<Extended>, FieldError> {
    let (campaign, _) = &follows::without(campaign);
    let claimed = report.causes.iter().filter(|cause| cause.confidence_level > 1);
    let known = claimed
        .filter_map(|cause| Mechanism::ALL.into_iter().find(|it| it.name().0 == cause.mechanism));
    // A covariate that affects only flow times or balance readings makes no angle.
    let of_angles = |covariate: &&String| {
        let mut found = report.findings.iter().filter(|finding| finding.channel == Channel::Repose);
        found.any(|finding| finding.covariate.as_ref() == Some(*covariate))
    };
    let unknown =
        report.unexplained.iter().filter_map(|it| it.covariate.as_ref()).filter(of_angles).cloned();
    let unknown = unknown.map(Cause::Unknown);
    let causes: Vec<Cause> = known.map(Cause::Known).chain(unknown).collect();
    let mut extensions = Vec::new();
    for cause in &causes {
        extensions.extend(extension(campaign, responses, cause)?);
    }
    if extensions.is_empty() {
        return Ok(None);
    }
    let powders = at_reference(campaign, responses, &extensions)?;
    Ok(Some(Extended { extensions, powders }))
}

fn session(campaign: &Campaign) -> usize {
    campaign.runs.iter().map(|run| run.session).max().unwrap_or(0)
}

/// Where a cause is evaluated, and how its strength is given.
enum Looks<'a> {
    /// At the 5th and the 95th percentile of each covariate.
    Form,
    /// Along a covariate.
    Course(Vec<f64>),
    /// At each name.
    Levels(&'a [String]),
}

fn extension(
    campaign: &Campaign,
    responses: &Responses,
    cause: &Cause,
) -> Result<Option<Extension>, FieldError> {
    let covariates = cause.covariates();
    let Some(first) = covariates.first() else { return Ok(None) };
    let (looks, places) = places(campaign, cause, first);
    let powders = campaign.powders.len();
    let runs: Vec<_> = places
        .iter()
        .flat_map(|place| (0..powders).map(move |powder| (powder, place.clone(), None)))
        .collect();
    let (with_runs, begin) = extended(campaign, session(campaign), &runs);
    let prepared = Prepared::new(&with_runs, responses)?;
    let posterior = Posterior::new(&prepared);
    let shifts = posterior.shifts_by(cause);
    let run = |place: usize, powder: usize| begin + place * powders + powder;
    let mean = |place: usize| {
        (0..powders).map(|powder| shifts[run(place, powder)]).sum::<f64>() / powders as f64
    };
    let course: Vec<f64> = (0..places.len()).map(mean).collect();
    let (mechanism, (hook, up)) = match cause {
        Cause::Known(mechanism) => (*mechanism, hook(*mechanism)),
        // The only mechanism in the table that is a parameter.
        _ => (Mechanism::Temperature, hook(Mechanism::Temperature)),
    };
    let by = |a: &usize, b: &usize| (up * course[*a]).total_cmp(&(up * course[*b]));
    let ends = (0..places.len()).min_by(by).zip((0..places.len()).max_by(by));
    let Some((weakest, strongest)) = ends.filter(|(a, b)| course[*a] != course[*b]) else {
        return Ok(None);
    };
    let pair = |powder: usize| (run(weakest, powder), run(strongest, powder));
    let Some(effect) = posterior.effect(cause, &(0..powders).map(pair).collect::<Vec<_>>()) else {
        return Ok(None);
    };
    let (effect_deg, effect_ci95) = (effect.moments().0, effect.interval(0.95));
    let told =
        told(campaign, &hook, &covariates, &posterior, cause, looks, (weakest, strongest), &course);
    let Some((form, through, strength)) = told else { return Ok(None) };
    let shares = responses.get(&mechanism).filter(|shares| shares.len() >= powders);
    let share = |powder: usize| {
        shares.map_or(1.0, |of| of[powder] * powders as f64 / of.iter().sum::<f64>())
    };
    let on_powder = |powder: usize| {
        let own = posterior.effect(cause, &[pair(powder)]).map_or(effect_deg, |it| it.moments().0);
        let factor = (own / effect_deg / share(powder)).clamp(0.0, FACTOR_MAX);
        let effect_deg = if factor > 0.0 { own } else { 0.0 };
        OnPowder { powder: campaign.powders[powder].clone(), effect_deg, factor }
    };
    Ok(Some(Extension {
        mechanism: cause.name().0,
        amplitude: by_table(mechanism, &hook, effect_deg, effect_ci95),
        hook,
        form,
        through,
        strength,
        effect_deg,
        effect_ci95,
        powders: (0..powders).map(on_powder).collect(),
        fit: None,
    }))
}

fn places<'a>(campaign: &'a Campaign, cause: &Cause, first: &str) -> (Looks<'a>, Vec<Places>) {
    if let Some(names) = levels(campaign, first) {
        let at = |level: usize| Places::from([(first.to_owned(), Setting::Level(level))]);
        return (Looks::Levels(names), (0..names.len()).map(at).collect());
    }
    let at = |share: f64| {
        let value = |name: &str| {
            Some((name.to_owned(), Setting::Number(percentile(campaign, name, share)?)))
        };
        cause.covariates().into_iter().filter_map(value).collect::<Places>()
    };
    if matches!(cause, Cause::Known(_)) {
        return (Looks::Form, vec![at(0.05), at(0.95)]);
    }
    let [low, high] = [0.0, 1.0].map(|share| percentile(campaign, first, share).unwrap_or(0.0));
    let course: Vec<f64> =
        (0..PLACES).map(|k| low + (high - low) * k as f64 / (PLACES - 1) as f64).collect();
    let places =
        course.iter().map(|&at| Places::from([(first.to_owned(), Setting::Number(at))])).collect();
    (Looks::Course(course), places)
}

/// Form, covariates, and the form's values at strength 0 and 1.
#[expect(clippy::too_many_arguments, reason = "what a cause is known by")]
fn told(
    campaign: &Campaign,
    hook: &Hook,
    covariates: &[&str],
    posterior: &Posterior<'_>,
    cause: &Cause,
    looks: Looks<'_>,
    (weakest, strongest): (usize, usize),
    course: &[f64],
) -> Option<(Form, Vec<Through>, [f64; 2])> {
    let reads = *hook == Hook::Reading;
    let span = course[strongest] - course[weakest];
    let of_quantiles = |name: &str, reference: f64| Through {
        name: name.to_owned(),
        reference: Condition::Number(reference),
        quantiles: (0..=QUANTILES)
            .filter_map(|k| percentile(campaign, name, k as f64 / QUANTILES as f64))
            .collect(),
        shares: BTreeMap::new(),
    };
    match looks {
        Looks::Levels(names) => {
            let shares = shares(campaign, covariates[0], names);
            let mean: f64 = names
                .iter()
                .zip(course)
                .map(|(name, shift)| shares.get(name).unwrap_or(&0.0) * shift)
                .sum();
            let zero = if reads { mean } else { course[weakest] };
            let strengths = names
                .iter()
                .zip(course)
                .map(|(name, shift)| (name.clone(), (shift - zero) / span))
                .collect();
            let usual = names.iter().max_by(|a, b| {
                shares.get(*a).unwrap_or(&0.0).total_cmp(shares.get(*b).unwrap_or(&0.0))
            })?;
            let reference = Condition::Name(if reads { usual } else { &names[weakest] }.clone());
            let through = Through {
                name: covariates[0].to_owned(),
                reference,
                quantiles: Vec::new(),
                shares,
            };
            Some((Form::Levels(strengths), vec![through], [0.0, 1.0]))
        }
        Looks::Course(at) => {
            let through = of_quantiles(covariates[0], at[weakest]);
            let strengths = at
                .iter()
                .zip(course)
                .map(|(&at, shift)| [at, (shift - course[weakest]) / span])
                .collect();
            Some((Form::Course(strengths), vec![through], [0.0, 1.0]))
        }
        Looks::Form => {
            let Cause::Known(mechanism) = cause else { return None };
            let form = posterior.law(cause)?.to_owned();
            let at = |share: f64| {
                let values: Option<Vec<f64>> =
                    covariates.iter().map(|name| percentile(campaign, name, share)).collect();
                mechanism.strength(&form, &values?)
            };
            // The middle for readings; otherwise the end of the range at which the mechanism is
            // weakest.
            let end = if reads { 0.5 } else { [0.0, 1.0][weakest] };
            let zero = at(end)?;
            let one = zero + at([0.05, 0.95][strongest])? - at([0.05, 0.95][weakest])?;
            let through = covariates
                .iter()
                .map(|name| Some(of_quantiles(name, percentile(campaign, name, end)?)));
            Some((Form::Named(form), through.collect::<Option<_>>()?, [zero, one]))
        }
    }
}

/// Share of the measured runs with each name.
fn shares(campaign: &Campaign, covariate: &str, names: &[String]) -> BTreeMap<String, f64> {
    let Some(Values::Levels { of, .. }) = campaign.values(covariate) else {
        return BTreeMap::new();
    };
    let seen: Vec<usize> = campaign.measured().into_iter().filter_map(|i| of[i]).collect();
    let share = |level: usize| {
        seen.iter().filter(|&&it| it == level).count() as f64 / seen.len().max(1) as f64
    };
    names.iter().enumerate().map(|(level, name)| (name.clone(), share(level))).collect()
}

/// The amplitude for an effect, from the table of simulated responses.
fn by_table(mechanism: Mechanism, hook: &Hook, effect_deg: f64, ci95: [f64; 2]) -> ParameterReport {
    let Some((name, value, unit)) = amplitude(mechanism, effect_deg) else {
        return ParameterReport {
            name: "reading".to_owned(),
            value: effect_deg,
            ci95,
            unit: "deg".to_owned(),
        };
    };
    // An amplitude of a mechanism is never negative.
    let floor = if matches!(hook, Hook::Extension(_)) { 0.0 } else { f64::NEG_INFINITY };
    let mut ci95 = ci95.map(|end| amplitude(mechanism, end).map_or(value, |it| it.1).max(floor));
    ci95.sort_by(f64::total_cmp);
    ParameterReport { name: name.to_owned(), value: value.max(floor), ci95, unit: unit.to_owned() }
}

/// The extended model's prediction for each measured powder where no mechanism acts. Two causes of
/// one covariate may have that at its two ends; the effect of what acts at the chosen one is
/// subtracted from the angle.
fn at_reference(
    campaign: &Campaign,
    responses: &Responses,
    extensions: &[Extension],
) -> Result<Vec<AtReference>, FieldError> {
    let (mut places, mut conditions) = (Places::new(), Conditions::new());
    for through in
        extensions.iter().filter(|it| it.hook != Hook::Reading).flat_map(|it| &it.through)
    {
        let setting = match &through.reference {
            Condition::Number(number) => Some(Setting::Number(*number)),
            Condition::Name(name) => {
                let names = levels(campaign, &through.name);
                names.and_then(|names| names.iter().position(|it| it == name)).map(Setting::Level)
            }
        };
        places.extend(setting.map(|setting| (through.name.clone(), setting)));
        conditions.insert(through.name.clone(), through.reference.clone());
    }
    let runs: Vec<_> =
        (0..campaign.powders.len()).map(|powder| (powder, places.clone(), None)).collect();
    let (with_runs, first) = extended(campaign, session(campaign), &runs);
    let prepared = Prepared::new(&with_runs, responses)?;
    let predicted = Posterior::new(&prepared).predict(&with_runs);
    let mut powders = Vec::new();
    for (k, powder) in campaign.powders.iter().enumerate() {
        let [_, after] = predicted[first + k];
        let acting = extensions.iter().filter(|it| it.hook != Hook::Reading);
        let shift_deg: f64 = acting.map(|it| it.shift_deg(Some(powder), &conditions)).sum();
        let n =
            campaign.runs.iter().filter(|run| run.powder == k && run.repose_deg.is_some()).count()
                as u32;
        // A powder without an angle has no prediction.
        if let Ok(repose) = Flowability::new(after.mean_deg - shift_deg, after.sd_deg, n.max(1)) {
            powders.push(AtReference { powder: powder.clone(), repose });
        }
    }
    Ok(powders)
}
