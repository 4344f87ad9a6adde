//! Films of spoonfuls, heaps and episodes.

use super::{BenchKind, Job, Labels};
use crate::app;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A film to make: of a spoonful of a weighing, of a heap of a parameter set, or of a dose with the
/// network of a training's episode.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FilmRequest {
    /// Weighing id.
    pub weighing: Option<String>,
    /// Which spoonful of it, from 1; default the first.
    pub spoonful: Option<u32>,
    /// Parameter set id, in place of a weighing.
    pub set: Option<String>,
    /// Seed of its heap. Default 1.
    pub seed: Option<u64>,
    /// Training id, in place of a weighing.
    pub training: Option<String>,
    /// Which episode of it: one of its `kept_episodes`.
    pub episode: Option<u32>,
    /// What the caller writes on it, to find it again.
    #[serde(default)]
    pub labels: Labels,
}

request! { FilmRequest => app::FilmRequest { weighing, spoonful, set, seed, training, episode, labels } }

/// A film: its job, what it shows, and its numbers once it has succeeded.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Film {
    /// The job; the film has the same id.
    pub job: Job,
    /// Weighing id; absent of a heap and of an episode.
    pub weighing: Option<String>,
    /// Which spoonful of it.
    pub spoonful: Option<u32>,
    /// The bench that shook it. On devices the film is what the simulator makes of the same moves.
    pub bench: Option<BenchKind>,
    /// Parameter set id of a heap or an episode; absent of a weighing.
    pub set: Option<String>,
    /// Seed of the heap or the episode.
    pub seed: Option<u64>,
    /// Training id of an episode.
    pub training: Option<String>,
    /// The episode, from 1, whose network doses.
    pub episode: Option<u32>,
    /// Target of that dose, mg.
    pub target_mg: Option<f64>,
    /// The film; absent until it has succeeded.
    pub result: Option<FilmResult>,
}

answer! { app::Film => Film {
    job, weighing, spoonful, bench, set, seed, training, episode, target_mg, result,
} }

/// A film that was made.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct FilmResult {
    /// SHA-256 of the file.
    pub sha256: String,
    /// Size of the file, bytes.
    pub size_bytes: u64,
    /// What it says in numbers; absent of a heap.
    pub head: Option<FilmHead>,
    /// What a film of a heap says in numbers; absent of a spoonful.
    pub heap: Option<HeapHead>,
}

answer! { app::FilmResult => FilmResult { sha256, size_bytes, head, heap } }

/// What a film of a heap says in numbers.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct HeapHead {
    /// Version of the simulator.
    pub simulator: String,
    /// Number of grains poured.
    pub grains: u32,
    /// Number of frames.
    pub frames: u32,
    /// Number of grains that fell off the base.
    pub falls: u32,
    /// Diameter of a mean grain, mm.
    pub grain_mm: f64,
    /// Simulated time between two frames, s.
    pub every_s: f64,
    /// Simulated time in all, s.
    pub duration_s: f64,
    /// Radius of the base, mm.
    pub base_radius_mm: f64,
    /// Number of grains that stayed on the base.
    pub on_base: u32,
    /// Angle from the apex, atan(2 h / d_base), degrees: the one that calibration uses.
    pub tip_deg: f64,
    /// Slope of the cone fitted between 20 % and 80 % of the height, degrees.
    pub cone_deg: f64,
    /// h: height of the apex over the base, mm.
    pub height_mm: f64,
    /// Height of the cone's point over the base, mm.
    pub cone_height_mm: f64,
    /// What the cone was fitted to.
    pub rings: Vec<HeapRing>,
}

answer! { app::HeapHead => HeapHead {
    simulator, grains, frames, falls, grain_mm, every_s, duration_s, base_radius_mm, on_base,
    tip_deg, cone_deg, height_mm, cone_height_mm, rings,
} }

/// The mean surface of a ring, one grain wide, in one of twelve sectors around the axis.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct HeapRing {
    /// Which sector, from 0, against the clock, beginning opposite to x.
    pub sector: u32,
    /// Mean distance from the axis, mm.
    pub radius_mm: f64,
    /// Mean height over the base, mm.
    pub height_mm: f64,
}

answer! { app::HeapRing => HeapRing { sector, radius_mm, height_mm } }

/// What a film of a spoonful says in numbers.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct FilmHead {
    /// Version of the simulator.
    pub simulator: String,
    /// Number of grains in the spoon at first.
    pub grains: u32,
    /// Number of frames.
    pub frames: u32,
    /// Number of grains that left the spoon.
    pub falls: u32,
    /// Diameter of a mean grain, mm.
    pub grain_mm: f64,
    /// Mass of a mean grain, mg.
    pub grain_mg: f64,
    /// Semi-axes of the bowl, half an ellipsoid, along its length, width and depth, mm.
    pub bowl_mm: [f64; 3],
    /// Radius of the vial's mouth, mm.
    pub vial_radius_mm: f64,
    /// From the middle of the spoon at rest to the axis of the vial, along the spoon, mm.
    pub vial_offset_mm: f64,
    /// Height of the level spoon's rim above the vial's mouth, mm.
    pub drop_height_mm: f64,
    /// Simulated time between two frames, s.
    pub every_s: f64,
    /// Simulated time in all, s: motion and the powder coming to rest, without the bench's waits.
    pub duration_s: f64,
    /// Powder in the spoon before the first step, mg.
    pub filled_mg: f64,
    /// Powder that fell into the vial, mg.
    pub vial_mg: f64,
    /// Powder that missed it, mg.
    pub spilled_mg: f64,
    /// The steps in order, the last of them the way back to level.
    pub steps: Vec<FilmStep>,
}

answer! { app::FilmHead => FilmHead {
    simulator, grains, frames, falls, grain_mm, grain_mg, bowl_mm, vial_radius_mm, vial_offset_mm,
    drop_height_mm, every_s, duration_s, filled_mg, vial_mg, spilled_mg, steps,
} }

/// One step of a film.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct FilmStep {
    /// When it begins, s.
    pub begins_s: f64,
    /// Pitch during its strokes and after them, degrees; positive is tip down.
    pub pitch_deg: f64,
    /// Amplitude of a stroke, mm; 0 for none.
    pub shake_mm: f64,
    /// Number of strokes.
    pub strokes: u32,
    /// Powder that fell into the vial during the step, mg.
    pub fell_mg: f64,
    /// Powder in the spoon after it, mg.
    pub spoon_mg: f64,
    /// Powder in the vial after it, mg.
    pub vial_mg: f64,
}

answer! { app::StepSeen => FilmStep {
    begins_s, pitch_deg, shake_mm, strokes, fell_mg, spoon_mg, vial_mg,
} }
