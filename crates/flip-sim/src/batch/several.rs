//! Several engines of one kind as one.
//!
//! Places are dealt out in turn, so that each engine has as many as any other or one more. The engines
//! work at the same time and exchange nothing.

use super::{Batch, Engine, Failed, Motion, Stand, Updates, no_place};
use crate::dispense::Dispenser;
use flip_core::learner::Shape;
use std::sync::Arc;

/// Engines of one kind, such as the graphics cards of a computer; at least one.
pub struct Several(Vec<Arc<dyn Engine>>);

impl Several {
    /// The engines as one; none if there are none.
    pub fn of(engines: Vec<Arc<dyn Engine>>) -> Option<Arc<dyn Engine>> {
        match engines.len() {
            0 | 1 => engines.into_iter().next(),
            _ => Some(Arc::new(Self(engines))),
        }
    }
}

impl Engine for Several {
    fn name(&self) -> String {
        format!("{} × {}", self.0.len(), self.0[0].name())
    }

    fn places(&self) -> usize {
        self.0.iter().map(|engine| engine.places()).sum()
    }

    fn batch(&self, places: usize) -> Result<Box<dyn Batch>, Failed> {
        let count = self.0.len();
        let share = |(k, engine): (usize, &Arc<dyn Engine>)| {
            let of_it = (places + count - 1 - k) / count;
            (of_it > 0).then(|| engine.batch(of_it))
        };
        let batches = self.0.iter().enumerate().filter_map(share).collect::<Result<_, _>>()?;
        Ok(Box::new(Dealt { batches, filled: vec![false; places] }))
    }

    /// A learner is on one of them.
    fn updates(&self, shape: &Shape) -> Result<Option<Box<dyn Updates>>, Failed> {
        self.0[0].updates(shape)
    }
}

/// The place of one batch that is dealt out to several.
struct Dealt {
    batches: Vec<Box<dyn Batch>>,
    filled: Vec<bool>,
}

impl Dealt {
    /// Which of the batches has a place, and its number there.
    fn at(&self, place: usize) -> Result<(usize, usize), Failed> {
        let (places, count) = (self.filled.len(), self.batches.len());
        if place < places {
            Ok((place % count, place / count))
        } else {
            Err(no_place(place, places))
        }
    }

    /// Does the same with all batches at once, each with its own share.
    fn each<T: Send, R: Send>(
        &mut self,
        shares: Vec<Vec<T>>,
        act: impl Fn(&mut dyn Batch, Vec<T>) -> Result<R, Failed> + Sync,
    ) -> Result<Vec<R>, Failed> {
        let act = &act;
        std::thread::scope(|scope| {
            let threads: Vec<_> = self
                .batches
                .iter_mut()
                .zip(shares)
                .map(|(batch, share)| scope.spawn(move || act(&mut **batch, share)))
                .collect();
            let joined = threads.into_iter().map(|thread| {
                thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            });
            joined.collect()
        })
    }
}

impl Batch for Dealt {
    fn places(&self) -> usize {
        self.filled.len()
    }

    fn fill(&mut self, beds: &[(usize, &Dispenser)]) -> Result<(), Failed> {
        let mut shares: Vec<Vec<_>> = self.batches.iter().map(|_| Vec::new()).collect();
        for &(place, bed) in beds {
            let (batch, there) = self.at(place)?;
            shares[batch].push((there, bed));
        }
        self.each(shares, |batch, share| batch.fill(&share))?;
        beds.iter().for_each(|(place, _)| self.filled[*place] = true);
        Ok(())
    }

    fn step(&mut self, motions: &[(usize, Motion)]) -> Result<Vec<Stand>, Failed> {
        let mut shares: Vec<Vec<_>> = self.batches.iter().map(|_| Vec::new()).collect();
        let mut named = vec![false; self.filled.len()];
        for &(place, motion) in motions {
            let (batch, there) = self.at(place)?;
            // With the place's number here, which an engine does not know.
            if std::mem::replace(&mut named[place], true) {
                return Err(Failed(format!("place {place} is named twice in one step")));
            }
            if !self.filled[place] {
                return Err(Failed(format!("place {place} is empty")));
            }
            shares[batch].push((there, motion));
        }
        let count = self.batches.len();
        let stands = self.each(shares, |batch, share| batch.step(&share))?;
        let mut stands: Vec<_> = stands.into_iter().map(Vec::into_iter).collect();
        let next = |(place, _): &(usize, Motion)| stands[place % count].next();
        motions
            .iter()
            .map(next)
            .collect::<Option<_>>()
            .ok_or_else(|| Failed("an engine did not answer for every spoon".to_owned()))
    }
}
