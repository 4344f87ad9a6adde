//! Polydispersity: grains of unequal size.

use super::Extensions;
use flip_core::domain::seed::derive;

/// Log-normal radii, `ln r = ln r_m + s z` with z normal, cut at [`CUT`] standard deviations. The
/// median is below the mean size, so that the mean volume, and with it the mass of the powder,
/// equals that of monodisperse grains: `r_m = (d / 2) exp(-3 s^2 / 2)`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Sizes {
    spread: f64,
}

/// Cut-off of the radii in standard deviations: a single boulder among hundreds of grains would be
/// a different scene.
const CUT: f64 = 2.5;

impl Sizes {
    pub(super) fn new(extensions: &Extensions) -> Self {
        Self { spread: extensions.size_spread }
    }

    /// No radius is larger, diameters.
    pub(crate) fn widest(&self) -> f32 {
        if self.spread == 0.0 {
            return 0.5;
        }
        (0.5 * libm::exp(self.spread * CUT - 1.5 * self.spread * self.spread)) as f32
    }

    /// Radius of a grain, drawn by its id (order of pouring), diameters.
    pub(crate) fn radius(&self, id: u32) -> f32 {
        if self.spread == 0.0 {
            return 0.5;
        }
        let uniform =
            |k| ((derive(0x512E, &[u64::from(id), k]) >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
        // Box and Muller 1958, with functions that give the same bits on every machine.
        let z = libm::sqrt(-2.0 * libm::log(uniform(0)))
            * libm::cos(std::f64::consts::TAU * uniform(1));
        let z = z.clamp(-CUT, CUT);
        (0.5 * libm::exp(self.spread * z - 1.5 * self.spread * self.spread)) as f32
    }
}
