//! Whole episodes, replayed for a recurrent network.

use super::replay::{Batch, Courses, Memory, Ring, drawn_target};
use super::settings::Settings;
use flip_policy::{Actor, OUTPUTS};
use rand::Rng;

/// A stored episode.
#[derive(Debug, Clone, PartialEq)]
pub struct Episode {
    /// Its steps.
    pub steps: Vec<Memory>,
    /// The actor's state `[2 * hidden]` after the first step, with its weights at that time; empty
    /// if not stored.
    pub state: Vec<f32>,
}

impl Episode {
    /// Stores these steps of an episode that `actor` played, or could have played if the actions
    /// were random.
    ///
    /// The published code stores the state before the first step, which is zero, and this one. It
    /// depends on the first observation alone, so it is computed here.
    pub fn new(steps: Vec<Memory>, actor: &Actor, settings: &Settings) -> Self {
        let state = match steps.first() {
            Some(first) if settings.stores_states() => {
                let mut carried = actor.begin();
                let seen = first.before(first.target_mg.into());
                actor.forward(&seen.encode(settings.encoding, &first.known_before()), &mut carried);
                carried.to_flat()
            }
            _ => Vec::new(),
        };
        Self { steps, state }
    }
}

/// Draws `batch` episodes with replacement. One relabelled with another target ends where it would
/// have ended for that target.
pub(super) fn draw(ring: &Ring<Episode>, settings: &Settings, rng: &mut impl Rng) -> Batch {
    let mut batch = Batch::default();
    let mut stored = Vec::new();
    // Per episode: the observations before each step and after the last, each with the preceding
    // action.
    let mut courses: Vec<Vec<f32>> = Vec::new();
    for _ in 0..settings.batch {
        let episode = ring.pick(rng);
        let target_mg = drawn_target(&episode.steps[0], settings, rng);
        stored.extend(&episode.state);
        let mut course = Vec::new();
        let first = &episode.steps[0];
        first.before(target_mg).encode_into(settings.encoding, &first.known_before(), &mut course);
        course.extend([0.0; OUTPUTS]);
        for memory in &episode.steps {
            let ends = batch.push(memory, target_mg, settings);
            memory.after(target_mg).encode_into(
                settings.encoding,
                &memory.known_after(),
                &mut course,
            );
            course.extend(memory.step.action);
            if ends {
                break;
            }
        }
        courses.push(course);
    }
    batch.courses = Some(interleave(&courses, settings.encoding.width() + OUTPUTS, stored));
    batch
}

/// Interleaves courses of any length, with rows of `width` numbers.
pub(super) fn interleave(courses: &[Vec<f32>], width: usize, stored: Vec<f32>) -> Courses {
    let (episodes, longest) = (courses.len(), courses.iter().map(Vec::len).max().unwrap_or(0));
    let mut inputs = vec![0.0; longest * episodes];
    let mut at = Vec::new();
    for (e, course) in courses.iter().enumerate() {
        for (step, row) in course.chunks_exact(width).enumerate() {
            let place = step * episodes + e;
            inputs[place * width..(place + 1) * width].copy_from_slice(row);
            at.push(place as i64);
        }
        // Nothing follows the last observation.
        at.pop();
    }
    Courses { episodes, inputs, at, stored: (!stored.is_empty()).then_some(stored) }
}

#[cfg(test)]
#[path = "episodes_tests.rs"]
mod tests;
