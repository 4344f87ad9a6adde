//! The document of an investigation's results.

mod gain;
pub mod names;
mod null_check;
mod numerics;
pub mod printed;
pub(crate) mod sizes;
pub mod spoon;

pub use crate::data::campaign::Channel;
use crate::data::reading::FileRead;
pub use gain::{Coverage, Gain, HeldOut, LogScore, WeighingGain};
pub use null_check::NullCheck;
pub use numerics::{Dependence, FitSet, Numerics, Varied};
use serde::{Deserialize, Serialize};
use spoon::SpoonReport;

/// Version of the document; readers refuse versions they do not know.
pub const SCHEMA_VERSION: u32 = 1;

/// What an investigation found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

impl Report {
    /// Whether the findings on angles make a better simulator: more than a hint, and better on
    /// left-out days. Those on spoons say so themselves (`spoon::extended`).
    pub fn is_worth_a_version(&self) -> bool {
        self.verdict != Verdict::Hint && self.gain.as_ref().is_some_and(|gain| gain.accepted)
    }

    /// An empty document for a p-value and the simulator judged.
    pub(crate) fn blank(base: &str, p_value: f64, null_check: NullCheck) -> Self {
        Self {
            schema_version: SCHEMA_VERSION,
            sentence: String::new(),
            verdict: Verdict::NoDiscrepancy,
            p_value,
            findings: Vec::new(),
            causes: Vec::new(),
            ambiguous_between: Vec::new(),
            unexplained: None,
            suggested_experiment: None,
            simulator_version: SimulatorVersions {
                base: base.to_owned(),
                extended: None,
                verified: false,
            },
            gain: None,
            minimum_detectable: Vec::new(),
            blind_spots: Vec::new(),
            evidence: Vec::new(),
            untestable: Vec::new(),
            left_out: Vec::new(),
            unjudged: None,
            null_check,
            beside: Vec::new(),
            traces: None,
            spoon: None,
            rows: Vec::new(),
            curves: Vec::new(),
            numerics: None,
            files: Vec::new(),
            simulator_runs: 0,
            wall_s: 0.0,
        }
    }

    /// Adds how the files were read, and why columns were not judged.
    pub fn read_from(&mut self, files: &[FileRead]) {
        files.clone_into(&mut self.files);
        let columns = self
            .files
            .iter_mut()
            .filter(|file| file.file == "measurements")
            .flat_map(|it| &mut it.columns);
        for column in columns {
            let Some(out) = self.left_out.iter().find(|out| out.column == column.column) else {
                continue;
            };
            let before = if column.note.is_empty() { "" } else { "; " };
            column.note = format!("{}{before}left out: {}", column.note, out.reason);
        }
    }
}

/// Whether anything is wrong, and whether it has a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
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

/// A departure of measured angles, or of balance readings, from the simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

/// An effect on one powder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PowderEffect {
    /// Powder id.
    pub powder: String,
    /// Degrees.
    pub effect: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
}

/// A cause of the catalogue.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

/// A fitted number.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

/// A departure without a cause.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Unexplained {
    /// The covariate it depends on; absent if no recorded one explains it.
    pub covariate: Option<String>,
    /// Its law, in words and numbers.
    pub law: String,
    /// Kind of law.
    pub form_class: FormClass,
}

/// Kinds of law.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
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

impl FormClass {
    /// Name used in the document.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Power => "power",
            Self::Threshold => "threshold",
            Self::Saturating => "saturating",
            Self::Periodic => "periodic",
            Self::Smooth => "smooth",
        }
    }
}

/// An experiment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Experiment {
    /// What to do, in plain words.
    pub what: String,
    /// One entry per run, in the order to do them: powder and settings by column name.
    pub runs: Vec<std::collections::BTreeMap<String, String>>,
    /// Duration, minutes.
    pub minutes: f64,
    /// Chance that the winner's inclusion probability exceeds 0.8; absent where not simulated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub chance_of_resolution: Option<f64>,
    /// Mean inclusion probability of the right cause afterwards; absent where not simulated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected_posterior: Option<f64>,
}

/// Versions of the simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SimulatorVersions {
    /// The version that was judged.
    pub base: String,
    /// The version made from the findings; absent where nothing was accepted.
    pub extended: Option<String>,
    /// Whether simulations confirmed it.
    pub verified: bool,
}

/// The effect a design would find in four of five campaigns.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Detectable {
    /// Cause.
    pub mechanism: String,
    /// Change from the 5th to the 95th percentile of its covariate, all powders alike, degrees.
    pub effect_deg: f64,
    /// 0.8.
    pub power: f64,
}

/// How well a cause explains the data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

/// A cause the data cannot judge.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct UntestableReport {
    /// Name.
    pub mechanism: String,
    /// Why.
    pub reason: String,
}

/// A column that is not a condition.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ColumnLeftOut {
    /// The column's name.
    pub column: String,
    /// Why.
    pub reason: String,
}

/// Balance readings, judged by themselves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

/// A quantity measured alongside the angle, judged by itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

/// A row of the file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

/// Residuals over a covariate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
