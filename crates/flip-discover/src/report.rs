//! What an investigation found, as its document has it.

use super::extension::FitSet;
pub use super::null_check::NullCheck;
use super::numerics::Dependence;
use super::reading::FileRead;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Version of the document; a reader refuses one that it does not know.
pub const SCHEMA_VERSION: u32 = 1;

/// What an investigation found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Report {
    /// 1.
    pub schema_version: u32,
    /// What was found, in plain words.
    pub sentence: String,
    /// Whether anything is wrong, and whether it has a name.
    pub verdict: Verdict,
    /// Chance of evidence as strong for any cause if nothing is wrong; of several channels the smallest, corrected for all (Holm).
    pub p_value: f64,
    /// Where measured angles and balance readings depart from the simulator.
    pub findings: Vec<Finding>,
    /// Causes of the catalogue, most probable first.
    pub causes: Vec<CauseReport>,
    /// With verdict `ambiguous`: causes that these data cannot tell apart.
    pub ambiguous_between: Vec<String>,
    /// With verdict `unexplained`: what the departure depends on.
    pub unexplained: Option<Unexplained>,
    /// What would tell most.
    pub suggested_experiment: Option<Experiment>,
    /// The simulator that was judged, and the version that the findings make.
    pub simulator_version: SimulatorVersions,
    /// What the extension is worth on data that it was not fitted to; absent where nothing was extended.
    pub gain: Option<Gain>,
    /// What this design would have found.
    pub minimum_detectable: Vec<Detectable>,
    /// What cannot be seen with this data, sentence by sentence.
    pub blind_spots: Vec<String>,
    /// Every cause that was judged, most probable first.
    pub evidence: Vec<Evidence>,
    /// Causes of which this data cannot tell, and why.
    pub untestable: Vec<UntestableReport>,
    /// Columns that were not judged because they follow from what was measured, in the order of the file.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<ColumnLeftOut>,
    /// Why the angles could not be judged, and what it would take; absent where they were, or where there are none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unjudged: Option<String>,
    /// How often as much is found where nothing is wrong: of angles, and of balance readings where there are no angles.
    pub null_check: NullCheck,
    /// What was measured beside the angle, by itself: flow times where there are any, and how far repeats scatter.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub beside: Vec<SideChannel>,
    /// What balance readings say by themselves; absent where none were given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub traces: Option<TraceChannel>,
    /// Every row of the file, before and after.
    pub rows: Vec<Row>,
    /// The residuals' course over what was recorded, for the figures.
    pub curves: Vec<Curve>,
    /// Whether angles of simulated heaps depend on how they are computed; absent where nothing was simulated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub numerics: Option<Numerics>,
    /// How the files were read: what each column was taken as, and what was left out.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<FileRead>,
    /// Simulations that this took.
    pub simulator_runs: u32,
    /// Time that this took, s; 0 where nobody measured it.
    pub wall_s: f64,
}

impl Report {
    /// Whether what was found makes a better simulator: days left out are predicted better, and it is more than a hint.
    pub fn is_worth_a_version(&self) -> bool {
        self.verdict != Verdict::Hint && self.gain.as_ref().is_some_and(|gain| gain.accepted)
    }

    /// A document that says nothing yet of what was judged with this p-value against this simulator.
    pub(super) fn blank(base: &str, p_value: f64, null_check: NullCheck) -> Self {
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
            simulator_version: SimulatorVersions { base: base.to_owned(), extended: None, verified: false },
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
            rows: Vec::new(),
            curves: Vec::new(),
            numerics: None,
            files: Vec::new(),
            simulator_runs: 0,
            wall_s: 0.0,
        }
    }

    /// How the files were read, and of columns that were not judged why.
    pub fn read_from(&mut self, files: &[FileRead]) {
        files.clone_into(&mut self.files);
        let columns = self.files.iter_mut().filter(|file| file.file == "measurements").flat_map(|it| &mut it.columns);
        for column in columns {
            let Some(out) = self.left_out.iter().find(|out| out.column == column.column) else { continue };
            let before = if column.note.is_empty() { "" } else { "; " };
            column.note = format!("{}{before}left out: {}", column.note, out.reason);
        }
    }
}

/// What is wrong with the simulator without any data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Numerics {
    /// The set whose heaps were poured.
    pub set: FitSet,
    /// How the angle depends on each thing about the computation.
    pub dependences: Vec<Dependence>,
}

/// Whether anything is wrong, and whether it has a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Nothing shown.
    NoDiscrepancy,
    /// One or two causes of the catalogue.
    Cause,
    /// Real, and several causes would do it.
    Ambiguous,
    /// Real, and nothing in the catalogue does it.
    Unexplained,
    /// One cause of the catalogue by the evidence, but its effect is not told from zero, or days left out are not predicted better: no cause yet.
    Hint,
}

/// Which measured quantity departs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Channel {
    /// Angle of repose.
    Repose,
    /// Flow through a hole.
    FlowTime,
    /// Balance readings of weighings.
    Trace,
    /// How far angles scatter.
    Scatter,
}

/// A departure of measured angles, or of balance readings, from the simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Finding {
    /// What departs.
    pub channel: Channel,
    /// With what it changes; absent if nobody recorded it.
    pub covariate: Option<String>,
    /// Powders whose own 95 % interval leaves out zero, as it is printed; none of balance readings, which are judged over all weighings together.
    pub powders: Vec<String>,
    /// Change from the 5th to the 95th percentile of the covariate, on average over powders; of names, from the first to the last in the
    /// alphabet, or between the two that differ most; where that is printed as zero, between the ends of what was seen.
    pub effect: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
    /// `deg`; of a flow time and of scatter `%`; of balance readings `mg`, or `%` of a shake's mass or of a reading's SD.
    pub unit: String,
    /// From where to where.
    pub span: String,
    /// The powder whose effect this is, where the average over powders, which may react in opposite ways, is not told from zero; absent: the average.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub powder: Option<String>,
    /// The same of each powder; of names, of those that were measured with both.
    pub by_powder: Vec<PowderEffect>,
}

/// An effect on one powder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PowderEffect {
    /// Powder id.
    pub powder: String,
    /// Degrees.
    pub effect: f64,
    /// 95 % interval.
    pub ci95: [f64; 2],
}

/// A cause of the catalogue.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CauseReport {
    /// Name.
    pub mechanism: String,
    /// Causes that look alike.
    pub family: String,
    /// Probability that it is at work, if anything is.
    pub inclusion_probability: f64,
    /// 1: its pattern is there; 2: the simulator extended by it predicts better what it was not fitted to; 3: an intervention confirmed it.
    pub confidence_level: u8,
    /// What was fitted.
    pub parameters: Vec<ParameterReport>,
    /// Powders on which it shows.
    pub powders: Vec<String>,
}

/// A fitted number.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Unexplained {
    /// What it depends on; absent if nothing that was recorded explains it.
    pub covariate: Option<String>,
    /// Its law, in words and numbers.
    pub law: String,
    /// Kind of law.
    pub form_class: FormClass,
}

/// Kinds of law.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FormClass {
    /// a + b x.
    Linear,
    /// a + b x^m.
    Power,
    /// A step.
    Threshold,
    /// Towards a limit.
    Saturating,
    /// A wave.
    Periodic,
    /// Smooth, of no simpler form.
    Smooth,
}

impl FormClass {
    /// As the document has it.
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Experiment {
    /// What to do, in plain words.
    pub what: String,
    /// One entry for each run, in the order in which to do them: powder and settings by column name.
    pub runs: Vec<std::collections::BTreeMap<String, String>>,
    /// How long it takes.
    pub minutes: f64,
    /// Probability that the winner's inclusion probability will pass 0.8; absent where the experiment was not simulated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub chance_of_resolution: Option<f64>,
    /// Mean inclusion probability of the right cause after it; absent where the experiment was not simulated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected_posterior: Option<f64>,
}

/// Versions of the simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SimulatorVersions {
    /// That was judged.
    pub base: String,
    /// That the findings make; absent where nothing was accepted.
    pub extended: Option<String>,
    /// Whether simulations confirmed it.
    pub verified: bool,
}

/// What an extension is worth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Gain {
    /// Days left out in turn: the number that decides.
    pub held_out: HeldOut,
    /// Powders left out in turn.
    pub by_powder: Option<HeldOut>,
    /// The highest and the lowest fifth of the covariate left out in turn.
    pub by_range: Option<HeldOut>,
    /// Mean log probability density of what was left out.
    pub log_score: LogScore,
    /// Share of what was left out within the 90 % interval.
    pub coverage90: Coverage,
    /// Error of weighings; absent where no policy was trained.
    pub weighing_error_mg: Option<WeighingGain>,
    /// Whether the extension won.
    pub accepted: bool,
}

/// Errors on what was left out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct HeldOut {
    /// Root mean square error of the simulator as it was.
    pub rmse_before: f64,
    /// Of the extended one.
    pub rmse_after: f64,
    /// 95 % interval of the difference, before less after, over days.
    pub ci95: [f64; 2],
    /// `deg`; of flow times `%`.
    pub unit: String,
    /// Runs left out.
    pub n: u32,
}

/// Log scores.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct LogScore {
    /// Nats a run.
    pub before: f64,
    /// Nats a run.
    pub after: f64,
    /// 95 % interval of the difference, after less before, over days.
    pub ci95: [f64; 2],
}

/// Coverage of 90 % intervals.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Coverage {
    /// Of the simulator as it was.
    pub before: f64,
    /// Of the extended one.
    pub after: f64,
}

/// Mean absolute errors of weighings, mg.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WeighingGain {
    /// Policy of the simulator as it was.
    pub before: f64,
    /// Policy adapted on the extended one.
    pub after: f64,
    /// Adapted as long on an extension without effect.
    pub sham: f64,
    /// Adapted on the truth, where it is known.
    pub oracle: Option<f64>,
    /// 95 % interval of before less after.
    pub ci95: [f64; 2],
}

/// What a design would find in four of five campaigns.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Detectable {
    /// Cause.
    pub mechanism: String,
    /// Change from the 5th to the 95th percentile of its covariate, all powders alike, degrees.
    pub effect_deg: f64,
    /// 0.8.
    pub power: f64,
}

/// How well a cause explains the data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Evidence {
    /// `unknown: <covariate>` is a smooth function of a covariate; `unrecorded` a wander over the sessions; `wander` one of balance readings
    /// within weighings.
    pub cause: String,
    /// Family, if it is in the catalogue.
    pub family: Option<String>,
    /// Log10 of the evidence over that of noise alone.
    pub log10_evidence: f64,
    /// Probability that it is at work, if anything is.
    pub inclusion_probability: f64,
}

/// A cause of which the data cannot tell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct UntestableReport {
    /// Name.
    pub mechanism: String,
    /// Why.
    pub reason: String,
}

/// A column that is no condition.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ColumnLeftOut {
    /// Which.
    pub column: String,
    /// Why.
    pub reason: String,
}

/// Balance readings, judged by themselves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TraceChannel {
    /// Whether anything is wrong with the simulated bench, and whether it has a name.
    pub verdict: Verdict,
    /// Chance of evidence as strong if nothing is wrong, not corrected for another channel.
    pub p_value: f64,
    /// Doses.
    pub weighings: u32,
    /// Logs of the empty pan or of a standard mass.
    pub controls: u32,
    /// Readings that were looked at.
    pub readings: u32,
    /// Shakes that were looked at.
    pub shakes: u32,
    /// How often as much is found where nothing is wrong.
    pub null_check: NullCheck,
    /// What would tell most of the balance readings.
    pub suggested_experiment: Option<Experiment>,
    /// Why what the spoon lets fall was not judged; absent where it was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unjudged: Option<String>,
}

/// What was measured beside the angle, judged by itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SideChannel {
    /// `flow_time`, or `scatter`, of which the simulator says nothing and which therefore leaves the document's verdict alone.
    pub channel: Channel,
    /// Whether it depends on anything, and whether that has a name.
    pub verdict: Verdict,
    /// Chance of evidence as strong if nothing is wrong, not corrected for other channels.
    pub p_value: f64,
    /// Flow times, or differences between repeats, that were looked at.
    pub n: u32,
    /// What it says, in plain words.
    pub sentence: String,
    /// Every cause that was judged on it, most probable first.
    pub evidence: Vec<Evidence>,
    /// How often as much is found where nothing is wrong.
    pub null_check: NullCheck,
    /// What its causes are worth on days left out; absent where no cause was proposed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain: Option<Gain>,
}

/// A row of the file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Row {
    /// Row of the file, the header being row 1.
    pub row: u32,
    /// Powder id.
    pub powder: String,
    /// Measured; absent in rows that were only predicted.
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Curve {
    /// Which.
    pub covariate: String,
    /// Names, where it is one of names: places are indices into them.
    pub levels: Vec<String>,
    /// Where each row was; absent where it was not recorded.
    pub at: Vec<Option<f64>>,
    /// The extended simulator's course over a grid: place, mean and half width of the 90 % band of one run, degrees from the powders' means.
    pub course: Vec<[f64; 3]>,
}
