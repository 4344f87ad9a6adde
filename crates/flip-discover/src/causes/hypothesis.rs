//! What may explain a campaign: every mechanism of the catalogue, every recorded covariate by a
//! smooth function, and an unrecorded wander.

use super::catalogue::{Family, Mechanism};
use super::response::{Action, Responses};
use super::signature::{Course, DEVIATIONS};
use crate::data::campaign::{Campaign, Quantity, Values};
use crate::thresholds::WANDER_SESSIONS_MIN;
use nalgebra::DMatrix;

/// Length scales of smooth functions of a covariate, as shares of its range.
const SMOOTH_LENGTHS: [f64; 2] = [0.35, 0.9];
/// Prior odds of a smooth function of a covariate that has a catalogued mechanism, and of one that
/// has none.
const UNCATALOGUED_PRIOR: [f64; 2] = [0.05, 0.3];
/// Prior odds of a wander over the sessions.
const UNRECORDED_PRIOR: f64 = 0.1;

/// A possible explanation of a discrepancy.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Cause {
    /// A mechanism of the catalogue.
    Known(Mechanism),
    /// A smooth function of this covariate.
    Unknown(String),
    /// Something unrecorded that changes over the sessions.
    Unrecorded,
}

impl Cause {
    /// Name used in reports, and the family within which causes look alike.
    pub fn name(&self) -> (String, Option<Family>) {
        match self {
            Self::Known(mechanism) => (mechanism.name().0.to_owned(), Some(mechanism.name().1)),
            Self::Unknown(covariate) => (format!("unknown: {covariate}"), None),
            Self::Unrecorded => ("unrecorded".to_owned(), None),
        }
    }

    /// The covariates it acts through.
    pub fn covariates(&self) -> Vec<&str> {
        match self {
            Self::Known(mechanism) => mechanism.covariates().to_vec(),
            Self::Unknown(covariate) => vec![covariate],
            Self::Unrecorded => Vec::new(),
        }
    }
}

/// A mechanism this campaign cannot judge, and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Untestable {
    /// Which.
    pub mechanism: Mechanism,
    /// Why, for a reader.
    pub reason: String,
}

/// A cause to be judged: its possible effects, and what is known of it a priori.
pub(crate) struct Hypothesis {
    pub cause: Cause,
    /// For each form and each amount of deviation between powders, over all runs: `[runs, k]`, the
    /// common part in the first columns.
    pub features: Vec<DMatrix<f64>>,
    /// What the cause grows with, for each of the features.
    pub laws: Vec<String>,
    /// Direction in which it moves the angle, if known.
    pub sign: Option<f64>,
    pub prior: f64,
}

impl Hypothesis {
    /// A cause with these courses, every powder its own deviation. The simulator's responses count
    /// where powders hardly deviate: powders of one angle differ by as much as the effect, so where
    /// they deviate they do so from one another.
    pub fn of(
        cause: Cause,
        courses: &[(String, Course)],
        powder: &[usize],
        response: Option<&[f64]>,
    ) -> Self {
        let each =
            || courses.iter().flat_map(|course| DEVIATIONS.map(|deviation| (course, deviation)));
        let features =
            each().map(|((_, course), deviation)| match response.filter(|_| deviation < 1.0) {
                Some(response) => course.scaled(response, powder).with_powders(powder, deviation),
                None => course.with_powders(powder, deviation),
            });
        let features = features.collect();
        let laws = each().map(|((law, _), _)| law.clone()).collect();
        Self { cause, features, laws, sign: None, prior: 1.0 }
    }

    /// Which coefficients have a known sign, given that this hypothesis' features begin at column
    /// `first`.
    pub fn signs(&self, first: usize) -> Vec<(usize, f64)> {
        self.sign.map(|sign| (first, sign)).into_iter().collect()
    }
}

/// Which hypotheses can be judged, and which cannot.
pub(crate) fn hypotheses(
    campaign: &Campaign,
    responses: &Responses,
) -> (Vec<Hypothesis>, Vec<Untestable>) {
    let powder = campaign.powder_of();
    let hypothesis = |cause: Cause, courses: Vec<(String, Course)>, prior: f64| Hypothesis {
        prior,
        ..Hypothesis::of(cause, &courses, &powder, None)
    };
    let (mut judged, mut untestable) = (Vec::new(), Vec::new());
    for mechanism in
        Mechanism::ALL.into_iter().filter(|mechanism| mechanism.moves(campaign.quantity))
    {
        match mechanism.courses(campaign) {
            Ok(courses) => {
                let response = Action::of(mechanism).and_then(|action| responses.of(action));
                let of = Hypothesis::of(Cause::Known(mechanism), &courses, &powder, response);
                let sign = mechanism.sign().filter(|_| campaign.quantity == Quantity::Repose);
                judged.push(Hypothesis { sign, ..of });
            }
            Err(reason) => untestable.push(Untestable { mechanism, reason }),
        }
    }
    let is_catalogued = |name: &str| campaign.quantity != Quantity::Scatter && has_mechanism(name);
    for covariate in &campaign.covariates {
        let name = &covariate.name;
        let courses = match &covariate.values {
            Values::Numbers(_) => {
                campaign.numbers(name).map_or(Vec::new(), |values| smooth(&values, campaign))
            }
            // A mechanism on levels already has one free coefficient per level.
            Values::Levels { .. } if is_catalogued(name) => Vec::new(),
            Values::Levels { .. } => {
                let levels = campaign.levels(name).ok();
                let course =
                    levels.and_then(|(level, count)| Course::of_levels(&level, count, campaign));
                course
                    .map(|course| (format!("one number for each {name}"), course))
                    .into_iter()
                    .collect()
            }
        };
        if !courses.is_empty() {
            let prior = UNCATALOGUED_PRIOR[usize::from(!is_catalogued(name))];
            judged.push(hypothesis(Cause::Unknown(name.clone()), courses, prior));
        }
    }
    if campaign.sessions() >= WANDER_SESSIONS_MIN {
        let session: Vec<f64> = campaign.runs.iter().map(|run| run.session as f64).collect();
        let courses = smooth(&session, campaign);
        // If each powder has a day of its own, its mean is the day's.
        if !courses.is_empty() {
            judged.push(hypothesis(Cause::Unrecorded, courses, UNRECORDED_PRIOR));
        }
    }
    (judged, untestable)
}

fn smooth(values: &[f64], campaign: &Campaign) -> Vec<(String, Course)> {
    let course = |&length: &f64| {
        Some(("a smooth course".to_owned(), Course::smooth(values, length, campaign)?))
    };
    SMOOTH_LENGTHS.iter().filter_map(course).collect()
}

/// Whether the catalogue has a mechanism that acts through this covariate.
pub(crate) fn has_mechanism(covariate: &str) -> bool {
    Mechanism::ALL.iter().any(|mechanism| mechanism.covariates().contains(&covariate))
}
