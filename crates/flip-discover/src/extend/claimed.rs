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
use crate::causes::hypothesis::Cause;
use crate::causes::response::{Action, Responses};
use crate::data::campaign::{Campaign, Values};
use crate::data::scenario::{Conditions as Places, Setting, extended, levels, percentile};
use crate::judge::posterior::{Mixture, Posterior};
use crate::judge::prepared::Prepared;
use crate::report::{Channel, ParameterReport, Report};
use flip_core::domain::FieldError;
use flip_core::domain::conditions::{Condition, Conditions};
use flip_core::domain::powder::Flowability;
use std::collections::BTreeMap;
use std::ops::Range;

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
    let known = claimed.filter_map(|cause| {
        Mechanism::ALL.into_iter().find(|mechanism| mechanism.name().0 == cause.mechanism)
    });
    // A covariate that affects only flow times or balance readings makes no angle.
    let of_angles = |covariate: &&String| {
        let mut found = report.findings.iter().filter(|finding| finding.channel == Channel::Repose);
        found.any(|finding| finding.covariate.as_ref() == Some(*covariate))
    };
    let unknown = report
        .unexplained
        .iter()
        .filter_map(|unexplained| unexplained.covariate.as_ref())
        .filter(of_angles)
        .cloned();
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
enum Along<'a> {
    /// At the 5th and the 95th percentile of each covariate, by a form of the catalogue.
    Form,
    /// Along a covariate.
    Course(Vec<f64>),
    /// At each name.
    Levels(&'a [String]),
}

/// The number of the simulator through which a cause acts; `None` for causes of the laboratory,
/// which affect readings. A departure without a cause acts on cohesion.
fn action(cause: &Cause) -> Option<&'static Action> {
    match cause {
        Cause::Known(mechanism) => Action::of(*mechanism),
        Cause::Unknown(_) | Cause::Unrecorded => Some(&Action::COHESION),
    }
}

/// The extension that one cause makes; `None` if nothing was recorded with which it goes, or if it
/// moves no angle.
fn extension(
    campaign: &Campaign,
    responses: &Responses,
    cause: &Cause,
) -> Result<Option<Extension>, FieldError> {
    let covariates = cause.covariates();
    let Some(first) = covariates.first() else { return Ok(None) };
    let (along, places) = places(campaign, cause, first);
    let powders = campaign.powders.len();
    let runs: Vec<_> = places
        .iter()
        .flat_map(|place| (0..powders).map(move |powder| (powder, place.clone(), None)))
        .collect();
    let (with_runs, first_run) = extended(campaign, session(campaign), &runs);
    let prepared = Prepared::new(&with_runs, responses)?;
    let posterior = Posterior::new(&prepared);
    let evaluated = Evaluated::new(campaign, cause, &posterior, first_run, places.len());
    let Some(evaluated) = evaluated else { return Ok(None) };
    let Some(effect) = evaluated.effect(0..powders) else { return Ok(None) };
    let Some(strengths) = evaluated.strengths(along) else { return Ok(None) };
    let (effect_deg, effect_ci95) = (effect.moments().0, effect.interval(0.95));
    let action = action(cause);
    let shares = action.and_then(|action| responses.of(action)).filter(|of| of.len() >= powders);
    let share = |powder: usize| {
        shares.map_or(1.0, |of| of[powder] * powders as f64 / of.iter().sum::<f64>())
    };
    let on_powder = |powder: usize| {
        let own =
            evaluated.effect(powder..powder + 1).map_or(effect_deg, |effect| effect.moments().0);
        let factor = (own / effect_deg / share(powder)).clamp(0.0, FACTOR_MAX);
        let effect_deg = if factor > 0.0 { own } else { 0.0 };
        OnPowder { powder: campaign.powders[powder].clone(), effect_deg, factor }
    };
    Ok(Some(Extension {
        mechanism: cause.name().0,
        amplitude: by_table(action, effect_deg, effect_ci95),
        hook: evaluated.hook.clone(),
        form: strengths.form,
        through: strengths.through,
        strength: strengths.ends,
        effect_deg,
        effect_ci95,
        powders: (0..powders).map(on_powder).collect(),
        fit: None,
    }))
}

fn places<'a>(campaign: &'a Campaign, cause: &Cause, first: &str) -> (Along<'a>, Vec<Places>) {
    if let Some(names) = levels(campaign, first) {
        let at = |level: usize| Places::from([(first.to_owned(), Setting::Level(level))]);
        return (Along::Levels(names), (0..names.len()).map(at).collect());
    }
    let at = |share: f64| {
        let value = |name: &str| {
            Some((name.to_owned(), Setting::Number(percentile(campaign, name, share)?)))
        };
        cause.covariates().into_iter().filter_map(value).collect::<Places>()
    };
    if matches!(cause, Cause::Known(_)) {
        return (Along::Form, vec![at(0.05), at(0.95)]);
    }
    let [low, high] = [0.0, 1.0].map(|share| percentile(campaign, first, share).unwrap_or(0.0));
    let course: Vec<f64> =
        (0..PLACES).map(|k| low + (high - low) * k as f64 / (PLACES - 1) as f64).collect();
    let places =
        course.iter().map(|&at| Places::from([(first.to_owned(), Setting::Number(at))])).collect();
    (Along::Course(course), places)
}

/// A cause evaluated at every place on every powder.
struct Evaluated<'a> {
    campaign: &'a Campaign,
    cause: &'a Cause,
    posterior: &'a Posterior<'a>,
    hook: Hook,
    /// The first of the hypothetical runs: place by place, powder by powder.
    first_run: usize,
    /// Shift of the angle at each place, degrees, on average over powders.
    course: Vec<f64>,
    /// Places at which the mechanism is weakest and strongest.
    weakest: usize,
    strongest: usize,
}

/// How strong a cause is: its form, its covariates, and the form's values at strength 0 and 1.
struct Strengths {
    form: Form,
    through: Vec<Through>,
    ends: [f64; 2],
}

impl<'a> Evaluated<'a> {
    /// Returns `None` if the cause is as strong everywhere.
    fn new(
        campaign: &'a Campaign,
        cause: &'a Cause,
        posterior: &'a Posterior<'a>,
        first_run: usize,
        places: usize,
    ) -> Option<Self> {
        let powders = campaign.powders.len();
        let shifts = posterior.shifts_by(cause);
        let mean = |place: usize| {
            let start = first_run + place * powders;
            shifts[start..start + powders].iter().sum::<f64>() / powders as f64
        };
        let course: Vec<f64> = (0..places).map(mean).collect();
        let action = action(cause);
        let direction = action.map_or(1.0, Action::direction);
        let by_strength =
            |a: &usize, b: &usize| (direction * course[*a]).total_cmp(&(direction * course[*b]));
        let weakest = (0..places).min_by(by_strength)?;
        let strongest = (0..places).max_by(by_strength)?;
        let is_moving = course[weakest] != course[strongest];
        let hook = action.map_or(Hook::Reading, Action::hook);
        is_moving.then_some(Self {
            campaign,
            cause,
            posterior,
            hook,
            first_run,
            course,
            weakest,
            strongest,
        })
    }

    /// How far the cause moves the angle from its weakest to its strongest, averaged over powders.
    fn effect(&self, powders: Range<usize>) -> Option<Mixture> {
        let all = self.campaign.powders.len();
        let run = |place: usize, powder: usize| self.first_run + place * all + powder;
        let pairs: Vec<(usize, usize)> =
            powders.map(|p| (run(self.weakest, p), run(self.strongest, p))).collect();
        self.posterior.effect(self.cause, &pairs)
    }

    /// A correction of readings has the campaign's average for its reference, because it was made
    /// on all of them; a mechanism has the end at which it is weakest.
    fn is_of_readings(&self) -> bool {
        self.hook == Hook::Reading
    }

    fn span(&self) -> f64 {
        self.course[self.strongest] - self.course[self.weakest]
    }

    fn strengths(&self, along: Along<'_>) -> Option<Strengths> {
        match along {
            Along::Levels(names) => self.of_levels(names),
            Along::Course(at) => Some(self.of_course(&at)),
            Along::Form => self.of_form(),
        }
    }

    fn of_levels(&self, names: &[String]) -> Option<Strengths> {
        let covariate = self.cause.covariates()[0];
        let shares = shares(self.campaign, covariate, names);
        let share = |name: &String| *shares.get(name).unwrap_or(&0.0);
        let shifts = || names.iter().zip(&self.course);
        let mean: f64 = shifts().map(|(name, shift)| share(name) * shift).sum();
        let zero = if self.is_of_readings() { mean } else { self.course[self.weakest] };
        let strength =
            |(name, shift): (&String, &f64)| (name.clone(), (shift - zero) / self.span());
        let form = Form::Levels(shifts().map(strength).collect());
        let usual = names.iter().max_by(|a, b| share(a).total_cmp(&share(b)))?;
        let reference = if self.is_of_readings() { usual } else { &names[self.weakest] }.clone();
        let through = Through {
            name: covariate.to_owned(),
            reference: Condition::Name(reference),
            quantiles: Vec::new(),
            shares,
        };
        Some(Strengths { form, through: vec![through], ends: [0.0, 1.0] })
    }

    fn of_course(&self, at: &[f64]) -> Strengths {
        let strength =
            |(&at, shift): (&f64, &f64)| [at, (shift - self.course[self.weakest]) / self.span()];
        let form = Form::Course(at.iter().zip(&self.course).map(strength).collect());
        let through = self.through(self.cause.covariates()[0], at[self.weakest]);
        Strengths { form, through: vec![through], ends: [0.0, 1.0] }
    }

    fn of_form(&self) -> Option<Strengths> {
        let Cause::Known(mechanism) = self.cause else { return None };
        let covariates = self.cause.covariates();
        let form = self.posterior.law(self.cause)?.to_owned();
        let value = |name: &str, share: f64| percentile(self.campaign, name, share);
        let at = |share: f64| {
            let values: Option<Vec<f64>> =
                covariates.iter().map(|name| value(name, share)).collect();
            mechanism.strength(&form, &values?)
        };
        // The middle for readings; otherwise the end of the range at which the mechanism is weakest.
        let end = if self.is_of_readings() { 0.5 } else { [0.0, 1.0][self.weakest] };
        let zero = at(end)?;
        let percentiles = [0.05, 0.95];
        let one = zero + at(percentiles[self.strongest])? - at(percentiles[self.weakest])?;
        let through = covariates.iter().map(|name| Some(self.through(name, value(name, end)?)));
        let through = through.collect::<Option<_>>()?;
        Some(Strengths { form: Form::Named(form), through, ends: [zero, one] })
    }

    /// A covariate of numbers and its reference.
    fn through(&self, name: &str, reference: f64) -> Through {
        let quantile = |k: usize| percentile(self.campaign, name, k as f64 / QUANTILES as f64);
        Through {
            name: name.to_owned(),
            reference: Condition::Number(reference),
            quantiles: (0..=QUANTILES).filter_map(quantile).collect(),
            shares: BTreeMap::new(),
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
        seen.iter().filter(|&&seen| seen == level).count() as f64 / seen.len().max(1) as f64
    };
    names.iter().enumerate().map(|(level, name)| (name.clone(), share(level))).collect()
}

/// The amplitude for an effect, from the table of simulated responses.
fn by_table(action: Option<&Action>, effect_deg: f64, ci95: [f64; 2]) -> ParameterReport {
    let Some(action) = action else {
        return ParameterReport {
            name: "reading".to_owned(),
            value: effect_deg,
            ci95,
            unit: "deg".to_owned(),
        };
    };
    // An amplitude of a mechanism is never negative.
    let is_of_mechanism = matches!(action.hook(), Hook::Extension(_));
    let floor = if is_of_mechanism { 0.0 } else { f64::NEG_INFINITY };
    let mut ci95 = ci95.map(|end| action.amplitude(end).max(floor));
    ci95.sort_by(f64::total_cmp);
    ParameterReport {
        name: action.name.to_owned(),
        value: action.amplitude(effect_deg).max(floor),
        ci95,
        unit: action.unit.to_owned(),
    }
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
    for through in extensions
        .iter()
        .filter(|extension| extension.hook != Hook::Reading)
        .flat_map(|extension| &extension.through)
    {
        let setting = match &through.reference {
            Condition::Number(number) => Some(Setting::Number(*number)),
            Condition::Name(name) => {
                let names = levels(campaign, &through.name);
                names
                    .and_then(|names| names.iter().position(|known| known == name))
                    .map(Setting::Level)
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
        let acting = extensions.iter().filter(|extension| extension.hook != Hook::Reading);
        let shift_deg: f64 =
            acting.map(|extension| extension.shift_deg(Some(powder), &conditions)).sum();
        let n = campaign.runs.iter().filter(|run| run.powder == k && run.value.is_some()).count()
            as u32;
        // A powder without an angle has no prediction.
        if let Ok(repose) = Flowability::new(after.mean - shift_deg, after.sd, n.max(1)) {
            powders.push(AtReference { powder: powder.clone(), repose });
        }
    }
    Ok(powders)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::causes::response::responses;
    use crate::data::sample;

    fn extension_of(campaign: &Campaign, cause: Cause) -> Extension {
        extension(campaign, &responses(campaign), &cause).unwrap().unwrap()
    }

    #[test]
    fn the_reference_is_where_the_mechanism_is_weakest() {
        let humid = sample::campaign(1, |at| 0.1 * at.humidity);
        let humidity = extension_of(&humid, Cause::Known(Mechanism::Humidity));
        assert_eq!(humidity.through[0].reference, Condition::Number(20.0));
        assert!(humidity.strength[0] < humidity.strength[1] && humidity.effect_deg > 2.0);
        // A rise with the humidity is a fall from where the air is dry: charge, weakest when humid.
        let dry = sample::campaign(1, |at| 0.2 * (45.0 - at.humidity).max(0.0));
        let charge = extension_of(&dry, Cause::Known(Mechanism::Charge));
        assert_eq!(charge.through[0].reference, Condition::Number(64.0));
        assert!(charge.effect_deg > 2.0);
        // A cause without a mechanism acts on cohesion, from where angles are lowest.
        let supplied = sample::campaign(1, |at| 0.2 * (at.supply - 225.0));
        let unknown = extension_of(&supplied, Cause::Unknown("supply_v".to_owned()));
        assert_eq!(unknown.hook, Hook::Parameter("cohesion".to_owned()));
        let Condition::Number(reference) = unknown.through[0].reference else { panic!() };
        assert!(reference < 215.0 && unknown.effect_deg > 2.0, "{reference}");
    }

    #[test]
    fn readings_are_corrected_from_the_average_of_the_campaign() {
        let campaign = sample::campaign(1, |at| 2.0 * at.operator as f64);
        let operator = extension_of(&campaign, Cause::Known(Mechanism::Operator));
        let Form::Levels(strengths) = &operator.form else { panic!() };
        let (ada, ben) = (strengths["Ada"], strengths["Ben"]);
        assert!((ben - ada - 1.0).abs() < 1e-9 && (ada + ben).abs() < 1e-9, "{ada} {ben}");
        assert_eq!((operator.hook, operator.amplitude.name.as_str()), (Hook::Reading, "reading"));
    }

    #[test]
    fn a_powder_that_moves_less_than_simulated_has_a_smaller_factor() {
        let campaign = sample::campaign(1, |at| [0.02, 0.1][at.powder] * at.humidity);
        let humidity = extension_of(&campaign, Cause::Known(Mechanism::Humidity));
        let [sand, salt] = &humidity.powders[..] else { panic!() };
        assert!(sand.factor < 0.6 && salt.factor > 1.3, "{sand:?} {salt:?}");
        assert!(sand.effect_deg < 0.6 * salt.effect_deg);
        // Without an effect of its own a powder has none.
        let opposed = sample::campaign(1, |at| [-0.1, 0.2][at.powder] * at.humidity);
        let humidity = extension_of(&opposed, Cause::Known(Mechanism::Humidity));
        assert_eq!((humidity.powders[0].factor, humidity.powders[0].effect_deg), (0.0, 0.0));
    }
}
