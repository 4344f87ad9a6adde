//! A batch of spoons on a card.

use crate::card::Room;
use crate::layout::Kernel;
use crate::orders::{self, Task};
use crate::{Bed, Card, CardError, Fault, Result};
use cudarc::driver::CudaSlice;
use flip_core::domain::bench::Action;
use flip_sim::batch::Motion;
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
    /// Mass of those kept, of those that fell into the vial, and of those that missed it, relative to a
    /// mean grain.
    pub(crate) kept_mass: f64,
    pub(crate) left: [f64; 2],
}

/// What is known here of a spoon that was filled.
#[derive(Debug, Clone, Copy)]
struct Standing {
    /// Place of its law, and of its bed: in the bank or, behind it, its own.
    bed: usize,
    pitch_deg: f64,
    grains: u32,
    /// Of the grains, relative to a mean one.
    mass: f64,
    substeps: u32,
    /// The same in the vial and beside it since it was filled.
    left: [f64; 2],
}

impl Standing {
    fn filled(place: usize, bed: &Bed) -> Self {
        let Bed { grains, mass, pitch_deg, .. } = *bed;
        Self { bed: place, pitch_deg, grains, mass, substeps: 0, left: [0.0; 2] }
    }
}

/// Those of one table have one layout.
const UNLIKE: CardError =
    CardError::Unfit("powders with and without mechanisms cannot be in one table of spoons");

/// Spoons on one card, each with its own powder. Their states stay there between actions.
#[derive(Debug)]
pub struct Spoons {
    card: Card,
    held: Held,
    /// Of the bank, then of each spoon's own.
    laws: CudaSlice<u32>,
    bank: CudaSlice<u32>,
    words: CudaSlice<u32>,
    room: Room,
    kernel_s: f64,
}

/// What is known here of the beds and the spoons.
#[derive(Debug)]
struct Held {
    /// The bank.
    beds: Vec<Bed>,
    /// What spoons were filled with that is not in the bank, by spoon.
    own: Vec<Option<Bed>>,
    /// By spoon; none is empty.
    standing: Vec<Option<Standing>>,
}

impl Held {
    fn exists(&self, spoon: usize) -> Result<()> {
        let count = self.standing.len();
        if spoon < count { Ok(()) } else { Err(CardError::NoSuch { number: spoon, count }) }
    }

    /// A filled spoon, and what it was filled with.
    fn filled(&self, spoon: usize) -> Result<(&Standing, &Bed)> {
        self.exists(spoon)?;
        let standing = self.standing[spoon].as_ref();
        let found = standing.and_then(|it| {
            let bed = self.beds.get(it.bed).or(self.own[spoon].as_ref());
            bed.map(|bed| (it, bed))
        });
        found.ok_or(CardError::Empty(spoon))
    }
}

impl Spoons {
    /// Puts the beds on the card and fills `count` spoons from them, one bed after another. A spoon
    /// takes 0.8 MB of the card's memory, a bed 0.4 MB; twice that if grains turn.
    ///
    /// # Errors
    /// [`CardError`]: no beds, beds with and without mechanisms, too little memory, or a card that
    /// fails.
    pub fn new(card: &Card, beds: Vec<Bed>, count: usize) -> Result<Self> {
        let (Some(first), true) = (beds.first(), count > 0) else {
            return Err(CardError::NoSuch { number: 0, count: 0 });
        };
        let kernel = first.kernel();
        if beds.iter().any(|bed| bed.kernel() != kernel) {
            return Err(UNLIKE);
        }
        let mut spoons = Self::with_bank(card, kernel, beds, count)?;
        for spoon in 0..count {
            spoons.fill(spoon, spoon % spoons.held.beds.len())?;
        }
        Ok(spoons)
    }

    /// So many empty spoons, each to be filled by [`Spoons::put`].
    pub(crate) fn empty(card: &Card, kernel: Kernel, count: usize) -> Result<Self> {
        Self::with_bank(card, kernel, Vec::new(), count)
    }

    fn with_bank(card: &Card, kernel: Kernel, beds: Vec<Bed>, count: usize) -> Result<Self> {
        let card = card.for_spoons(kernel)?;
        let stream = card.stream();
        let [law, image] = [kernel.law(), kernel.image()];
        // No table may be empty.
        let mut laws = stream.alloc_zeros::<u32>(((beds.len() + count) * law).max(1))?;
        let mut bank = stream.alloc_zeros::<u32>((beds.len() * image).max(1))?;
        for (k, bed) in beds.iter().enumerate() {
            stream.memcpy_htod(&bed.image, &mut bank.slice_mut(k * image..(k + 1) * image))?;
            stream.memcpy_htod(&bed.law, &mut laws.slice_mut(k * law..(k + 1) * law))?;
        }
        let words = stream.alloc_zeros::<u32>((count * kernel.spoon()).max(1))?;
        stream.synchronize()?;
        let (own, standing) = ((0..count).map(|_| None).collect(), vec![None; count]);
        let held = Held { beds, own, standing };
        let room = Room::default();
        Ok(Self { card, held, laws, bank, words, room, kernel_s: 0.0 })
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.held.standing.len()
    }

    /// How a spoon is laid out, and where it begins.
    fn room(&self, spoon: usize) -> (Kernel, usize) {
        let of = self.card.layout();
        (of, spoon * of.spoon())
    }

    /// Fills a spoon from a bed of the bank, and forgets what was in it.
    ///
    /// # Errors
    /// [`CardError::NoSuch`], or a card that fails.
    pub fn fill(&mut self, spoon: usize, bed: usize) -> Result<()> {
        self.held.exists(spoon)?;
        let beds = self.held.beds.len();
        let from = self.held.beds.get(bed).ok_or(CardError::NoSuch { number: bed, count: beds })?;
        let (of, start) = self.room(spoon);
        let image = self.bank.slice(bed * of.image()..(bed + 1) * of.image());
        let mut place = self.words.slice_mut(start..start + of.image());
        self.card.stream().memcpy_dtod(&image, &mut place)?;
        self.held.standing[spoon] = Some(Standing::filled(bed, from));
        Ok(())
    }

    /// Fills a spoon with this bed, and forgets what was in it: 0.4 MB go to the card.
    ///
    /// # Errors
    /// [`CardError`]: no such spoon, a powder that turns among others that do not, or a card that fails.
    pub fn put(&mut self, spoon: usize, mut bed: Bed) -> Result<()> {
        self.held.exists(spoon)?;
        let (stream, (of, start)) = (self.card.stream(), self.room(spoon));
        if bed.kernel() != of {
            return Err(UNLIKE);
        }
        let mut place = self.words.slice_mut(start..start + of.image());
        stream.memcpy_htod(&bed.image, &mut place)?;
        let law = self.held.beds.len() + spoon;
        let mut place = self.laws.slice_mut(law * of.law()..(law + 1) * of.law());
        stream.memcpy_htod(&bed.law, &mut place)?;
        // Until then the card may read them.
        stream.synchronize()?;
        (bed.image, bed.law) = (Vec::new(), Vec::new());
        self.held.standing[spoon] = Some(Standing::filled(law, &bed));
        self.held.own[spoon] = Some(bed);
        Ok(())
    }

    /// Carries out one action of each of these spoons, as
    /// [`Dispenser::step`](flip_sim::dispense::Dispenser::step) does, and waits for all. The results
    /// are in the order of the actions; a spoon may be named once.
    ///
    /// # Errors
    /// [`CardError`]: a spoon that does not exist, is empty or is named twice, or a card that fails;
    /// the states on it are lost then.
    pub fn step(&mut self, actions: &[(usize, Action)]) -> Result<Vec<Poured>> {
        let motions = actions.iter().map(|(spoon, action)| (*spoon, Motion::Act(*action)));
        self.carry_out(&motions.collect::<Vec<_>>())
    }

    /// The same for motions of any kind.
    ///
    /// # Errors
    /// As [`Spoons::step`].
    pub fn carry_out(&mut self, motions: &[(usize, Motion)]) -> Result<Vec<Poured>> {
        let mut named = vec![false; self.held.standing.len()];
        let mut tasks = Vec::with_capacity(motions.len());
        for &(spoon, motion) in motions {
            let (standing, bed) = self.held.filled(spoon)?;
            if std::mem::replace(&mut named[spoon], true) {
                return Err(CardError::Twice(spoon));
            }
            let Standing { bed: law, pitch_deg, grains, mass, .. } = *standing;
            tasks.push(Task { spoon, law, shape: &bed.shape, pitch_deg, motion, grains, mass });
        }
        let orders = orders::plan(&tasks);
        let raw = self.card.carry_out(&self.laws, &mut self.words, &orders, &mut self.room)?;
        self.kernel_s = raw.kernel_s;
        let poured = orders::poured(&tasks, &orders, &raw)?;
        for (&(spoon, motion), poured) in motions.iter().zip(&poured) {
            let Some(standing) = &mut self.held.standing[spoon] else { continue };
            standing.pitch_deg = poured.pitch_deg;
            (standing.grains, standing.mass) = (poured.kept, poured.kept_mass);
            standing.substeps += poured.substeps;
            for (sum, more) in standing.left.iter_mut().zip(poured.left) {
                *sum += more;
            }
            if matches!(motion, Motion::Settle) {
                standing.left = [0.0; 2];
            }
        }
        Ok(poured)
    }

    /// Powder in the vial and beside it since a spoon was filled, mg.
    ///
    /// # Errors
    /// [`CardError`]: a spoon that does not exist or is empty.
    pub fn left_mg(&self, spoon: usize) -> Result<[f64; 2]> {
        let (standing, bed) = self.held.filled(spoon)?;
        Ok(standing.left.map(|mass| mass * bed.shape.grain_mg))
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
        let (standing, Bed { shape, .. }) = self.held.filled(spoon)?;
        Ok(shape.snapshot(&state, f64::from(standing.substeps) * shape.substep_s))
    }

    /// The grains of a spoon and the memory of their contacts, in the spoon's frame.
    ///
    /// # Errors
    /// [`CardError`]: a spoon that does not exist or is empty, or a card that fails.
    pub fn state(&self, spoon: usize) -> Result<State> {
        self.held.filled(spoon)?;
        self.card.state(&self.words, spoon)
    }
}
