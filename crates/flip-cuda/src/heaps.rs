//! Heaps on a card, many at once. Their states stay there between orders.

use crate::card::Room;
use crate::layout::{self, Kernel, Outcome};
use crate::orders::{Orders, Raw};
use crate::{Card, CardError, Result};
use cudarc::driver::CudaSlice;
use flip_sim::batch::Failed;
use flip_sim::batch::heaps::{self, Falling, Order, Stand};

/// Places for heaps on one card. A heap takes 0.8 MB of its memory, 1.7 MB with mechanisms.
#[derive(Debug)]
pub struct Heaps {
    card: Card,
    /// In which table each heap is.
    of: Vec<Kernel>,
    /// Those without mechanisms, and those with: made when they are first needed, with all places.
    tables: [Option<Table>; 2],
}

impl Heaps {
    /// So many empty places.
    ///
    /// # Errors
    /// [`CardError`]: too little memory, or a card that fails.
    pub fn empty(card: &Card, count: usize) -> Result<Self> {
        let base = Table::empty(card, Kernel::Base, count)?;
        let of = vec![Kernel::Base; count];
        Ok(Self { card: card.clone(), of, tables: [Some(base), None] })
    }

    fn obey(&mut self, orders: &[(usize, Order)]) -> Result<Vec<Stand>> {
        let count = self.of.len();
        for (place, order) in orders {
            if let (Some(of), Some(ground)) = (self.of.get_mut(*place), &order.begin) {
                *of = Kernel::of_heap(ground);
            }
        }
        let mut stands = vec![Stand::default(); orders.len()];
        for (kernel, table) in [Kernel::Base, Kernel::Extended].into_iter().zip(&mut self.tables) {
            // A place that does not exist is named by the table.
            let is_here = |place: usize| self.of.get(place).is_none_or(|of| *of == kernel);
            let numbers = || (0..orders.len()).filter(|k| is_here(orders[*k].0));
            let these: Vec<_> = numbers().map(|k| (orders[k].0, &orders[k].1)).collect();
            if these.is_empty() {
                continue;
            }
            let table = match table {
                Some(table) => table,
                None => table.insert(Table::empty(&self.card, kernel, count)?),
            };
            for (number, stand) in numbers().zip(table.obey(&these)?) {
                stands[number] = stand;
            }
        }
        Ok(stands)
    }
}

impl heaps::Heaps for Heaps {
    fn places(&self) -> usize {
        self.of.len()
    }

    fn room(&self) -> u32 {
        layout::GRAINS as u32
    }

    fn carry_out(&mut self, orders: &[(usize, Order)]) -> std::result::Result<Vec<Stand>, Failed> {
        Ok(self.obey(orders)?)
    }
}

/// Places for heaps of one kernel.
#[derive(Debug)]
struct Table {
    kernel: Kernel,
    card: Card,
    laws: CudaSlice<u32>,
    words: CudaSlice<u32>,
    room: Room,
    held: Held,
}

impl Table {
    fn empty(card: &Card, kernel: Kernel, count: usize) -> Result<Self> {
        let card = card.for_heaps(kernel)?;
        let stream = card.stream();
        // No table may be empty.
        let laws = stream.alloc_zeros::<u32>((count * kernel.law()).max(1))?;
        let words = stream.alloc_zeros::<u32>((count * kernel.spoon()).max(1))?;
        stream.synchronize()?;
        let (room, held) = (Room::default(), Held::empty(kernel, count));
        Ok(Self { kernel, card, laws, words, room, held })
    }

    fn obey(&mut self, orders: &[(usize, &Order)]) -> Result<Vec<Stand>> {
        let (stream, kernel) = (self.card.stream(), self.kernel);
        let begun = self.held.begin(orders)?;
        for (place, law) in &begun {
            let mut words = self.laws.slice_mut(place * kernel.law()..(place + 1) * kernel.law());
            stream.memcpy_htod(law, &mut words)?;
            let start = place * kernel.spoon();
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

/// What is known here of the heaps.
#[derive(Debug)]
pub(crate) struct Held {
    kernel: Kernel,
    /// Places for grains in use.
    used: Vec<u32>,
    /// Grains poured so far, and gravity.
    poured: Vec<u32>,
    gravity: Vec<f32>,
    /// Heaps that were given more grains than there is room for, and stay as they were.
    overfull: Vec<bool>,
}

impl Held {
    pub(crate) fn empty(kernel: Kernel, count: usize) -> Self {
        let (used, poured) = (vec![0; count], vec![0; count]);
        let (gravity, overfull) = (vec![0.0; count], vec![false; count]);
        Self { kernel, used, poured, gravity, overfull }
    }

    /// Notes which heaps begin anew; their laws.
    pub(crate) fn begin(&mut self, orders: &[(usize, &Order)]) -> Result<Vec<(usize, Vec<u32>)>> {
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
                self.overfull[*place] = false;
                begun.push((*place, layout::ground(ground)));
            }
        }
        Ok(begun)
    }

    /// One job for each order, the longest first.
    pub(crate) fn plan(&mut self, orders: &[(usize, &Order)]) -> Result<Orders> {
        let mut planned = Orders::default();
        let mut weights = Vec::with_capacity(orders.len());
        for (number, (place, order)) in orders.iter().enumerate() {
            let wanted = self.used[*place] as usize + order.pour.len();
            self.overfull[*place] |= wanted > layout::GRAINS;
            let (pour, substeps) = match self.overfull[*place] {
                true => (&[][..], 0),
                false => (&order.pour[..], order.substeps),
            };
            self.used[*place] += pour.len() as u32;
            let standing = [0.0, -self.gravity[*place]].map(f32::to_bits);
            planned.parts.extend([0, 0, substeps, standing[0], standing[1]]);
            let first = (planned.added.len() / self.kernel.added()) as u32;
            for Falling { x, v, radius } in pour {
                planned.added.extend(x.iter().chain(v).map(|x| x.to_bits()));
                planned.added.push(self.poured[*place]);
                let has_radius = self.kernel == Kernel::Extended;
                planned.added.extend(has_radius.then_some(radius.to_bits()));
                self.poured[*place] += 1;
            }
            let weight = u64::from(self.used[*place]) * u64::from(substeps);
            weights.push((weight, number, first, pour.len() as u32));
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
    pub(crate) fn stands(&mut self, orders: &[(usize, &Order)], raw: &Raw) -> Result<Vec<Stand>> {
        let outcomes: Vec<Outcome> =
            raw.outcomes.chunks_exact(layout::OUTCOME).map(layout::outcome).collect();
        if outcomes.len() != orders.len() {
            return Err(CardError::Nonsense("there are not as many outcomes as jobs"));
        }
        for ((place, _), outcome) in orders.iter().zip(&outcomes) {
            self.used[*place] = outcome.places;
        }
        let stand = |(outcome, (place, _)): (&Outcome, &(usize, &Order))| Stand {
            apex: outcome.apex,
            speed_rms: (outcome.speeds2 / f64::from(outcome.kept.max(1))).sqrt() as f32,
            state: None,
            fault: match self.overfull[*place] {
                true => Some(format!("a card has room for {} grains of a heap", layout::GRAINS)),
                false => outcome.fault.map(|fault| fault.to_string()),
            },
        };
        Ok(outcomes.iter().zip(orders).map(stand).collect())
    }
}
