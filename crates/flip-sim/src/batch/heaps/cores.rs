//! The processor's own solver as one of many heaps.

use super::{Falling, Ground, Heaps, Order, Stand};
use crate::batch::{Failed, no_place};
use crate::constraints::{Contact, Vector, vector};
use crate::dispense::outside::{Grain, State, Strengths};
use crate::engine::{Engine, Physical};
use crate::law::Law;
use crate::repose::Settings;
use crate::walls::{Plate, Shape};
use rayon::prelude::*;

/// Grains for which a heap has room: as many as [`Settings`] may ask for.
const ROOM: u32 = 100_000;

/// Heaps on the cores of this machine.
pub(in crate::batch) struct OnCores(Vec<Option<Physical>>);

impl OnCores {
    /// So many empty places.
    pub fn empty(places: usize) -> Self {
        Self((0..places).map(|_| None).collect())
    }
}

impl Heaps for OnCores {
    fn places(&self) -> usize {
        self.0.len()
    }

    fn room(&self) -> u32 {
        ROOM
    }

    fn carry_out(&mut self, orders: &[(usize, Order)]) -> Result<Vec<Stand>, Failed> {
        let mut asked: Vec<Option<(usize, &Order)>> = vec![None; self.0.len()];
        for (number, (place, order)) in orders.iter().enumerate() {
            let free = asked.get_mut(*place).ok_or_else(|| no_place(*place, self.0.len()))?;
            if free.replace((number, order)).is_some() {
                return Err(Failed(format!("place {place} is named twice in one step")));
            }
        }
        let both = self.0.par_iter_mut().zip(asked).enumerate();
        let stands = both.filter_map(|(place, (heap, asked))| {
            let (number, order) = asked?;
            if let Some(ground) = &order.begin {
                *heap = Some(begun(ground));
            }
            let heap = heap.as_mut().ok_or_else(|| Failed(format!("place {place} is empty")));
            Some(heap.map(|heap| (number, obeyed(heap, order))))
        });
        let mut stands: Vec<(usize, Stand)> = stands.collect::<Result<_, _>>()?;
        stands.sort_unstable_by_key(|(number, _)| *number);
        Ok(stands.into_iter().map(|(_, stand)| stand).collect())
    }
}

fn obeyed(heap: &mut Physical, order: &Order) -> Stand {
    // Their radii follow from their numbers.
    for Falling { x, v, .. } in &order.pour {
        heap.pour(vector(x[0], x[1], x[2]), vector(v[0], v[1], v[2]));
    }
    heap.advance(order.substeps);
    let grain = |x: &Vector| Grain {
        radius: x[3],
        id: 0,
        x: [x[0], x[1], x[2]],
        v: [0.0; 3],
        contacts: 0.0,
        wall_anchor: None,
    };
    let state = || State { grains: heap.heap().iter().map(grain).collect(), ..State::default() };
    Stand {
        apex: heap.apex(),
        speed_rms: heap.speed_rms(),
        state: order.look.then(state),
        fault: heap.fault(),
    }
}

fn begun(ground: &Ground) -> Physical {
    let law = Law {
        gravity: ground.gravity,
        drag: ground.drag,
        grain: contact(&ground.grain),
        wall: contact(&ground.wall),
        mechanisms: ground.own,
        extended: ground.mechanisms.is_some(),
        // Lengths and times come in its units.
        diameter_m: 1.0,
        substep_s: 1.0,
    };
    let mut engine = Physical::under(law, &Settings::default());
    engine.plate = Shape::Plate(Plate { radius: ground.radius });
    engine
}

fn contact(of: &Strengths) -> Contact {
    let &Strengths { normal, tangential, normal_damping, tangential_damping, .. } = of;
    let &Strengths { friction, attraction, onset, reach, .. } = of;
    Contact {
        normal,
        tangential,
        normal_damping,
        tangential_damping,
        friction,
        attraction,
        onset,
        reach,
    }
}
