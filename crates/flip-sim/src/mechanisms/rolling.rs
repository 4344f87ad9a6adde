//! Rolling resistance: a torque against grains rolling on each other and on walls.

use super::{AtWall, Extensions, Mechanism, Pair, Scene};
use crate::constraints::{V3, add, choose, inner, scale, sub};
use crate::lanes::{Lanes, Mask};

/// An elastic-plastic spring, the model that keeps heaps still (type C in Ai, Chen, Rotter and Ooi
/// 2011):
///
/// ```text
/// w = w_i - w_j                        rolling and twisting velocity, radians per substep
/// s <- s + w                           stretch since the contact stuck
/// M = m r^2 (k_t s + c_t w)            torque, m = 2 m_i m_j / (m_i + m_j)
/// M' = M min(1, mu_r r push / |M|)     and s follows so that the next substep begins at the limit
/// ```
///
/// with r = 2 r_i r_j / (r_i + r_j); at a wall, the grain's own radius. Twisting about the normal
/// is resisted like rolling: a contact flat enough to resist one resists the other.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Rolling {
    friction: f32,
    stiffness: f32,
    damping: f32,
}

/// Damping over stiffness of a rolling contact, as for sliding.
const DAMPING_OVER_STIFFNESS: f32 = 2.0;

impl Rolling {
    pub(super) fn new(extensions: &Extensions, scene: &Scene) -> Self {
        Self {
            friction: extensions.rolling_friction as f32,
            stiffness: scene.grip,
            damping: DAMPING_OVER_STIFFNESS * scene.grip,
        }
    }

    /// Its friction, stiffness and damping.
    pub(super) fn numbers(&self) -> [f32; 3] {
        [self.friction, self.stiffness, self.damping]
    }

    /// Torque against `turning` and the updated stretch, for contacts of this radius and share.
    #[allow(clippy::inline_always)] // See `lanes`.
    #[inline(always)]
    fn resist<L: Lanes>(
        &self,
        stretch: V3<L>,
        turning: V3<L>,
        radius: L,
        side: L,
        push: L,
    ) -> [V3<L>; 2] {
        let s = add(stretch, turning);
        let r2 = radius * radius * side;
        let (k, c) = (L::splat(self.stiffness) * r2, L::splat(self.damping) * r2);
        let torque = add(scale(s, k), scale(turning, c));
        let limit = L::splat(self.friction) * radius * push;
        let size2 = inner(torque, torque);
        let slips = (limit * limit).below(size2);
        if slips == 0 {
            return [torque, s];
        }
        let one = L::splat(1.0);
        let torque = scale(torque, L::select(slips, limit / size2.sqrt(), one));
        [torque, choose(slips, scale(torque, one / k), s)]
    }
}

#[allow(clippy::inline_always)] // See `lanes`.
impl Mechanism for Rolling {
    #[inline(always)]
    fn pair<L: Lanes>(&self, pair: &mut Pair<L>) {
        if self.friction == 0.0 || pair.touch == 0 {
            return;
        }
        let zero = L::splat(0.0);
        let [mine, theirs] = pair.radii;
        let radius = (mine + mine) * theirs / (mine + theirs);
        let stretch =
            [L::load(&pair.memory[0]), L::load(&pair.memory[1]), L::load(&pair.memory[2])];
        let [torque, stretch] =
            self.resist(stretch, pair.turning, radius, pair.reduced_mass, pair.push);
        let kept: [L; 3] = choose(pair.touch, stretch, [zero; 3]);
        kept[0].store(&mut pair.memory[0]);
        kept[1].store(&mut pair.memory[1]);
        kept[2].store(&mut pair.memory[2]);
        pair.torque = sub(pair.torque, choose(pair.touch, torque, [zero; 3]));
    }

    #[inline(always)]
    fn wall<L: Lanes>(&self, contact: &mut AtWall<L>) {
        if self.friction == 0.0 {
            return;
        }
        let zero = L::splat(0.0);
        // A wall does not yield: the grain takes the whole stretch.
        let side = L::splat(2.0);
        let [torque, stretch] =
            self.resist(*contact.stretch, contact.spin, contact.radius, side, contact.push);
        let touch: Mask = contact.touch;
        *contact.stretch = choose(touch, stretch, [zero; 3]);
        contact.torque = sub(contact.torque, choose(touch, torque, [zero; 3]));
    }
}
