//! The document of what spoonfuls say.

use super::Verdict;
use crate::thresholds::CLAIM;
use flip_core::domain::conditions::Patch;
use serde::{Deserialize, Serialize};

/// What is changed about a simulated spoonful. Nothing by default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Change {
    /// Of the powder; holds in heaps and spoons alike.
    pub patch: Patch,
    /// Factor on the amplitude of every stroke.
    pub stroke: f64,
    /// Factor on what the spoon is filled with.
    pub fill: f64,
    /// Added to the Coulomb coefficient of the spoon.
    pub spoon_friction: f64,
}

impl Default for Change {
    fn default() -> Self {
        Self { patch: Patch::default(), stroke: 1.0, fill: 1.0, spoon_friction: 0.0 }
    }
}

/// A cause of a discrepancy of spoonfuls.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SpoonCause {
    /// Grains attract each other more than the angle shows.
    Cohesion,
    /// Water bridges grains.
    Humidity,
    /// Contacts grow stronger with their age.
    Consolidation,
    /// What attracts grains to each other attracts them to the spoon as well.
    Stickiness,
    /// Grains turn, and resist turning.
    Shape,
    /// Grains differ in size.
    SizeSpread,
    /// Grains stick to the spoon.
    SpoonAdhesion,
    /// Charged grains are attracted by the spoon.
    Charge,
    /// A film of grains stays on the spoon.
    SpoonHoldup,
    /// The spoon is rougher.
    SpoonFriction,
    /// The set has another gravity than the bench.
    GravityScale,
    /// Strokes are shorter than recorded.
    Actuator,
    /// The spoon holds less than simulated.
    FillLevel,
}

/// What weighings say of the simulated spoon.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpoonReport {
    /// In plain words, a sentence for each powder.
    pub sentence: String,
    /// Smallest corrected p of all powders.
    pub p_value: f64,
    /// Powder by powder, in the order of their first spoonful.
    pub powders: Vec<PowderReport>,
    /// Powders that were not judged, and why.
    pub unjudged: Vec<Unjudged>,
    /// Replays of all spoonfuls as calibrated: p cannot be below one in as many.
    pub campaigns: u32,
    /// Replayed spoonfuls.
    pub replays: u32,
    /// Poured heaps.
    pub heaps: u32,
    /// Limits of these data and of the comparison, sentence by sentence.
    pub blind_spots: Vec<String>,
}

/// A powder that was not judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Unjudged {
    /// Powder, by id.
    pub powder: String,
    /// Why.
    pub why: String,
}

/// How probable a family of causes is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FamilyShare {
    /// Family within which causes look alike.
    pub family: String,
    /// Probability that the cause is of it, if anything is wrong.
    pub probability: f64,
}

/// What the spoonfuls of one powder say.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PowderReport {
    /// Powder, by id.
    pub powder: String,
    /// Whether anything is wrong, and whether it has a name.
    pub verdict: Verdict,
    /// In plain words.
    pub sentence: String,
    /// Chance of lying as far from the replays if nothing is wrong.
    pub p_value: f64,
    /// The same for any powder of the file.
    pub p_corrected: f64,
    /// Spoonfuls judged, of those given.
    pub spoonfuls: [u32; 2],
    /// Calibrated sets.
    pub sets: u32,
    /// Onset, masses, scatter: measured, and what replays give.
    pub summaries: Vec<SummaryRow>,
    /// Spoonful by spoonful, step by step.
    pub courses: Vec<CourseReport>,
    /// Causes, most probable first; empty where nothing was found.
    pub causes: Vec<SpoonCauseReport>,
    /// Probability of each family of causes, most probable first.
    pub families: Vec<FamilyShare>,
    /// Probability of a cause that is not in the catalogue.
    pub unknown_probability: f64,
    /// With verdict `ambiguous`: causes that these data cannot distinguish.
    pub ambiguous_between: Vec<String>,
    /// On spoonfuls left out; absent where nothing was found or too few can be left out.
    pub gain: Option<SpoonGain>,
    /// The most probable cause as changes of the simulator; absent unless it predicts spoonfuls left
    /// out better. With verdict `ambiguous` it does so by itself, whatever its name.
    pub extension: Option<SpoonExtension>,
}

impl PowderReport {
    /// With verdict `ambiguous`: the family of all its causes, if it is as probable as a cause that is
    /// claimed.
    pub fn named_family(&self) -> Option<&FamilyShare> {
        let first = self.families.first().filter(|it| it.probability >= CLAIM)?;
        (self.verdict == Verdict::Ambiguous).then_some(first)
    }
}

/// One number of a powder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SummaryRow {
    /// `onset`, `total`, `scatter`, or the cell of pitch and stroke of a mean step.
    pub name: String,
    /// `deg`, `mg`, or empty.
    pub unit: String,
    /// By the balance.
    pub measured: f64,
    /// Median of replays.
    pub simulated: f64,
    /// 5th to 95th percentile of replays: balance, shakes, spoonfuls, days and sets together.
    pub band90: [f64; 2],
}

/// A spoonful, step by step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CourseReport {
    /// Id of the weighing.
    pub weighing: String,
    /// Which spoonful of it.
    pub spoonful: u32,
    /// Steps in order.
    pub steps: Vec<StepReport>,
    /// What stays in the spoon, mg: measured, and by replays; absent where the filling is unknown.
    pub left_mg: Option<[f64; 2]>,
    /// Mass at the end with the causes found, mg.
    pub after_mg: Option<f64>,
}

/// One step: what had fallen at its end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StepReport {
    /// Pitch, deg.
    pub pitch_deg: f64,
    /// Stroke, mm.
    pub shake_mm: f64,
    /// By the balance, mg.
    pub weighed_mg: f64,
    /// Median of replays, mg.
    pub simulated_mg: f64,
    /// 5th to 95th percentile of replays, mg.
    pub band90_mg: [f64; 2],
}

/// A cause.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpoonCauseReport {
    /// Which.
    pub cause: SpoonCause,
    /// Family within which causes look alike.
    pub family: String,
    /// Probability that it is the one, if anything is wrong.
    pub probability: f64,
    /// Log10 of its evidence over that of the calibrated sets.
    pub log10_evidence: f64,
    /// How strong it is, in the simulator's units.
    pub amplitude: f64,
    /// 95 % interval.
    pub amplitude_ci95: [f64; 2],
    /// What it changes in a spoonful, mg.
    pub effect_mg: f64,
    /// 95 % interval.
    pub effect_ci95_mg: [f64; 2],
    /// Angle of the heap with it, deg; absent where no angle was measured.
    pub angle_deg: Option<f64>,
    /// The experiment that would prove it.
    pub experiment: String,
}

/// The gain of the causes on spoonfuls left out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpoonGain {
    /// What was left out in turn: `session` or `weighing`.
    pub by: String,
    /// Spoonfuls predicted.
    pub spoonfuls: u32,
    /// Mean absolute error of a spoonful's mass by the calibrated sets, mg.
    pub error_before_mg: f64,
    /// By the causes.
    pub error_after_mg: f64,
    /// By a catalogue of causes that change nothing.
    pub error_sham_mg: f64,
    /// 95 % interval of before less after, mg.
    pub gain_ci95_mg: [f64; 2],
    /// Whether the causes won: against the sets by this interval, and against the sham.
    pub accepted: bool,
}

/// A cause as changes of the simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpoonExtension {
    /// Which.
    pub cause: SpoonCause,
    /// What is changed, with the friction that keeps the angle.
    pub change: Change,
    /// Whether it belongs to the powder; if not, to the bench, whose settings it corrects.
    pub is_of_powder: bool,
}
