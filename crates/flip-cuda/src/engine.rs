//! A card as an engine of batches.

use crate::{Bed, Card, CardError, Spoons};
use flip_sim::batch::{Batch, Engine, Failed, Motion, Stand};
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
