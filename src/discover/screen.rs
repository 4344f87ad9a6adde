//! Is anything wrong, and what explains it best.
//!
//! ```text
//! E_h  = mean over noise models, courses, deviations between powders and amplitudes of the evidence of cause h
//! T    = max over h of log(prior_h E_h / E_0)
//! p    = (1 + number of simulated campaigns with T at least as large) / (1 + number of simulated campaigns)
//! ```
//!
//! Simulated campaigns have this one's design, day for day and gap for gap, and nothing wrong: noise drawn from the noise models as probable as the
//! data make them. They go through the whole search, so p holds however many causes there are.
//!
//! The largest statistic of many against its own null is the usual correction for looking at many; with repeats in days, exchangeable are days,
//! of which there are too few to permute, so the null is simulated.

use super::campaign::{Campaign, Values};
use super::catalogue::{Family, Mechanism};
use super::signature::{Course, DEVIATIONS};
use crate::domain::FieldError;
use crate::domain::seed::derive;
use crate::stats::mixed_model::{Group, MixedModelError, Whitening, log_mean_exp};
use crate::stats::normal;
use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rayon::prelude::*;

/// Variance of what a day does to all powders, over that of a repeat.
const DAY_RATIOS: [f64; 5] = [0.0, 0.05, 0.2, 0.6, 1.5];
/// Variance of what a day does to one powder, over that of a repeat.
const DAY_POWDER_RATIOS: [f64; 3] = [0.0, 0.05, 0.2];
/// Root mean square of a cause over the SD of a repeat.
const AMPLITUDES: [f64; 4] = [0.15, 0.3, 0.6, 1.2];
/// Length scales of what is smooth in a covariate, shares of its range.
const SMOOTH_LENGTHS: [f64; 2] = [0.35, 0.9];
/// Robust SD from a powder's median beyond which an angle is drawn in to that distance.
const OUTLIER_SD: f64 = 3.5;
/// Degrees of freedom that the pooled SD of repeats has in a powder's own.
const POOLED_FREEDOM: f64 = 4.0;
/// Odds before any data of a smooth function of a covariate, where a catalogued mechanism has that covariate and where none has.
const UNCATALOGUED_PRIOR: [f64; 2] = [0.05, 0.3];

/// How to screen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// Of the simulated campaigns.
    pub seed: u64,
    /// Simulated campaigns in which nothing is wrong, 99 to 9999.
    pub simulations: u32,
}

/// What may explain a discrepancy.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Cause {
    /// A mechanism of the catalogue.
    Known(Mechanism),
    /// A smooth function of this covariate.
    Unknown(String),
}

/// A cause and how well it explains the campaign.
#[derive(Debug, Clone, PartialEq)]
pub struct Judged {
    /// What.
    pub cause: Cause,
    /// Log of the evidence over that of noise alone.
    pub log_evidence: f64,
    /// Probability among all causes that were judged, if one of them is at work alone.
    pub probability: f64,
}

/// A mechanism of which this campaign cannot tell, and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Untestable {
    /// Which.
    pub mechanism: Mechanism,
    /// Why, for a reader.
    pub reason: String,
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
}

impl Cause {
    /// As reports have it, and the family within which causes look alike.
    pub fn name(&self) -> (String, Option<Family>) {
        match self {
            Self::Known(mechanism) => (mechanism.name().0.to_owned(), Some(mechanism.name().1)),
            Self::Unknown(covariate) => (format!("unknown: {covariate}"), None),
        }
    }
}

/// A cause to be judged: its forms and what is known of it before any data.
struct Hypothesis {
    cause: Cause,
    courses: Vec<Course>,
    /// Which way it moves the angle, if that is known.
    sign: Option<f64>,
    prior: f64,
}

/// Judge every cause of the catalogue, and every covariate without a cause, on a campaign.
///
/// # Errors
/// A setting out of bounds; a campaign whose runs say nothing of their noise.
pub fn screen(campaign: &Campaign, settings: &Settings) -> Result<Screening, FieldError> {
    if !(99..=9999).contains(&settings.simulations) {
        let message = format!("must be from 99 to 9999, got {}", settings.simulations);
        return Err(FieldError::new("simulations", message));
    }
    let refused = |error: MixedModelError| FieldError::new("measurements", error.to_string());
    let powder = campaign.powder_of();
    let (hypotheses, untestable) = hypotheses(campaign);
    let weights = weights(campaign);
    let noises = noises(campaign, &weights).map_err(refused)?;
    let observed = drawn_in(campaign);
    if !varies(campaign) {
        return Err(FieldError::new(
            "repose_deg",
            "is the same in all runs of each powder; measure to 0.1 deg or finer",
        ));
    }
    let alone = DMatrix::from_column_slice(observed.len(), 1, &observed);
    let log_noises: Vec<f64> =
        noises.iter().map(|noise| noise.model.log_null(noise.model.squares(&alone)[0])).collect();
    let all = with_simulated(campaign, &weights, &noises, &log_noises, &observed, settings);
    let judged: Vec<Evidences> =
        noises.par_iter().map(|noise| evidences(&noise.model, &hypotheses, &powder, &all)).collect();
    let over_noises = |of: &dyn Fn(&Evidences) -> f64| log_mean_exp(&judged.iter().map(of).collect::<Vec<f64>>());
    let log_odds = |k: usize, h: usize| over_noises(&|it| it.causes[h][k]) - over_noises(&|it| it.null[k]);
    let largest = |k: usize| {
        hypotheses.iter().enumerate().map(|(h, it)| log_odds(k, h) + it.prior.ln()).fold(f64::NEG_INFINITY, f64::max)
    };
    let here = largest(0);
    let as_large = (1..all.ncols()).filter(|&k| largest(k) >= here).count();
    let total =
        log_mean_exp(&hypotheses.iter().enumerate().map(|(h, it)| log_odds(0, h) + it.prior.ln()).collect::<Vec<_>>())
            + (hypotheses.len() as f64).ln();
    let mut found: Vec<Judged> = hypotheses
        .iter()
        .enumerate()
        .map(|(h, it)| {
            let log_evidence = log_odds(0, h);
            Judged { cause: it.cause.clone(), log_evidence, probability: (log_evidence + it.prior.ln() - total).exp() }
        })
        .collect();
    found.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    let p_value = (1 + as_large) as f64 / all.ncols() as f64;
    Ok(Screening { p_value, judged: found, untestable })
}

/// What can be judged, and what cannot.
fn hypotheses(campaign: &Campaign) -> (Vec<Hypothesis>, Vec<Untestable>) {
    let (mut judged, mut untestable) = (Vec::new(), Vec::new());
    for mechanism in Mechanism::ALL {
        match mechanism.courses(campaign) {
            Ok(courses) => judged.push(Hypothesis {
                cause: Cause::Known(mechanism),
                courses,
                sign: mechanism.sign(),
                prior: mechanism.prior(),
            }),
            Err(reason) => untestable.push(Untestable { mechanism, reason }),
        }
    }
    let powder = campaign.powder_of();
    for covariate in &campaign.covariates {
        let name = &covariate.name;
        let courses: Vec<Course> = match &covariate.values {
            Values::Numbers(_) => campaign.numbers(name).map_or(Vec::new(), |values| {
                SMOOTH_LENGTHS.iter().filter_map(|&length| Course::smooth(&values, length, &powder)).collect()
            }),
            // A mechanism on levels is already one free number for each.
            Values::Levels(_) if has_mechanism(name) => Vec::new(),
            Values::Levels(_) => campaign
                .levels(name)
                .ok()
                .and_then(|(level, count)| Course::of_levels(&level, count, &powder))
                .into_iter()
                .collect(),
        };
        if !courses.is_empty() {
            let prior = UNCATALOGUED_PRIOR[usize::from(!has_mechanism(name))];
            judged.push(Hypothesis { cause: Cause::Unknown(name.clone()), courses, sign: None, prior });
        }
    }
    (judged, untestable)
}

fn has_mechanism(covariate: &str) -> bool {
    Mechanism::ALL.iter().any(|mechanism| mechanism.covariates().contains(&covariate))
}

/// SD of each run's own noise over the root mean square of all: of a powder's repeats within days, drawn towards that of all powders; less for a
/// run that is the mean of several.
fn weights(campaign: &Campaign) -> Vec<f64> {
    let powders = campaign.powders.len();
    let (mut squares, mut freedom) = (vec![0.0; powders], vec![0.0; powders]);
    let mut days: std::collections::BTreeMap<(usize, usize), Vec<f64>> = std::collections::BTreeMap::new();
    for run in &campaign.runs {
        match run.repose_sd_deg {
            Some(sd) if run.repeats > 1 => {
                squares[run.powder] += sd * sd * f64::from(run.repeats - 1);
                freedom[run.powder] += f64::from(run.repeats - 1);
            }
            _ => days.entry((run.session, run.powder)).or_default().push(run.repose_deg),
        }
    }
    for ((_, powder), angles) in &days {
        let mean = angles.iter().sum::<f64>() / angles.len() as f64;
        squares[*powder] += angles.iter().map(|angle| (angle - mean).powi(2)).sum::<f64>();
        freedom[*powder] += (angles.len() - 1) as f64;
    }
    let (all_squares, all_freedom) = (squares.iter().sum::<f64>(), freedom.iter().sum::<f64>());
    // Without any repeats all runs count alike.
    let pooled = if all_freedom > 0.0 && all_squares > 0.0 { all_squares / all_freedom } else { 1.0 };
    let variance = |run: &super::Run| {
        let of_powder = (squares[run.powder] + POOLED_FREEDOM * pooled) / (freedom[run.powder] + POOLED_FREEDOM);
        of_powder / f64::from(run.repeats.max(1))
    };
    let variances: Vec<f64> = campaign.runs.iter().map(variance).collect();
    let mean = variances.iter().sum::<f64>() / variances.len() as f64;
    variances.iter().map(|variance| (variance / mean).sqrt()).collect()
}

/// Whether any powder has two different angles.
fn varies(campaign: &Campaign) -> bool {
    let mut first: Vec<Option<f64>> = vec![None; campaign.powders.len()];
    campaign.runs.iter().any(|run| *first[run.powder].get_or_insert(run.repose_deg) != run.repose_deg)
}

/// Angles less their powder's median, outliers drawn in.
fn drawn_in(campaign: &Campaign) -> Vec<f64> {
    let middle = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2].midpoint(values[(values.len() - 1) / 2])
    };
    let of_powder = |powder: usize| {
        let angles: Vec<f64> =
            campaign.runs.iter().filter(|run| run.powder == powder).map(|run| run.repose_deg).collect();
        let centre = middle(angles.clone());
        // 1.4826: SD of a normal distribution over its median absolute deviation.
        (centre, OUTLIER_SD * 1.4826 * middle(angles.iter().map(|angle| (angle - centre).abs()).collect()))
    };
    let known: Vec<(f64, f64)> = (0..campaign.powders.len()).map(of_powder).collect();
    let run = |run: &super::Run| {
        let (centre, reach) = known[run.powder];
        let angle = run.repose_deg - centre;
        // More than half of the angles are the same: there is no telling what is far.
        if reach == 0.0 { angle } else { angle.clamp(-reach, reach) }
    };
    campaign.runs.iter().map(run).collect()
}

/// A noise model and its ratios.
struct Noise {
    model: Whitening,
    day: f64,
    day_powder: f64,
}

fn noises(campaign: &Campaign, weights: &[f64]) -> Result<Vec<Noise>, MixedModelError> {
    let (powder, session) = (campaign.powder_of(), campaign.session_of());
    let powders = campaign.powders.len();
    let both: Vec<usize> = session.iter().zip(&powder).map(|(session, powder)| session * powders + powder).collect();
    let means = DMatrix::from_fn(powder.len(), powders, |i, k| f64::from(u8::from(powder[i] == k)));
    let ratios: Vec<(f64, f64)> =
        DAY_RATIOS.iter().flat_map(|&day| DAY_POWDER_RATIOS.map(|day_powder| (day, day_powder))).collect();
    ratios
        .into_par_iter()
        .map(|(day, day_powder)| {
            let groups = [Group { of: &session, ratio: day }, Group { of: &both, ratio: day_powder }];
            Whitening::new(weights, &groups, &means).map(|model| Noise { model, day, day_powder })
        })
        .collect()
}

/// The observed campaign in the first column, simulated ones of the same design in the others: `[n, 1 + simulations]`.
fn with_simulated(
    campaign: &Campaign,
    weights: &[f64],
    noises: &[Noise],
    log_noises: &[f64],
    observed: &[f64],
    settings: &Settings,
) -> DMatrix<f64> {
    let (n, powders) = (observed.len(), campaign.powders.len());
    let sessions = campaign.runs.iter().map(|run| run.session).max().map_or(0, |last| last + 1);
    let best = log_noises.iter().copied().fold(f64::MIN, f64::max);
    let odds: Vec<f64> = log_noises.iter().map(|log| (log - best).exp()).collect();
    let total: f64 = odds.iter().sum();
    let mut all = DMatrix::zeros(n, 1 + settings.simulations as usize);
    all.column_mut(0).copy_from_slice(observed);
    for k in 1..all.ncols() {
        let mut rng = Pcg64::seed_from_u64(derive(settings.seed, &[k as u64]));
        let mut left = rng.random::<f64>() * total;
        let chosen = odds.iter().position(|odds| {
            left -= odds;
            left < 0.0
        });
        let noise = &noises[chosen.unwrap_or(noises.len() - 1)];
        let mut draws = |count: usize, variance: f64| -> Vec<f64> {
            (0..count).map(|_| variance.sqrt() * normal::quantile(rng.random::<f64>().max(f64::EPSILON))).collect()
        };
        let (day, day_powder) = (draws(sessions, noise.day), draws(sessions * powders, noise.day_powder));
        let own = draws(n, 1.0);
        for (i, run) in campaign.runs.iter().enumerate() {
            all[(i, k)] = day[run.session] + day_powder[run.session * powders + run.powder] + weights[i] * own[i];
        }
    }
    all
}

/// Log evidences under one noise model.
struct Evidences {
    /// Of noise alone, `[campaign]`.
    null: Vec<f64>,
    /// Of each cause, `[hypothesis][campaign]`.
    causes: Vec<Vec<f64>>,
}

fn evidences(noise: &Whitening, hypotheses: &[Hypothesis], powder: &[usize], all: &DMatrix<f64>) -> Evidences {
    let squares = noise.squares(all);
    let null: Vec<f64> = squares.iter().map(|&squares| noise.log_null(squares)).collect();
    let judge = |hypothesis: &Hypothesis| {
        let features = hypothesis
            .courses
            .iter()
            .flat_map(|course| DEVIATIONS.iter().map(move |&deviation| course.with_powders(powder, deviation)));
        let signatures: Vec<_> = features.filter_map(|features| noise.signature(&features)).collect();
        let seen: Vec<DMatrix<f64>> = signatures.iter().map(|signature| signature.seen(all)).collect();
        let of_campaign = |k: usize| {
            let each = signatures.iter().zip(&seen).flat_map(|(signature, seen)| {
                AMPLITUDES.map(|amplitude| {
                    noise.log_evidence(signature, seen.column(k), squares[k], amplitude, hypothesis.sign)
                })
            });
            log_mean_exp(&each.collect::<Vec<f64>>())
        };
        (0..all.ncols()).map(of_campaign).collect()
    };
    Evidences { null, causes: hypotheses.iter().map(judge).collect() }
}
