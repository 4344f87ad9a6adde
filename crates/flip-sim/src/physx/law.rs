//! The nine parameters as interpreted by the published engine. Lengths in grain diameters, time in
//! frames.

use crate::law::GRAVITY;
use flip_core::domain::parameters::ParameterSet;

/// Frame, s: the longest of those tried in which a grain falling from the opening moves less than a
/// diameter; beyond that it could pass the plate undetected. Grains overlap by less than 1 % of d
/// on average.
pub(crate) const FRAME_S: f64 = 0.001;
/// Iterations per frame: the engine's default.
pub(crate) const ITERATIONS: u32 = 16;

/// Distance within which two grains are solved as a pair, diameters: twice the contact offset, 1.5
/// rest offsets of half a diameter each, times the engine's neighbourhood scale.
const PAIR_RANGE: f32 = 1.5 * 1.01;
/// Surface distance within which a wall contact is made, diameters: contact offset minus rest
/// offset.
const WALL_RANGE: f32 = 0.25;
/// Squared distance below which the engine ignores a pair, m^2: centres within 10 micrometres no
/// longer repel.
const NEAREST2_M2: f64 = 1e-10;
/// The engine's factor on friction between grains; not one of the nine parameters.
const PARTICLE_FRICTION_SCALE: f32 = 1.0;

/// A powder in the terms of the published engine's kernel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Law {
    /// Magnitude of gravity, diameters per frame squared.
    pub gravity: f32,
    /// Factor on every velocity, per frame.
    pub drag: f32,
    /// Iterations per frame.
    pub iterations: u32,
    /// Share of the averaged correction that is applied.
    pub relaxation: f32,
    /// The same at walls.
    pub wall_relaxation: f32,
    /// Coulomb coefficient between grains.
    pub friction: f32,
    /// Coulomb coefficient at walls.
    pub wall_friction: f32,
    /// Adhesion between grains.
    pub grain_adhesion: f32,
    /// Adhesion at walls.
    pub wall_adhesion: f32,
    /// Adhesion radius scale: the distance at which attraction between grains ends, in diameters.
    pub radius_scale: f32,
    /// Gap at which attraction to walls ends, diameters: the same number interpreted as metres.
    pub wall_guard: f32,
    /// Speed limit, diameters per frame. The engine has none unless one is set.
    pub speed_max: f32,
    /// Squared distance within which two grains are a pair, diameters squared.
    pub pair_range2: f32,
    /// Gap within which a grain is in contact with a wall.
    pub wall_range: f32,
    /// Squared distance below which a pair is ignored.
    pub nearest2: f32,
    /// Grain diameter, m.
    pub diameter_m: f64,
    /// Frame, s.
    pub frame_s: f64,
}

impl Law {
    /// The law of a parameter set, with frames of `frame_s` seconds and `iterations` iterations
    /// each, at least one.
    pub(crate) fn new(set: &ParameterSet, frame_s: f64, iterations: u32) -> Self {
        let diameter_m = set.particle_diameter_mm() * 1e-3;
        let iterations = iterations.max(1);
        let relaxation = (2.0 / f64::from(iterations).sqrt()).min(0.9) as f32;
        Self {
            gravity: (set.gravity_scale() * GRAVITY * frame_s * frame_s / diameter_m) as f32,
            drag: (1.0 - (set.damping() * frame_s).min(1.0)) as f32,
            iterations,
            relaxation,
            wall_relaxation: relaxation.min(0.7),
            friction: set.friction() as f32 * PARTICLE_FRICTION_SCALE,
            wall_friction: set.friction() as f32,
            grain_adhesion: (set.adhesion() * set.particle_adhesion_scale()) as f32,
            wall_adhesion: set.adhesion() as f32,
            radius_scale: set.adhesion_offset_scale() as f32,
            wall_guard: (set.adhesion_offset_scale() / diameter_m) as f32,
            speed_max: f32::INFINITY,
            pair_range2: PAIR_RANGE * PAIR_RANGE,
            wall_range: WALL_RANGE,
            nearest2: (NEAREST2_M2 / (diameter_m * diameter_m)) as f32,
            diameter_m,
            frame_s,
        }
    }

    /// Largest reduction of a pair's gap `e` by attraction in one iteration, diameters.
    ///
    /// Between grains it requires a radius scale above 1: within a smaller radius `e` is negative,
    /// and the larger of zero and a negative number is zero.
    #[inline]
    pub(super) fn grain_pull(&self, e: f32) -> f32 {
        if e + 1.0 >= self.radius_scale {
            return 0.0;
        }
        let fade = 1.0 - e / (self.radius_scale - 1.0);
        let fade2 = fade * fade;
        let fade4 = fade2 * fade2;
        (self.grain_adhesion * (fade4 * fade4) * e).max(0.0)
    }

    /// Largest reduction of the separation `sep` to a wall by attraction in one iteration,
    /// diameters.
    ///
    /// The radius is negative for a radius scale below 1, and the fourth power rises again beyond a
    /// positive one; the guard compares a length with a scale. All three are the engine's
    /// behaviour.
    #[inline]
    pub(super) fn wall_pull(&self, sep: f32) -> f32 {
        if self.radius_scale <= 0.0 || self.wall_adhesion <= 0.0 || sep >= self.wall_guard {
            return 0.0;
        }
        let radius = 0.5 * self.radius_scale - 0.5;
        let fade = 1.0 - sep / radius;
        let fade2 = fade * fade;
        (self.wall_adhesion * (fade2 * fade2) * sep.max(0.0)).max(0.0)
    }
}
