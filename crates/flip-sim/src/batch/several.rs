//! Several engines of one kind as one.
//!
//! Places are dealt out in turn, so that each engine has as many as any other or one more. The engines
//! work at the same time and exchange nothing.

use super::heaps::{self, Heaps, Order};
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

impl Several {
    /// The engines that have a share of so many places, and how many.
    fn dealt(&self, places: usize) -> impl Iterator<Item = (&Arc<dyn Engine>, usize)> {
        let count = self.0.len();
        let share = move |k| (places + count - 1 - k) / count;
        self.0.iter().enumerate().map(move |(k, it)| (it, share(k))).filter(|(_, share)| *share > 0)
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
        let batches = self.dealt(places).map(|(engine, share)| engine.batch(share));
        Ok(Box::new(Dealt {
            batches: batches.collect::<Result<_, _>>()?,
            filled: vec![false; places],
        }))
    }

    fn heaps(&self, places: usize) -> Result<Option<Box<dyn Heaps>>, Failed> {
        let parts = self.dealt(places).map(|(engine, share)| engine.heaps(share));
        let parts: Option<Vec<_>> = parts.collect::<Result<_, _>>()?;
        Ok(parts.map(|parts| Box::new(DealtHeaps { parts, places }) as Box<dyn Heaps>))
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
        at(place, self.filled.len(), self.batches.len())
    }
}

/// Which of so many parts has a place, and its number there.
fn at(place: usize, places: usize, parts: usize) -> Result<(usize, usize), Failed> {
    if place < places { Ok((place % parts, place / parts)) } else { Err(no_place(place, places)) }
}

/// Does the same with all parts at once, each with its own share.
fn each<P: ?Sized + Send, T: Send, R: Send>(
    parts: &mut [Box<P>],
    shares: Vec<Vec<T>>,
    act: impl Fn(&mut P, Vec<T>) -> Result<R, Failed> + Sync,
) -> Result<Vec<R>, Failed> {
    let act = &act;
    std::thread::scope(|scope| {
        let threads: Vec<_> = parts
            .iter_mut()
            .zip(shares)
            .map(|(part, share)| scope.spawn(move || act(&mut **part, share)))
            .collect();
        let joined = threads
            .into_iter()
            .map(|thread| thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
        joined.collect()
    })
}

/// Lays out the answers of the parts in the order of the places that were asked.
fn in_turn<R>(places: impl Iterator<Item = usize>, answers: Vec<Vec<R>>) -> Result<Vec<R>, Failed> {
    let count = answers.len();
    let mut answers: Vec<_> = answers.into_iter().map(Vec::into_iter).collect();
    let answered: Option<_> = places.map(|place| answers[place % count].next()).collect();
    answered.ok_or_else(|| Failed("an engine did not answer for everything".to_owned()))
}

/// A place among so many that is named twice is refused with its number here, which an engine does not
/// know.
fn named_once(named: &mut [bool], place: usize) -> Result<(), Failed> {
    match std::mem::replace(&mut named[place], true) {
        true => Err(Failed(format!("place {place} is named twice in one step"))),
        false => Ok(()),
    }
}

/// The places for heaps of several engines.
struct DealtHeaps {
    parts: Vec<Box<dyn Heaps>>,
    places: usize,
}

impl Heaps for DealtHeaps {
    fn places(&self) -> usize {
        self.places
    }

    fn room(&self) -> u32 {
        self.parts.iter().map(|part| part.room()).min().unwrap_or_default()
    }

    fn carry_out(&mut self, orders: &[(usize, Order)]) -> Result<Vec<heaps::Stand>, Failed> {
        let mut shares: Vec<Vec<_>> = self.parts.iter().map(|_| Vec::new()).collect();
        let mut named = vec![false; self.places];
        for (place, order) in orders {
            let (part, there) = at(*place, self.places, self.parts.len())?;
            named_once(&mut named, *place)?;
            shares[part].push((there, order.clone()));
        }
        let stands = each(&mut self.parts, shares, |part, share| part.carry_out(&share))?;
        in_turn(orders.iter().map(|(place, _)| *place), stands)
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
        each(&mut self.batches, shares, |batch, share| batch.fill(&share))?;
        beds.iter().for_each(|(place, _)| self.filled[*place] = true);
        Ok(())
    }

    fn step(&mut self, motions: &[(usize, Motion)]) -> Result<Vec<Stand>, Failed> {
        let mut shares: Vec<Vec<_>> = self.batches.iter().map(|_| Vec::new()).collect();
        let mut named = vec![false; self.filled.len()];
        for &(place, motion) in motions {
            let (batch, there) = self.at(place)?;
            named_once(&mut named, place)?;
            if !self.filled[place] {
                return Err(Failed(format!("place {place} is empty")));
            }
            shares[batch].push((there, motion));
        }
        let stands = each(&mut self.batches, shares, |batch, share| batch.step(&share))?;
        in_turn(motions.iter().map(|(place, _)| *place), stands)
    }
}
