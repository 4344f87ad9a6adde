//! Spoons by the batch: the unit in which they are computed, on cores or on a graphics card.
//!
//! ```text
//!   settled or loose beds --fill--> places of a Batch --step: one motion each--> how each stands
//!                                      ^  Cores: rayon over Dispenser, the same bytes on any number of threads
//!                                      |  flip-cuda: one launch for all, statistics of the same physics
//!                                      |  Several: its places dealt out to engines of one kind (several.rs)
//!   procedures that act on one spoon after the other: side_by_side (seats.rs)
//! ```
//!
//! An [`Engine`] is chosen at run time. What a spoon pours depends on its bed and its motions alone, not
//! on the other spoons of the batch.

pub mod heaps;
mod seats;
mod several;

pub use seats::{Place, Seat, side_by_side};
pub use several::Several;

use super::dispense::Dispenser;
use flip_core::domain::bench::{Action, PitchLimits};
use flip_core::learner::{Drawn, Learned, Losses, Shape};
use rayon::prelude::*;

/// What a spoon is asked to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion {
    /// An action, as [`Dispenser::step`] carries it out.
    Act(Action),
    /// Back to level, as [`Dispenser::level`] carries it out.
    Level,
    /// A loose heap comes to rest, as [`Dispenser::settle`] carries it out: what falls off is
    /// forgotten.
    Settle,
}

impl From<Action> for Motion {
    fn from(action: Action) -> Self {
        Self::Act(action)
    }
}

/// How a spoon stands after a motion.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Stand {
    /// Powder in the vial since the spoon was filled, mg.
    pub vial_mg: f64,
    /// Powder that missed the vial since then, mg.
    pub spilled_mg: f64,
    /// Powder left in the spoon, mg.
    pub spoon_mg: f64,
    /// Pitch, degrees.
    pub pitch_deg: f64,
    /// Duration of the last motion and of the powder coming to rest, s.
    pub duration_s: f64,
    /// Why the simulation is no longer meaningful, if it is not.
    pub fault: Option<String>,
}

impl Stand {
    /// How this spoon stands, having moved for so long, s.
    pub fn of(spoon: &Dispenser, duration_s: f64) -> Self {
        Self {
            vial_mg: spoon.vial_mg(),
            spilled_mg: spoon.spilled_mg(),
            spoon_mg: spoon.spoon_mg(),
            pitch_deg: spoon.pitch_deg(),
            duration_s,
            fault: spoon.fault().map(str::to_owned),
        }
    }
}

/// Why a batch did not do what was asked, for people. Its spoons are lost.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Failed(pub String);

/// Places for filled spoons that are moved side by side.
pub trait Batch: Send {
    /// How many places there are; they are counted from 0.
    fn places(&self) -> usize;

    /// Puts a copy of each of these spoonfuls into a place, and forgets what was there. A loose one
    /// first needs [`Motion::Settle`].
    ///
    /// # Errors
    /// A place that does not exist, a spoonful that this engine cannot compute, or a device that fails.
    fn fill(&mut self, beds: &[(usize, &Dispenser)]) -> Result<(), Failed>;

    /// Carries out one motion of each of these spoons, and waits for all. The results are in the order of
    /// the motions.
    ///
    /// # Errors
    /// A place that does not exist, is empty or is named twice, or a device that fails.
    fn step(&mut self, motions: &[(usize, Motion)]) -> Result<Vec<Stand>, Failed>;
}

/// Makes updates of learners of one shape.
pub trait Updates: Send {
    /// Makes an update of a learner with each of these batches, one after the other, and returns
    /// their losses. State and losses are those of `flip-learn`'s own gradients on cores in every bit.
    ///
    /// # Errors
    /// A device that fails, or a state or batch of another shape; the learner is then as it was.
    fn make(&mut self, of: &mut Learned, with: &[Drawn<'_>]) -> Result<Vec<Losses>, Failed>;
}

/// What computes batches of spoons, and on request updates of what learns from them.
pub trait Engine: Send + Sync {
    /// Its name, for people.
    fn name(&self) -> String;

    /// As many spoons as it computes best at once.
    fn places(&self) -> usize;

    /// So many empty places.
    ///
    /// # Errors
    /// A device that fails, or has too little memory.
    fn batch(&self, places: usize) -> Result<Box<dyn Batch>, Failed>;

    /// What makes updates of learners of this shape; none if they are better made on cores.
    ///
    /// # Errors
    /// A device that fails, or has too little memory.
    fn updates(&self, _: &Shape) -> Result<Option<Box<dyn Updates>>, Failed> {
        Ok(None)
    }

    /// So many empty places for heaps; none if it has no solver of heaps.
    ///
    /// # Errors
    /// A device that fails, or has too little memory.
    fn heaps(&self, _places: usize) -> Result<Option<Box<dyn heaps::Heaps>>, Failed> {
        Ok(None)
    }
}

/// A filled spoon that is moved and looked at, wherever it is computed.
pub trait Filled {
    /// Carries out a motion and waits until the powder rests; returns how long that took, s.
    fn carry_out(&mut self, motion: Motion) -> f64;
    /// The range of its pitch.
    fn pitch(&self) -> PitchLimits;
    /// Current pitch, degrees.
    fn pitch_deg(&self) -> f64;
    /// Powder in the vial, mg.
    fn vial_mg(&self) -> f64;
    /// Powder that missed the vial, mg.
    fn spilled_mg(&self) -> f64;
    /// Why the simulation is no longer meaningful, if it is not.
    fn fault(&self) -> Option<&str>;
}

impl Filled for Dispenser {
    fn carry_out(&mut self, motion: Motion) -> f64 {
        let poured = match motion {
            Motion::Act(action) => self.step(action),
            Motion::Level => self.level(),
            Motion::Settle => return self.settle(),
        };
        poured.duration_s
    }
    fn pitch(&self) -> PitchLimits {
        self.pitch()
    }
    fn pitch_deg(&self) -> f64 {
        self.pitch_deg()
    }
    fn vial_mg(&self) -> f64 {
        self.vial_mg()
    }
    fn spilled_mg(&self) -> f64 {
        self.spilled_mg()
    }
    fn fault(&self) -> Option<&str> {
        self.fault()
    }
}

/// Spoons whose powder has yet to fall: how each stands at rest, and after each of these motions, which
/// all carry out together. By spoon.
///
/// # Errors
/// As [`Batch::step`].
pub fn in_step(
    engine: &dyn Engine,
    loose: &[Dispenser],
    motions: &[Motion],
) -> Result<Vec<Vec<Stand>>, Failed> {
    let mut stands = Vec::with_capacity(loose.len());
    for some in loose.chunks(engine.places().max(1)) {
        let mut batch = engine.batch(some.len())?;
        batch.fill(&some.iter().enumerate().collect::<Vec<_>>())?;
        let mut of_each = vec![Vec::with_capacity(motions.len() + 1); some.len()];
        for motion in [Motion::Settle].iter().chain(motions) {
            let all: Vec<_> = (0..some.len()).map(|place| (place, *motion)).collect();
            for (stands, stand) in of_each.iter_mut().zip(batch.step(&all)?) {
                stands.push(stand);
            }
        }
        stands.extend(of_each);
    }
    Ok(stands)
}

/// The cores of this machine.
#[derive(Debug, Clone, Copy, Default)]
pub struct Cores;

impl Engine for Cores {
    fn name(&self) -> String {
        "the processor".to_owned()
    }

    fn places(&self) -> usize {
        4 * rayon::current_num_threads()
    }

    fn batch(&self, places: usize) -> Result<Box<dyn Batch>, Failed> {
        Ok(Box::new(OnCores { spoons: (0..places).map(|_| None).collect() }))
    }

    fn heaps(&self, places: usize) -> Result<Option<Box<dyn heaps::Heaps>>, Failed> {
        Ok(Some(Box::new(heaps::OnCores::empty(places))))
    }
}

struct OnCores {
    spoons: Vec<Option<Dispenser>>,
}

impl Batch for OnCores {
    fn places(&self) -> usize {
        self.spoons.len()
    }

    fn fill(&mut self, beds: &[(usize, &Dispenser)]) -> Result<(), Failed> {
        let places = self.spoons.len();
        for (place, bed) in beds {
            let spoon = self.spoons.get_mut(*place).ok_or_else(|| no_place(*place, places))?;
            *spoon = Some((*bed).clone());
        }
        Ok(())
    }

    fn step(&mut self, motions: &[(usize, Motion)]) -> Result<Vec<Stand>, Failed> {
        let places = self.spoons.len();
        let mut asked = vec![None; places];
        for (k, (place, motion)) in motions.iter().enumerate() {
            let slot = asked.get_mut(*place).ok_or_else(|| no_place(*place, places))?;
            if slot.replace((k, *motion)).is_some() {
                return Err(Failed(format!("place {place} is named twice in one step")));
            }
            if self.spoons[*place].is_none() {
                return Err(Failed(format!("place {place} is empty")));
            }
        }
        let carried_out = self.spoons.par_iter_mut().zip(asked).filter_map(|(spoon, asked)| {
            let ((k, motion), spoon) = (asked?, spoon.as_mut()?);
            let duration_s = Filled::carry_out(spoon, motion);
            Some((k, Stand::of(spoon, duration_s)))
        });
        let mut stands: Vec<(usize, Stand)> = carried_out.collect();
        stands.sort_unstable_by_key(|(k, _)| *k);
        Ok(stands.into_iter().map(|(_, stand)| stand).collect())
    }
}

/// The error for a place that does not exist.
pub fn no_place(place: usize, places: usize) -> Failed {
    Failed(format!("place {place} was named, and there are {places}, counted from 0"))
}

#[cfg(test)]
#[path = "batch/tests.rs"]
mod tests;
