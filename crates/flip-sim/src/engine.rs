//! The solver interface used by the heap experiment, and its two implementations.

use super::constraints::{Vector, vector};
use super::grains::Grains;
use super::law::Law;
use super::mechanisms::Site;
use super::physx;
use super::repose::{DEPARTURE_CHECK, Settings};
use super::snapshot::Snapshot;
use super::walls::{Plate, Shape};
use flip_core::domain::parameters::ParameterSet;

/// The units of an engine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scales {
    /// Magnitude of gravity, diameters per step squared.
    pub gravity: f32,
    /// Grain diameter, m.
    pub diameter_m: f64,
    /// Step, s.
    pub step_s: f64,
}

impl Scales {
    /// Converts a speed in diameters per step to m/s.
    pub(super) fn speed_m_s(&self, speed: f32) -> f64 {
        f64::from(speed) * self.diameter_m / self.step_s
    }

    /// Number of steps in a time, rounded to the nearest.
    pub(super) fn steps(&self, seconds: f64) -> u32 {
        (seconds / self.step_s).round() as u32
    }
}

/// A powder on a plate, solved in steps. Lengths in grain diameters, time in steps.
pub(super) trait Engine {
    fn scales(&self) -> Scales;
    /// Adds a grain.
    fn pour(&mut self, x: Vector, v: Vector);
    /// Advances one step.
    fn step(&mut self);
    /// Advances so many steps, and removes the grains that fell off.
    fn advance(&mut self, steps: u32) {
        for step in 0..steps {
            self.step();
            if step % DEPARTURE_CHECK == 0 {
                self.drop_departed();
            }
        }
    }
    /// Removes the grains that fell off.
    fn drop_departed(&mut self);
    fn centres(&self) -> &[Vector];
    /// Centres of the poured grains, measured from the height on which the heap stands; the fourth
    /// number is the radius.
    fn heap(&self) -> Vec<Vector>;
    fn snapshot(&self, time_s: f64) -> Snapshot;
    /// Velocities in the order of the centres; the fourth number counts contacts.
    fn velocities(&self) -> &[Vector];
    /// Height of the highest grain that rests on others, or of the base.
    fn apex(&self) -> f32 {
        let lying = self.centres().iter().zip(self.velocities()).filter(|(_, v)| v[3] >= 2.0);
        lying.fold(0.0, |top, (x, _)| top.max(x[2]))
    }
    /// Root-mean-square speed.
    fn speed_rms(&self) -> f32;
    /// Mean and largest overlap of overlapping grains.
    fn overlaps(&mut self) -> (f64, f64);
    /// The reason why the state is meaningless, if any.
    fn fault(&self) -> Option<String>;
}

/// The simulator's own solver; one step is a substep.
pub(super) struct Physical {
    pub law: Law,
    pub plate: Shape,
    pub grains: Grains,
    /// Height from which the heap is measured.
    floor: f32,
}

impl Physical {
    pub(super) fn new(set: &ParameterSet, settings: &Settings) -> Self {
        let law = Law::new(set, settings.base_friction, settings.substep_s);
        Self::under(law.extended(&settings.extensions, set, Site::Base), settings)
    }

    /// Grains that follow `law`.
    pub(super) fn under(law: Law, settings: &Settings) -> Self {
        // Only a law with mechanisms supports fixed grains.
        let law = Law { extended: law.extended || settings.rough_base, ..law };
        let plate = Plate { radius: settings.base_radius_diameters as f32 };
        let mut grains = Grains::default();
        if settings.rough_base {
            close_packed(plate.radius).into_iter().for_each(|x| grains.fix(x));
        }
        // A grain in a hollow of the fixed layer has its lowest point there.
        let floor = if settings.rough_base { LAYER } else { 0.0 };
        Self { law, plate: Shape::Plate(plate), grains, floor }
    }
}

/// Distance between close-packed layers, grain diameters: sqrt(2/3).
pub(super) const LAYER: f32 = 0.816_496_6;

/// Centres of a close-packed layer on a round base.
pub(super) fn close_packed(radius: f32) -> Vec<Vector> {
    let rows = (radius / 0.75) as i32;
    let at =
        |row: i32, column: i32| [column as f32 + 0.5 * (row & 1) as f32, row as f32 * 0.866_025_4];
    let all = (-rows..=rows).flat_map(|row| (-rows..=rows).map(move |column| at(row, column)));
    all.filter(|[x, y]| x * x + y * y <= radius * radius).map(|[x, y]| vector(x, y, 0.5)).collect()
}

impl Engine for Physical {
    fn scales(&self) -> Scales {
        Scales {
            gravity: self.law.gravity,
            diameter_m: self.law.diameter_m,
            step_s: self.law.substep_s,
        }
    }
    fn pour(&mut self, x: Vector, v: Vector) {
        self.grains.pour(&self.law, x, v);
    }
    fn step(&mut self) {
        self.grains.substep(&self.law, vector(0.0, 0.0, -self.law.gravity), &self.plate);
    }
    fn drop_departed(&mut self) {
        self.grains.take_departed(&self.plate);
    }
    fn centres(&self) -> &[Vector] {
        self.grains.centres()
    }
    fn heap(&self) -> Vec<Vector> {
        self.grains.free().map(|x| [x[0], x[1], x[2] - self.floor, x[3]]).collect()
    }
    fn snapshot(&self, time_s: f64) -> Snapshot {
        Snapshot::of(self.grains.ids(), self.grains.centres(), self.law.diameter_m, time_s)
    }
    fn velocities(&self) -> &[Vector] {
        self.grains.velocities()
    }
    fn speed_rms(&self) -> f32 {
        self.grains.speeds().1
    }
    fn overlaps(&mut self) -> (f64, f64) {
        self.grains.overlaps()
    }
    fn fault(&self) -> Option<String> {
        self.grains.fault()
    }
}

/// The published engine's semantics; one step is a frame.
pub(super) struct Physx {
    law: physx::Law,
    plate: Plate,
    solver: physx::Solver,
}

impl Physx {
    pub(super) fn new(set: &ParameterSet, settings: &Settings) -> Self {
        let law = physx::Law::new(set, settings.frame_s, settings.iterations);
        let plate = Plate { radius: settings.base_radius_diameters as f32 };
        Self { law, plate, solver: physx::Solver::default() }
    }
}

impl Engine for Physx {
    fn scales(&self) -> Scales {
        Scales {
            gravity: self.law.gravity,
            diameter_m: self.law.diameter_m,
            step_s: self.law.frame_s,
        }
    }
    fn pour(&mut self, x: Vector, v: Vector) {
        self.solver.pour(x, v);
    }
    fn step(&mut self) {
        self.solver.frame(&self.law, vector(0.0, 0.0, -self.law.gravity), &self.plate);
    }
    fn drop_departed(&mut self) {
        self.solver.drop_departed(&self.plate);
    }
    fn centres(&self) -> &[Vector] {
        self.solver.centres()
    }
    fn heap(&self) -> Vec<Vector> {
        self.solver.centres().iter().map(|x| [x[0], x[1], x[2], 0.5]).collect()
    }
    fn snapshot(&self, time_s: f64) -> Snapshot {
        let ids: Vec<u32> = (0..self.solver.centres().len() as u32).collect();
        Snapshot::of(&ids, &self.heap(), self.law.diameter_m, time_s)
    }
    fn velocities(&self) -> &[Vector] {
        self.solver.velocities()
    }
    fn speed_rms(&self) -> f32 {
        self.solver.speed_rms()
    }
    fn overlaps(&mut self) -> (f64, f64) {
        self.solver.overlaps(&self.law)
    }
    fn fault(&self) -> Option<String> {
        self.solver.fault()
    }
}
