//! A batch of spoons on a card.

use crate::orders::{self, Task};
use crate::{Bed, Card, CardError, Fault, Result, layout};
use cudarc::driver::CudaSlice;
use flip_core::domain::bench::Action;
use flip_sim::dispense::outside::State;
use flip_sim::snapshot::Snapshot;

/// What one action poured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Poured {
    /// Mass that fell into the vial, mg.
    pub vial_mg: f64,
    /// Mass that missed the vial, mg.
    pub spilled_mg: f64,
    /// Mass left in the spoon, mg.
    pub spoon_mg: f64,
    /// Duration of the motion and of the powder coming to rest, s.
    pub duration_s: f64,
    /// Pitch afterwards, degrees.
    pub pitch_deg: f64,
    /// Why the simulation is no longer meaningful, if it is not. Such a spoon does nothing until it
    /// is filled again.
    pub fault: Option<Fault>,
    /// Substeps simulated.
    pub substeps: u32,
    /// Neighbour lists built.
    pub rebuilds: u32,
    pub(crate) kept: u32,
}

#[derive(Debug, Clone, Copy)]
struct Standing {
    bed: usize,
    pitch_deg: f64,
    grains: u32,
    substeps: u32,
}

/// Spoons on one card, each with its own powder. Their states stay there between actions.
#[derive(Debug)]
pub struct Spoons {
    card: Card,
    beds: Vec<Bed>,
    laws: CudaSlice<u32>,
    bank: CudaSlice<u32>,
    words: CudaSlice<u32>,
    standing: Vec<Standing>,
    kernel_s: f64,
}

impl Spoons {
    /// Puts the beds on the card and fills `count` spoons from them, one bed after another. A spoon
    /// takes 0.8 MB of the card's memory, a bed 0.4 MB.
    ///
    /// # Errors
    /// [`CardError`]: no beds, too little memory, or a card that fails.
    pub fn new(card: &Card, beds: Vec<Bed>, count: usize) -> Result<Self> {
        if beds.is_empty() || count == 0 {
            return Err(CardError::NoSuch { number: 0, count: 0 });
        }
        let stream = card.stream();
        let laws: Vec<u32> = beds.iter().flat_map(|bed| &bed.law).copied().collect();
        let laws = stream.clone_htod(&laws)?;
        let mut bank = stream.alloc_zeros::<u32>(beds.len() * layout::IMAGE)?;
        for (k, bed) in beds.iter().enumerate() {
            let mut place = bank.slice_mut(k * layout::IMAGE..(k + 1) * layout::IMAGE);
            stream.memcpy_htod(&bed.image, &mut place)?;
        }
        let words = stream.alloc_zeros::<u32>(count * layout::SPOON)?;
        stream.synchronize()?;
        let standing = vec![Standing { bed: 0, pitch_deg: 0.0, grains: 0, substeps: 0 }; count];
        let mut spoons =
            Self { card: card.clone(), laws, bank, words, standing, beds, kernel_s: 0.0 };
        for spoon in 0..count {
            spoons.fill(spoon, spoon % spoons.beds.len())?;
        }
        Ok(spoons)
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.standing.len()
    }

    /// Fills a spoon from a bed, and forgets what was in it.
    ///
    /// # Errors
    /// [`CardError::NoSuch`], or a card that fails.
    pub fn fill(&mut self, spoon: usize, bed: usize) -> Result<()> {
        let missing = |number: usize, count: usize| CardError::NoSuch { number, count };
        let (spoons, beds) = (self.standing.len(), self.beds.len());
        let from = self.beds.get(bed).ok_or_else(|| missing(bed, beds))?;
        let standing = self.standing.get_mut(spoon).ok_or_else(|| missing(spoon, spoons))?;
        let image = self.bank.slice(bed * layout::IMAGE..(bed + 1) * layout::IMAGE);
        let start = spoon * layout::SPOON;
        let mut place = self.words.slice_mut(start..start + layout::IMAGE);
        self.card.stream().memcpy_dtod(&image, &mut place)?;
        *standing = Standing { bed, pitch_deg: from.pitch_deg, grains: from.grains, substeps: 0 };
        Ok(())
    }

    /// Carries out one action of each of these spoons, as
    /// [`Dispenser::step`](flip_sim::dispense::Dispenser::step) does, and waits for all. The results
    /// are in the order of the actions; a spoon may be named once.
    ///
    /// # Errors
    /// [`CardError`]: a spoon that does not exist or is named twice, or a card that fails; the
    /// states on it are lost then.
    pub fn step(&mut self, actions: &[(usize, Action)]) -> Result<Vec<Poured>> {
        let count = self.standing.len();
        let mut named = vec![false; count];
        let mut tasks = Vec::with_capacity(actions.len());
        for &(spoon, action) in actions {
            match named.get_mut(spoon) {
                Some(named) if *named => return Err(CardError::Twice(spoon)),
                Some(named) => *named = true,
                None => return Err(CardError::NoSuch { number: spoon, count }),
            }
            let Standing { bed, pitch_deg, grains, .. } = self.standing[spoon];
            let shape = &self.beds[bed].shape;
            tasks.push(Task { spoon, law: bed, shape, pitch_deg, action, grains });
        }
        let orders = orders::plan(&tasks);
        let raw = self.card.carry_out(&self.laws, &mut self.words, &orders)?;
        self.kernel_s = raw.kernel_s;
        let poured = orders::poured(&tasks, &orders, &raw)?;
        for (&(spoon, _), poured) in actions.iter().zip(&poured) {
            let standing = &mut self.standing[spoon];
            standing.pitch_deg = poured.pitch_deg;
            standing.grains = poured.kept;
            standing.substeps += poured.substeps;
        }
        Ok(poured)
    }

    /// Time that the card took for the last step, s: without planning, copying and judging.
    pub fn kernel_s(&self) -> f64 {
        self.kernel_s
    }

    /// The grains of a spoon as they are now, in the spoon's frame; its time counts from when the
    /// spoon was filled.
    ///
    /// # Errors
    /// As [`Spoons::state`].
    pub fn snapshot(&self, spoon: usize) -> Result<Snapshot> {
        let state = self.state(spoon)?;
        let Standing { bed, substeps, .. } = self.standing[spoon];
        let shape = &self.beds[bed].shape;
        Ok(shape.snapshot(&state, f64::from(substeps) * shape.substep_s))
    }

    /// The grains of a spoon and the memory of their contacts, in the spoon's frame.
    ///
    /// # Errors
    /// [`CardError`]: a spoon that does not exist, or a card that fails.
    pub fn state(&self, spoon: usize) -> Result<State> {
        let count = self.standing.len();
        if spoon >= count {
            return Err(CardError::NoSuch { number: spoon, count });
        }
        let stream = self.card.stream();
        let start = spoon * layout::SPOON;
        let mut words = stream.clone_dtoh(&self.words.slice(start..start + layout::MOTION))?;
        stream.synchronize()?;
        let memory = layout::present_memory(&words);
        let memory = start + memory.start..start + memory.end;
        words.extend(stream.clone_dtoh(&self.words.slice(memory))?);
        stream.synchronize()?;
        Ok(layout::state(&words))
    }
}
