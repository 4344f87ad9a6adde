//! A campaign with everything that judging it takes: its noise models and its hypotheses, and the
//! evidence of each.

use super::noise::{self, Noise};
use crate::causes::hypothesis::{Hypothesis, Untestable, hypotheses};
use crate::causes::response::Responses;
use crate::data::campaign::Campaign;
use flip_core::domain::FieldError;
use flip_core::stats::mixed_model::{MixedModelError, Signature, Whitening, log_mean_exp};
use nalgebra::DMatrix;
use rayon::prelude::*;

/// Root mean square of a cause over the SD of a repeat.
pub(crate) const AMPLITUDES: [f64; 4] = [0.15, 0.3, 0.6, 1.2];

/// A campaign with everything needed to judge it.
pub(crate) struct Prepared {
    pub powder: Vec<usize>,
    /// Runs that have an angle.
    pub measured: Vec<usize>,
    /// SD of each run's own noise over the root mean square of the measured ones.
    pub weights: Vec<f64>,
    /// Median of each powder.
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

    /// SD of a repeat: root mean square over runs, with the noise that explains these
    /// angles best.
    pub fn repeat_sd(&self, angles: &[f64]) -> f64 {
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
pub(crate) struct Seen<'a> {
    /// One a column.
    all: &'a DMatrix<f64>,
    /// `y*^T y*` under each noise.
    squares: Vec<Vec<f64>>,
    /// Log evidence of noise alone.
    log_null: Vec<f64>,
}
