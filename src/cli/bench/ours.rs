//! Costs of the simulator itself: the released column flowing and at rest, at several sizes, and
//! the two experiments built on it.

use super::clock::{Spread, core_s};
use super::{Failure, settle};
use flip_core::domain::bench::Action;
use flip_core::domain::parameters::ParameterSet;
use flip_sim::Work;
use flip_sim::column::Column;
use flip_sim::dispense::{self, Dispenser};
use flip_sim::law::SUBSTEP_S;
use flip_sim::repose::{self, repose};
use rayon::prelude::*;
use serde::Serialize;
use std::time::Instant;

/// Start of the first window, after the release, s: the column collapses from then on. As in
/// `benches/peers/scene.py`.
const START_S: f64 = 0.004;
/// Length of a window, s. As in `benches/peers/scene.py`.
const WINDOW_S: f64 = 0.002;
/// When a column of 2000 grains has come to rest, after the release, s; taller ones take longer as
/// sqrt(height).
const REST_S: f64 = 0.3;
/// Minimum number of particle-substeps in a measurement, for the clock's resolution.
const ENOUGH: f64 = 4e6;

fn substeps(seconds: f64) -> u32 {
    (seconds / SUBSTEP_S).round() as u32
}

/// A column whose windows can be timed one after another.
pub(super) struct Windows {
    /// State before the first window.
    start: Column,
    column: Column,
    /// Core-seconds per simulated second of each window.
    pub costs: Vec<f64>,
    overlaps: Vec<f64>,
}

impl Windows {
    /// The column shortly after its release, flowing.
    pub(super) fn flowing(centres_m: &[[f64; 3]]) -> Self {
        Self::after(Column::new(centres_m), START_S)
    }

    /// The same grains come to rest.
    pub(super) fn resting(centres_m: &[[f64; 3]]) -> Self {
        let higher = (centres_m.len() as f64 / 2000.0).cbrt().sqrt().max(1.0);
        Self::after(Column::new(centres_m), REST_S * higher)
    }

    fn after(mut column: Column, seconds: f64) -> Self {
        column.advance(substeps(seconds));
        Self { start: column.clone(), column, costs: Vec::new(), overlaps: Vec::new() }
    }

    /// Times the next window: the same stretch, repeated as often as the clock needs.
    pub(super) fn time_next(&mut self) {
        let steps = substeps(WINDOW_S);
        let repeats = (ENOUGH / (self.column.particles() as f64 * f64::from(steps))).ceil();
        let mut spent = 0.0;
        let mut end = self.column.clone();
        for _ in 0..repeats as u32 {
            end = self.column.clone();
            spent += core_s(|| end.advance(steps)).0;
        }
        self.column = end;
        self.costs.push(spent / repeats / (f64::from(steps) * SUBSTEP_S));
        self.overlaps.push(self.column.overlaps().0);
    }

    /// Times all of them.
    pub(super) fn time(mut self, windows: u32) -> Self {
        (0..windows).for_each(|_| self.time_next());
        self
    }

    pub(super) fn column(&self) -> &Column {
        &self.column
    }

    /// Core-nanoseconds per grain for one build of the neighbour list, in the first window: the
    /// extra cost of building one in every substep.
    pub(super) fn list_ns(&self) -> f64 {
        let steps = substeps(WINDOW_S);
        let (mut seldom, mut always) = (self.start.clone(), self.start.clone());
        let (plain_s, ()) = core_s(|| seldom.advance(steps));
        let (built_s, ()) = core_s(|| {
            for _ in 0..steps {
                always.outdate();
                always.advance(1);
            }
        });
        let more = (always.rebuilds() - seldom.rebuilds()).max(1);
        1e9 * (built_s - plain_s) / (more as f64 * self.start.particles() as f64)
    }

    /// Operations and bytes of all windows, and their number of particle-substeps.
    pub(super) fn count(&self) -> (Work, f64) {
        let steps = self.costs.len() as u32 * substeps(WINDOW_S);
        (self.start.clone().count(steps), self.start.particles() as f64 * f64::from(steps))
    }

    pub(super) fn cost(&self) -> Spread {
        Spread::of(&self.costs)
    }

    /// Mean over the ends of the windows, in diameters.
    pub(super) fn overlap_mean(&self) -> f64 {
        self.overlaps.iter().sum::<f64>() / self.overlaps.len().max(1) as f64
    }

    /// Core-nanoseconds for one substep of one grain.
    pub(super) fn ns_per_particle_substep(&self) -> Spread {
        self.cost().scaled(1e9 * SUBSTEP_S / self.column.particles() as f64)
    }
}

/// Costs at one number of grains.
#[derive(Debug, Serialize)]
pub(super) struct Size {
    pub particles: u32,
    pub flowing_ns: Spread,
    pub resting_ns: Spread,
    /// Flowing cost per grain over that of the smallest size.
    pub ratio: f64,
    /// Root-mean-square speed of the grains at rest, mm/s.
    pub resting_rms_mm_s: f64,
    /// Neighbour lists built per substep, flowing, over all windows.
    pub lists_per_substep: f64,
    /// Cost of building one list, ns per grain.
    pub list_ns: Spread,
    /// Share of the flowing cost that goes into lists.
    pub list_share: f64,
    /// Memory per grain, flowing, bytes.
    pub bytes_per_particle: f64,
}

/// Cost per grain at each size, on beds made by the simulator itself.
pub(super) fn sizes(particles: &[u32], windows: u32) -> Result<Vec<Size>, Failure> {
    let mut sizes: Vec<Size> = Vec::new();
    for &particles in particles {
        let centres = settle(particles)?;
        let flowing = Windows::flowing(&centres).time(windows);
        let resting = Windows::resting(&centres).time(windows);
        for scene in [&flowing, &resting] {
            if let Some(cause) = scene.column().fault() {
                return Err(Failure::Failed(anyhow::anyhow!("the column of {particles}: {cause}")));
            }
        }
        let flowing_ns = flowing.ns_per_particle_substep();
        let list_ns = Spread::over(windows, |_| flowing.list_ns());
        let built = (flowing.column.rebuilds() - flowing.start.rebuilds()) as f64;
        let lists_per_substep = built / f64::from(windows * substeps(WINDOW_S));
        let mean_cost = flowing.costs.iter().sum::<f64>() / flowing.costs.len() as f64;
        let mean_ns = 1e9 * SUBSTEP_S * mean_cost / f64::from(particles);
        sizes.push(Size {
            particles,
            flowing_ns,
            resting_ns: resting.ns_per_particle_substep(),
            ratio: flowing_ns.median
                / sizes.first().map_or(flowing_ns, |size| size.flowing_ns).median,
            resting_rms_mm_s: resting.column().speeds_m_s().1 * 1e3,
            lists_per_substep,
            list_ns,
            list_share: lists_per_substep * list_ns.median / mean_ns,
            bytes_per_particle: flowing.column().bytes() as f64 / f64::from(particles),
        });
    }
    Ok(sizes)
}

/// Core-seconds of one heap of 2000 grains of the default powder; every window uses another seed.
pub(super) fn heap(windows: u32, seed: u64) -> Spread {
    let settings = repose::Settings::default();
    Spread::over(windows, |k| {
        core_s(|| repose(&ParameterSet::default(), &settings, seed + u64::from(k))).0
    })
}

/// Core-seconds of one step of a weighing: 2500 grains of the default powder at 24 degrees, an 8 mm
/// shake, until they are at rest.
pub(super) fn weighing_step(windows: u32, seed: u64) -> Spread {
    let mut spoon = Dispenser::new(&ParameterSet::default(), &dispense::Settings::default(), seed);
    for _ in 0..3 {
        spoon.step(Action::once(8.0, 0.0));
    }
    let shake = Action::once(0.0, 8.0);
    Spread::over(windows, |_| {
        let mut spoon = spoon.clone();
        core_s(|| spoon.step(shake)).0
    })
}

/// How independent simulations share the machine.
#[derive(Debug, Serialize)]
pub(super) struct Threads {
    pub threads: usize,
    pub simulations: usize,
    /// Wall-clock time of all of them on one thread, s.
    pub one_thread_s: Spread,
    /// The same on all threads.
    pub all_threads_s: Spread,
    /// Median on one thread over median on all.
    pub speed_up: f64,
}

/// Times two copies of a column per thread, on one thread and on all, in turn.
pub(super) fn threads(scene: &Windows, windows: u32) -> Result<Threads, Failure> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let column = &scene.start;
    let steps = (ENOUGH / column.particles() as f64).ceil() as u32;
    let clock = |threads: usize, simulations: usize| -> Result<f64, Failure> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .map_err(anyhow::Error::from)?;
        let mut columns = vec![column.clone(); simulations];
        let start = Instant::now();
        pool.install(|| {
            columns.par_iter_mut().with_max_len(1).for_each(|column| column.advance(steps))
        });
        Ok(start.elapsed().as_secs_f64())
    };
    let simulations = 2 * threads;
    let (mut one, mut all) = (Vec::new(), Vec::new());
    for _ in 0..windows {
        one.push(clock(1, simulations)?);
        all.push(clock(threads, simulations)?);
    }
    let (one_thread_s, all_threads_s) = (Spread::of(&one), Spread::of(&all));
    let speed_up = one_thread_s.median / all_threads_s.median;
    Ok(Threads { threads, simulations, one_thread_s, all_threads_s, speed_up })
}
