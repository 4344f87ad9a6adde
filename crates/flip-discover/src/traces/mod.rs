//! Finds what the simulated balance gets wrong, from balance readings during weighings, and what
//! makes shakes depart from a law of amplitude, pitch and powder. What the simulated *spoon* gets
//! wrong is for `spoon/`, which replays weighings; a dose that looks for its onset is left to it.
//!
//! ```text
//! readings.rs    what was recorded
//! design.rs      from readings to plateaus, masses of shakes, scatter
//! bench.rs       the simulated spoon and balance that signatures come from
//! catalogue.rs   the causes and their forms
//! shakes.rs      what each powder's spoon lets fall
//! noise.rs       noise of each level, plain or wandering
//! evidence.rs    how well signatures explain, weighing by weighing
//! level.rs       a level, judged
//! simulate.rs    readings in which nothing is wrong
//! screen.rs      is anything wrong, and what explains it best
//! span.rs        how large a cause is over what it goes with
//! report.rs      what of it a document has            words.rs   its sentences and experiments
//! ```
//!
//! As for angles of repose, anything a calibration would absorb is not judged, and the best of all
//! causes is compared with the best in readings of the same design where nothing is wrong.
//! Something that wanders in each weighing in its own way has no signature: it is judged alongside
//! the causes, and a cause that leaves too much of it loses its name.

mod bench;
mod catalogue;
mod design;
mod evidence;
mod level;
mod noise;
mod parameter;
pub mod readings;
pub(super) mod report;
mod screen;
mod shakes;
mod simulate;
mod span;
mod words;

#[cfg(test)]
mod tests;

pub use catalogue::TraceMechanism;
pub use parameter::Parameter;
pub use readings::{Kind, Reading, Traces, Weighing};
pub use report::WANDER;
pub use screen::{
    Effect as TraceEffect, Settings, TraceCause, TraceJudged, TraceScreening, Unjudged,
    screen_traces,
};
