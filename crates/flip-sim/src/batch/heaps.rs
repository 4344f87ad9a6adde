//! Heaps by the batch, on a solver outside this crate: many poured side by side, each by the procedure
//! of [`repose`](crate::repose).
//!
//! ```text
//!   a thread for each heap --asks--> one step for all of a group --answers--> threads
//! ```
//!
//! A step begins once every heap of the group has asked for something. Lengths in grain diameters, time in substeps.

mod cores;

use super::Failed;
use crate::constraints::{Vector, dot, vector};
use crate::dispense::outside::{self, State, Strengths};
use crate::engine::{Engine, Scales};
use crate::law::Law;
use crate::mechanisms::{Mechanisms, Site};
use crate::repose::{Compat, Refusal, Repose, Settings, repose_of};
use crate::snapshot::Snapshot;
use flip_core::domain::parameters::ParameterSet;
use std::cell::RefCell;
use std::ops::ControlFlow;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Mutex, PoisonError};

pub(super) use cores::OnCores;

/// A powder on its base, without grains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ground {
    /// Factor on every velocity per substep.
    pub drag: f32,
    /// Gravity, downwards.
    pub gravity: f32,
    /// Between grains.
    pub grain: Strengths,
    /// Between a grain and the base.
    pub wall: Strengths,
    /// Mechanisms beyond the base simulator, if its powder has any.
    pub mechanisms: Option<outside::Mechanisms>,
    /// Radius of the round base, which is at height 0 and has a sharp rim.
    pub radius: f32,
    /// Substeps between two looks for grains that fell off.
    pub slice: u32,
    /// For the product's own solver.
    own: Mechanisms,
}

/// A heap to pour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wanted {
    /// The powder.
    pub set: ParameterSet,
    /// How it is poured and read.
    pub settings: Settings,
    /// Seed.
    pub seed: u64,
}

/// Why only [`repose`](crate::repose::repose) can compute a heap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum OnlyOnCores {
    /// Its base has a layer of grains.
    #[error("a rough base is computed on the processor")]
    RoughBase,
    /// It is the published engine's.
    #[error("`compat` physx is computed on the processor")]
    Physx,
    /// It has too many grains.
    #[error("a heap of more than {0} grains is computed on the processor")]
    Grains(u32),
}

impl Wanted {
    /// Whether a solver with room for so many grains can compute it.
    ///
    /// # Errors
    /// [`OnlyOnCores`]
    pub fn fits(&self, room: u32) -> Result<(), OnlyOnCores> {
        let Settings { compat, rough_base, particles, .. } = &self.settings;
        match (compat, rough_base) {
            (Compat::Physx, _) => Err(OnlyOnCores::Physx),
            (_, true) => Err(OnlyOnCores::RoughBase),
            _ if *particles > room => Err(OnlyOnCores::Grains(room)),
            _ => Ok(()),
        }
    }

    fn law(&self) -> Law {
        Law::new(&self.set, self.settings.base_friction, self.settings.substep_s).extended(
            &self.settings.extensions,
            &self.set,
            Site::Base,
        )
    }

    /// The powder and its base.
    pub fn ground(&self) -> Ground {
        let law = self.law();
        Ground {
            drag: law.drag,
            gravity: law.gravity,
            grain: (&law.grain).into(),
            wall: (&law.wall).into(),
            mechanisms: law.extended.then(|| law.mechanisms.outside()),
            radius: self.settings.base_radius_diameters as f32,
            slice: crate::repose::DEPARTURE_CHECK,
            own: law.mechanisms,
        }
    }
}

/// A grain that is poured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Falling {
    /// Centre.
    pub x: [f32; 3],
    /// Velocity.
    pub v: [f32; 3],
    /// Radius.
    pub radius: f32,
}

/// What one heap is asked to do.
#[derive(Debug, Clone, PartialEq)]
pub struct Order {
    /// Forget what was there, and begin anew on this.
    pub begin: Option<Ground>,
    /// Grains to add.
    pub pour: Vec<Falling>,
    /// Substeps to advance.
    pub substeps: u32,
    /// Whether to tell every grain afterwards.
    pub look: bool,
}

/// How a heap stands.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Stand {
    /// Height of the highest grain that touches two others or more, or of the base.
    pub apex: f32,
    /// Root-mean-square speed.
    pub speed_rms: f32,
    /// The grains, if they were asked for.
    pub state: Option<State>,
    /// Why the simulation is no longer meaningful, if it is not.
    pub fault: Option<String>,
}

/// Places for heaps that are computed side by side.
pub trait Heaps: Send {
    /// How many places there are; they are counted from 0.
    fn places(&self) -> usize;

    /// Grains of one heap for which there is room.
    fn room(&self) -> u32;

    /// Carries out one order of each of these heaps, and waits for all. The results are in the order
    /// of the orders.
    ///
    /// # Errors
    /// A place that does not exist or is named twice, or a device that fails.
    fn carry_out(&mut self, orders: &[(usize, Order)]) -> Result<Vec<Stand>, Failed>;
}

/// Most groups, and the fewest heaps of one: a group waits until all of its heaps have poured a layer or
/// moved on to rest, and each has launches of its own.
const GROUPS: usize = 16;
const GROUP_MIN: usize = 4;

/// Pours heaps on an engine, with as many places as are of use; `each` is as for [`pour`].
///
/// # Errors
/// The engine pours no heaps, or failed.
///
/// # Panics
/// As [`pour`].
pub fn pour_on(
    engine: &dyn super::Engine,
    wanted: &[Wanted],
    each: &mut (dyn FnMut(usize, Result<Repose, Refusal>) -> ControlFlow<()> + Send),
) -> Result<(), Failed> {
    let places = engine.places().min(wanted.len());
    let count = places.div_ceil(GROUP_MIN).min(GROUPS);
    let mut groups = Vec::with_capacity(count);
    for group in 0..count {
        let heaps = engine.heaps((places + group) / count)?;
        groups.push(heaps.ok_or_else(|| Failed(format!("{} pours no heaps", engine.name())))?);
    }
    let groups = groups.iter_mut().map(|it| &mut **it as &mut dyn Heaps);
    pour(&mut groups.collect::<Vec<_>>(), wanted, each)
}

/// Pours heaps, as many at once as there are places in all groups, which do not wait for one another.
/// `each` receives what came of each as soon as it is known: in any order, but one at a time. After
/// `Break` no further heap begins.
///
/// # Errors
/// The solver failed; `each` has received the heaps that had ended.
///
/// # Panics
/// A heap that does not [fit](Wanted::fits) was asked for, or a thread panics.
pub fn pour(
    groups: &mut [&mut dyn Heaps],
    wanted: &[Wanted],
    each: &mut (dyn FnMut(usize, Result<Repose, Refusal>) -> ControlFlow<()> + Send),
) -> Result<(), Failed> {
    let room = groups.iter().map(|it| it.room()).min().unwrap_or_default();
    wanted.iter().for_each(|it| it.fits(room).expect("only heaps that fit are asked for"));
    let (next, over, each) = (AtomicUsize::new(0), AtomicBool::new(false), Mutex::new(each));
    let work = |place: usize, says: Sender<Said>, answers: &Receiver<Stand>| {
        while !over.load(Ordering::SeqCst) {
            let number = next.fetch_add(1, Ordering::SeqCst);
            let Some(one) = wanted.get(number) else { break };
            let outcome =
                repose_of(Remote::new(one, place, &says, answers), &one.settings, one.seed);
            if over.load(Ordering::SeqCst) && outcome.is_err() {
                break;
            }
            let mut each = each.lock().unwrap_or_else(PoisonError::into_inner);
            if (*each)(number, outcome).is_break() {
                over.store(true, Ordering::SeqCst);
            }
        }
    };
    std::thread::scope(|scope| {
        let (mut threads, mut solvers) = (Vec::new(), Vec::new());
        for heaps in groups {
            let (says, heard) = channel();
            let mut answers = Vec::new();
            for place in 0..heaps.places().min(wanted.len()) {
                let (answer, answered) = channel();
                answers.push(answer);
                let (says, work) = (says.clone(), &work);
                threads.push(scope.spawn(move || {
                    let leaves = Leaves(says.clone());
                    work(place, says, &answered);
                    drop(leaves);
                }));
            }
            let over = &over;
            solvers.push(scope.spawn(move || serve(&mut **heaps, &heard, &answers, over)));
        }
        for thread in threads {
            thread.join().unwrap_or_else(|panic| resume_unwind(panic));
        }
        let ended = solvers
            .into_iter()
            .map(|solver| solver.join().unwrap_or_else(|panic| resume_unwind(panic)));
        // All have ended before the first failure is told.
        ended.collect::<Vec<_>>().into_iter().collect()
    })
}

/// What a thread says.
enum Said {
    Asks(usize, Box<Order>),
    Leaves,
}

/// Says so when a thread ends, by a panic too.
struct Leaves(Sender<Said>);

impl Drop for Leaves {
    fn drop(&mut self) {
        let _ = self.0.send(Said::Leaves);
    }
}

/// Answers until all threads have left.
fn serve(
    heaps: &mut dyn Heaps,
    heard: &Receiver<Said>,
    answers: &[Sender<Stand>],
    over: &AtomicBool,
) -> Result<(), Failed> {
    let (mut there, mut asked, mut ended) = (answers.len(), Vec::new(), Ok(()));
    while let Ok(said) = heard.recv() {
        match said {
            Said::Asks(place, order) => asked.push((place, *order)),
            Said::Leaves => there -= 1,
        }
        if asked.len() < there || asked.is_empty() {
            continue;
        }
        let mut orders = std::mem::take(&mut asked);
        // In one order, whoever asked first.
        orders.sort_unstable_by_key(|(place, _)| *place);
        let stands = match &ended {
            Ok(()) => heaps.carry_out(&orders),
            Err(failed) => Err(Failed::clone(failed)),
        };
        let stands = stands.unwrap_or_else(|failed| {
            over.store(true, Ordering::SeqCst);
            let stand = Stand { fault: Some(failed.to_string()), ..Stand::default() };
            ended = Err(failed);
            vec![stand; orders.len()]
        });
        for ((place, _), stand) in orders.iter().zip(stands) {
            // A thread that asked waits for its answer.
            let _ = answers[*place].send(stand);
        }
    }
    ended
}

/// A heap that is computed elsewhere.
struct Remote<'a> {
    scales: Scales,
    mechanisms: Mechanisms,
    /// Grains poured so far.
    count: u32,
    place: usize,
    says: &'a Sender<Said>,
    answers: &'a Receiver<Stand>,
    begin: RefCell<Option<Ground>>,
    poured: RefCell<Vec<Falling>>,
    stand: RefCell<Stand>,
}

impl<'a> Remote<'a> {
    fn new(
        one: &Wanted,
        place: usize,
        says: &'a Sender<Said>,
        answers: &'a Receiver<Stand>,
    ) -> Self {
        let Law { gravity, diameter_m, substep_s: step_s, mechanisms, .. } = one.law();
        Self {
            scales: Scales { gravity, diameter_m, step_s },
            mechanisms,
            count: 0,
            place,
            says,
            answers,
            begin: RefCell::new(Some(one.ground())),
            poured: RefCell::default(),
            stand: RefCell::default(),
        }
    }

    fn ask(&self, substeps: u32, look: bool) {
        let order = Order { begin: self.begin.take(), pour: self.poured.take(), substeps, look };
        let said = self.says.send(Said::Asks(self.place, Box::new(order)));
        let ended = |_| Stand { fault: Some("the batch has ended".to_owned()), ..Stand::default() };
        let answer = said.map_err(|_| ()).and_then(|()| self.answers.recv().map_err(|_| ()));
        self.stand.replace(answer.unwrap_or_else(ended));
    }

    /// The grains as they are now.
    fn state(&self) -> State {
        if self.stand.borrow().state.is_none() {
            self.ask(0, true);
        }
        self.stand.borrow().state.clone().unwrap_or_default()
    }
}

impl Engine for Remote<'_> {
    fn scales(&self) -> Scales {
        self.scales
    }
    fn pour(&mut self, x: Vector, v: Vector) {
        let [x, v] = [x, v].map(|[x, y, z, _]| [x, y, z]);
        let radius = self.mechanisms.sizes.radius(self.count);
        self.poured.get_mut().push(Falling { x, v, radius });
        self.count += 1;
    }
    fn step(&mut self) {
        self.ask(1, false);
    }
    fn advance(&mut self, steps: u32) {
        self.ask(steps, false);
    }
    // It happens on the way.
    fn drop_departed(&mut self) {}
    // What asks for these asks for the apex, the heap or the snapshot here.
    fn centres(&self) -> &[Vector] {
        &[]
    }
    fn velocities(&self) -> &[Vector] {
        &[]
    }
    fn apex(&self) -> f32 {
        self.stand.borrow().apex
    }
    fn heap(&self) -> Vec<Vector> {
        self.state().grains.iter().map(|it| [it.x[0], it.x[1], it.x[2], it.radius]).collect()
    }
    fn snapshot(&self, time_s: f64) -> Snapshot {
        let ids: Vec<u32> = self.state().grains.iter().map(|grain| grain.id).collect();
        Snapshot::of(&ids, &self.heap(), self.scales.diameter_m, time_s)
    }
    fn speed_rms(&self) -> f32 {
        self.stand.borrow().speed_rms
    }
    fn overlaps(&mut self) -> (f64, f64) {
        let grains = self.heap();
        let (mut sum, mut largest, mut count) = (0.0, 0.0f64, 0);
        for (i, x) in grains.iter().enumerate() {
            for y in &grains[..i] {
                let apart = vector(x[0] - y[0], x[1] - y[1], x[2] - y[2]);
                let overlap = f64::from(x[3] + y[3]) - f64::from(dot(apart, apart).sqrt());
                if overlap > 0.0 {
                    sum += overlap;
                    largest = largest.max(overlap);
                    count += 1;
                }
            }
        }
        (sum / f64::from(count.max(1)), largest)
    }
    fn fault(&self) -> Option<String> {
        self.stand.borrow().fault.clone()
    }
}

#[cfg(test)]
#[path = "heaps_tests.rs"]
mod tests;
