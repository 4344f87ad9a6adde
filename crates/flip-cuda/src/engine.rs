//! A card as an engine of batches, and of updates.

use crate::layout::Kernel;
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
        let of = (0..places).map(|_| Kernel::Base).collect();
        Ok(Box::new(Table { card: self.clone(), of, base: None, extended: None }))
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

/// Places for spoons of any powder: those whose grains turn have a table of their own.
struct Table {
    card: Card,
    /// In which one each spoon is.
    of: Vec<Kernel>,
    /// Made when they are first needed, with all places.
    base: Option<Spoons>,
    extended: Option<Spoons>,
}

impl Table {
    fn table(&mut self, kernel: Kernel) -> crate::Result<&mut Spoons> {
        let places = self.of.len();
        let table = match kernel {
            Kernel::Base => &mut self.base,
            Kernel::Extended => &mut self.extended,
        };
        if let Some(table) = table {
            return Ok(table);
        }
        Ok(table.insert(Spoons::empty(&self.card, kernel, places)?))
    }
}

impl Batch for Table {
    fn places(&self) -> usize {
        self.of.len()
    }

    fn fill(&mut self, beds: &[(usize, &Dispenser)]) -> Result<(), Failed> {
        for (place, bed) in beds {
            let bed = Bed::of(bed).map_err(CardError::from)?;
            let kernel = bed.kernel();
            self.table(kernel)?.put(*place, bed)?;
            self.of[*place] = kernel;
        }
        Ok(())
    }

    fn step(&mut self, motions: &[(usize, Motion)]) -> Result<Vec<Stand>, Failed> {
        let mut stands = vec![None; motions.len()];
        for kernel in [Kernel::Base, Kernel::Extended] {
            // A place that does not exist is named by the table.
            let is_here =
                |place: &usize| self.of.get(*place).copied().unwrap_or(Kernel::Base) == kernel;
            let numbers: Vec<usize> =
                (0..motions.len()).filter(|k| is_here(&motions[*k].0)).collect();
            if numbers.is_empty() {
                continue;
            }
            let these: Vec<_> = numbers.iter().map(|k| motions[*k]).collect();
            let table = self.table(kernel)?;
            let poured = table.carry_out(&these)?;
            for ((k, (place, _)), poured) in numbers.iter().zip(&these).zip(poured) {
                let [vial_mg, spilled_mg] = table.left_mg(*place)?;
                stands[*k] = Some(Stand {
                    vial_mg,
                    spilled_mg,
                    spoon_mg: poured.spoon_mg,
                    pitch_deg: poured.pitch_deg,
                    duration_s: poured.duration_s,
                    fault: poured.fault.map(|fault| fault.to_string()),
                });
            }
        }
        Ok(stands.into_iter().flatten().collect())
    }
}
