//! Decides whether anything is wrong with the simulated bench, and what explains it best.
//!
//! ```text
//! B_h = E_h / E_0                              on the level on which cause h acts
//! B_U = (B_U of readings + B_U of shakes) / 2  what wanders and no cause makes
//! T   = max over h of log(prior_h B_h)         p = (1 + number of simulated readings with T at least as large) / (1 + number of simulated)
//! ```
//!
//! Levels: readings within plateaus, masses of shakes, scatter within plateaus. Each has its own
//! fixed part (levels of plateaus; responses of powders), which a calibration would absorb and
//! which is therefore not judged.

use super::bench::Bench;
use super::catalogue::{self, Differs, Level, Shaped, TraceMechanism};
use super::design::Design;
use super::level::{Estimate, Form, Hypothesis, Noise, Verdict, judge};
use super::noise::{self, FILTERED, Masses, SCATTERS, ShakeNoise};
use super::parameter::{Parameter, parameters};
use super::readings::{Kind, Traces};
use super::shakes;
use super::simulate::{self, Scatter};
use super::span::Along;
use crate::thresholds::trace::EXPLAINED_MIN;
use flip_core::domain::FieldError;
use flip_core::stats::mixed_model::log_mean_exp;
use nalgebra::DMatrix;
use rayon::prelude::*;

/// How much powders or sessions may differ in a cause, relative to their common part.
const DIFFERENCES: [f64; 2] = [0.3, 1.0];
/// Most averaged readings of all simulations together: about ten matrices of this many numbers are
/// held at once.
const SIMULATED_ROWS_MAX: usize = 20_000_000;
/// Prior odds of a wander, and of an actuator: a curved response of the spoon looks like one.
const PRIORS: [f64; 2] = [1.0, 0.3];

/// How to screen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// Seed of the simulated readings.
    pub seed: u64,
    /// Simulated sets of readings in which nothing is wrong, 99 to 9999.
    pub simulations: u32,
}

/// A possible explanation of a discrepancy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum TraceCause {
    /// A mechanism of the catalogue.
    Known(TraceMechanism),
    /// Something that wanders, in each weighing in its own way.
    Unknown,
}

/// How large a cause is: the change from the 5th to the 95th percentile of the covariate it goes
/// with.
#[derive(Debug, Clone, PartialEq)]
pub struct Effect {
    /// Column of the file.
    pub covariate: &'static str,
    /// Change, and its 95 % interval.
    pub value: f64,
    /// Lower and upper limit of 95 %.
    pub ci95: [f64; 2],
    /// `mg`, or `%` of a shake's mass or of a reading's SD.
    pub unit: &'static str,
    /// From where to where, in words.
    pub span: String,
}

/// A cause and how well it explains the readings.
#[derive(Debug, Clone, PartialEq)]
pub struct TraceJudged {
    /// The cause.
    pub mechanism: TraceCause,
    /// Log of the evidence over that of noise alone.
    pub log_evidence: f64,
    /// Probability among everything judged, if one cause is at work alone.
    pub probability: f64,
    /// Its size and its shape.
    pub parameters: Vec<Parameter>,
    /// How large it is; `None` for a wander.
    pub effect: Option<Effect>,
}

/// The outcome of [`screen_traces`].
#[derive(Debug, Clone, PartialEq)]
pub struct TraceScreening {
    /// Chance of evidence as strong for any cause if nothing is wrong.
    pub p_value: f64,
    /// Most probable first.
    pub judged: Vec<TraceJudged>,
    /// Mechanisms these readings cannot judge, and why, in the catalogue's order.
    pub untestable: Vec<(TraceMechanism, String)>,
    /// Whether the residuals of the best cause are white. If not, its probability went to the
    /// unknown.
    pub white: bool,
    /// The largest evidence here, with its prior, natural log.
    pub statistic: f64,
    /// The same in each of the simulated readings, in ascending order.
    pub null: Vec<f64>,
    /// Number of readings and of shakes judged.
    pub looked_at: [u32; 2],
    /// Why masses of shakes were not judged, where they were not.
    pub unjudged: Option<Unjudged>,
}

/// Masses of shakes that follow no formula, so only the simulator itself could predict them.
#[derive(Debug, Clone, PartialEq)]
pub struct Unjudged {
    /// Why.
    pub why: String,
    /// Simulated doses required: as many sets of all of them as make one in twenty.
    pub doses: u32,
}

impl TraceCause {
    /// Name used in reports, and the family within which causes look alike.
    pub fn name(self) -> (&'static str, Option<&'static str>) {
        match self {
            Self::Known(mechanism) => (mechanism.name().0, Some(mechanism.name().1)),
            Self::Unknown => ("unknown", None),
        }
    }
}

/// Judges every cause of the catalogue, and a wander, on balance readings.
///
/// # Errors
/// A setting out of bounds; more readings than this many simulations can have; traces that
/// [`Traces::checked`] refuses or whose weighings leave nothing to judge.
pub fn screen_traces(traces: &Traces, settings: &Settings) -> Result<TraceScreening, FieldError> {
    if !(99..=9999).contains(&settings.simulations) {
        let message = format!("must be from 99 to 9999, got {}", settings.simulations);
        return Err(FieldError::new("simulations", message));
    }
    let design = Design::new(&traces.clone().checked()?);
    let rows_max = SIMULATED_ROWS_MAX / settings.simulations as usize;
    if design.rows.len() > rows_max {
        let message = format!(
            "{} are too many for readings that average to {} rows, and {rows_max} rows are the most: ask for fewer, or leave weighings out",
            settings.simulations,
            design.rows.len()
        );
        return Err(FieldError::new("simulations", message));
    }
    let bench = Bench::new(&design);
    let mut untestable = Vec::new();
    let mut known = Vec::new();
    for mechanism in TraceMechanism::ALL {
        match mechanism.effects(&design) {
            Ok(effects) => known.push((mechanism, effects)),
            Err(reason) => untestable.push((mechanism, reason)),
        }
    }
    let masses = shakes::response(&design);
    let plan = Plan { design: &design, bench: &bench, masses: masses.as_ref(), known };
    let reading_noises = noise::of_readings(&design);
    let shake_noises =
        plan.masses.map(|masses| noise::of_shakes(&design, masses)).unwrap_or_default();
    let measured = plan.seen(&design.shown_mg);
    let scatter = plan.scatter(&reading_noises, &shake_noises, &measured);
    let simulated: Vec<Seen> = (1..=u64::from(settings.simulations))
        .into_par_iter()
        .map(|k| plan.seen(&simulate::readings(&design, plan.masses, &scatter, settings.seed, k)))
        .collect();
    let all: Vec<&Seen> = std::iter::once(&measured).chain(&simulated).collect();
    let shake_scatter =
        plan.masses.map(|_| shakes::scatter(&measured.0[Level::Shakes as usize], &shake_noises));
    let shake_noises: Vec<Noise> = shake_noises.into_iter().map(|shakes| shakes.noise).collect();
    let mut levels = [
        plan.judge(Level::Readings, &reading_noises, &all),
        plan.judge(Level::Shakes, &shake_noises, &all),
        plan.judge(Level::Scatter, &plan.scatter_noises(), &all),
    ];
    let of_shakes = levels[Level::Shakes as usize].as_ref().zip(shake_scatter);
    let unjudged = of_shakes.and_then(|(judged, scatter)| shakes::unlike(&design, scatter, judged));
    let unjudged = unjudged.or_else(|| shakes::unfilled(&design));
    let unjudged = plan.masses.and_then(|masses| shakes::sought(&design, masses)).or(unjudged);
    if unjudged.is_some() {
        levels[Level::Shakes as usize] = None;
    }
    if levels.iter().all(Option::is_none) && unjudged.is_none() {
        let message = "leave nothing to judge: no two readings follow the same shake, and too few shakes were counted";
        return Err(FieldError::new("traces", message));
    }
    for (mechanism, _) in &plan.known {
        if !levels
            .iter()
            .flatten()
            .any(|level| level.causes.iter().any(|(judged, _)| judged == mechanism))
        {
            let why = unjudged.as_ref().filter(|_| mechanism.level() == Level::Shakes);
            untestable.push((
                *mechanism,
                why.map_or("has no range in which it could act", |unjudged| unjudged.why.as_str())
                    .to_owned(),
            ));
        }
    }
    untestable.sort_by_key(|(mechanism, _)| {
        TraceMechanism::ALL.iter().position(|known| known == mechanism)
    });
    let concluded = plan.conclude(&levels, untestable, all.len());
    let is_judged = levels.iter().any(Option::is_some);
    Ok(match is_judged {
        true => TraceScreening { unjudged, ..concluded },
        // With nothing to judge there is no evidence, not even for a wander.
        false => {
            let null = vec![0.0; concluded.null.len()];
            TraceScreening {
                unjudged,
                p_value: 1.0,
                judged: Vec::new(),
                statistic: 0.0,
                null,
                ..concluded
            }
        }
    })
}

/// The data of each level for one set of readings.
struct Seen([Vec<f64>; 3]);

/// Everything that is judged on one design.
struct Plan<'a> {
    design: &'a Design,
    bench: &'a Bench<'a>,
    masses: Option<&'a Masses>,
    known: Vec<(TraceMechanism, Vec<Shaped>)>,
}

impl Plan<'_> {
    fn scatter_noises(&self) -> Vec<Noise> {
        let plateaus = self.scattered();
        let logs: Vec<usize> = plateaus.iter().map(|&k| self.design.plateaus[k].log).collect();
        let is_dose: Vec<bool> =
            logs.iter().map(|&log| self.design.logs[log].kind == Kind::Dose).collect();
        let fixed =
            DMatrix::from_fn(logs.len(), 2, |i, k| f64::from(u8::from(is_dose[i] == (k == 0))));
        if logs.is_empty() { Vec::new() } else { noise::of_scatter(&logs, &fixed) }
    }

    /// Plateaus whose scatter and vibration are known.
    fn scattered(&self) -> Vec<usize> {
        let plateaus = &self.design.plateaus;
        let has_both =
            |k: &usize| plateaus[*k].vibration.is_some() && plateaus[*k].readings.len() >= 3;
        (0..plateaus.len()).filter(has_both).collect()
    }

    /// Estimates the bench's scatter when nothing is wrong from the measured readings.
    fn scatter(&self, readings: &[Noise], shakes: &[ShakeNoise], measured: &Seen) -> Scatter {
        let plain = judge(readings, &[], &column(measured, Level::Readings), None).plain;
        let mut filtered: Vec<(f64, (f64, f64))> = plain.into_iter().zip(FILTERED).collect();
        if filtered.is_empty() {
            filtered.push((1.0, FILTERED[0]));
        }
        let shakes = match self.masses {
            None => vec![(1.0, [SCATTERS[0], 0.0, 0.0])],
            Some(_) => {
                let mass = column(measured, Level::Shakes);
                let plain = shakes.iter().filter(|shakes| !shakes.noise.is_wander);
                let odds = plain.map(|ShakeNoise { noise, weighing, step, .. }| {
                    let squares = noise.model.apply(&mass).norm_squared();
                    (
                        noise.model.log_null(squares),
                        [(squares / noise.model.freedom).sqrt(), *weighing, *step],
                    )
                });
                let odds: Vec<_> = odds.collect();
                let most = odds.iter().map(|odds| odds.0).fold(f64::NEG_INFINITY, f64::max);
                odds.into_iter().map(|(log, of)| ((log - most).exp(), of)).collect()
            }
        };
        let reading_mg =
            simulate::noise_behind(self.design.reading_sd(), self.design.readability_mg);
        Scatter { reading_mg, filtered, shakes }
    }

    /// The data of each level for these readings, `[rows]` each.
    fn seen(&self, shown: &[f64]) -> Seen {
        let design = self.design;
        let floor = (design.readability_mg.powi(2) / 50.0).max(0.1 * design.reading_sd().powi(2));
        let scatter = design.scatter(shown);
        let log_scatter = |k: usize| (scatter[k].unwrap_or(0.0) + floor).ln();
        let masses =
            self.masses.map(|masses| masses.seen(&design.masses(shown))).unwrap_or_default();
        Seen([
            design.averaged(shown),
            masses,
            self.scattered().into_iter().map(log_scatter).collect(),
        ])
    }

    /// The weighing of each row of a level.
    fn logs(&self, level: Level) -> Vec<usize> {
        let design = self.design;
        match level {
            Level::Readings => {
                design.rows.iter().map(|row| design.plateaus[row.plateau].log).collect()
            }
            Level::Shakes => design.shakes.iter().map(|shake| shake.log).collect(),
            Level::Scatter => self.scattered().iter().map(|&k| design.plateaus[k].log).collect(),
        }
    }

    /// Change of a level under an effect of small size, over that size, `[rows]`.
    fn raw(&self, effect: catalogue::Effect) -> Vec<f64> {
        use catalogue::Effect;
        /// Size of an effect whose signature is a difference of two runs of the bench.
        const SMALL: f64 = 1e-4;
        let over = |with: Vec<f64>, without: Vec<f64>| -> Vec<f64> {
            with.iter().zip(&without).map(|(with, without)| (with - without) / SMALL).collect()
        };
        match (effect, self.masses) {
            (Effect::Sensor(effect), _) => {
                let run = |size: f64| self.design.averaged(&self.bench.shown_mg(effect, size));
                over(run(SMALL), run(0.0))
            }
            (Effect::Spoon(effect), Some(masses)) => {
                let run = |size: f64| {
                    masses.seen(&self.bench.masses_mg(&masses.nominal_mg, effect, size))
                };
                over(run(SMALL), run(0.0))
            }
            (Effect::Spoon(_), None) => Vec::new(),
            (Effect::Vibration(onset), _) => {
                let rise = |v: f64| (v / onset).powi(2).ln_1p();
                let known: Vec<f64> = self
                    .scattered()
                    .into_iter()
                    .filter_map(|k| self.design.plateaus[k].vibration)
                    .collect();
                let mut sorted = known.clone();
                sorted.sort_by(f64::total_cmp);
                let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share).round() as usize];
                let whole = if known.is_empty() { 1.0 } else { rise(at(0.95)) - rise(at(0.05)) };
                known.into_iter().map(|v| rise(v) / if whole > 0.0 { whole } else { 1.0 }).collect()
            }
        }
    }

    fn judge(&self, level: Level, noises: &[Noise], all: &[&Seen]) -> Option<Verdict> {
        let plain = &noises.first()?.model;
        let logs = self.logs(level);
        let observations =
            DMatrix::from_fn(logs.len(), all.len(), |i, k| all[k].0[level as usize][i]);
        let (powders, sessions) = self.design.counts();
        let of_mechanism = |mechanism: TraceMechanism, effects: &[Shaped]| {
            let (which, count) = match mechanism.differs_between() {
                Some(Differs::Powders) => (Some(0), powders),
                Some(Differs::Sessions) => (Some(1), sessions),
                None => (None, 1),
            };
            let group_of = |&log: &usize| {
                let of = [self.design.logs[log].powder, self.design.logs[log].session];
                which.map_or(0, |which: usize| of[which])
            };
            let along = Along::of(mechanism, self.design, &self.scattered());
            let form = |&(effect, shape): &Shaped| {
                let raw = self.raw(effect);
                let span = match self.masses {
                    // In the log of a shake's mass.
                    Some(masses) if level == Level::Shakes => {
                        let of_log = |(i, dz): (usize, &f64)| dz / masses.log_slope(i);
                        along.span(&raw.iter().enumerate().map(of_log).collect::<Vec<f64>>())
                    }
                    _ => along.span(&raw),
                };
                Form::new(&raw, shape, span, plain)
            };
            let forms = effects.iter().filter_map(form);
            let differ = if count > 1 { DIFFERENCES.map(Some).to_vec() } else { vec![None] };
            Hypothesis {
                mechanism,
                forms: forms.collect(),
                group: logs.iter().map(group_of).collect(),
                differ,
            }
        };
        let here = self.known.iter().filter(|(mechanism, _)| mechanism.level() == level);
        let hypotheses = here.map(|(mechanism, effects)| of_mechanism(*mechanism, effects));
        let hypotheses: Vec<Hypothesis> =
            hypotheses.filter(|hypothesis| !hypothesis.forms.is_empty()).collect();
        let white = self.design.reading_sd().powi(2) + self.design.readability_mg.powi(2) / 12.0;
        let white = (level == Level::Readings).then_some(white);
        Some(judge(noises, &hypotheses, &observations, white))
    }

    fn conclude(
        &self,
        levels: &[Option<Verdict>],
        untestable: Vec<(TraceMechanism, String)>,
        count: usize,
    ) -> TraceScreening {
        let prior =
            |mechanism| if mechanism == TraceMechanism::Actuator { PRIORS[1].ln() } else { 0.0 };
        let wander = |k: usize| {
            let of_levels: Vec<f64> =
                levels[..2].iter().flatten().map(|level| level.wander[k]).collect();
            log_mean_exp(&of_levels) + PRIORS[0].ln()
        };
        let causes: Vec<(TraceMechanism, &Vec<f64>, &Estimate)> = levels
            .iter()
            .flatten()
            .flat_map(|level| level.causes.iter().zip(&level.estimates))
            .map(|((mechanism, logs), estimate)| (*mechanism, logs, estimate))
            .collect();
        let largest = |k: usize| {
            causes
                .iter()
                .map(|(mechanism, logs, _)| logs[k] + prior(*mechanism))
                .fold(wander(k), f64::max)
        };
        let here = largest(0);
        let mut null: Vec<f64> = (1..count).map(largest).collect();
        null.sort_by(f64::total_cmp);
        let as_large = null.iter().filter(|&&other| other >= here).count();
        let logs: Vec<f64> = causes
            .iter()
            .map(|(mechanism, logs, _)| logs[0] + prior(*mechanism))
            .chain(std::iter::once(wander(0)))
            .collect();
        let total = log_mean_exp(&logs) + (logs.len() as f64).ln();
        let mut judged: Vec<TraceJudged> = causes
            .iter()
            .map(|(mechanism, logs, estimate)| TraceJudged {
                mechanism: TraceCause::Known(*mechanism),
                log_evidence: logs[0],
                probability: (logs[0] + prior(*mechanism) - total).exp(),
                parameters: parameters(*mechanism, estimate),
                effect: self.effect(*mechanism, estimate),
            })
            .collect();
        let best = (0..judged.len())
            .max_by(|&a, &b| judged[a].probability.total_cmp(&judged[b].probability));
        let white = best.is_none_or(|best| causes[best].2.explained >= EXPLAINED_MIN);
        let mut unknown = (wander(0) - total).exp();
        for (judged, (_, _, estimate)) in judged.iter_mut().zip(&causes) {
            if estimate.explained < EXPLAINED_MIN {
                unknown += std::mem::take(&mut judged.probability);
            }
        }
        judged.push(TraceJudged {
            mechanism: TraceCause::Unknown,
            log_evidence: wander(0) - PRIORS[0].ln(),
            probability: unknown,
            parameters: Vec::new(),
            effect: None,
        });
        judged.sort_by(|a, b| b.probability.total_cmp(&a.probability));
        let p_value = (1 + as_large) as f64 / count as f64;
        let looked_at = [self.design.times_s.len() as u32, self.design.shakes.len() as u32];
        TraceScreening {
            p_value,
            judged,
            untestable,
            white,
            statistic: here,
            null,
            looked_at,
            unjudged: None,
        }
    }

    /// How large a cause is over the covariate it goes with.
    fn effect(&self, mechanism: TraceMechanism, estimate: &Estimate) -> Option<Effect> {
        let along = Along::of(mechanism, self.design, &self.scattered());
        let [value, low, high] = estimate.effect().map(|effect| mechanism.in_unit(effect));
        let ends = along.ends()?;
        let span = mechanism.between(along.covariate, ends);
        Some(Effect {
            covariate: along.covariate,
            value,
            ci95: [low, high],
            unit: mechanism.unit(),
            span,
        })
    }
}

fn column(seen: &Seen, level: Level) -> DMatrix<f64> {
    let rows = &seen.0[level as usize];
    DMatrix::from_column_slice(rows.len(), 1, rows)
}
