//! Judges one level: the evidence of each cause, of a wander that no cause explains, and of noise
//! alone.
//!
//! ```text
//! E_0 = mean over plain noises of the evidence of noise alone
//! E_U = mean over wandering noises of the same
//! E_h = 1/2 mean over plain noises, forms and amplitudes of the evidence of cause h
//!     + 1/2 mean over wandering noises, forms and amplitudes of it
//! ```
//!
//! A cause keeps its name if a small wander remains, since its true form is none of ours; the
//! caller decides how much may remain.

use super::catalogue::TraceMechanism;
use super::evidence::{AMPLITUDES, Fit, Whitening};
use flip_core::stats::mixed_model::log_mean_exp;
use nalgebra::DMatrix;
use rayon::prelude::*;

/// A noise model.
pub(super) struct Noise {
    pub model: Whitening,
    /// Whether it includes a wander.
    pub is_wander: bool,
    /// Lower bound on the sum of squares of any set of readings: the part hidden by the display's
    /// steps.
    pub floor: f64,
}

/// A form of a cause.
pub(super) struct Form {
    /// `[n]`, mean square 1 as whitened by plain noise.
    pub course: Vec<f64>,
    /// Size of the effect over the coefficient of the course.
    pub scale: f64,
    /// Value of its shape parameter.
    pub shape: Option<f64>,
    /// Change due to an effect of size 1 from the lowest to the highest tenth of the covariate it
    /// goes with.
    pub span: f64,
}

/// A cause and its forms.
pub(super) struct Hypothesis {
    pub mechanism: TraceMechanism,
    pub forms: Vec<Form>,
    /// Group of each row, of those that may differ in the cause.
    pub group: Vec<usize>,
    /// How much they may differ relative to their common part; one entry is `None`.
    pub differ: Vec<Option<f64>>,
}

/// The full estimate of a cause's size and shape from the measured readings.
#[derive(Debug, Clone, Default)]
pub(super) struct Estimate {
    /// One for each form, noise and amplitude.
    parts: Vec<Part>,
    /// Share of the structure beyond noise that the cause explains: all of it, with the probability
    /// that nothing else wanders; otherwise the share of the log evidence or of the squares that it
    /// gains alone, whichever is more.
    pub explained: f64,
    /// Share of the squares that its best form leaves, with the most probable plain noise.
    pub left: f64,
}

/// The estimate of one form under one noise and amplitude.
#[derive(Debug, Clone, Copy)]
struct Part {
    weight: f64,
    /// Mean and SD of the size.
    size: f64,
    sd: f64,
    shape: Option<f64>,
    span: f64,
}

/// A judged level.
pub(super) struct Verdict {
    /// For each cause, `[hypothesis][readings]`, log of the evidence over that of plain noise; the
    /// first readings are the measured ones.
    pub causes: Vec<(TraceMechanism, Vec<f64>)>,
    /// The same for a wander.
    pub wander: Vec<f64>,
    pub estimates: Vec<Estimate>,
    /// Odds of the plain noises in the measured readings.
    pub plain: Vec<f64>,
}

impl Form {
    /// A raw signature scaled to size 1; `None` if the fixed part explains it.
    pub fn new(raw: &[f64], shape: Option<f64>, span: f64, plain: &Whitening) -> Option<Self> {
        let column = DMatrix::from_column_slice(raw.len(), 1, raw);
        let size = (plain.apply(&column).norm_squared() / plain.freedom).sqrt();
        let is_seen = size > 1e-9 * column.norm();
        is_seen.then(|| Self {
            course: raw.iter().map(|x| x / size).collect(),
            scale: 1.0 / size,
            shape,
            span,
        })
    }
}

/// Scale, shape and span of a form.
#[derive(Debug, Clone, Copy)]
struct Sized {
    scale: f64,
    shape: Option<f64>,
    span: f64,
}

/// Results under one noise: for the noise itself, for each cause, and for the sizes in the measured
/// readings.
struct Seen {
    null: Vec<f64>,
    causes: Vec<Vec<f64>>,
    sizes: Vec<Vec<(Fit, Sized)>>,
    squares: f64,
    freedom: f64,
}

/// Judges observations `[n, 1 + simulated]` on all causes of this level. `white` is the variance of
/// noise alone, if known beforehand.
pub(super) fn judge(
    noises: &[Noise],
    hypotheses: &[Hypothesis],
    observations: &DMatrix<f64>,
    white: Option<f64>,
) -> Verdict {
    let seen: Vec<Seen> =
        noises.par_iter().map(|noise| see(noise, hypotheses, observations)).collect();
    let over = |is_wander: bool, of: &dyn Fn(&Seen) -> f64| {
        let kept = noises.iter().zip(&seen).filter(|(noise, _)| noise.is_wander == is_wander);
        log_mean_exp(&kept.map(|(_, seen)| of(seen)).collect::<Vec<f64>>())
    };
    let count = observations.ncols();
    let null: Vec<f64> = (0..count).map(|k| over(false, &|seen| seen.null[k])).collect();
    let wander = (0..count).map(|k| over(true, &|seen| seen.null[k]) - null[k]).collect();
    let cause = |h: usize| {
        let of = |k: usize| {
            log_mean_exp(&[false, true].map(|which| over(which, &|seen| seen.causes[h][k])))
                - null[k]
        };
        (hypotheses[h].mechanism, (0..count).map(of).collect())
    };
    let best = seen.iter().zip(noises).filter(|(_, noise)| !noise.is_wander);
    let most = best.clone().map(|(seen, _)| seen.null[0]).fold(f64::NEG_INFINITY, f64::max);
    let plain = best.map(|(seen, _)| (seen.null[0] - most).exp()).collect();
    let estimates = (0..hypotheses.len()).map(|h| estimate(noises, &seen, h, white)).collect();
    Verdict { causes: (0..hypotheses.len()).map(cause).collect(), wander, estimates, plain }
}

fn see(noise: &Noise, hypotheses: &[Hypothesis], observations: &DMatrix<f64>) -> Seen {
    let floor = noise.floor;
    let noise = &noise.model;
    let through = noise.apply(observations);
    let squares: Vec<f64> =
        through.column_iter().map(|column| column.norm_squared() + floor).collect();
    let null: Vec<f64> = squares.iter().map(|&squares| noise.log_null(squares)).collect();
    let (mut causes, mut sizes) = (Vec::new(), Vec::new());
    for hypothesis in hypotheses {
        let sign = hypothesis.mechanism.sign();
        let mut of_forms: Vec<Vec<f64>> = vec![Vec::new(); squares.len()];
        let mut of_sizes = Vec::new();
        for form in &hypothesis.forms {
            let course = noise.course(&form.course, &hypothesis.group, &through);
            for &differ in &hypothesis.differ {
                let signature = course.signature(differ);
                for amplitude in AMPLITUDES {
                    for (k, logs) in of_forms.iter_mut().enumerate() {
                        let Some(signature) = &signature else {
                            logs.push(null[k]);
                            continue;
                        };
                        let fit = noise.fit(signature, k, squares[k], amplitude, sign);
                        logs.push(fit.log_evidence);
                        if k == 0 {
                            of_sizes.push((
                                fit,
                                Sized { scale: form.scale, shape: form.shape, span: form.span },
                            ));
                        }
                    }
                }
            }
        }
        causes.push(of_forms.iter().map(|logs| log_mean_exp(logs)).collect());
        sizes.push(of_sizes);
    }
    Seen { null, causes, sizes, squares: squares[0], freedom: noise.freedom }
}

fn estimate(noises: &[Noise], seen: &[Seen], h: usize, white: Option<f64>) -> Estimate {
    let counts = [false, true]
        .map(|which| noises.iter().filter(|noise| noise.is_wander == which).count().max(1));
    let mut new = Estimate::default();
    // With the most probable plain noise: its log weight, the part of the squares that the cause
    // explains, and the part beyond noise.
    let (mut plain, mut is_plain) = ((f64::NEG_INFINITY, 0.0, 0.0), Vec::new());
    new.left = 1.0;
    for (noise, seen) in noises.iter().zip(seen) {
        let log_prior = -(counts[usize::from(noise.is_wander)] as f64).ln();
        for &(fit, Sized { scale, shape, span }) in &seen.sizes[h] {
            let log_weight = fit.log_evidence + log_prior;
            let (size, sd) = (fit.first * scale, fit.first_sd * scale);
            new.parts.push(Part { weight: log_weight, size, sd, shape, span });
            is_plain.push(!noise.is_wander);
            if !noise.is_wander && log_weight > plain.0 {
                let more = white.map_or(f64::INFINITY, |white| seen.squares - white * seen.freedom);
                plain = (log_weight, seen.squares - fit.left, more);
                new.left = if seen.squares > 0.0 {
                    (fit.left / seen.squares).clamp(0.0, 1.0)
                } else {
                    1.0
                };
            }
        }
    }
    let null: Vec<f64> =
        noises.iter().zip(seen).filter(|it| !it.0.is_wander).map(|it| it.1.null[0]).collect();
    let of = |which: bool| {
        let kept: Vec<f64> = (0..is_plain.len())
            .filter(|&k| is_plain[k] == which)
            .map(|k| new.parts[k].weight)
            .collect();
        let sizes = kept.len() as f64 / counts[usize::from(!which)] as f64;
        log_mean_exp(&kept) + (kept.len() as f64).ln() - sizes.ln()
    };
    let (alone, both) = (of(true), log_mean_exp(&[of(true), of(false)]));
    let alone_probability = (alone - 2f64.ln() - both).exp().min(1.0);
    let gain = ((alone - log_mean_exp(&null))
        / (both - log_mean_exp(&null)).max(f64::MIN_POSITIVE))
    .clamp(0.0, 1.0);
    let squares = if plain.2 > 0.0 { (plain.1 / plain.2).min(1.0) } else { 0.0 };
    new.explained = alone_probability + (1.0 - alone_probability) * gain.max(squares);
    let best = new.parts.iter().map(|part| part.weight).fold(f64::NEG_INFINITY, f64::max);
    new.parts.iter_mut().for_each(|part| part.weight = (part.weight - best).exp());
    new
}

impl Estimate {
    /// Mean and 95 % limits of the size, from a normal distribution with the mixture's mean and
    /// variance.
    pub fn size(&self) -> [f64; 3] {
        self.mixture(|_| 1.0)
    }

    /// The same for the change over the span.
    pub fn effect(&self) -> [f64; 3] {
        self.mixture(|part| part.span)
    }

    fn mixture(&self, scale: impl Fn(&Part) -> f64) -> [f64; 3] {
        let (mut total, mut mean, mut square) = (0.0, 0.0, 0.0);
        for part in &self.parts {
            let (value, sd) = (part.size * scale(part), part.sd * scale(part));
            total += part.weight;
            mean += part.weight * value;
            square += part.weight * (value * value + sd * sd);
        }
        let mean = mean / total;
        let sd = (square / total - mean * mean).max(0.0).sqrt();
        [mean, mean - 1.96 * sd, mean + 1.96 * sd]
    }

    /// Weighted median of the shape and the limits that leave out 2.5 % on each side, each widened
    /// by half a grid step; `None` if no probable form has one.
    pub fn shape(&self) -> Option<[f64; 3]> {
        let mut all: Vec<(f64, f64)> = self
            .parts
            .iter()
            .filter_map(|part| part.shape.map(|shape| (shape, part.weight)))
            .collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        let total: f64 = all.iter().map(|(_, weight)| weight).sum();
        let of_all: f64 = self.parts.iter().map(|part| part.weight).sum();
        if total < 0.5 * of_all {
            return None;
        }
        let at = |share: f64| {
            let mut below = 0.0;
            let found = all.iter().find(|(_, weight)| {
                below += weight;
                below >= share * total
            });
            found.map_or(f64::NAN, |(shape, _)| *shape)
        };
        let (low, middle, high) = (at(0.025), at(0.5), at(0.975));
        let below =
            all.iter().rev().find(|(shape, _)| *shape < low).map_or(low / 2.0, |(shape, _)| *shape);
        let above =
            all.iter().find(|(shape, _)| *shape > high).map_or(high * 2.0, |(shape, _)| *shape);
        Some([middle, (low * below).sqrt(), (high * above).sqrt()])
    }
}
