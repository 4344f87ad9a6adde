//! What the heap experiment asks of a solver, and the two solvers that answer.

use super::constraints::{Vector, vector};
use super::grains::Grains;
use super::law::Law;
use super::physx;
use super::repose::Settings;
use super::walls::Plate;
use crate::domain::parameters::ParameterSet;

/// The units of an engine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scales {
    /// Size of gravity, diameters per step squared.
    pub gravity: f32,
    /// Grain diameter, m.
    pub diameter_m: f64,
    /// Step, s.
    pub step_s: f64,
}

impl Scales {
    /// A speed in diameters per step as m/s.
    pub(super) fn speed_m_s(&self, speed: f32) -> f64 {
        f64::from(speed) * self.diameter_m / self.step_s
    }

    /// Steps in a time, rounded to the nearest.
    pub(super) fn steps(&self, seconds: f64) -> u32 {
        (seconds / self.step_s).round() as u32
    }
}

/// A powder on a plate, solved in steps. Lengths in grain diameters, time in steps.
pub(super) trait Engine {
    fn scales(&self) -> Scales;
    /// Add a grain.
    fn pour(&mut self, x: Vector, v: Vector);
    /// Advance one step.
    fn step(&mut self);
    /// Take out the grains that fell off.
    fn drop_departed(&mut self);
    fn centres(&self) -> &[Vector];
    /// In the order of the centres; the fourth number counts contacts.
    fn velocities(&self) -> &[Vector];
    /// Root mean square.
    fn speed_rms(&self) -> f32;
    /// Mean and largest overlap of overlapping grains.
    fn overlaps(&mut self) -> (f64, f64);
    /// What makes the state meaningless, if anything does.
    fn fault(&self) -> Option<String>;
}

/// The simulator's own solver; a step is a substep.
pub(super) struct Physical {
    law: Law,
    plate: Plate,
    grains: Grains,
}

impl Physical {
    pub(super) fn new(set: &ParameterSet, settings: &Settings) -> Self {
        let law = Law::new(set, settings.base_friction, settings.substep_s);
        Self { law, plate: plate(settings), grains: Grains::default() }
    }
}

fn plate(settings: &Settings) -> Plate {
    Plate { radius: settings.base_radius_diameters as f32 }
}

impl Engine for Physical {
    fn scales(&self) -> Scales {
        Scales { gravity: self.law.gravity, diameter_m: self.law.diameter_m, step_s: self.law.substep_s }
    }
    fn pour(&mut self, x: Vector, v: Vector) {
        self.grains.pour(x, v);
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

/// The published engine's semantics; a step is a frame.
pub(super) struct Physx {
    law: physx::Law,
    plate: Plate,
    solver: physx::Solver,
}

impl Physx {
    pub(super) fn new(set: &ParameterSet, settings: &Settings) -> Self {
        let law = physx::Law::new(set, settings.frame_s, settings.iterations);
        Self { law, plate: plate(settings), solver: physx::Solver::default() }
    }
}

impl Engine for Physx {
    fn scales(&self) -> Scales {
        Scales { gravity: self.law.gravity, diameter_m: self.law.diameter_m, step_s: self.law.frame_s }
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
