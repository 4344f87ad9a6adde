//! The spoon's own adhesion, and the film of powder that sticks to it.

use super::{AtWall, Extensions, Mechanism, Scene, Site};
use crate::constraints::attract;
use crate::lanes::Lanes;
use flip_core::domain::seed::derive;

/// Grains are attracted to a spoon with a bond number of `spoon_adhesion`; a share `hold_up` of all
/// grains, once in contact with it, with one of [`CLING`], which neither tilt nor shake overcomes:
/// a film of up to that share of a layer remains when the spoon is emptied.
///
/// Both fall to zero over a gap of [`REACH`], like the base simulator's adhesion.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Film {
    pull: f32,
    cling: f32,
    share: f64,
}

/// Bond number of the film.
const CLING: f32 = 30.0;
/// Gap at which both end, diameters.
const REACH: f32 = 0.05;

impl Film {
    pub(super) fn new(extensions: &Extensions, scene: &Scene) -> Self {
        let spoon = scene.site == Site::Spoon;
        let share = if spoon { extensions.hold_up } else { 0.0 };
        let adhesion = if spoon { extensions.spoon_adhesion } else { 0.0 };
        Self { pull: adhesion as f32 * scene.bond, cling: CLING * scene.bond, share }
    }

    /// Its pull, that on a grain that clings beside it, and the reach of both.
    pub(super) fn numbers(&self) -> [f32; 3] {
        [self.pull, self.cling, REACH]
    }

    /// 1 for a grain that clings, drawn by its id (order of pouring).
    pub(crate) fn clings(&self, id: u32) -> f32 {
        let draw = (derive(0xF11A, &[u64::from(id)]) >> 11) as f64 / (1u64 << 53) as f64;
        if draw < self.share { 1.0 } else { 0.0 }
    }
}

#[allow(clippy::inline_always)] // See `lanes`.
impl Mechanism for Film {
    #[inline(always)]
    fn wall<L: Lanes>(&self, contact: &mut AtWall<L>) {
        if self.pull == 0.0 && self.share == 0.0 {
            return;
        }
        let full =
            (L::splat(self.pull) + L::splat(self.cling) * contact.clings) * contact.lightness;
        contact.pull = contact.pull + attract(contact.gap, full, L::splat(1.0 / REACH));
    }
}
