//! A card as an engine of batches, and of updates.

use crate::{Bed, Card, CardError, Heaps, Learners, Spoons};
use flip_core::learner::{Drawn, Learned, Losses, Shape};
use flip_sim::batch::heaps;
use flip_sim::batch::{Batch, Engine, Failed, Motion, Stand, Updates};
use flip_sim::dispense::Dispenser;

/// Spoons for each multiprocessor: with a queue of them, none waits long for the slowest of a batch.
const QUEUED: usize = 4;

impl From<CardError> for Failed {
    fn from(error: CardError) -> Self {
        Self(error.to_string())
    }
}

impl Engine for Card {
    fn name(&self) -> String {
        self.found().to_string()
    }

    fn places(&self) -> usize {
        QUEUED * self.multiprocessors()
    }

    fn batch(&self, places: usize) -> Result<Box<dyn Batch>, Failed> {
        Ok(Box::new(Spoons::empty(self, places)?))
    }

    fn updates(&self, shape: &Shape) -> Result<Option<Box<dyn Updates>>, Failed> {
        match Learners::serves(self, shape)? {
            true => Ok(Some(Box::new(Learners::empty(self, *shape, 1)?))),
            false => Ok(None),
        }
    }

    fn heaps(&self, places: usize) -> Result<Option<Box<dyn heaps::Heaps>>, Failed> {
        Ok(Some(Box::new(Heaps::empty(self, places)?)))
    }
}

/// Those of the first training.
impl Updates for Learners {
    fn make(&mut self, of: &mut Learned, with: &[Drawn<'_>]) -> Result<Vec<Losses>, Failed> {
        self.put(0, of)?;
        let made = self.update(with)?;
        *of = self.learned(0)?;
        Ok(made)
    }
}

impl Batch for Spoons {
    fn places(&self) -> usize {
        self.count()
    }

    fn fill(&mut self, beds: &[(usize, &Dispenser)]) -> Result<(), Failed> {
        for (place, bed) in beds {
            self.put(*place, Bed::of(bed).map_err(CardError::from)?)?;
        }
        Ok(())
    }

    fn step(&mut self, motions: &[(usize, Motion)]) -> Result<Vec<Stand>, Failed> {
        let poured = self.carry_out(motions)?;
        let stand = |((place, _), poured): (&(usize, Motion), crate::Poured)| {
            let [vial_mg, spilled_mg] = self.left_mg(*place)?;
            Ok(Stand {
                vial_mg,
                spilled_mg,
                spoon_mg: poured.spoon_mg,
                pitch_deg: poured.pitch_deg,
                duration_s: poured.duration_s,
                fault: poured.fault.map(|fault| fault.to_string()),
            })
        };
        motions.iter().zip(poured).map(stand).collect()
    }
}
