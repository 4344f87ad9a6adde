//! Contact-age cohesion: a contact strengthens while it lasts.

use super::{Extensions, Mechanism, Pair, Scene};
use crate::lanes::Lanes;

/// `Bo(t) = Bo_c t / (t + tau)` in addition to the base cohesion, for a contact of age t. A contact
/// that opens loses its age.
///
/// Creep flattens the asperities of a contact under load, so that its adhesion grows and saturates;
/// the hyperbola is the simplest law with both limits. tau is [`HALF_LIFE_S`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Consolidation {
    pull: f32,
    half_life: f32,
}

/// Age at which half of the strength is reached, s.
const HALF_LIFE_S: f64 = 0.1;
/// Memory slot for the age, in substeps.
pub(crate) const AGE: usize = 3;

impl Consolidation {
    pub(super) fn new(extensions: &Extensions, scene: &Scene) -> Self {
        Self {
            pull: extensions.consolidation as f32 * scene.bond,
            half_life: (HALF_LIFE_S / scene.substep_s) as f32,
        }
    }
}

impl Consolidation {
    /// Its pull on a contact of any age, and the age at which it is half of that, substeps.
    pub(super) fn numbers(&self) -> [f32; 2] {
        [self.pull, self.half_life]
    }
}

#[allow(clippy::inline_always)] // See `lanes`.
impl Mechanism for Consolidation {
    #[inline(always)]
    fn pair<L: Lanes>(&self, pair: &mut Pair<L>) {
        if self.pull == 0.0 || pair.touch == 0 {
            return;
        }
        let zero = L::splat(0.0);
        let age = L::load(&pair.memory[AGE]) + L::splat(1.0);
        L::select(pair.touch, age, zero).store(&mut pair.memory[AGE]);
        let pull = L::splat(self.pull) * age / (age + L::splat(self.half_life)) * pair.effective;
        pair.pull = pair.pull + L::select(pair.touch, pull, zero);
    }
}
