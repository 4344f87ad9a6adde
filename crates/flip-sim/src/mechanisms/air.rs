//! Air drag on single grains.

use super::{Extensions, Mechanism, Scene};
use crate::constraints::{V3, inner, scale};
use crate::lanes::Lanes;

/// Drag on a sphere with `C_D = 24 / Re + 0.4` (Stokes at low, Newton at high Reynolds number),
/// taken implicitly:
///
/// ```text
/// u <- u / (1 + a (1 + b |u|)),   a = 18 eta h / (rho d^2),   b = 0.4 rho_air d |u| / (24 eta)
/// ```
///
/// rho follows from the particle mass and diameter of the parameter set: in air the mass matters.
/// The air is at rest in the solved frame, and grains do not shield each other.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Air {
    /// a in the equation above, for a grain of the mean radius.
    rate: f32,
    /// b in the equation above, per diameter per substep.
    inertia: f32,
}

/// Dynamic viscosity of air at 20 deg C, Pa s.
const VISCOSITY: f64 = 1.82e-5;
/// Density of air at 20 deg C, kg/m^3.
const DENSITY: f64 = 1.204;

impl Air {
    pub(super) fn new(extensions: &Extensions, scene: &Scene) -> Self {
        let d = scene.set.particle_diameter_mm() * 1e-3;
        let density =
            scene.set.particle_mass_ug() * 1e-9 / (std::f64::consts::PI / 6.0 * d * d * d);
        let viscosity = VISCOSITY * extensions.air;
        let inertia = if viscosity > 0.0 {
            0.4 * DENSITY * d / (24.0 * viscosity) * d / scene.substep_s
        } else {
            0.0
        };
        Self {
            rate: (18.0 * viscosity * scene.substep_s / (density * d * d)) as f32,
            inertia: inertia as f32,
        }
    }
}

impl Air {
    /// a and b of the equation above.
    pub(super) fn numbers(&self) -> [f32; 2] {
        [self.rate, self.inertia]
    }
}

#[allow(clippy::inline_always)] // See `lanes`.
impl Mechanism for Air {
    #[inline(always)]
    fn grain<L: Lanes>(&self, u: V3<L>, radius: L) -> V3<L> {
        if self.rate == 0.0 {
            return u;
        }
        let one = L::splat(1.0);
        let smallness = L::splat(0.5) / radius;
        let reynolds = L::splat(self.inertia) * inner(u, u).sqrt() / smallness;
        let rate = L::splat(self.rate) * smallness * smallness * (one + reynolds);
        scale(u, one / (one + rate))
    }
}
