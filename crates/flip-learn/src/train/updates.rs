//! The updates of a round: on cores one after the other, or on what an engine has for them.
//!
//! ```text
//!   replay --draw: cores, a seed for each update--> a piece of batches --> Updates: one launch
//!                                                   the next piece        (or Learner::update, one by one)
//! ```
//!
//! The replay memory does not change within a round, so batches are drawn in advance: those of the
//! next piece while the present one is learned from.

use super::plan::stream;
use super::record::Losses;
use super::replay::{Batch, Replay};
use super::sac::Learner;
use super::settings::Settings;
use flip_core::domain::seed::derive;
use flip_core::learner::Drawn;
use flip_policy::normal;
use flip_sim::batch::{Engine, Failed, Updates};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use std::ops::Range;

/// Numbers in a piece of batches: 16 MiB, of which two are held at a time.
const PIECE: usize = 1 << 22;

/// What makes the updates of a training.
pub(super) struct Updating {
    beside: Option<Box<dyn Updates>>,
    /// Updates in a piece.
    piece: u64,
    failed: Option<Failed>,
}

impl Updating {
    /// The cores.
    pub(super) fn on_cores() -> Self {
        Self { beside: None, piece: 1, failed: None }
    }

    /// What this engine has for a learner of these settings; the cores where it has nothing.
    ///
    /// # Errors
    /// A device that fails, or has too little memory.
    pub(super) fn on(engine: &dyn Engine, settings: &Settings) -> Result<Self, Failed> {
        let Some(shape) = Learner::shape(settings) else { return Ok(Self::on_cores()) };
        let piece = (PIECE / shape.drawn().max(1)).max(1) as u64;
        Ok(Self { beside: engine.updates(&shape)?, piece, failed: None })
    }

    /// Why the updates are no longer made on an engine.
    pub(super) fn failed(&self) -> Option<&Failed> {
        self.failed.as_ref()
    }

    /// Makes the updates of these numbers; returns the sum of their losses.
    pub(super) fn make(
        &mut self,
        mut numbers: Range<u64>,
        learner: &mut Learner,
        replay: &Replay,
        settings: &Settings,
    ) -> Losses {
        let mut sum = Losses::default();
        let mut count = |seen: Losses| {
            sum.critic += seen.critic;
            sum.actor += seen.actor;
            sum.entropy += seen.entropy;
            sum.alpha += seen.alpha;
        };
        if self.beside.is_some() && !numbers.is_empty() {
            let (made, end) = self.make_beside(numbers.clone(), learner, replay, settings);
            made.into_iter().for_each(&mut count);
            numbers.start = end;
        }
        // All of them, or what a device that failed has left: the bits are the same.
        for number in numbers {
            let Update { batch, noise } = Update::drawn(number, replay, settings);
            count(learner.update(&batch, &noise, settings));
        }
        sum
    }

    /// Makes them on the engine, piece by piece; returns their losses, and which comes next if it
    /// fails.
    fn make_beside(
        &mut self,
        numbers: Range<u64>,
        learner: &mut Learner,
        replay: &Replay,
        settings: &Settings,
    ) -> (Vec<Losses>, u64) {
        let Some(beside) = &mut self.beside else { return (Vec::new(), numbers.start) };
        let piece = |from: u64| from..numbers.end.min(from.saturating_add(self.piece));
        let draw = |numbers: Range<u64>| -> Vec<Update> {
            numbers.into_par_iter().map(|it| Update::drawn(it, replay, settings)).collect()
        };
        let (mut learned, mut losses, mut next) = (learner.learned(), Vec::new(), numbers.start);
        let mut drawn = draw(piece(next));
        while !drawn.is_empty() {
            let after = next + drawn.len() as u64;
            let with: Vec<Drawn<'_>> = drawn.iter().map(Update::plain).collect();
            let mut following = Vec::new();
            let made = rayon::in_place_scope(|scope| {
                scope.spawn(|_| following = draw(piece(after)));
                beside.make(&mut learned, &with)
            });
            match made {
                Ok(made) => losses.extend(made),
                Err(failed) => {
                    (self.beside, self.failed) = (None, Some(failed));
                    break;
                }
            }
            (drawn, next) = (following, after);
        }
        learner.put(learned);
        (losses, next)
    }
}

/// What is drawn for an update.
struct Update {
    batch: Batch,
    noise: Vec<f32>,
}

impl Update {
    /// For the update of this number, counted over the whole training.
    fn drawn(number: u64, replay: &Replay, settings: &Settings) -> Self {
        let seed = derive(settings.seed, &[stream::UPDATE, number]);
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let batch = replay.draw(settings, &mut rng);
        let noise = (0..4 * batch.reward.len()).map(|_| normal(&mut rng)).collect();
        Self { batch, noise }
    }

    fn plain(&self) -> Drawn<'_> {
        let Batch { now, next, reward, goes_on, .. } = &self.batch;
        Drawn { now, next, reward, goes_on, noise: &self.noise }
    }
}
