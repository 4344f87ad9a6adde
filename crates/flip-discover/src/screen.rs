//! Decides whether anything is wrong, and what explains it best.
//!
//! ```text
//! log odds of a cause  =  log mean over noises, forms, deviations, amplitudes of p(y | cause)  -  log mean over noises of p(y | none)
//! T = largest over causes of (log odds + log prior)          p = share of simulated campaigns, this one among them, with T as large
//! ```
//!
//! The simulated campaigns have the design of this one (its powders, days, gaps and all), noise
//! drawn from what is known of it, and nothing wrong; the whole search is repeated on each, which
//! accounts for the many causes and their many forms. As many again are the residuals of this
//! campaign after its causes, with signs redrawn, because angles may scatter more in some
//! conditions than in others; the larger of the two p-values counts.
//!
//! Source: evidences as in [`flip_core::stats::mixed_model`]. The largest of many statistics under its
//! own null is the usual correction for multiple comparisons; with repeats in days only days are
//! exchangeable, and there are too few to permute, so the null is simulated.

use super::campaign::Campaign;
use super::hypothesis::{Cause, Hypothesis, Responses, Untestable, hypotheses};
use super::noise::{self, Noise};
use super::posterior::Posterior;
use flip_core::domain::FieldError;
use flip_core::stats::mixed_model::{MixedModelError, Signature, Whitening, log_mean_exp};
use nalgebra::DMatrix;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

/// Root mean square of a cause over the SD of a repeat.
pub(super) const AMPLITUDES: [f64; 4] = [0.15, 0.3, 0.6, 1.2];

/// How to screen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Seed of the simulated campaigns.
    pub seed: u64,
    /// Simulated campaigns in which nothing is wrong, 99 to 9999.
    pub simulations: u32,
}

impl Settings {
    /// Returns the settings if they are within bounds.
    ///
    /// # Errors
    /// Too few or too many simulated campaigns.
    pub fn checked(self) -> Result<Self, FieldError> {
        match (99..=9999).contains(&self.simulations) {
            true => Ok(self),
            false => {
                let message = format!("must be from 99 to 9999, got {}", self.simulations);
                Err(FieldError::new("simulations", message))
            }
        }
    }
}

/// A cause and how well it explains the campaign.
#[derive(Debug, Clone, PartialEq)]
pub struct Judged {
    /// The cause.
    pub cause: Cause,
    /// Log of the evidence over that of noise alone.
    pub log_evidence: f64,
    /// Probability among all judged causes, if one of them is at work alone.
    pub probability: f64,
}

/// The outcome of [`screen`].
#[derive(Debug, Clone, PartialEq)]
pub struct Screening {
    /// Chance of evidence as strong for any cause if nothing is wrong.
    pub p_value: f64,
    /// Most probable first.
    pub judged: Vec<Judged>,
    /// In the catalogue's order.
    pub untestable: Vec<Untestable>,
    /// T.
    pub statistic: f64,
    /// T in each simulated campaign, ascending.
    pub null: Vec<f64>,
}

/// A campaign with everything needed to judge it.
pub(super) struct Prepared {
    pub powder: Vec<usize>,
    /// Runs that have an angle.
    pub measured: Vec<usize>,
    /// SD of each run's own noise over the root mean square of the measured ones.
    pub weights: Vec<f64>,
    /// Median of each powder, degrees.
    pub centres: Vec<f64>,
    /// Measured angles less their powder's centre, outliers clamped.
    pub observed: Vec<f64>,
    /// Columns of the powders' means over all runs.
    pub means: DMatrix<f64>,
    pub noises: Vec<Noise>,
    pub hypotheses: Vec<Hypothesis>,
    pub untestable: Vec<Untestable>,
}

impl Prepared {
    pub fn new(campaign: &Campaign, responses: &Responses) -> Result<Self, FieldError> {
        let weights = noise::weights(campaign);
        let refused = |error: MixedModelError| FieldError::new("measurements", error.to_string());
        let noises = noise::noises(campaign, &weights).map_err(refused)?;
        let (observed, centres) = noise::drawn_in(campaign);
        let (hypotheses, untestable) = hypotheses(campaign, responses);
        let (powder, measured) = (campaign.powder_of(), campaign.measured());
        let means = noise::powder_means(campaign);
        Ok(Self {
            powder,
            measured,
            weights,
            centres,
            observed,
            means,
            noises,
            hypotheses,
            untestable,
        })
    }

    /// SD of a repeat, degrees: root mean square over runs, with the noise that explains these
    /// angles best.
    pub fn repeat_sd_deg(&self, angles: &[f64]) -> f64 {
        let y = DMatrix::from_column_slice(angles.len(), 1, angles);
        let of = |noise: &Noise| {
            let squares = noise.model.squares(&y)[0];
            (noise.model.log_null(squares), (squares / noise.model.freedom()).sqrt())
        };
        self.noises.iter().map(of).max_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |best| best.1)
    }

    /// Features of a hypothesis, whitened by a noise.
    pub fn signatures(&self, noise: &Whitening, hypothesis: &Hypothesis) -> Vec<Option<Signature>> {
        let of = |features: &DMatrix<f64>| noise.signature(&features.select_rows(&self.measured));
        hypothesis.features.iter().map(of).collect()
    }

    /// Campaigns, one a column, whitened by each noise.
    pub fn seen<'a>(&self, all: &'a DMatrix<f64>) -> Seen<'a> {
        let squares: Vec<Vec<f64>> =
            self.noises.par_iter().map(|noise| noise.model.squares(all)).collect();
        let log_null = |k: usize| {
            let each = self
                .noises
                .iter()
                .zip(&squares)
                .map(|(noise, squares)| noise.model.log_null(squares[k]));
            log_mean_exp(&each.collect::<Vec<f64>>())
        };
        let log_null = (0..all.ncols()).map(log_null).collect();
        Seen { all, squares, log_null }
    }

    /// Log odds of a hypothesis over noise alone in each campaign.
    pub fn log_odds(&self, hypothesis: &Hypothesis, seen: &Seen<'_>) -> Vec<f64> {
        let of_noise = |(noise, squares): (&Noise, &Vec<f64>)| {
            self.evidence(&noise.model, hypothesis, seen.all, squares)
        };
        let judged: Vec<Vec<f64>> =
            self.noises.par_iter().zip(&seen.squares).map(of_noise).collect();
        let over_noises =
            |k: usize| log_mean_exp(&judged.iter().map(|of| of[k]).collect::<Vec<f64>>());
        (0..seen.all.ncols()).map(|k| over_noises(k) - seen.log_null[k]).collect()
    }

    /// Log evidence of a hypothesis under one noise in each campaign.
    fn evidence(
        &self,
        noise: &Whitening,
        hypothesis: &Hypothesis,
        all: &DMatrix<f64>,
        squares: &[f64],
    ) -> Vec<f64> {
        let signatures: Vec<Signature> =
            self.signatures(noise, hypothesis).into_iter().flatten().collect();
        let seen: Vec<DMatrix<f64>> =
            signatures.iter().map(|signature| signature.seen(all)).collect();
        let signs = hypothesis.signs(0);
        let of_column = |k: usize| {
            let each = signatures.iter().zip(&seen).flat_map(|(signature, seen)| {
                AMPLITUDES.map(|amplitude| {
                    noise.log_evidence(signature, seen.column(k), squares[k], amplitude, &signs)
                })
            });
            log_mean_exp(&each.collect::<Vec<f64>>())
        };
        (0..all.ncols()).map(of_column).collect()
    }
}

/// Campaigns whitened by each noise.
pub(super) struct Seen<'a> {
    /// One a column.
    all: &'a DMatrix<f64>,
    /// `y*^T y*` under each noise.
    squares: Vec<Vec<f64>>,
    /// Log evidence of noise alone.
    log_null: Vec<f64>,
}

/// Judges every cause of the catalogue, and every covariate without a cause, on a campaign.
///
/// # Errors
/// A setting out of bounds; a campaign whose runs carry no information about their noise.
pub fn screen(
    campaign: &Campaign,
    responses: &Responses,
    settings: &Settings,
) -> Result<Screening, FieldError> {
    let settings = settings.checked()?;
    let prepared = Prepared::new(campaign, responses)?;
    let never = |_: f64| ControlFlow::Continue(());
    let explained = Posterior::new(&prepared).shifts();
    screen_prepared(&prepared, campaign, &explained, &settings, never)
        .ok_or_else(|| FieldError::new("measurements", "stopped"))
}

/// `explained`: the estimated contribution of causes to each run, degrees; the scatter of the rest
/// is judged. `on_cause` receives the share of causes judged so far; `Break` stops, and there is no
/// screening.
pub(super) fn screen_prepared(
    prepared: &Prepared,
    campaign: &Campaign,
    explained: &[f64],
    settings: &Settings,
    on_cause: impl FnMut(f64) -> ControlFlow<()>,
) -> Option<Screening> {
    let Prepared { weights, noises, observed, .. } = prepared;
    let simulated = noise::with_simulated(
        campaign,
        weights,
        noises,
        observed,
        settings.seed,
        settings.simulations,
    );
    let left: Vec<f64> =
        prepared.measured.iter().zip(observed).map(|(&i, angle)| angle - explained[i]).collect();
    let redrawn = noise::with_signs_redrawn(campaign, &left, settings.seed, settings.simulations);
    screen_among(prepared, &[simulated.columns_range(1..).into_owned(), redrawn], on_cause)
}

/// `nulls`: groups of campaigns of the same design in which nothing is wrong, one a column; the
/// largest p-value counts, and the first group is reported.
pub(super) fn screen_among(
    prepared: &Prepared,
    nulls: &[DMatrix<f64>],
    mut on_cause: impl FnMut(f64) -> ControlFlow<()>,
) -> Option<Screening> {
    let Prepared { observed, hypotheses, .. } = prepared;
    let mut columns = observed.clone();
    nulls.iter().for_each(|null| columns.extend_from_slice(null.as_slice()));
    let all = DMatrix::from_vec(observed.len(), columns.len() / observed.len(), columns);
    let seen = prepared.seen(&all);
    let mut log_odds = Vec::new();
    for (k, hypothesis) in hypotheses.iter().enumerate() {
        if on_cause(k as f64 / hypotheses.len() as f64).is_break() {
            return None;
        }
        log_odds.push(prepared.log_odds(hypothesis, &seen));
    }
    let scores =
        |k: usize| hypotheses.iter().zip(&log_odds).map(move |(it, of)| of[k] + it.prior.ln());
    let largest = |k: usize| scores(k).fold(f64::NEG_INFINITY, f64::max);
    let p_in = |null: &[f64]| {
        (1 + null.iter().filter(|&&score| score >= largest(0)).count()) as f64
            / (1 + null.len()) as f64
    };
    let mut next = 1;
    let mut group = |of: &DMatrix<f64>| -> Vec<f64> {
        next += of.ncols();
        (next - of.ncols()..next).map(largest).collect()
    };
    let groups: Vec<Vec<f64>> = nulls.iter().map(&mut group).collect();
    let p_value = groups.iter().map(|null| p_in(null)).fold(0.0, f64::max);
    let mut null = groups.into_iter().next().unwrap_or_default();
    null.sort_by(f64::total_cmp);
    let total = log_mean_exp(&scores(0).collect::<Vec<_>>()) + (hypotheses.len() as f64).ln();
    let judge = |(it, score): (&Hypothesis, f64)| Judged {
        cause: it.cause.clone(),
        log_evidence: score - it.prior.ln(),
        probability: (score - total).exp(),
    };
    let mut judged: Vec<Judged> = hypotheses.iter().zip(scores(0)).map(judge).collect();
    judged.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    let untestable = prepared.untestable.clone();
    Some(Screening { p_value, judged, untestable, statistic: largest(0), null })
}
