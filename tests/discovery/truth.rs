//! Laboratories with a hidden truth: campaigns of angles of repose in which a known cause, or none,
//! is at work.
//!
//! Nothing from the crate is used here, so detector and truth share no code and no formulas: a
//! [`Case`] is the file a chemist would upload, plus the hidden truth. The same family, size and
//! seed produce the same bytes.
//!
//! ```text
//! y = powder + effect + day + day x powder + repeat          effect = sum over causes of scale * susceptibility[powder] * product of factors
//! ```
//!
//! | symbol | value | unit | source |
//! |---|---|---|---|
//! | powder, SD of repeat | five powders, [`laboratory::PUBLISHED`] | deg | FLIP, arXiv:2506.03896: means and SDs of five repeats |
//! | SD of day, of day x powder | 0.5, 0.4; [`Family::NullDays`] has days of 1.2, [`Family::NullRestless`] of 2.5 | deg | chosen: the suite's default campaign |
//! | size | SD of the effect of each cause within a powder, over all runs | deg | 0.5, 0.75 and 1.0 are S, M and L |
//!
//! Effects have mean 0 within each powder of the campaign, because calibration removes the mean.

mod effect;
mod families;
mod laboratory;
#[cfg(test)]
mod tests;

use laboratory::{Laboratory, Run, Value, mean, percentile};
use std::collections::BTreeMap;

/// The hidden effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Family {
    /// Nothing.
    NullPlain,
    /// Nothing, but some runs went wrong by 6 to 12 deg.
    NullOutliers,
    /// Nothing, but a fifth to two fifths of what was recorded is missing.
    NullMissing,
    /// Nothing, but days differ by 1.2 deg.
    NullDays,
    /// Nothing, on four days of fifteen runs that differ by 2.5 deg, and so do weather, operator
    /// and plate: treating the runs of a day as independent finds a cause.
    NullRestless,
    /// Nothing, but humidity, temperature and the age of the containers move together.
    NullConfounded,
    /// Nothing, but a covariate changes the scatter.
    NullScatter,
    /// Angles rise with humidity, in at least three powders.
    Humidity,
    /// Sugar and salt change abruptly at a humidity of 60 to 85 %.
    Deliquescence,
    /// Angles rise with the time at rest.
    RestTime,
    /// Humidity times rest: nothing in dry air, nothing without rest.
    HumidAgeing,
    /// Angles change with the time since the container was opened.
    ContainerAge,
    /// Angles rise in dry air, unless an ioniser is on.
    Charge,
    /// Angles change with temperature.
    Temperature,
    /// Angles fall with vibration.
    Vibration,
    /// Angles fall with the height of the funnel.
    FunnelHeight,
    /// Angles change in the course of a session.
    Order,
    /// Batches differ.
    Batch,
    /// The camera reads differently from the hand.
    MethodBias,
    /// Operators differ.
    Operator,
    /// Base plates differ.
    BaseFriction,
    /// Two of the single causes that do not look alike, each of the full size.
    TwoCauses,
    /// One of two causes whose covariates went together: the right answer is to ask for an
    /// experiment.
    Confounded,
    /// A recorded covariate without a mechanism.
    Recorded,
    /// Something unrecorded, over the weeks.
    Unrecorded,
    /// Anything: see [`wild`]. Never tune to it.
    Wild,
}

impl Family {
    /// Where nothing is hidden.
    pub const NULLS: [Self; 7] = [
        Self::NullPlain,
        Self::NullOutliers,
        Self::NullMissing,
        Self::NullDays,
        Self::NullRestless,
        Self::NullConfounded,
        Self::NullScatter,
    ];
    /// One cause of the catalogue each.
    pub const SINGLES: [Self; 14] = [
        Self::Humidity,
        Self::Deliquescence,
        Self::RestTime,
        Self::HumidAgeing,
        Self::ContainerAge,
        Self::Charge,
        Self::Temperature,
        Self::Vibration,
        Self::FunnelHeight,
        Self::Order,
        Self::Batch,
        Self::MethodBias,
        Self::Operator,
        Self::BaseFriction,
    ];
    /// The others.
    pub const OTHERS: [Self; 5] =
        [Self::TwoCauses, Self::Confounded, Self::Recorded, Self::Unrecorded, Self::Wild];

    /// Name of the family; for a single cause, the cause's name in the catalogue.
    pub fn name(self) -> &'static str {
        match self {
            Self::NullPlain => "null_plain",
            Self::NullOutliers => "null_outliers",
            Self::NullMissing => "null_missing",
            Self::NullDays => "null_days",
            Self::NullRestless => "null_restless",
            Self::NullConfounded => "null_confounded",
            Self::NullScatter => "null_scatter",
            Self::Humidity => "humidity",
            Self::Deliquescence => "deliquescence",
            Self::RestTime => "rest_time",
            Self::HumidAgeing => "humid_ageing",
            Self::ContainerAge => "container_age",
            Self::Charge => "charge",
            Self::Temperature => "temperature",
            Self::Vibration => "vibration",
            Self::FunnelHeight => "funnel_height",
            Self::Order => "order",
            Self::Batch => "batch",
            Self::MethodBias => "method_bias",
            Self::Operator => "operator",
            Self::BaseFriction => "base_friction",
            Self::TwoCauses => "two_causes",
            Self::Confounded => "confounded",
            Self::Recorded => "outside_recorded",
            Self::Unrecorded => "outside_unrecorded",
            Self::Wild => "wild",
        }
    }
}

/// A campaign and its truth. Vectors have one value for each row of the file.
#[derive(Debug, Clone)]
pub struct Case {
    /// Family, size and seed in words.
    pub name: String,
    /// [`Family::name`].
    pub family: &'static str,
    /// The file the chemist uploads.
    pub csv: String,
    /// The one cause of the catalogue at work; none if there is none, or two.
    pub mechanism: Option<&'static str>,
    /// Equally right answers: `unrecorded` if it was not recorded; for a wild case any cause that
    /// acts through its covariate.
    pub also_right: Vec<&'static str>,
    /// Every cause of the catalogue at work.
    pub mechanisms: Vec<&'static str>,
    /// Causes these data cannot distinguish from `mechanism`.
    pub rivals: Vec<&'static str>,
    /// The column through which the (first) cause acts, if it was recorded.
    pub covariate: Option<String>,
    /// For a recorded cause outside the catalogue: linear, power, threshold, saturating, periodic
    /// or smooth.
    pub form_class: Option<&'static str>,
    /// The hidden effect, for people.
    pub formula: String,
    /// SD of each cause's effect within a powder in the campaign, degrees.
    pub size_deg: f64,
    /// Powder mean and effect: the limit of infinitely many repeats on an average day.
    pub noise_free_deg: Vec<f64>,
    /// The effect, with mean 0 within each powder of the campaign.
    pub effect_deg: Vec<f64>,
    /// [`Case::change_deg`] of `covariate` over its [`Case::span`]; 0 without a covariate, NaN for
    /// batches that are each of one powder.
    pub effect_5_95_deg: f64,
    laboratory: Laboratory,
    runs: Vec<Run>,
}

/// A campaign of this family; nulls and wild cases have their own size.
///
/// # Panics
/// No laboratory out of many drawn shows the effect clearly: the family is badly defined.
pub fn case(family: Family, size_deg: f64, seed: u64) -> Case {
    let laboratory = families::draw(family, size_deg, seed);
    let runs = laboratory.campaign();
    Case::of(
        format!("{} {:.2} deg, seed {seed}", family.name(), laboratory.truth.size_deg),
        laboratory,
        runs,
    )
}

/// A campaign of any kind: 3 to 8 powders, 12 to 40 days, 1 to 3 repeats, noise normal or not, an
/// effect of composed forms or none.
pub fn wild(seed: u64) -> Case {
    case(Family::Wild, f64::NAN, seed)
}

impl Case {
    fn of(name: String, laboratory: Laboratory, runs: Vec<Run>) -> Self {
        let effect_deg: Vec<f64> = runs.iter().map(|run| laboratory.effect_deg(run)).collect();
        let powder_deg = |run: &Run| laboratory.powders[run.powder].mean_deg;
        let truth = laboratory.truth.clone();
        let mut case = Self {
            name,
            family: truth.family,
            csv: laboratory.csv(&runs),
            mechanism: truth.mechanism,
            also_right: truth.also_right,
            mechanisms: truth.mechanisms,
            rivals: truth.rivals,
            covariate: truth.covariate.map(str::to_owned),
            form_class: truth.form_class,
            formula: laboratory
                .terms
                .iter()
                .map(ToString::to_string)
                .collect::<Vec<_>>()
                .join(" + "),
            size_deg: truth.size_deg,
            noise_free_deg: runs
                .iter()
                .zip(&effect_deg)
                .map(|(run, effect)| powder_deg(run) + effect)
                .collect(),
            effect_deg,
            effect_5_95_deg: 0.0,
            laboratory,
            runs,
        };
        if let Some(column) = truth.covariate {
            case.effect_5_95_deg = case.change_over_spans_deg(&[column]).unwrap_or(f64::NAN);
        }
        case
    }

    /// The 5th and the 95th percentile of a column; for names, the first and the last in the
    /// alphabet, if powders share them.
    pub fn span(&self, column: &str) -> Option<[String; 2]> {
        let mut numbers = Vec::new();
        let mut names = Vec::new();
        for run in &self.runs {
            match run.values.get(column)? {
                Value::Number(x) => numbers.push(*x),
                Value::Name(name) => names.push(name.clone()),
            }
        }
        if names.is_empty() {
            return Some([0.05, 0.95].map(|share| percentile(&numbers, share).to_string()));
        }
        let shared = column != "batch" || self.laboratory.shares_batches();
        shared.then_some([names.iter().min()?.clone(), names.iter().max()?.clone()])
    }

    /// Mean change over the powders if a column goes from one value to another and all else stays
    /// as it was in the runs, degrees.
    ///
    /// # Panics
    /// No such column, or text where a number is required.
    pub fn change_deg(&self, column: &str, from: &str, to: &str) -> f64 {
        self.change_of_all_deg(&[(column, [from.to_owned(), to.to_owned()])])
    }

    /// [`Case::change_deg`] of these columns, all at once from one end of their [`Case::span`] to
    /// the other; none where one has no span.
    pub fn change_over_spans_deg(&self, columns: &[&str]) -> Option<f64> {
        let moves: Option<Vec<_>> =
            columns.iter().map(|&column| Some((column, self.span(column)?))).collect();
        moves.map(|moves| self.change_of_all_deg(&moves))
    }

    fn change_of_all_deg(&self, moves: &[(&str, [String; 2])]) -> f64 {
        let at = |run: &Run, end: usize| {
            let mut moved = run.clone();
            for (column, ends) in moves {
                let value = moved
                    .values
                    .get_mut(*column)
                    .unwrap_or_else(|| panic!("nothing is called {column}"));
                *value = Value::parse(column, &ends[end]);
            }
            self.laboratory.effect_deg(&moved)
        };
        let of_powder = |powder: usize| {
            let runs = self.runs.iter().filter(|run| run.powder == powder);
            mean(&runs.map(|run| at(run, 1) - at(run, 0)).collect::<Vec<_>>())
        };
        mean(&(0..self.laboratory.powders.len()).map(of_powder).collect::<Vec<_>>())
    }

    /// The next days of the same laboratory, and only these: for the error of a prediction against
    /// the noise-free truth.
    pub fn more_days(&self, days: usize) -> Self {
        let runs = self.laboratory.ordinary_days(self.next_day(), days);
        Self::of(format!("{}, {days} days more", self.name), self.laboratory.clone(), runs)
    }

    /// The campaign with the rows the laboratory measures for these requested settings, column to
    /// value, in this order.
    ///
    /// A row without `powder` is measured with each. Rows with the same text for `session`, or with
    /// none, share a day, which is always a new one. Conditions not set in a row are as on any day;
    /// columns that the campaign lacks are added.
    ///
    /// # Panics
    /// A column that cannot be set, a powder that the laboratory does not have.
    pub fn after_experiment(&self, settings: &[BTreeMap<String, String>]) -> Self {
        let mut laboratory = self.laboratory.clone();
        let mut runs = self.runs.clone();
        runs.extend(laboratory.experiment(self.next_day(), settings));
        Self::of(format!("{}, after an experiment", self.name), laboratory, runs)
    }

    fn next_day(&self) -> usize {
        self.runs.iter().map(|run| run.day + 1).max().unwrap_or(0)
    }
}
