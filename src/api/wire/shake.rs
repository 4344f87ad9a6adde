//! What spoons let fall, shake by shake.

use super::{BenchKind, MotionLimits, NamedPowder, Timestamp, is_default};
use crate::app;
use serde::Serialize;
use utoipa::ToSchema;

/// The conditions of a weighing that its readings and actions do not show.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Apparatus {
    /// Step of the balance's display, mg.
    pub readability_mg: f64,
    /// SD of repeated readings of one weight, mg; absent if it was not checked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeatability_mg: Option<f64>,
    /// Mass of one filling of the spoon, mg; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub capacity_mg: Option<f64>,
    /// The strokes of the arm; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stroke: Option<Stroke>,
}

answer! { flip_core::domain::apparatus::Apparatus => Apparatus {
    readability_mg, repeatability_mg, capacity_mg, stroke,
} }

/// How an arm strokes.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Stroke {
    /// Largest amplitude that may be commanded, mm.
    pub shake_mm_max: f64,
    /// The limits within which a commanded stroke is planned.
    pub limits: MotionLimits,
    /// The arm's response, by which commands were corrected; absent if it was not measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub response: Option<StrokeResponse>,
}

answer! { flip_core::domain::apparatus::Stroke => Stroke { shake_mm_max, limits, response } }

/// A measured response to commanded strokes.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct StrokeResponse {
    /// Executed over commanded amplitude.
    pub gain: f64,
    /// Executed amplitude at zero commanded amplitude, mm.
    pub offset_mm: f64,
    /// Executed over planned peak speed.
    pub speed_gain: f64,
}

answer! { flip_core::domain::apparatus::StrokeResponse => StrokeResponse {
    gain, offset_mm, speed_gain,
} }

/// A spoonful and where it comes from.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct KeptSpoonful {
    /// The spoonful.
    pub spoonful: Spoonful,
    /// The bench that shook it; absent if it was imported.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bench: Option<BenchKind>,
    /// Where imported numbers come from.
    #[serde(default, skip_serializing_if = "is_default")]
    pub source: String,
    /// When the weighing began, or when it was imported.
    pub at: Timestamp,
}

answer! { app::KeptSpoonful => KeptSpoonful { spoonful, bench, source, at } }

/// The steps of one filling of the spoon, in order, and what it was filled with.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Spoonful {
    /// Id of the weighing, or of the run in a file.
    pub weighing: String,
    /// Which spoonful of the weighing; the first is 1.
    pub spoonful: u32,
    /// Powder, by id.
    pub powder: String,
    /// Lot of the powder; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lot: Option<String>,
    /// Day, or another unit over which powder and bench are alike.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<String>,
    /// Step of the balance's display, mg; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub readability_mg: Option<f64>,
    /// In the order in which they were made.
    pub shakes: Vec<Shake>,
}

answer! { flip_core::domain::shake::Spoonful => Spoonful {
    weighing, spoonful, powder, lot, session, readability_mg, shakes,
} }

/// One step of a spoonful: the pitch it went to, then the shake made there.
///
/// A reading may be below zero and a shake may give nothing: both are measurements.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Shake {
    /// Pitch of the spoon during the shake, degrees; positive is tip down.
    pub pitch_deg: f64,
    /// Amplitude as executed, mm; 0 where the step only changed the pitch.
    pub shake_mm: f64,
    /// How often it was made before the reading.
    pub strokes: u32,
    /// Largest acceleration of the stroke, m/s^2; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acceleration_m_s2: Option<f64>,
    /// Powder in the spoon before the step, mg: filled less fallen; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spoon_mg: Option<f64>,
    /// Mass that fell during the step, by the balance, mg.
    pub fell_mg: f64,
    /// Its standard uncertainty, mg.
    pub sd_mg: f64,
    /// Time from filling the spoon to the end of the step, s; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub since_filled_s: Option<f64>,
}

answer! { flip_core::domain::shake::Shake => Shake {
    pitch_deg, shake_mm, strokes, acceleration_m_s2, spoon_mg, fell_mg, sd_mg, since_filled_s,
} }

/// Result of importing a file of shakes.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ImportedShakes {
    /// Ids of the powders registered because the file names them.
    pub powders: Vec<String>,
    /// Powders given by name in the file, with the ids made or found for them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub named: Vec<NamedPowder>,
    /// Spoonfuls added.
    pub spoonfuls: usize,
    /// Their shakes.
    pub shakes: usize,
    /// Spoonfuls of the file that were stored already with the same shakes, and were skipped.
    #[serde(default, skip_serializing_if = "is_default")]
    pub already_stored: usize,
}

answer! { app::ImportedShakes => ImportedShakes {
    powders, named, spoonfuls, shakes, already_stored,
} }

/// What was forgotten.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ForgottenShakes {
    /// Up to when.
    pub forgotten: Forgotten,
    /// Spoonfuls that were listed until then.
    pub spoonfuls: usize,
}

answer! { app::ForgottenShakes => ForgottenShakes { forgotten, spoonfuls } }

/// Up to when the shakes of a powder, or of one of its lots, are neither used nor listed.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Forgotten {
    /// Id.
    pub id: String,
    /// Powder id.
    pub powder: String,
    /// The lot; absent for all lots and shakes of unknown lots.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lot: Option<String>,
    /// Weighings that began, and spoonfuls imported, until then.
    pub at: Timestamp,
}

answer! { flip_store::spoonfuls::Forgotten => Forgotten { id, powder, lot, at } }
