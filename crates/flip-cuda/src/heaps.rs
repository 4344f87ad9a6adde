//! Heaps on a card, many at once. Their states stay there between orders.

use crate::card::Room;
use crate::layout::{self, Kernel, Outcome};
use crate::orders::{Orders, Raw};
use crate::{Card, CardError, Result};
use cudarc::driver::CudaSlice;
use flip_sim::batch::Failed;
use flip_sim::batch::heaps::{self, Order, Stand};

const BASE: Kernel = Kernel::Base;

/// Places for heaps on one card. A heap takes 0.8 MB of its memory.
#[derive(Debug)]
pub struct Heaps {
    card: Card,
    laws: CudaSlice<u32>,
    words: CudaSlice<u32>,
    room: Room,
    held: Held,
}

impl Heaps {
    /// So many empty places.
    ///
    /// # Errors
    /// [`CardError`]: too little memory, or a card that fails.
    pub fn empty(card: &Card, count: usize) -> Result<Self> {
        let card = card.for_heaps()?;
        let stream = card.stream();
        // No table may be empty.
        let laws = stream.alloc_zeros::<u32>((count * BASE.law()).max(1))?;
        let words = stream.alloc_zeros::<u32>((count * BASE.spoon()).max(1))?;
        stream.synchronize()?;
        let (room, held) = (Room::default(), Held::empty(count));
        Ok(Self { card, laws, words, room, held })
    }

    fn obey(&mut self, orders: &[(usize, Order)]) -> Result<Vec<Stand>> {
        let stream = self.card.stream();
        let begun = self.held.begin(orders)?;
        for (place, law) in &begun {
            let mut words = self.laws.slice_mut(place * BASE.law()..(place + 1) * BASE.law());
            stream.memcpy_htod(law, &mut words)?;
            let start = place * BASE.spoon();
            stream.memset_zeros(&mut self.words.slice_mut(start..start + layout::HEAD))?;
        }
        // Until then the card may read the laws.
        stream.synchronize()?;
        let planned = self.held.plan(orders)?;
        let raw = self.card.carry_out(&self.laws, &mut self.words, &planned, &mut self.room)?;
        let mut stands = self.held.stands(orders, &raw)?;
        for ((place, order), stand) in orders.iter().zip(&mut stands) {
            if order.look {
                stand.state = Some(self.card.state(&self.words, *place)?);
            }
        }
        Ok(stands)
    }
}

impl heaps::Heaps for Heaps {
    fn places(&self) -> usize {
        self.held.used.len()
    }

    fn room(&self) -> u32 {
        layout::GRAINS as u32
    }

    fn carry_out(&mut self, orders: &[(usize, Order)]) -> std::result::Result<Vec<Stand>, Failed> {
        Ok(self.obey(orders)?)
    }
}

/// What is known here of the heaps.
#[derive(Debug)]
pub(crate) struct Held {
    /// Places for grains in use.
    used: Vec<u32>,
    /// Grains poured so far, and gravity.
    poured: Vec<u32>,
    gravity: Vec<f32>,
}

impl Held {
    pub(crate) fn empty(count: usize) -> Self {
        Self { used: vec![0; count], poured: vec![0; count], gravity: vec![0.0; count] }
    }

    /// Notes which heaps begin anew; their laws.
    pub(crate) fn begin(&mut self, orders: &[(usize, Order)]) -> Result<Vec<(usize, Vec<u32>)>> {
        let count = self.used.len();
        let mut named = vec![false; count];
        let mut begun = Vec::new();
        for (place, order) in orders {
            let name = named.get_mut(*place).ok_or(CardError::NoSuch { number: *place, count })?;
            if std::mem::replace(name, true) {
                return Err(CardError::Twice(*place));
            }
            if let Some(ground) = &order.begin {
                (self.used[*place], self.poured[*place]) = (0, 0);
                self.gravity[*place] = ground.gravity;
                begun.push((*place, layout::ground(ground)));
            }
        }
        Ok(begun)
    }

    /// One job for each order, the longest first.
    pub(crate) fn plan(&mut self, orders: &[(usize, Order)]) -> Result<Orders> {
        let mut planned = Orders::default();
        let mut weights = Vec::with_capacity(orders.len());
        for (number, (place, order)) in orders.iter().enumerate() {
            let pour = order.pour.len() as u32;
            self.used[*place] += pour;
            if self.used[*place] as usize > layout::GRAINS {
                return Err(CardError::Unfit("a heap has more grains than a card has room for"));
            }
            let standing = [0.0, -self.gravity[*place]].map(f32::to_bits);
            planned.parts.extend([0, 0, order.substeps, standing[0], standing[1]]);
            let first = (planned.added.len() / layout::ADDED) as u32;
            for grain in &order.pour {
                planned.added.extend(grain.as_flattened().iter().map(|x| x.to_bits()));
                planned.added.push(self.poured[*place]);
                self.poured[*place] += 1;
            }
            let weight = u64::from(self.used[*place]) * u64::from(order.substeps);
            weights.push((weight, number, first, pour));
        }
        // No block should still be at work when all others are done.
        weights.sort_unstable_by_key(|(weight, number, ..)| (std::cmp::Reverse(*weight), *number));
        for (_, number, first, pour) in weights {
            let (place, number) = (orders[number].0 as u32, number as u32);
            planned.jobs.extend([place, place, number, 1, number, first, pour]);
        }
        Ok(planned)
    }

    /// How the heaps stand after that.
    pub(crate) fn stands(&mut self, orders: &[(usize, Order)], raw: &Raw) -> Result<Vec<Stand>> {
        let outcomes: Vec<Outcome> =
            raw.outcomes.chunks_exact(layout::OUTCOME).map(layout::outcome).collect();
        if outcomes.len() != orders.len() {
            return Err(CardError::Nonsense("there are not as many outcomes as jobs"));
        }
        for ((place, _), outcome) in orders.iter().zip(&outcomes) {
            self.used[*place] = outcome.places;
        }
        let stand = |outcome: &Outcome| Stand {
            apex: outcome.apex,
            speed_rms: (outcome.speeds2 / f64::from(outcome.kept.max(1))).sqrt() as f32,
            state: None,
            fault: outcome.fault.map(|fault| fault.to_string()),
        };
        Ok(outcomes.iter().map(stand).collect())
    }
}
