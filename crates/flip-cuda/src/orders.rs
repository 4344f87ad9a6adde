//! What every block has to do in one step, and what came of it: plain words, the same for the card
//! and for its twin.

use crate::layout::{self, Kernel, Outcome};
use crate::{Poured, Result};
use flip_sim::batch::Motion;
use flip_sim::dispense::outside::{Departed, Plan, Spoon};

/// One spoon's motion.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Task<'a> {
    /// Places in the tables of spoons and laws.
    pub spoon: usize,
    pub law: usize,
    /// Shape and law of it.
    pub shape: &'a Spoon,
    pub pitch_deg: f64,
    pub motion: Motion,
    /// Grains in it, and their mass relative to a mean grain.
    pub grains: u32,
    pub mass: f64,
}

/// The tables for one launch.
#[derive(Debug, Default)]
pub(crate) struct Orders {
    /// Jobs, the longest first.
    pub jobs: Vec<u32>,
    pub parts: Vec<u32>,
    pub bodies: Vec<f32>,
    /// Grains that are poured.
    pub added: Vec<u32>,
    /// By place, as the parts.
    pub plans: Vec<Plan>,
    /// First part of each place.
    firsts: Vec<usize>,
}

/// The tables that a launch fills.
#[derive(Debug, Default)]
pub(crate) struct Raw {
    pub outcomes: Vec<u32>,
    pub rests: Vec<u32>,
    pub departed: Vec<u32>,
    /// Time from the kernel's start to its end, s.
    pub kernel_s: f64,
}

/// Applies `each` to all items on all processors.
pub(crate) fn on_all<T: Sync, R: Send>(
    items: &[T],
    each: impl Fn(usize, &T) -> R + Sync,
) -> Vec<R> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let share = items.len().div_ceil(threads).max(1);
    let each = &each;
    std::thread::scope(|scope| {
        let work = |(k, chunk): (usize, &'_ [T])| -> Vec<R> {
            chunk.iter().enumerate().map(|(i, item)| each(k * share + i, item)).collect()
        };
        let chunks: Vec<_> =
            items.chunks(share).enumerate().map(|chunk| scope.spawn(move || work(chunk))).collect();
        // A panic of a thread goes on in this one.
        let joined = chunks.into_iter().map(|it| match it.join() {
            Ok(results) => results,
            Err(panic) => std::panic::resume_unwind(panic),
        });
        joined.flatten().collect()
    })
}

/// Plans every task.
pub(crate) fn plan(tasks: &[Task]) -> Orders {
    let mut orders = Orders {
        plans: on_all(tasks, |_, task| task.shape.plan(task.pitch_deg, task.motion)),
        ..Orders::default()
    };
    let mut weights = Vec::with_capacity(tasks.len());
    for (place, (task, plan)) in tasks.iter().zip(&orders.plans).enumerate() {
        orders.firsts.push(orders.parts.len() / layout::PART);
        let mut substeps = 0;
        for part in &plan.parts {
            orders.parts.extend([
                (orders.bodies.len() / 2) as u32,
                part.body.len() as u32,
                part.rest_max,
                part.standing[0].to_bits(),
                part.standing[1].to_bits(),
            ]);
            orders.bodies.extend(part.body.iter().flatten());
            substeps += part.body.len();
        }
        weights.push((u64::from(task.grains) * substeps as u64, place));
    }
    // The longest first, so that no block is still at work when all others are done.
    weights.sort_unstable_by_key(|(weight, place)| (std::cmp::Reverse(*weight), *place));
    for (_, place) in weights {
        let (first, parts) = (orders.firsts[place], orders.plans[place].parts.len());
        let task = &tasks[place];
        orders
            .jobs
            .extend([task.spoon, task.law, first, parts, place, 0, 0].map(|number| number as u32));
    }
    orders
}

/// What each task poured.
pub(crate) fn poured(tasks: &[Task], orders: &Orders, raw: &Raw) -> Result<Vec<Poured>> {
    let mut departed: Vec<Vec<Departed>> = vec![Vec::new(); tasks.len()];
    // All are in one table.
    let kernel = tasks.first().map_or(Kernel::Base, |task| Kernel::of(task.shape));
    for words in raw.departed.chunks_exact(kernel.departed()) {
        let (place, grain) = layout::departed(kernel, words);
        let Some(of_place) = departed.get_mut(place) else {
            return Err(crate::CardError::Nonsense("a grain left a spoon that is not there"));
        };
        of_place.push(grain);
    }
    let outcomes: Vec<Outcome> =
        raw.outcomes.chunks_exact(layout::OUTCOME).map(layout::outcome).collect();
    if outcomes.len() != tasks.len() {
        return Err(crate::CardError::Nonsense("there are not as many outcomes as jobs"));
    }
    Ok(on_all(tasks, |place, task| {
        let (plan, outcome) = (&orders.plans[place], &outcomes[place]);
        let [vial, spilled] = task.shape.landed(plan, &departed[place]);
        let rests = raw.rests[orders.firsts[place]..].iter();
        let duration_s = plan
            .parts
            .iter()
            .zip(rests)
            .map(|(part, rest)| part.duration_s + f64::from(*rest) * task.shape.substep_s)
            .sum();
        let mg = |mass: f64| mass * task.shape.grain_mg;
        let left_mass = task.mass - (vial + spilled);
        Poured {
            vial_mg: mg(vial),
            spilled_mg: mg(spilled),
            spoon_mg: mg(left_mass),
            duration_s,
            pitch_deg: plan.pitch_deg,
            fault: outcome.fault,
            substeps: outcome.substeps,
            rebuilds: outcome.rebuilds,
            kept: outcome.kept,
            kept_mass: left_mass,
            left: [vial, spilled],
        }
    }))
}
