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

use super::noise;
use super::posterior::Posterior;
use super::prepared::Prepared;
use crate::causes::hypothesis::{Cause, Hypothesis, Untestable};
use crate::causes::response::Responses;
use crate::data::campaign::Campaign;
use flip_core::domain::FieldError;
use flip_core::stats::mixed_model::log_mean_exp;
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

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

/// `explained`: the estimated contribution of causes to each run; the scatter of the rest
/// is judged. `on_cause` receives the share of causes judged so far; `Break` stops, and there is no
/// screening.
pub(crate) fn screen_prepared(
    prepared: &Prepared,
    campaign: &Campaign,
    explained: &[f64],
    settings: &Settings,
    on_cause: impl FnMut(f64) -> ControlFlow<()>,
) -> Option<Screening> {
    screen_among(prepared, &nulls(prepared, campaign, explained, settings), on_cause)
}

/// Campaigns of the same design in which nothing is wrong, one a column: with noise drawn from what
/// is known of it, and the residuals after the causes with signs redrawn.
fn nulls(
    prepared: &Prepared,
    campaign: &Campaign,
    explained: &[f64],
    settings: &Settings,
) -> [DMatrix<f64>; 2] {
    let Settings { seed, simulations } = *settings;
    let Prepared { weights, noises, observed, measured, .. } = prepared;
    let drawn = noise::with_simulated(campaign, weights, noises, observed, seed, simulations);
    let left: Vec<f64> =
        measured.iter().zip(observed).map(|(&i, angle)| angle - explained[i]).collect();
    let redrawn = noise::with_signs_redrawn(campaign, &left, seed, simulations);
    [drawn.columns_range(1..).into_owned(), redrawn]
}

/// `nulls`: groups of campaigns of the same design in which nothing is wrong, one a column; the
/// largest p-value counts, and the first group is reported.
pub(crate) fn screen_among(
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::sample;

    #[test]
    fn the_larger_p_value_of_both_nulls_counts() {
        const SETTINGS: Settings = Settings { seed: 1, simulations: 99 };
        let go_on = |_: f64| ControlFlow::Continue(());
        let mut strict = [0, 0];
        for seed in 0..6 {
            // Humid days scatter more, which only the residuals of this campaign know.
            let campaign = sample::campaign(seed, |at| {
                (at.supply * 7919.0).sin() * (at.humidity / 20.0).powi(2)
            });
            let prepared = Prepared::new(&campaign, &Responses::new()).unwrap();
            let explained = vec![0.0; campaign.runs.len()];
            let both = screen_prepared(&prepared, &campaign, &explained, &SETTINGS, go_on).unwrap();
            let [drawn, redrawn] = nulls(&prepared, &campaign, &explained, &SETTINGS);
            let alone = [drawn, redrawn]
                .map(|null| screen_among(&prepared, &[null], go_on).unwrap().p_value);
            assert_eq!(both.p_value, alone[0].max(alone[1]));
            (0..2).for_each(|k| strict[k] += usize::from(alone[k] > alone[1 - k]));
        }
        // Each is the larger one somewhere, so that neither can be left out.
        assert!(strict.iter().all(|&count| count > 0), "{strict:?}");
    }
}
