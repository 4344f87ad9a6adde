//! Electrostatic attraction of charged grains to walls.

use super::{AtWall, Extensions, Mechanism, Scene};
use crate::lanes::Lanes;

/// The attraction of a charge to its image in a conducting wall, `F = F_0 (r / (r + gap))^2`, with
/// `F_0 = charge m g` at contact; it is cut off at [`REACH`], where 3 % remains. Repulsion between
/// grains of like charge is not included.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Charge {
    pull: f32,
}

/// Gap at which the attraction is cut off, diameters.
const REACH: f32 = 2.5;

impl Charge {
    pub(super) fn new(extensions: &Extensions, scene: &Scene) -> Self {
        Self { pull: extensions.charge as f32 * scene.bond }
    }

    /// Its pull at contact, and its reach.
    pub(super) fn numbers(&self) -> [f32; 2] {
        [self.pull, self.reach()]
    }

    /// Largest gap at which a wall acts, diameters.
    pub(super) fn reach(&self) -> f32 {
        if self.pull > 0.0 { REACH } else { 0.0 }
    }
}

#[allow(clippy::inline_always)] // See `lanes`.
impl Mechanism for Charge {
    #[inline(always)]
    fn wall<L: Lanes>(&self, contact: &mut AtWall<L>) {
        if self.pull == 0.0 {
            return;
        }
        let zero = L::splat(0.0);
        let share = contact.radius / (contact.radius + zero.max(contact.gap));
        let pull = L::splat(self.pull) * share * share * contact.lightness;
        contact.pull = contact.pull + L::select(contact.gap.below(L::splat(REACH)), pull, zero);
    }
}
