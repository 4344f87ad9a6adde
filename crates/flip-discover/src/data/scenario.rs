//! Hypothetical runs: a campaign extended by the conditions to be predicted.

use super::campaign::{Campaign, Covariate, Run, Values};
use std::collections::BTreeMap;

/// A setting of a covariate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Setting {
    /// In the covariate's unit.
    Number(f64),
    /// Index of a name.
    Level(usize),
}

/// Conditions of a run, by covariate; missing ones are as usual.
pub type Conditions = BTreeMap<String, Setting>;

/// The campaign with further runs, which have no angle unless one is given; and the index of the
/// first of them.
pub fn extended(
    campaign: &Campaign,
    session: usize,
    runs: &[(usize, Conditions, Option<f64>)],
) -> (Campaign, usize) {
    let first = campaign.runs.len();
    let mut more = Campaign { flow_time_s: Vec::new(), ..campaign.clone() };
    more.runs.extend(runs.iter().map(|&(powder, _, value)| Run { row: 0, powder, session, value }));
    for Covariate { name, values } in &mut more.covariates {
        match values {
            Values::Numbers(values) => {
                values.extend(runs.iter().map(|(_, conditions, _)| match conditions.get(name) {
                    Some(Setting::Number(value)) => Some(*value),
                    _ => None,
                }))
            }
            Values::Levels { of, .. } => {
                of.extend(runs.iter().map(|(_, conditions, _)| match conditions.get(name) {
                    Some(Setting::Level(level)) => Some(*level),
                    _ => None,
                }))
            }
        }
    }
    (more, first)
}

/// The value below which this share of the measured runs' values lies, by linear interpolation.
pub fn percentile(campaign: &Campaign, covariate: &str, share: f64) -> Option<f64> {
    let Some(Values::Numbers(values)) = campaign.values(covariate) else { return None };
    let mut known: Vec<f64> = campaign.measured().iter().filter_map(|&i| values[i]).collect();
    known.sort_by(f64::total_cmp);
    quantile(&known, share)
}

/// The same for sorted values.
pub fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let place = share * sorted.len().checked_sub(1)? as f64;
    let (below, above) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
    Some(below + (above - below) * place.fract())
}

/// Names of a covariate, if it is named.
pub fn levels<'a>(campaign: &'a Campaign, covariate: &str) -> Option<&'a [String]> {
    match campaign.values(covariate) {
        Some(Values::Levels { names, .. }) => Some(names),
        _ => None,
    }
}
