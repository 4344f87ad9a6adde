//! Vertical vibration of a base or a spoon.

use super::{Extensions, Mechanism, Scene};

/// `a(t) = -A g sin(2 pi f t)`: the inertial acceleration in the frame of a base with the
/// acceleration `A g sin(2 pi f t)`, at [`FREQUENCY_HZ`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Vibration {
    /// Peak acceleration, diameters per substep squared.
    peak: f64,
    /// Angular frequency, radians per substep.
    pace: f64,
}

/// Typical of the small motors in laboratory feeders.
const FREQUENCY_HZ: f64 = 100.0;

impl Vibration {
    pub(super) fn new(extensions: &Extensions, scene: &Scene) -> Self {
        let diameter_m = scene.set.particle_diameter_mm() * 1e-3;
        let per_substep2 = scene.substep_s * scene.substep_s / diameter_m;
        Self {
            peak: extensions.vibration_g * crate::law::GRAVITY * per_substep2,
            pace: std::f64::consts::TAU * FREQUENCY_HZ * scene.substep_s,
        }
    }
}

impl Vibration {
    /// Its peak acceleration, and its angle a substep, radians.
    pub(super) fn numbers(&self) -> [f64; 2] {
        [self.peak, self.pace]
    }
}

impl Mechanism for Vibration {
    fn step(&self, substep: u32) -> f32 {
        // Not the standard library's sine, whose last bit depends on the machine.
        (0.0 - self.peak * libm::sin(self.pace * f64::from(substep))) as f32
    }
}
