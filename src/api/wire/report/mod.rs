//! The report of an investigation: what the simulator gets wrong, and why.

mod gain;
mod numerics;
mod reading;
mod spoon;

pub use gain::*;
pub use numerics::*;
pub use reading::*;
pub use spoon::*;

use serde::Serialize;
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// What an investigation found.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Report {
    /// 1.
    pub schema_version: u32,
    /// What was found, in plain words.
    pub sentence: String,
    /// Whether anything is wrong, and whether it has a name.
    pub verdict: Verdict,
    /// Chance of evidence as strong for any cause if nothing is wrong; for several channels the
    /// smallest, corrected for all (Holm).
    pub p_value: f64,
    /// Where measured angles and balance readings depart from the simulator.
    pub findings: Vec<Finding>,
    /// Causes of the catalogue, most probable first.
    pub causes: Vec<CauseReport>,
    /// With verdict `ambiguous`: causes these data cannot distinguish.
    pub ambiguous_between: Vec<String>,
    /// With verdict `unexplained`: what the departure depends on.
    pub unexplained: Option<Unexplained>,
    /// The most informative experiment.
    pub suggested_experiment: Option<Experiment>,
    /// The simulator that was judged, and the version made from the findings.
    pub simulator_version: SimulatorVersions,
    /// Gain of the extension on data it was not fitted to; absent where nothing was extended.
    pub gain: Option<Gain>,
    /// What this design would have found.
    pub minimum_detectable: Vec<Detectable>,
    /// Limits of this data, sentence by sentence.
    pub blind_spots: Vec<String>,
    /// Every cause that was judged, most probable first.
    pub evidence: Vec<Evidence>,
    /// Causes this data cannot judge, and why.
    pub untestable: Vec<UntestableReport>,
    /// Columns not judged because they are derived from the measurement, in file order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<ColumnLeftOut>,
    /// Why angles were not judged, and what it would take; absent where judged or not measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unjudged: Option<String>,
    /// How often as much is found by chance: for angles, or for balance readings without angles.
    pub null_check: NullCheck,
    /// Other quantities by themselves: flow times, if measured, and scatter of repeats.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub beside: Vec<SideChannel>,
    /// The result of balance readings by themselves; absent where none were given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub traces: Option<TraceChannel>,
    /// What weighings say of the simulated spoon; absent where no shakes were judged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spoon: Option<SpoonReport>,
    /// Every row of the file, before and after.
    pub rows: Vec<Row>,
    /// Course of the residuals over the recorded covariates, for the figures.
    pub curves: Vec<Curve>,
    /// Whether simulated angles depend on how they are computed; absent where none were simulated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub numerics: Option<Numerics>,
    /// How the files were read: the role of each column, and what was left out.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<FileRead>,
    /// Simulations run.
    pub simulator_runs: u32,
    /// Wall-clock time, s; 0 where not measured.
    pub wall_s: f64,
}

answer! { flip_discover::report::Report => Report {
    schema_version, sentence, verdict, p_value, findings, causes, ambiguous_between, unexplained,
    suggested_experiment, simulator_version, gain, minimum_detectable, blind_spots, evidence,
    untestable, left_out, unjudged, null_check, beside, traces, spoon, rows, curves, numerics, files,
    simulator_runs, wall_s,
} }

/// Whether anything is wrong, and whether it has a name.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Nothing shown.
    NoDiscrepancy,
    /// One or two causes of the catalogue.
    Cause,
    /// Real, with several possible causes.
    Ambiguous,
    /// Real, with no matching cause in the catalogue.
    Unexplained,
    /// Not yet a cause: the evidence favours one, but its effect is not distinguishable from zero,
    /// or days left out are not predicted better.
    Hint,
}

answer! { flip_discover::report::Verdict => enum Verdict {
    NoDiscrepancy, Cause, Ambiguous, Unexplained, Hint,
} }

/// A departure of measured angles, or of balance readings, from the simulator.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Finding {
    /// What departs.
    pub channel: Channel,
    /// The covariate it changes with; absent if none was recorded.
    pub covariate: Option<String>,
    /// Powders whose own 95 % interval, as printed, excludes zero; none for balance readings, which
    /// are judged over all weighings together.
    pub powders: Vec<String>,
    /// Change from the 5th to the 95th percentile of the covariate, averaged over powders; for
    /// names, from the first to the last in the alphabet, or between the two that differ most;
    /// where that prints as zero, between the ends of the range seen.
    pub effect: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// `deg`; for flow times and scatter `%`; for balance readings `mg`, or `%` of a shake's mass
    /// or of a reading's SD.
    pub unit: String,
    /// The range it covers, in words.
    pub span: String,
    /// The powder with this effect, if the average over powders (which may respond in opposite
    /// directions) is not distinguishable from zero; absent: the average.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub powder: Option<String>,
    /// The same for each powder; for names, for those measured with both.
    pub by_powder: Vec<PowderEffect>,
}

answer! { flip_discover::report::Finding => Finding {
    channel, covariate, powders, effect, ci95, unit, span, powder, by_powder,
} }

/// An effect on one powder.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PowderEffect {
    /// Powder id.
    pub powder: String,
    /// Degrees.
    pub effect: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
}

answer! { flip_discover::report::PowderEffect => PowderEffect { powder, effect, ci95 } }

/// A cause of the catalogue.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct CauseReport {
    /// Name.
    pub mechanism: String,
    /// Family of causes that look alike.
    pub family: String,
    /// Probability that it is at work, if anything is.
    pub inclusion_probability: f64,
    /// 1: its pattern is present; 2: the extended simulator better predicts data it was not fitted
    /// to; 3: an intervention confirmed it.
    pub confidence_level: u8,
    /// The fitted numbers.
    pub parameters: Vec<ParameterReport>,
    /// Powders on which it shows.
    pub powders: Vec<String>,
}

answer! { flip_discover::report::CauseReport => CauseReport {
    mechanism, family, inclusion_probability, confidence_level, parameters, powders,
} }

/// A fitted number.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ParameterReport {
    /// Name.
    pub name: String,
    /// Value.
    pub value: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// Unit.
    pub unit: String,
}

answer! { flip_discover::report::ParameterReport => ParameterReport { name, value, ci95, unit } }

/// A departure without a cause.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Unexplained {
    /// The covariate it depends on; absent if no recorded one explains it.
    pub covariate: Option<String>,
    /// Its law, in words and numbers.
    pub law: String,
    /// Kind of law.
    pub form_class: FormClass,
}

answer! { flip_discover::report::Unexplained => Unexplained { covariate, law, form_class } }

/// Kinds of law.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FormClass {
    /// a + b x.
    Linear,
    /// a + b x^m.
    Power,
    /// A step.
    Threshold,
    /// Approach to a limit.
    Saturating,
    /// A wave.
    Periodic,
    /// Smooth, of no simpler form.
    Smooth,
}

answer! { flip_discover::report::FormClass => enum FormClass {
    Linear, Power, Threshold, Saturating, Periodic, Smooth,
} }

/// An experiment.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Experiment {
    /// What to do, in plain words.
    pub what: String,
    /// One entry per run, in the order to do them: powder and settings by column name.
    pub runs: Vec<BTreeMap<String, String>>,
    /// Duration, minutes.
    pub minutes: f64,
    /// Chance that the winner's inclusion probability exceeds 0.8; absent where not simulated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub chance_of_resolution: Option<f64>,
    /// Mean inclusion probability of the right cause afterwards; absent where not simulated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected_posterior: Option<f64>,
}

answer! { flip_discover::report::Experiment => Experiment {
    what, runs, minutes, chance_of_resolution, expected_posterior,
} }

/// Versions of the simulator.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct SimulatorVersions {
    /// The version that was judged.
    pub base: String,
    /// The version made from the findings; absent where nothing was accepted.
    pub extended: Option<String>,
    /// Whether simulations confirmed it.
    pub verified: bool,
}

answer! { flip_discover::report::SimulatorVersions => SimulatorVersions {
    base, extended, verified,
} }

/// The effect a design would find in four of five campaigns.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Detectable {
    /// Cause.
    pub mechanism: String,
    /// Change from the 5th to the 95th percentile of its covariate, all powders alike, degrees.
    pub effect_deg: f64,
    /// 0.8.
    pub power: f64,
}

answer! { flip_discover::report::Detectable => Detectable { mechanism, effect_deg, power } }

/// How well a cause explains the data.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Evidence {
    /// `unknown: <covariate>` is a smooth function of a covariate; `unrecorded` a wander over the
    /// sessions; `wander` one of balance readings within weighings.
    pub cause: String,
    /// Family, if it is in the catalogue.
    pub family: Option<String>,
    /// Log10 of the evidence over that of noise alone.
    pub log10_evidence: f64,
    /// Probability that it is at work, if anything is.
    pub inclusion_probability: f64,
}

answer! { flip_discover::report::Evidence => Evidence {
    cause, family, log10_evidence, inclusion_probability,
} }

/// A cause the data cannot judge.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct UntestableReport {
    /// Name.
    pub mechanism: String,
    /// Why.
    pub reason: String,
}

answer! { flip_discover::report::UntestableReport => UntestableReport { mechanism, reason } }

/// A column that is not a condition.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ColumnLeftOut {
    /// The column's name.
    pub column: String,
    /// Why.
    pub reason: String,
}

answer! { flip_discover::report::ColumnLeftOut => ColumnLeftOut { column, reason } }

/// Balance readings, judged by themselves.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct TraceChannel {
    /// Whether anything is wrong with the simulated bench, and whether it has a name.
    pub verdict: Verdict,
    /// Chance of evidence as strong if nothing is wrong, not corrected for other channels.
    pub p_value: f64,
    /// Doses.
    pub weighings: u32,
    /// Logs of the empty pan or of a standard mass.
    pub controls: u32,
    /// Readings judged.
    pub readings: u32,
    /// Shakes judged.
    pub shakes: u32,
    /// How often as much is found where nothing is wrong.
    pub null_check: NullCheck,
    /// The most informative experiment for balance readings.
    pub suggested_experiment: Option<Experiment>,
    /// Why the masses of shakes were not judged; absent where they were.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unjudged: Option<String>,
}

answer! { flip_discover::report::TraceChannel => TraceChannel {
    verdict, p_value, weighings, controls, readings, shakes, null_check, suggested_experiment,
    unjudged,
} }

/// A quantity measured alongside the angle, judged by itself.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct SideChannel {
    /// `flow_time`, or `scatter`: not predicted by the simulator, so it never affects the verdict.
    pub channel: Channel,
    /// Whether it depends on anything, and whether that has a name.
    pub verdict: Verdict,
    /// Chance of evidence as strong if nothing is wrong, not corrected for other channels.
    pub p_value: f64,
    /// Flow times, or differences between repeats, judged.
    pub n: u32,
    /// The result, in plain words.
    pub sentence: String,
    /// Every cause that was judged on it, most probable first.
    pub evidence: Vec<Evidence>,
    /// How often as much is found where nothing is wrong.
    pub null_check: NullCheck,
    /// Gain from its causes on left-out days; absent where no cause was proposed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain: Option<Gain>,
}

answer! { flip_discover::report::SideChannel => SideChannel {
    channel, verdict, p_value, n, sentence, evidence, null_check, gain,
} }

/// A row of the file.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Row {
    /// Row of the file, the header being row 1.
    pub row: u32,
    /// Powder id.
    pub powder: String,
    /// Measured; absent in predicted rows.
    pub measured_deg: Option<f64>,
    /// By the simulator as it was; absent for a powder without any angle.
    pub before_deg: Option<f64>,
    /// SD of one run around it.
    pub before_sd_deg: f64,
    /// By the extended simulator.
    pub after_deg: Option<f64>,
    /// SD of one run around it.
    pub after_sd_deg: f64,
}

answer! { flip_discover::report::Row => Row {
    row, powder, measured_deg, before_deg, before_sd_deg, after_deg, after_sd_deg,
} }

/// Residuals over a covariate.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Curve {
    /// The covariate's name.
    pub covariate: String,
    /// Its names, if it is named: positions are indices into them.
    pub levels: Vec<String>,
    /// Value in each row; absent where not recorded.
    pub at: Vec<Option<f64>>,
    /// The extended simulator's course over a grid: position, mean and half width of the 90 % band
    /// of one run, degrees from the powders' means.
    pub course: Vec<[f64; 3]>,
}

answer! { flip_discover::report::Curve => Curve { covariate, levels, at, course } }
