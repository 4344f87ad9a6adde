//! Liquid bridges: water pulls grains that have touched together until the bridge ruptures.

use super::{Extensions, Mechanism, Pair, Scene};
use crate::lanes::Lanes;

/// A bridge forms on contact and breaks at its rupture distance: separating costs more than
/// approaching returns.
///
/// ```text
/// F = F_0 / (1 + 1.05 s + 2.5 s^2),  s = gap / sqrt(V / R)      Willett, Adams, Johnson, Seville 2000
/// gap < V^(1/3)                                                  Lian, Thornton, Adams 1993, contact angle zero
/// ```
///
/// `humidity` scales both the force, `F_0 = 2 humidity m g`, and the volume,
/// `V = 0.008 humidity d^3 / 8`: at 1 a bridge ruptures at 0.1 d.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Bridges {
    pull: f32,
    /// Gap at which a bridge breaks, diameters.
    pub rupture: f32,
    /// 1 / sqrt(V / R), per diameter.
    inverse_length: f32,
}

/// Bond number at humidity 1.
const BOND: f32 = 2.0;
/// Volume of a bridge at humidity 1 over the radius cubed.
const VOLUME: f64 = 0.008;
/// Memory slot for whether a bridge spans a pair.
const WET: usize = 4;

impl Bridges {
    pub(super) fn new(extensions: &Extensions, scene: &Scene) -> Self {
        let radius = 0.5;
        let volume = VOLUME * extensions.humidity * radius * radius * radius;
        let inverse_length = if volume > 0.0 { 1.0 / (volume / radius).sqrt() } else { 0.0 };
        Self {
            pull: BOND * extensions.humidity as f32 * scene.bond,
            rupture: libm::cbrt(volume) as f32,
            inverse_length: inverse_length as f32,
        }
    }
}

impl Bridges {
    /// Its pull at contact, the gap at which it breaks, and 1 over the length in which the pull falls.
    pub(super) fn numbers(&self) -> [f32; 3] {
        [self.pull, self.rupture, self.inverse_length]
    }
}

#[allow(clippy::inline_always)] // See `lanes`.
impl Mechanism for Bridges {
    #[inline(always)]
    fn pair<L: Lanes>(&self, pair: &mut Pair<L>) {
        if self.pull == 0.0 {
            return;
        }
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let within = pair.gap.below(L::splat(self.rupture));
        let spans = (pair.touch | zero.below(L::load(&pair.memory[WET]))) & within;
        L::select(spans, one, zero).store(&mut pair.memory[WET]);
        *pair.linked |= spans;
        let s = zero.max(pair.gap) * L::splat(self.inverse_length);
        let shape = one + s * (L::splat(1.05) + L::splat(2.5) * s);
        let pull = L::splat(self.pull) / shape * pair.effective;
        pair.pull = pair.pull + L::select(spans, pull, zero);
    }
}
