//! Which of the causes are at work, if one or two are, and the resulting prediction for each run.
//!
//! ```text
//! models      none (0.5) | one cause (0.35, by its prior) | two causes (0.15, by the product of theirs)
//! component   a model with a noise, a form and deviation for each of its causes, and an amplitude
//! weight      prior of the model  x  evidence of the component  /  how many components the model has
//! given a component, with a = (powder means, features):
//!     M = a^T V^-1 a + diag(0, I / t^2),   c = M^-1 a^T V^-1 y,   s^2 = (y^T V^-1 y - c^T M c) / (n - p)
//!     what a row r adds up to, r^T c, is Student's t with n - p degrees of freedom, scale s sqrt(r^T M^-1 r)
//! ```
//!
//! For two causes not every form is tried with every other: the best of each alone are, and the
//! omitted ones are assumed to hold the same share as they do alone.

use super::prepared::{AMPLITUDES, Prepared};
use crate::causes::hypothesis::{Cause, Hypothesis};
use crate::data::campaign::Campaign;
use nalgebra::{Cholesky, DMatrix, DVector};
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Prior probability of no, one and two causes.
const MODELS: [f64; 3] = [0.5, 0.35, 0.15];
/// Number of causes tried with every other.
const LEADERS: usize = 3;
/// Features of a cause tried with those of another.
const TRIED: usize = 2;
/// Number of noises tried with two causes.
const NOISES: usize = 6;
/// Number of components used for predictions, and the least weight of one relative to the heaviest.
const COMPONENTS: usize = 80;
const WEIGHT_MIN: f64 = 1e-3;

/// A model with everything but its coefficients.
#[derive(Debug, Clone)]
struct Component {
    noise: usize,
    /// Hypothesis and feature.
    parts: Vec<(usize, usize)>,
    amplitude: f64,
    log_weight: f64,
}

/// The posterior over models.
pub(crate) struct Posterior<'a> {
    prepared: &'a Prepared,
    components: Vec<Component>,
    /// Probability that each hypothesis is at work, if anything is.
    pub inclusion: Vec<f64>,
}

/// Mean and SD of the predicted reading of a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Predicted {
    /// In the unit of the campaign's quantity.
    pub mean: f64,
    /// The same, including noise.
    pub sd: f64,
}

/// A mixture of Student's t distributions.
#[derive(Debug, Clone)]
pub(crate) struct Mixture(Vec<Student>);

#[derive(Debug, Clone)]
struct Student {
    weight: f64,
    location: f64,
    scale: f64,
    freedom: f64,
}

impl<'a> Posterior<'a> {
    /// Weighs every model on the campaign.
    pub fn new(prepared: &'a Prepared) -> Self {
        let y = DMatrix::from_column_slice(prepared.observed.len(), 1, &prepared.observed);
        let noises = prepared.noises.len();
        let none = (0..noises).map(|noise| {
            let model = &prepared.noises[noise].model;
            let log_weight =
                MODELS[0].ln() + model.log_null(model.squares(&y)[0]) - (noises as f64).ln();
            Component { noise, parts: Vec::new(), amplitude: 0.0, log_weight }
        });
        let mut components: Vec<Component> = none.collect();
        let hypotheses = &prepared.hypotheses;
        let total: f64 = hypotheses.iter().map(|hypothesis| hypothesis.prior).sum();
        let alone: Vec<Vec<Component>> = (0..hypotheses.len())
            .into_par_iter()
            .map(|h| {
                let features: Vec<usize> = (0..hypotheses[h].features.len()).collect();
                let parts: Vec<_> = features.iter().map(|&f| vec![(h, f)]).collect();
                let all: Vec<usize> = (0..noises).collect();
                let count = (noises * parts.len() * AMPLITUDES.len()) as f64;
                let log_prior = (MODELS[1] * hypotheses[h].prior / total / count).ln();
                judge(prepared, &y, &all, &parts, log_prior)
            })
            .collect();
        let together = pairs(prepared, &y, &alone);
        components.extend(alone.into_iter().flatten());
        components.extend(together);
        let heaviest = components
            .iter()
            .map(|component| component.log_weight)
            .fold(f64::NEG_INFINITY, f64::max);
        components.iter_mut().for_each(|component| component.log_weight -= heaviest);
        let sum = |of: &dyn Fn(&Component) -> bool| -> f64 {
            components
                .iter()
                .filter(|component| of(component))
                .map(|component| component.log_weight.exp())
                .sum()
        };
        let any = sum(&|component| !component.parts.is_empty()).max(f64::MIN_POSITIVE);
        let inclusion = (0..hypotheses.len())
            .map(|h| sum(&|component| component.parts.iter().any(|part| part.0 == h)) / any)
            .collect();
        Self { prepared, components, inclusion }
    }

    /// Prediction for each run from the powders' means alone, and with everything that may be at
    /// work; NaN for a powder without any angle.
    pub fn predict(&self, campaign: &Campaign) -> Vec<[Predicted; 2]> {
        let rows = campaign.runs.len();
        let before = self.solved(|component| component.parts.is_empty());
        let after = self.solved(|_| true);
        let moments = |solved: &[Solved], row: usize| {
            let run = solved.iter().map(|component| component.row(row));
            Mixture(run.collect()).moments()
        };
        let known: Vec<bool> = (0..campaign.powders.len())
            .map(|powder| self.prepared.measured.iter().any(|&i| self.prepared.powder[i] == powder))
            .collect();
        (0..rows)
            .map(|row| {
                let centre = match known[campaign.runs[row].powder] {
                    true => self.prepared.centres[campaign.runs[row].powder],
                    false => f64::NAN,
                };
                [&before, &after].map(|solved| {
                    let (mean, sd) = moments(solved, row);
                    Predicted { mean: centre + mean, sd }
                })
            })
            .collect()
    }

    /// Contribution of the causes to each run, without noise and powders' means: `[run]`;
    /// zero is the mean of a powder's measured runs.
    pub fn shifts(&self) -> Vec<f64> {
        let solved = self.solved(|_| true);
        (0..self.prepared.powder.len())
            .map(|row| {
                solved.iter().map(|component| component.weight * component.shift(row)).sum::<f64>()
            })
            .collect()
    }

    /// Contribution of a cause to each run where it is at work, without noise and powders' means.
    pub fn shifts_by(&self, cause: &Cause) -> Vec<f64> {
        let h = self.prepared.hypotheses.iter().position(|hypothesis| hypothesis.cause == *cause);
        let solved = self.solved(|component| component.parts.iter().any(|part| Some(part.0) == h));
        let row = |row: usize| {
            solved.iter().map(|component| component.weight * component.shift(row)).sum::<f64>()
        };
        (0..self.prepared.powder.len()).map(row).collect()
    }

    /// Probability that a cause is at work, if anything is.
    pub fn inclusion_of(&self, cause: &Cause) -> f64 {
        let h = self.prepared.hypotheses.iter().position(|hypothesis| hypothesis.cause == *cause);
        h.map_or(0.0, |h| self.inclusion[h])
    }

    /// The most probable law of a cause.
    pub fn law(&self, cause: &Cause) -> Option<&'a str> {
        let f = self.best_feature(cause)?;
        self.prepared
            .hypotheses
            .iter()
            .find(|hypothesis| hypothesis.cause == *cause)
            .map(|hypothesis| hypothesis.laws[f].as_str())
    }

    /// The feature of a cause that holds most of its probability.
    pub fn best_feature(&self, cause: &Cause) -> Option<usize> {
        let h =
            self.prepared.hypotheses.iter().position(|hypothesis| hypothesis.cause == *cause)?;
        let mut weights = vec![0.0; self.prepared.hypotheses[h].features.len()];
        for component in &self.components {
            for part in component.parts.iter().filter(|part| part.0 == h) {
                weights[part.1] += component.log_weight.exp();
            }
        }
        (0..weights.len()).max_by(|&a, &b| weights[a].total_cmp(&weights[b]))
    }

    /// How far a cause moves the angle from one run to another, averaged over pairs of runs; `None`
    /// where no component has it.
    pub fn effect(&self, cause: &Cause, pairs: &[(usize, usize)]) -> Option<Mixture> {
        let h =
            self.prepared.hypotheses.iter().position(|hypothesis| hypothesis.cause == *cause)?;
        let solved = self.solved(|component| component.parts.iter().any(|part| part.0 == h));
        (!solved.is_empty())
            .then(|| Mixture(solved.iter().map(|component| component.contrast(h, pairs)).collect()))
    }

    /// The heaviest of the selected components, with their coefficients; weights sum to 1.
    fn solved(&self, which: impl Fn(&Component) -> bool) -> Vec<Solved<'a>> {
        let mut chosen: Vec<&Component> =
            self.components.iter().filter(|component| which(component)).collect();
        chosen.sort_by(|a, b| b.log_weight.total_cmp(&a.log_weight));
        chosen.truncate(COMPONENTS);
        let Some(heaviest) = chosen.first().map(|component| component.log_weight) else {
            return Vec::new();
        };
        chosen.retain(|component| component.log_weight - heaviest > WEIGHT_MIN.ln());
        let total: f64 =
            chosen.iter().map(|component| (component.log_weight - heaviest).exp()).sum();
        let prepared = self.prepared;
        let solve = |component: &&Component| {
            Solved::new(prepared, component, (component.log_weight - heaviest).exp() / total)
        };
        chosen.par_iter().filter_map(solve).collect()
    }
}

/// Components of these parts with these noises and every amplitude.
fn judge(
    prepared: &Prepared,
    y: &DMatrix<f64>,
    noises: &[usize],
    parts: &[Vec<(usize, usize)>],
    log_prior: f64,
) -> Vec<Component> {
    let mut found = Vec::new();
    for parts in parts {
        let features = join(prepared, parts).select_rows(&prepared.measured);
        let (mut first, mut signs) = (0, Vec::new());
        for &(h, f) in parts {
            signs.extend(prepared.hypotheses[h].signs(first));
            first += prepared.hypotheses[h].features[f].ncols();
        }
        for &noise in noises {
            let model = &prepared.noises[noise].model;
            let Some(signature) = model.signature(&features) else { continue };
            let (seen, squares) = (signature.seen(y), model.squares(y)[0]);
            for amplitude in AMPLITUDES {
                let log_evidence =
                    model.log_evidence(&signature, seen.column(0), squares, amplitude, &signs);
                let log_weight = log_prior + log_evidence;
                found.push(Component { noise, parts: parts.clone(), amplitude, log_weight });
            }
        }
    }
    found
}

/// Features of several parts side by side, over all runs.
fn join(prepared: &Prepared, parts: &[(usize, usize)]) -> DMatrix<f64> {
    let of: Vec<&DMatrix<f64>> =
        parts.iter().map(|&(h, f)| &prepared.hypotheses[h].features[f]).collect();
    let columns: Vec<DVector<f64>> =
        of.iter().flat_map(|features| features.column_iter().map(|c| c.into_owned())).collect();
    if columns.is_empty() {
        DMatrix::zeros(prepared.powder.len(), 0)
    } else {
        DMatrix::from_columns(&columns)
    }
}

fn weight(components: &[Component], heaviest: f64) -> f64 {
    components.iter().map(|component| (component.log_weight - heaviest).exp()).sum()
}

/// The best causes, each paired with every other.
fn pairs(prepared: &Prepared, y: &DMatrix<f64>, alone: &[Vec<Component>]) -> Vec<Component> {
    let hypotheses = &prepared.hypotheses;
    let heaviest = alone
        .iter()
        .flatten()
        .map(|component| component.log_weight)
        .fold(f64::NEG_INFINITY, f64::max);
    let weights: Vec<f64> = alone.iter().map(|of| weight(of, heaviest)).collect();
    let mut order: Vec<usize> = (0..hypotheses.len()).collect();
    order.sort_by(|&a, &b| weights[b].total_cmp(&weights[a]));
    let mut of_noise = vec![0.0; prepared.noises.len()];
    alone
        .iter()
        .flatten()
        .for_each(|component| of_noise[component.noise] += (component.log_weight - heaviest).exp());
    let mut noises: Vec<usize> = (0..of_noise.len()).collect();
    noises.sort_by(|&a, &b| of_noise[b].total_cmp(&of_noise[a]));
    noises.truncate(NOISES);
    let best: Vec<(Vec<usize>, f64)> = (0..hypotheses.len())
        .map(|h| {
            let of = |f: usize| -> f64 {
                alone[h]
                    .iter()
                    .filter(|component| component.parts[0].1 == f)
                    .map(|component| (component.log_weight - heaviest).exp())
                    .sum()
            };
            let mut features: Vec<usize> = (0..hypotheses[h].features.len()).collect();
            features.sort_by(|&a, &b| of(b).total_cmp(&of(a)));
            features.truncate(TRIED);
            let share = features.iter().map(|&f| of(f)).sum::<f64>() / weights[h];
            (features, if share > 0.0 { share } else { 1.0 })
        })
        .collect();
    let allowed = |a: usize, b: usize| a != b && may_go_together(&hypotheses[a], &hypotheses[b]);
    let prior = |a: usize, b: usize| hypotheses[a].prior * hypotheses[b].prior;
    let total: f64 = (0..hypotheses.len())
        .flat_map(|a| (0..a).map(move |b| (a, b)))
        .filter(|&(a, b)| allowed(a, b))
        .map(|(a, b)| prior(a, b))
        .sum();
    let leaders = &order[..order.len().min(LEADERS)];
    let tried: Vec<(usize, usize)> = leaders
        .iter()
        .enumerate()
        .flat_map(|(k, &a)| order[k + 1..].iter().map(move |&b| (a, b)))
        .filter(|&(a, b)| allowed(a, b))
        .collect();
    // Noises that are not tried are assumed to hold the same share as for one cause.
    let noise_share =
        noises.iter().map(|&noise| of_noise[noise]).sum::<f64>() / of_noise.iter().sum::<f64>();
    tried
        .into_par_iter()
        .flat_map_iter(|(a, b)| {
            let parts: Vec<_> = best[a]
                .0
                .iter()
                .flat_map(|&f| best[b].0.iter().map(move |&g| vec![(a, f), (b, g)]))
                .collect();
            let of = |h: usize| hypotheses[h].features.len();
            let count = (of(a) * of(b) * prepared.noises.len() * AMPLITUDES.len()) as f64;
            let share = best[a].1 * best[b].1 * noise_share;
            let log_prior = (MODELS[2] * prior(a, b) / total / count / share).ln();
            judge(prepared, y, &noises, &parts, log_prior)
        })
        .collect()
}

/// Whether two causes are not substitutes for each other: dry charge and humid bridges share the
/// humidity but not the range.
fn may_go_together(a: &Hypothesis, b: &Hypothesis) -> bool {
    use crate::causes::catalogue::Mechanism::{Charge, Deliquescence, Humidity};
    match (&a.cause, &b.cause) {
        (Cause::Known(Charge), Cause::Known(Humidity | Deliquescence))
        | (Cause::Known(Humidity | Deliquescence), Cause::Known(Charge)) => true,
        (Cause::Known(one), Cause::Known(other))
            if one.covariates().len() != other.covariates().len() =>
        {
            true
        }
        _ => !a.cause.covariates().iter().any(|name| b.cause.covariates().contains(name)),
    }
}

/// A component with its coefficients.
struct Solved<'a> {
    prepared: &'a Prepared,
    weight: f64,
    /// Powder means and features over all runs.
    rows: DMatrix<f64>,
    /// Columns of each part's features.
    columns: Vec<(usize, std::ops::Range<usize>)>,
    means: usize,
    coefficients: DVector<f64>,
    precision: Cholesky<f64, nalgebra::Dyn>,
    /// s^2.
    variance: f64,
    freedom: f64,
    day: f64,
}

impl<'a> Solved<'a> {
    fn new(prepared: &'a Prepared, component: &Component, weight: f64) -> Option<Self> {
        let noise = &prepared.noises[component.noise];
        let features = join(prepared, &component.parts);
        let fixed = &prepared.means;
        let means = fixed.ncols();
        let rows = DMatrix::from_columns(
            &fixed
                .column_iter()
                .chain(features.column_iter())
                .map(|c| c.into_owned())
                .collect::<Vec<_>>(),
        );
        let mut columns = Vec::new();
        let mut first = means;
        for &(h, f) in &component.parts {
            let width = prepared.hypotheses[h].features[f].ncols();
            columns.push((h, first..first + width));
            first += width;
        }
        let measured = rows.select_rows(&prepared.measured);
        let y = DVector::from_column_slice(&prepared.observed);
        let solved = noise.factor.solve(&measured);
        let mut precision = measured.tr_mul(&solved);
        (means..precision.nrows())
            .for_each(|k| precision[(k, k)] += 1.0 / (component.amplitude * component.amplitude));
        let precision = Cholesky::new(precision)?;
        let seen = solved.tr_mul(&y);
        let coefficients = precision.solve(&seen);
        let freedom = noise.model.freedom();
        let variance = (y.dot(&noise.factor.solve(&y)) - coefficients.dot(&seen)) / freedom;
        let day = noise.day + noise.day_powder;
        Some(Self {
            prepared,
            weight,
            rows,
            columns,
            means,
            coefficients,
            precision,
            variance,
            freedom,
            day,
        })
    }

    /// The prediction for a run.
    fn row(&self, row: usize) -> Student {
        let at = self.rows.row(row).transpose();
        let spread =
            at.dot(&self.precision.solve(&at)) + self.prepared.weights[row].powi(2) + self.day;
        self.student(at.dot(&self.coefficients), spread)
    }

    /// The contribution of the features to a run.
    fn shift(&self, row: usize) -> f64 {
        (self.means..self.rows.ncols()).map(|k| self.rows[(row, k)] * self.coefficients[k]).sum()
    }

    /// The contribution of one hypothesis' features from one run to another, averaged over pairs.
    fn contrast(&self, hypothesis: usize, pairs: &[(usize, usize)]) -> Student {
        let mut at = DVector::zeros(self.rows.ncols());
        for (_, columns) in self.columns.iter().filter(|(h, _)| *h == hypothesis) {
            for k in columns.clone() {
                at[k] = pairs
                    .iter()
                    .map(|&(low, high)| self.rows[(high, k)] - self.rows[(low, k)])
                    .sum::<f64>()
                    / pairs.len() as f64;
            }
        }
        self.student(at.dot(&self.coefficients), at.dot(&self.precision.solve(&at)))
    }

    fn student(&self, location: f64, spread: f64) -> Student {
        Student {
            weight: self.weight,
            location,
            scale: (self.variance * spread).sqrt(),
            freedom: self.freedom,
        }
    }
}

impl Mixture {
    /// Mean and SD.
    pub fn moments(&self) -> (f64, f64) {
        let mean: f64 = self.0.iter().map(|student| student.weight * student.location).sum();
        let second = |student: &Student| {
            let spread = student.scale.powi(2) * student.freedom / (student.freedom - 2.0).max(0.5);
            student.weight * (spread + (student.location - mean).powi(2))
        };
        (mean, self.0.iter().map(second).sum::<f64>().sqrt())
    }

    /// Probability of a smaller value.
    pub fn below(&self, value: f64) -> f64 {
        let of = |student: &Student| match student.scale > 0.0 {
            true => StudentsT::new(student.location, student.scale, student.freedom)
                .map_or(0.5, |t| t.cdf(value)),
            false => f64::from(u8::from(value >= student.location)),
        };
        self.0.iter().map(|student| student.weight * of(student)).sum()
    }

    /// The equal-tailed interval that holds this probability.
    pub fn interval(&self, level: f64) -> [f64; 2] {
        let (mean, sd) = self.moments();
        [(1.0 - level) / 2.0, f64::midpoint(1.0, level)].map(|probability| {
            let (mut low, mut high) = (mean - 50.0 * sd - 1e-9, mean + 50.0 * sd + 1e-9);
            for _ in 0..80 {
                let middle = f64::midpoint(low, high);
                if self.below(middle) < probability { low = middle } else { high = middle }
            }
            f64::midpoint(low, high)
        })
    }
}

#[cfg(test)]
mod tests;
