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
use super::evidence::{AMPLITUDES, Fit, Signature, Whitening};
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

/// Results under one noise: for the noise itself, for each cause, and the fits of each cause to the
/// measured readings.
struct Seen {
    null: Vec<f64>,
    causes: Vec<Vec<f64>>,
    fits: Vec<Vec<FormFit>>,
    /// Of the measured readings.
    squares: f64,
    freedom: f64,
}

/// A form and its fit at one amplitude.
#[derive(Clone, Copy)]
struct FormFit {
    fit: Fit,
    scale: f64,
    shape: Option<f64>,
    span: f64,
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
    let through = noise.model.apply(observations);
    let squares: Vec<f64> =
        through.column_iter().map(|column| column.norm_squared() + noise.floor).collect();
    let null: Vec<f64> = squares.iter().map(|&squares| noise.model.log_null(squares)).collect();
    let whitened = Whitened { noise: &noise.model, through, squares, null };
    let (causes, fits) = hypotheses.iter().map(|hypothesis| whitened.judge(hypothesis)).unzip();
    let Whitened { squares, null, .. } = whitened;
    Seen { null, causes, fits, squares: squares[0], freedom: noise.model.freedom }
}

/// Observations passed through one noise.
struct Whitened<'a> {
    noise: &'a Whitening,
    through: DMatrix<f64>,
    /// Of each observation.
    squares: Vec<f64>,
    null: Vec<f64>,
}

impl Whitened<'_> {
    /// Log evidence of a cause in each observation, averaged over its forms, over how much groups
    /// differ in it, and over amplitudes; and all fits to the first observation.
    fn judge(&self, hypothesis: &Hypothesis) -> (Vec<f64>, Vec<FormFit>) {
        let sign = hypothesis.mechanism.sign();
        let mut logs: Vec<Vec<f64>> = vec![Vec::new(); self.squares.len()];
        let mut fits = Vec::new();
        for (form, signature) in self.signatures(hypothesis) {
            let Some(signature) = signature else {
                // What the fixed part explains is as likely as noise, at every amplitude.
                let unseen =
                    |(logs, null): (&mut Vec<f64>, &f64)| logs.extend([*null; AMPLITUDES.len()]);
                logs.iter_mut().zip(&self.null).for_each(unseen);
                continue;
            };
            let fit = |k: usize, amplitude: f64| {
                self.noise.fit(&signature, k, self.squares[k], amplitude, sign)
            };
            for (k, logs) in logs.iter_mut().enumerate() {
                logs.extend(AMPLITUDES.map(|amplitude| fit(k, amplitude).log_evidence));
            }
            let Form { scale, shape, span, .. } = *form;
            fits.extend(AMPLITUDES.map(|amplitude| FormFit {
                fit: fit(0, amplitude),
                scale,
                shape,
                span,
            }));
        }
        (logs.iter().map(|logs| log_mean_exp(logs)).collect(), fits)
    }

    /// The signature of each form, for every amount by which groups may differ in it; `None` where
    /// the fixed part explains it.
    fn signatures<'h>(
        &self,
        hypothesis: &'h Hypothesis,
    ) -> impl Iterator<Item = (&'h Form, Option<Signature>)> {
        hypothesis.forms.iter().flat_map(|form| {
            let course = self.noise.course(&form.course, &hypothesis.group, &self.through);
            hypothesis.differ.iter().map(move |&differ| (form, course.signature(differ)))
        })
    }
}

/// The estimate of a cause from its fits under every noise.
///
/// ```text
/// size        mixture over fits of N(c, sd^2), each by its evidence and the prior of its noise
/// E_p, E_w    mean evidence of the cause over plain and over wandering noises
/// P           E_p / (E_p + E_w): the probability that nothing wanders alongside
/// g           log(E_p / E_0) / log(((E_p + E_w) / 2) / E_0): share of the log evidence gained without a wander
/// q           squares the best plain fit explains / squares beyond those of white noise
/// explained   P + (1 - P) max(g, q)
/// ```
///
/// Where nothing wanders the cause explains all structure there is; where something does, it
/// explains what it gains alone. q rescues a cause that explains nearly every square of very many:
/// there any smallest rest is evidence for a wander.
fn estimate(noises: &[Noise], seen: &[Seen], h: usize, white: Option<f64>) -> Estimate {
    let kinds = Kinds::of(noises);
    let plain_null: Vec<f64> =
        noises.iter().zip(seen).filter(|it| !it.0.is_wander).map(|it| it.1.null[0]).collect();
    let (mut parts, mut is_plain) = (Vec::new(), Vec::new());
    let mut best: Option<Best> = None;
    for (noise, seen) in noises.iter().zip(seen) {
        for fit in &seen.fits[h] {
            let part = Part::of(fit, kinds.log_prior(noise.is_wander));
            if !noise.is_wander && best.as_ref().is_none_or(|best| part.weight > best.log_weight) {
                best = Some(Best { log_weight: part.weight, left: fit.fit.left, seen });
            }
            parts.push(part);
            is_plain.push(!noise.is_wander);
        }
    }
    let mean_evidence = |which: bool| {
        let kept = parts.iter().zip(&is_plain).filter(|it| *it.1 == which);
        let logs: Vec<f64> = kept.map(|it| it.0.weight).collect();
        let fits_of_noise = logs.len() as f64 / kinds.count(!which) as f64;
        log_mean_exp(&logs) + (logs.len() as f64).ln() - fits_of_noise.ln()
    };
    let alone = mean_evidence(true);
    let both = log_mean_exp(&[alone, mean_evidence(false)]);
    let alone_probability = (alone - 2f64.ln() - both).exp().min(1.0);
    let null = log_mean_exp(&plain_null);
    let gain = ((alone - null) / (both - null).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    let squares = best.as_ref().map_or(0.0, |best| best.share_beyond(white));
    let explained = alone_probability + (1.0 - alone_probability) * gain.max(squares);
    let left = best.as_ref().map_or(1.0, Best::share_left);
    let heaviest = parts.iter().map(|part| part.weight).fold(f64::NEG_INFINITY, f64::max);
    parts.iter_mut().for_each(|part| part.weight = (part.weight - heaviest).exp());
    Estimate { parts, explained, left }
}

/// How many noises are plain, and how many wander.
struct Kinds([usize; 2]);

impl Kinds {
    fn of(noises: &[Noise]) -> Self {
        let count = |which| noises.iter().filter(|noise| noise.is_wander == which).count().max(1);
        Self([false, true].map(count))
    }

    fn count(&self, is_wander: bool) -> usize {
        self.0[usize::from(is_wander)]
    }

    /// Either kind is as probable, and so are the noises of one.
    fn log_prior(&self, is_wander: bool) -> f64 {
        -(self.count(is_wander) as f64).ln()
    }
}

/// The most probable fit under plain noise.
struct Best<'a> {
    log_weight: f64,
    /// Squares that the fit leaves.
    left: f64,
    seen: &'a Seen,
}

impl Best<'_> {
    /// Share of the squares beyond those of white noise that the fit explains; nothing if the
    /// variance of white noise is not known.
    fn share_beyond(&self, white: Option<f64>) -> f64 {
        let Seen { squares, freedom, .. } = *self.seen;
        let beyond = white.map_or(f64::INFINITY, |white| squares - white * freedom);
        if beyond > 0.0 { ((squares - self.left) / beyond).min(1.0) } else { 0.0 }
    }

    fn share_left(&self) -> f64 {
        let squares = self.seen.squares;
        if squares > 0.0 { (self.left / squares).clamp(0.0, 1.0) } else { 1.0 }
    }
}

impl Part {
    /// The size by one fit; its weight is a logarithm until all are known.
    fn of(&FormFit { fit, scale, shape, span }: &FormFit, log_prior: f64) -> Self {
        let (size, sd) = (fit.first * scale, fit.first_sd * scale);
        Self { weight: fit.log_evidence + log_prior, size, sd, shape, span }
    }
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

#[cfg(test)]
mod tests;
