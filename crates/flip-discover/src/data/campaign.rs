//! What was measured, run by run, and under which conditions.

use crate::thresholds::{LEVELS_MAX, MISSING_MAX, RUNS_MIN};
use flip_core::domain::FieldError;
use flip_core::domain::powder::is_soluble;
use flip_core::stats::summary::mean;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// One measurement.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// Row of the file it came from, the header being row 1; the repeats behind a summary share one
    /// row.
    pub row: u32,
    /// Index into [`Campaign::powders`].
    pub powder: usize,
    /// Day, numbered in order of time; runs of one day share its day effect.
    pub session: usize,
    /// What was measured, in the unit of [`Campaign::quantity`]; none where it is to be predicted.
    #[serde(rename = "repose_deg")]
    pub value: Option<f64>,
}

/// Generates angles with this mean and SD: for a normal distribution these are sufficient, so the
/// repeats behind a summary carry neither more nor less.
///
/// With 1 for `repeats` there is no SD.
pub fn repeats_of(mean_deg: f64, sd_deg: f64, repeats: u32) -> Vec<f64> {
    let middle = f64::from(repeats.saturating_sub(1)) / 2.0;
    let places: Vec<f64> = (0..repeats).map(|k| f64::from(k) - middle).collect();
    let spread = (places.iter().map(|x| x * x).sum::<f64>() / (2.0 * middle).max(1.0)).sqrt();
    places
        .iter()
        .map(|place| mean_deg + if spread > 0.0 { sd_deg * place / spread } else { 0.0 })
        .collect()
}

/// A quantity recorded with each run; `None` where it was not.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Covariate {
    /// The column's name: `relative_humidity_pct`.
    pub name: String,
    /// One for each run.
    pub values: Values,
}

/// Numbers or names.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Values {
    /// In the unit given by the end of the covariate's name.
    Numbers(Vec<Option<f64>>),
    /// Names.
    Levels {
        /// Every name, in alphabetical order.
        names: Vec<String>,
        /// Index of each run's name.
        of: Vec<Option<usize>>,
    },
}

/// Which measured quantity departs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Channel {
    /// Angle of repose.
    Repose,
    /// Flow through a hole.
    FlowTime,
    /// Balance readings of weighings.
    Trace,
    /// How far angles scatter.
    Scatter,
}

/// The quantity measured in the runs of a campaign, which gives their values a unit.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// Angles of repose, degrees.
    #[default]
    Repose,
    /// Times in which the powder flows out: 100 times the natural logarithm of seconds.
    FlowTime,
    /// How far repeats are from each other: 100 times the natural logarithm of a contrast over the
    /// powder's usual one.
    Scatter,
}

/// A hundred times the natural logarithm: a change of one hundredth changes it by one.
pub(crate) fn percent(value: f64) -> f64 {
    100.0 * libm::log(value)
}

impl Quantity {
    /// Converts a change to the reported value, in the unit from [`Self::unit`].
    pub(crate) fn told(self, change: f64) -> f64 {
        match self {
            Self::Repose => change,
            Self::FlowTime | Self::Scatter => 100.0 * libm::expm1(change / 100.0),
        }
    }

    fn is_repose(&self) -> bool {
        *self == Self::Repose
    }

    pub(crate) fn channel(self) -> Channel {
        match self {
            Self::Repose => Channel::Repose,
            Self::FlowTime => Channel::FlowTime,
            Self::Scatter => Channel::Scatter,
        }
    }

    /// What was measured, as the beginning of a sentence.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Repose => "Angles of repose",
            Self::FlowTime => "Flow times",
            Self::Scatter => "Distances between repeats",
        }
    }

    /// Unit of a change.
    pub(crate) fn unit(self) -> &'static str {
        match self {
            Self::Repose => "deg",
            Self::FlowTime | Self::Scatter => "%",
        }
    }
}

/// Runs of some powders under recorded conditions.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Campaign {
    /// Powder ids.
    pub powders: Vec<String>,
    /// What was measured.
    pub runs: Vec<Run>,
    /// What was recorded alongside.
    pub covariates: Vec<Covariate>,
    /// Time the powder took to flow out, s, one for each run; empty if never measured.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub flow_time_s: Vec<Option<f64>>,
    /// The quantity of every [`Run::value`]: angles in a laboratory's file.
    #[serde(default, skip_serializing_if = "Quantity::is_repose")]
    pub quantity: Quantity,
    /// Whether powders dissolve in water that they take up from the air, by id, where the
    /// laboratory has said so.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub soluble: BTreeMap<String, bool>,
}

impl Campaign {
    /// Returns the campaign if it can be judged at all.
    ///
    /// # Errors
    /// Fewer than [`RUNS_MIN`] measured runs beyond one for each powder; an angle that is not a
    /// number; angles that are the same in all runs of each powder; a covariate whose number of
    /// values differs from the number of runs.
    pub fn checked(self) -> Result<Self, FieldError> {
        let measured = self.measured().len();
        if measured.saturating_sub(self.powders.len()) < RUNS_MIN {
            let message = format!(
                "{measured} runs of {} powders say nothing: each powder's mean takes one, and at least {RUNS_MIN} more are needed",
                self.powders.len()
            );
            return Err(FieldError::new("measurements", message));
        }
        if self.runs.iter().any(|run| run.value.is_some_and(|angle| !angle.is_finite())) {
            return Err(FieldError::new("repose_deg", "must be a finite number in every run"));
        }
        if !self.varies() {
            let message = "is the same in all runs of each powder; measure to 0.1 deg or finer";
            return Err(FieldError::new("repose_deg", message));
        }
        if ![0, self.runs.len()].contains(&self.flow_time_s.len()) {
            let message =
                format!("has {} values for {} runs", self.flow_time_s.len(), self.runs.len());
            return Err(FieldError::new("flow_time_s", message));
        }
        let odd = self.covariates.iter().find(|covariate| covariate.len() != self.runs.len());
        match odd {
            Some(covariate) => {
                let message =
                    format!("has {} values for {} runs", covariate.len(), self.runs.len());
                Err(FieldError::new(covariate.name.clone(), message))
            }
            None => Ok(self),
        }
    }

    /// Whether a powder may dissolve in humid air: unless it is known not to.
    pub(crate) fn may_dissolve(&self, powder: usize) -> bool {
        let id = &self.powders[powder];
        is_soluble(id, self.soluble.get(id).copied()) != Some(false)
    }

    /// Whether any powder has two different angles.
    fn varies(&self) -> bool {
        let mut first: Vec<Option<f64>> = vec![None; self.powders.len()];
        let mut angles = self.runs.iter().filter_map(|run| Some((run.powder, run.value?)));
        angles.any(|(powder, angle)| *first[powder].get_or_insert(angle) != angle)
    }

    /// Indices of the runs that have an angle.
    pub fn measured(&self) -> Vec<usize> {
        (0..self.runs.len()).filter(|&i| self.runs[i].value.is_some()).collect()
    }

    /// A copy without the angles of these runs, which are to be predicted and must not be seen.
    pub fn without(&self, hidden: &[usize]) -> Self {
        let mut rest = self.clone();
        hidden.iter().for_each(|&i| rest.runs[i].value = None);
        rest
    }

    /// A copy with another campaign's runs appended without their angles: rows to predict.
    /// Covariates recorded only in the other campaign are dropped; names never seen in this one
    /// count as not recorded.
    pub fn joined(&self, other: &Self) -> Self {
        let mut all = Self { flow_time_s: Vec::new(), ..self.clone() };
        let session = all.runs.iter().map(|run| run.session + 1).max().unwrap_or(0);
        let known = |powder: &String| self.powders.iter().position(|own| own == powder);
        all.powders.extend(other.powders.iter().filter(|powder| known(powder).is_none()).cloned());
        let place = |powder: usize| {
            all.powders.iter().position(|own| *own == other.powders[powder]).unwrap_or(0)
        };
        let moved = |run: &Run| Run {
            powder: place(run.powder),
            session: session + run.session,
            value: None,
            ..*run
        };
        let runs: Vec<Run> = other.runs.iter().map(moved).collect();
        all.runs.extend(runs);
        for Covariate { name, values } in &mut all.covariates {
            match (values, other.values(name)) {
                (Values::Numbers(of), Some(Values::Numbers(more))) => of.extend(more),
                (
                    Values::Levels { names, of },
                    Some(Values::Levels { names: theirs, of: more }),
                ) => {
                    let level = |level: &Option<usize>| {
                        let name = &theirs[(*level)?];
                        names.iter().position(|own| own == name)
                    };
                    of.extend(more.iter().map(level));
                }
                (Values::Numbers(of), _) => of.resize(of.len() + other.runs.len(), None),
                (Values::Levels { of, .. }, _) => of.resize(of.len() + other.runs.len(), None),
            }
        }
        all
    }

    /// Powder of each run.
    pub fn powder_of(&self) -> Vec<usize> {
        self.runs.iter().map(|run| run.powder).collect()
    }

    /// Number of sessions.
    pub fn sessions(&self) -> usize {
        let mut sessions = self.session_of();
        sessions.sort_unstable();
        sessions.dedup();
        sessions.len()
    }

    /// Session of each run.
    pub fn session_of(&self) -> Vec<usize> {
        self.runs.iter().map(|run| run.session).collect()
    }

    /// Numbers of a covariate with gaps filled: by the mean of the same session, else by the
    /// overall mean. The error states why it cannot be used.
    pub(crate) fn numbers(&self, name: &str) -> Result<Vec<f64>, String> {
        let Some(Values::Numbers(values)) = self.values(name) else {
            return Err(format!("{name} was not recorded"));
        };
        let measured = self.measured();
        let known: Vec<f64> = measured.iter().filter_map(|&i| values[i]).collect();
        let missing = measured.len() - known.len();
        if missing as f64 > MISSING_MAX * measured.len() as f64 {
            return Err(format!("{name} is missing in {missing} of {} runs", measured.len()));
        }
        if known.windows(2).all(|pair| pair[0] == pair[1]) {
            return Err(format!("{name} was the same in all runs"));
        }
        let overall = mean(&known).unwrap_or(0.0);
        let of_session = |session: usize| {
            let mates = self.runs.iter().zip(values).filter(|(run, _)| run.session == session);
            mean(&mates.filter_map(|(_, value)| *value).collect::<Vec<_>>())
        };
        let filled = self.runs.iter().zip(values);
        Ok(filled
            .map(|(run, value)| value.or_else(|| of_session(run.session)).unwrap_or(overall))
            .collect())
    }

    /// Level of each run and the number of levels; runs without one form a level of their own.
    pub(crate) fn levels(&self, name: &str) -> Result<(Vec<usize>, usize), String> {
        let Some(Values::Levels { of: values, .. }) = self.values(name) else {
            return Err(format!("{name} was not recorded"));
        };
        let measured = self.measured();
        let missing = measured.iter().filter(|&&i| values[i].is_none()).count();
        if missing as f64 > MISSING_MAX * measured.len() as f64 {
            return Err(format!("{name} is missing in {missing} of {} runs", measured.len()));
        }
        let count = values.iter().flatten().max().map_or(0, |last| last + 1);
        if count > LEVELS_MAX {
            return Err(format!(
                "{name} has {count} different names, more than the {LEVELS_MAX} that are looked at: group them into fewer"
            ));
        }
        let of: Vec<usize> = values.iter().map(|value| value.unwrap_or(count)).collect();
        match measured.windows(2).all(|pair| of[pair[0]] == of[pair[1]]) {
            true => Err(format!("{name} was the same in all runs")),
            false => Ok((of, count + usize::from(values.iter().any(Option::is_none)))),
        }
    }

    pub(crate) fn values(&self, name: &str) -> Option<&Values> {
        self.covariates
            .iter()
            .find(|covariate| covariate.name == name)
            .map(|covariate| &covariate.values)
    }
}

impl Covariate {
    fn len(&self) -> usize {
        match &self.values {
            Values::Numbers(values) => values.len(),
            Values::Levels { of, .. } => of.len(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_is_filled_by_its_session_and_only_then_by_all() {
        let run = |session: usize| Run { row: 0, powder: 0, session, value: Some(30.0) };
        let values = [Some(40.0), Some(44.0), None, Some(60.0), None];
        let campaign = Campaign {
            powders: vec!["sand".to_owned()],
            runs: [0, 0, 0, 1, 2].map(run).to_vec(),
            covariates: vec![Covariate {
                name: "relative_humidity_pct".to_owned(),
                values: Values::Numbers(values.to_vec()),
            }],
            ..Campaign::default()
        };
        // 42 is the mean of session 0, 48 that of 40, 44 and 60.
        let filled = campaign.numbers("relative_humidity_pct").unwrap();
        assert_eq!(filled, [40.0, 44.0, 42.0, 60.0, 48.0]);
    }
}
