//! What was measured, run by run, and under which conditions.

use crate::domain::FieldError;
use crate::stats::summary::mean;

/// Fewest runs that can say anything: with fewer there is no telling days from repeats.
pub const RUNS_MIN: usize = 12;
/// Share of runs that may lack a covariate before nothing is asked of it.
const MISSING_MAX: f64 = 0.5;

/// One angle of repose, or the mean of several.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Run {
    /// Index into [`Campaign::powders`].
    pub powder: usize,
    /// Day, by number; runs of one day share what a day does.
    pub session: usize,
    /// Angle of repose, degrees.
    pub repose_deg: f64,
    /// Standard deviation of the repeats behind it, degrees, if it is a mean.
    pub repose_sd_deg: Option<f64>,
    /// Repeats behind it, at least 1.
    pub repeats: u32,
}

/// Something that was recorded with each run; `None` where it was not.
#[derive(Debug, Clone, PartialEq)]
pub struct Covariate {
    /// As the column is called: `relative_humidity_pct`.
    pub name: String,
    /// One for each run.
    pub values: Values,
}

/// Numbers or names.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// In the unit that the covariate's name ends in.
    Numbers(Vec<Option<f64>>),
    /// Index of a level, as many as there are.
    Levels(Vec<Option<usize>>),
}

/// Runs of some powders under recorded conditions.
#[derive(Debug, Clone, PartialEq)]
pub struct Campaign {
    /// Powder ids.
    pub powders: Vec<String>,
    /// What was measured.
    pub runs: Vec<Run>,
    /// What was recorded beside it.
    pub covariates: Vec<Covariate>,
}

impl Campaign {
    /// The campaign, if it can say anything at all.
    ///
    /// # Errors
    /// Fewer than [`RUNS_MIN`] runs beyond one for each powder; a covariate with another number of values than there are runs.
    pub fn checked(self) -> Result<Self, FieldError> {
        let spare = self.runs.len().saturating_sub(self.powders.len());
        if spare < RUNS_MIN {
            let message = format!(
                "{} runs of {} powders say nothing: each powder's mean takes one, and at least {RUNS_MIN} more are needed",
                self.runs.len(),
                self.powders.len()
            );
            return Err(FieldError::new("measurements", message));
        }
        let odd = self.covariates.iter().find(|covariate| covariate.len() != self.runs.len());
        match odd {
            Some(covariate) => {
                let message = format!("has {} values for {} runs", covariate.len(), self.runs.len());
                Err(FieldError::new(covariate.name.clone(), message))
            }
            None => Ok(self),
        }
    }

    /// Powder of each run.
    pub fn powder_of(&self) -> Vec<usize> {
        self.runs.iter().map(|run| run.powder).collect()
    }

    /// Session of each run.
    pub fn session_of(&self) -> Vec<usize> {
        self.runs.iter().map(|run| run.session).collect()
    }

    /// Numbers of a covariate with the gaps filled: by the mean of the same session, else by the mean of all. An error says why it cannot be used.
    pub(super) fn numbers(&self, name: &str) -> Result<Vec<f64>, String> {
        let Some(Values::Numbers(values)) = self.values(name) else {
            return Err(format!("{name} was not recorded"));
        };
        let known: Vec<f64> = values.iter().flatten().copied().collect();
        let missing = values.len() - known.len();
        if missing as f64 > MISSING_MAX * values.len() as f64 {
            return Err(format!("{name} is missing in {missing} of {} runs", values.len()));
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
        Ok(filled.map(|(run, value)| value.or_else(|| of_session(run.session)).unwrap_or(overall)).collect())
    }

    /// Level of each run and how many levels there are; runs without are a level of their own.
    pub(super) fn levels(&self, name: &str) -> Result<(Vec<usize>, usize), String> {
        let Some(Values::Levels(values)) = self.values(name) else {
            return Err(format!("{name} was not recorded"));
        };
        let missing = values.iter().filter(|value| value.is_none()).count();
        if missing as f64 > MISSING_MAX * values.len() as f64 {
            return Err(format!("{name} is missing in {missing} of {} runs", values.len()));
        }
        let count = values.iter().flatten().max().map_or(0, |last| last + 1);
        let of: Vec<usize> = values.iter().map(|value| value.unwrap_or(count)).collect();
        match of.windows(2).all(|pair| pair[0] == pair[1]) {
            true => Err(format!("{name} was the same in all runs")),
            false => Ok((of, count + usize::from(missing > 0))),
        }
    }

    fn values(&self, name: &str) -> Option<&Values> {
        self.covariates.iter().find(|covariate| covariate.name == name).map(|covariate| &covariate.values)
    }
}

impl Covariate {
    fn len(&self) -> usize {
        match &self.values {
            Values::Numbers(values) => values.len(),
            Values::Levels(values) => values.len(),
        }
    }
}
