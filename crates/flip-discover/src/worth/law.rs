//! The law of a departure that nothing in the catalogue explains.
//!
//! Every class of laws is judged by its evidence, averaged over its forms: the covariate u runs
//! from 0 to 1 over its range, and a class is named if it holds half of the probability, all
//! classes being equally likely a priori. Otherwise the law is smooth.

use crate::causes::hypothesis::{Cause, Hypothesis};
use crate::causes::signature::Course;
use crate::data::campaign::Campaign;
use crate::data::scenario::{levels, percentile};
use crate::judge::prepared::Prepared;
use crate::report::names::{quantity, rounded};
use crate::report::{FormClass, Unexplained};
use crate::thresholds::NAMED_LAW;
use nalgebra::DMatrix;

/// Length scale of smooth functions, as a share of the range.
const SMOOTH_LENGTH: f64 = 0.35;
/// Width of a step, as a share of the range.
const STEP: f64 = 0.03;

/// What is known of the departure along a covariate.
pub(crate) fn law(campaign: &Campaign, prepared: &Prepared, covariate: &str) -> Unexplained {
    let smooth = |law: String| Unexplained {
        covariate: Some(covariate.to_owned()),
        law,
        form_class: FormClass::Smooth,
    };
    if levels(campaign, covariate).is_some() {
        return smooth(format!("a number of its own for each {}", quantity(covariate).0));
    }
    let range = [0.0, 1.0].map(|share| percentile(campaign, covariate, share));
    let ([Some(low), Some(high)], Ok(values)) = (range, campaign.numbers(covariate)) else {
        return smooth(format!("a change with {}", quantity(covariate).0));
    };
    let classes = classes(campaign, &values, low, high);
    let powder = campaign.powder_of();
    let y = DMatrix::from_column_slice(prepared.observed.len(), 1, &prepared.observed);
    let seen = prepared.seen(&y);
    let odds = |courses: &[(String, Course)]| {
        let hypothesis =
            Hypothesis::of(Cause::Unknown(covariate.to_owned()), courses, &powder, None);
        prepared.log_odds(&hypothesis, &seen)[0]
    };
    let judged: Vec<f64> = classes.iter().map(|(_, courses)| odds(courses)).collect();
    let best = judged.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let total: f64 = judged.iter().map(|odds| (odds - best).exp()).sum();
    let at = judged.iter().position(|&odds| odds == best).unwrap_or(0);
    let (form_class, courses) = &classes[at];
    if 1.0 / total < NAMED_LAW || *form_class == FormClass::Smooth {
        return smooth(format!("a smooth course over {}", quantity(covariate).0));
    }
    // The best form within the class.
    let form = courses.iter().map(|course| (odds(std::slice::from_ref(course)), &course.0));
    let form = form.max_by(|a, b| a.0.total_cmp(&b.0)).map_or(String::new(), |best| best.1.clone());
    Unexplained { covariate: Some(covariate.to_owned()), law: form, form_class: *form_class }
}

/// Every class with its forms, each with the law in words.
fn classes(
    campaign: &Campaign,
    values: &[f64],
    low: f64,
    high: f64,
) -> Vec<(FormClass, Vec<(String, Course)>)> {
    let u: Vec<f64> = values.iter().map(|value| (value - low) / (high - low)).collect();
    let strength = |law: String, form: &dyn Fn(f64) -> f64| {
        let strength: Vec<f64> = u.iter().map(|&u| form(u)).collect();
        Some((law, Course::of_strength(&strength, campaign)?))
    };
    let place = |u: f64| rounded(low + u * (high - low));
    let clipped = |u: f64| u.clamp(0.0, 1.0);
    let powers = [0.4, 2.0, 3.0, 5.0].into_iter().flat_map(|power: f64| {
        [
            strength(format!("a power of {power} from {} up", place(0.0)), &|u| {
                clipped(u).powf(power)
            }),
            strength(format!("a power of {power} from {} down", place(1.0)), &|u| {
                clipped(1.0 - u).powf(power)
            }),
        ]
    });
    let steps = (1..10).map(|k| {
        let middle = f64::from(k) / 10.0;
        strength(format!("a step at {}", place(middle)), &|u| {
            1.0 / (1.0 + ((middle - u) / STEP).exp())
        })
    });
    let limits = [0.08, 0.15, 0.3].into_iter().flat_map(|length: f64| {
        let scale = rounded(length * (high - low));
        [
            strength(format!("towards a limit over {scale} from {} up", place(0.0)), &|u| {
                -(-clipped(u) / length).exp()
            }),
            strength(format!("towards a limit over {scale} from {} down", place(1.0)), &|u| {
                -(-clipped(1.0 - u) / length).exp()
            }),
        ]
    });
    let waves = [0.2, 0.25, 0.33, 0.4, 0.5, 0.65, 0.8].into_iter().map(|period: f64| {
        let length = period * (high - low);
        Some((
            format!("a wave of period {}", rounded(length)),
            Course::wave(values, length, campaign)?,
        ))
    });
    let line = strength(format!("in proportion from {} to {}", place(0.0), place(1.0)), &|u| u);
    let smooth = Course::smooth(values, SMOOTH_LENGTH, campaign)
        .map(|course| ("a smooth course".to_owned(), course));
    [
        (FormClass::Linear, vec![line].into_iter().flatten().collect::<Vec<_>>()),
        (FormClass::Power, powers.flatten().collect()),
        (FormClass::Threshold, steps.flatten().collect()),
        (FormClass::Saturating, limits.flatten().collect()),
        (FormClass::Periodic, waves.flatten().collect()),
        (FormClass::Smooth, vec![smooth].into_iter().flatten().collect()),
    ]
    .into_iter()
    .filter(|(_, courses)| !courses.is_empty())
    .collect()
}
