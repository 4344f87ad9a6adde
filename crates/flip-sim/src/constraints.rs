//! One pure function per constraint, for sixteen contacts at once. Lengths in grain diameters, time
//! in substeps, so a velocity is a displacement.

use super::lanes::{Lanes, Mask};

/// A vector in memory; the meaning of the fourth number is documented where it is stored.
pub(super) type Vector = [f32; 4];
/// Sixteen vectors by component.
pub(super) type V3<L> = [L; 3];

/// A vector from its three components.
#[inline(always)]
pub(super) fn vector(x: f32, y: f32, z: f32) -> Vector {
    [x, y, z, 0.0]
}

/// The same vector for sixteen grains.
#[inline(always)]
pub(super) fn splat<L: Lanes>(a: Vector) -> V3<L> {
    [L::splat(a[0]), L::splat(a[1]), L::splat(a[2])]
}

/// Dot product of two vectors in memory.
#[inline(always)]
pub(super) fn dot(a: Vector, b: Vector) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(super) fn add<L: Lanes>(a: V3<L>, b: V3<L>) -> V3<L> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
pub(super) fn sub<L: Lanes>(a: V3<L>, b: V3<L>) -> V3<L> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(super) fn scale<L: Lanes>(a: V3<L>, k: L) -> V3<L> {
    [a[0] * k, a[1] * k, a[2] * k]
}

#[inline(always)]
pub(super) fn inner<L: Lanes>(a: V3<L>, b: V3<L>) -> L {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub(super) fn cross<L: Lanes>(a: V3<L>, b: V3<L>) -> V3<L> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
pub(super) fn choose<L: Lanes>(mask: Mask, yes: V3<L>, no: V3<L>) -> V3<L> {
    [L::select(mask, yes[0], no[0]), L::select(mask, yes[1], no[1]), L::select(mask, yes[2], no[2])]
}

/// Strengths of one kind of contact (grain-grain or grain-wall), in the kernel's units. A share is
/// the fraction that one substep removes from one side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Contact {
    /// Share of an overlap.
    pub normal: f32,
    /// Share of a tangential stretch.
    pub tangential: f32,
    /// Share of the approach velocity, for a grain with one contact.
    pub normal_damping: f32,
    /// Share of the slip velocity, for a grain with one contact.
    pub tangential_damping: f32,
    /// Coulomb friction coefficient.
    pub friction: f32,
    /// Attraction of touching bodies, diameters per substep squared.
    pub attraction: f32,
    /// Gap at which bodies begin to touch, diameters: above zero by the distance over which the
    /// attraction pulls them together, so that a pair at rest has no overlap.
    pub onset: f32,
    /// Gap at which the attraction has fallen to zero, diameters.
    pub reach: f32,
}

impl Contact {
    /// A contact whose attraction rises linearly from zero at `reach` and which rests at gap zero.
    ///
    /// ```text
    /// onset = b / (k + b / reach)      attraction = k onset        b: the attraction that the ramp has at gap zero
    /// ```
    ///
    /// so that the ramp `b (1 - gap / reach)` meets the tension `k gap` of a stretched contact at
    /// `onset`.
    pub(super) fn attracted(self, b: f32) -> Self {
        let onset = b / (self.normal + b / self.reach);
        Self { attraction: self.normal * onset, onset, ..self }
    }
}

/// Push along the normal between touching bodies: reverses an overlap and slows an approach.
///
/// ```text
/// C = gap - onset >= 0          push = max(0, -k C - c u)   if C < 0, else 0
/// ```
///
/// | symbol | argument | unit | |
/// |---|---|---|---|
/// | C | `gap` | diameters | gap beyond the onset, at the predicted positions |
/// | u | `opening` | diameters per substep | speed at which the bodies part, predicted |
/// | k | `stiffness` | 1 | share of the overlap per substep and side |
/// | c | `damping` | 1 | share of the speed per substep and side |
///
/// One relaxed Jacobi iteration per substep ("small steps", Macklin et al. 2019). A push never
/// becomes a pull: any excess damping is dropped.
#[inline(always)]
pub(super) fn separate<L: Lanes>(gap: L, opening: L, stiffness: L, damping: L) -> L {
    let zero = L::splat(0.0);
    zero.max(stiffness * (zero - gap) - damping * opening)
}

/// Pull along the normal between bodies that touch or nearly touch.
///
/// ```text
/// pull = b                                   gap <= onset
///      = b (reach - gap) / (reach - onset)   onset < gap < reach
///      = 0                                   gap >= reach
/// ```
///
/// A bounded force, the same in loading and unloading: the simplest law with a pull-off force and a
/// rupture distance. `inverse_ramp` is 1 / (reach - onset), `gap` is the gap beyond the onset.
#[inline(always)]
pub(super) fn attract<L: Lanes>(gap: L, attraction: L, inverse_ramp: L) -> L {
    let zero = L::splat(0.0);
    attraction * zero.max(L::splat(1.0) - zero.max(gap) * inverse_ramp)
}

/// The effect of friction on a contact.
#[derive(Clone, Copy)]
pub(super) struct Held<L> {
    /// Tangential correction of the first body.
    pub correction: V3<L>,
    /// New anchor of the contact.
    pub anchor: V3<L>,
}

/// Shares of a tangential stretch and of a slip velocity, and the Coulomb limit.
#[derive(Clone, Copy)]
pub(super) struct Grip<L> {
    /// Share of the stretch per substep and side.
    pub stiffness: L,
    /// Inverse of `stiffness`.
    pub looseness: L,
    /// Share of the slip velocity per substep and side.
    pub damping: L,
    /// Largest correction: friction coefficient times push.
    pub limit: L,
}

/// Tangential correction from the stretch of a contact since it last stuck.
///
/// ```text
/// s = (I - n n^T) (r - a)              stretch
/// w = (I - n n^T) u                    slip velocity
/// t = k_t s + c_t w
/// t' = t min(1, mu push / |t|)         Coulomb
/// correction = -t'                     a' = a on stick, r - t' / k_t on slip
/// ```
///
/// | symbol | argument | unit | |
/// |---|---|---|---|
/// | r | `offset` | diameters | relative position of the two bodies, predicted |
/// | a | `anchor` | diameters | relative position where the contact last stuck |
/// | u | `velocity` | diameters per substep | relative velocity, predicted |
/// | n | `normal` | 1 | unit normal |
/// | mu push | `grip.limit` | diameters | push from [`separate`], without the attraction: the cone rests on load plus attraction |
///
/// The anchor's memory is what keeps a heap at rest (Cundall and Strack 1979, in position form):
/// with friction on the displacement of one substep alone, a heap creeps.
#[inline(always)]
pub(super) fn stick<L: Lanes>(
    offset: V3<L>,
    anchor: V3<L>,
    velocity: V3<L>,
    normal: V3<L>,
    opening: L,
    grip: Grip<L>,
) -> Held<L> {
    let stretch = sub(offset, anchor);
    let s = sub(stretch, scale(normal, inner(stretch, normal)));
    let w = sub(velocity, scale(normal, opening));
    let t = add(scale(s, grip.stiffness), scale(w, grip.damping));
    let t2 = inner(t, t);
    let slips = (grip.limit * grip.limit).below(t2);
    if slips == 0 {
        return Held { correction: t, anchor };
    }
    let one = L::splat(1.0);
    let t = scale(t, L::select(slips, grip.limit / t2 * t2.sqrt(), one));
    let moved = sub(offset, scale(t, grip.looseness));
    Held { correction: t, anchor: choose(slips, moved, anchor) }
}

#[cfg(test)]
mod tests {
    use super::super::lanes::{Portable, WIDTH};
    use super::{Contact, Grip, Lanes, V3, attract, separate, stick};

    fn splat(x: f32) -> Portable {
        Portable::splat(x)
    }

    fn first(x: Portable) -> f32 {
        let mut lanes = [0.0; WIDTH];
        x.store(&mut lanes);
        lanes[0]
    }

    fn firsts(x: V3<Portable>) -> [f32; 3] {
        x.map(first)
    }

    #[test]
    fn an_overlap_is_pushed_apart_in_proportion_and_a_gap_is_left_alone() {
        let push =
            |gap, opening| first(separate(splat(gap), splat(opening), splat(0.15), splat(0.25)));
        assert_eq!(push(0.01, 0.0), 0.0);
        assert!((push(-0.02, 0.0) - 0.003).abs() < 1e-9);
        assert!((push(-0.02, -0.01) - 0.0055).abs() < 1e-9, "an approach is slowed down");
        assert_eq!(push(-0.02, 0.5), 0.0, "a push never becomes a pull");
    }

    #[test]
    fn attraction_is_full_in_contact_half_way_in_the_middle_and_gone_at_its_reach() {
        let pull = |gap| first(attract(splat(gap), splat(0.01), splat(1.0 / 0.05)));
        assert_eq!(pull(-0.1), 0.01);
        assert!((pull(0.025) - 0.005).abs() < 1e-8);
        assert_eq!((pull(0.05), pull(1.0)), (0.0, 0.0));
    }

    #[test]
    fn an_attracted_pair_rests_without_overlap_and_its_ramp_has_no_step() {
        let bare = Contact {
            normal: 0.15,
            tangential: 0.05,
            normal_damping: 0.25,
            tangential_damping: 0.1,
            friction: 0.4,
            attraction: 0.0,
            onset: 0.0,
            reach: 0.05,
        };
        assert_eq!(bare.attracted(0.0), bare);
        let b = 0.001;
        let contact = bare.attracted(b);
        let at = |gap: f32| {
            let beyond = splat(gap - contact.onset);
            let ramp = splat(1.0 / (contact.reach - contact.onset));
            let push = separate(beyond, splat(0.0), splat(contact.normal), splat(0.0));
            first(push - attract(beyond, splat(contact.attraction), ramp))
        };
        assert!(at(0.0).abs() < 1e-9, "no force at gap zero: {}", at(0.0));
        for gap in [contact.onset, 0.02, 0.04, 0.0499] {
            assert!(
                (at(gap) + b * (1.0 - gap / 0.05)).abs() < 1e-8,
                "the ramp at {gap}: {}",
                at(gap)
            );
        }
    }

    const GRIP: Grip<f32> = Grip { stiffness: 0.1, looseness: 10.0, damping: 0.0, limit: 1.0 };

    fn hold(
        offset: [f32; 3],
        anchor: [f32; 3],
        normal: [f32; 3],
        grip: Grip<f32>,
    ) -> ([f32; 3], [f32; 3]) {
        let grip = Grip {
            stiffness: splat(grip.stiffness),
            looseness: splat(grip.looseness),
            damping: splat(grip.damping),
            limit: splat(grip.limit),
        };
        let still = [0.0; 3].map(splat);
        let held =
            stick(offset.map(splat), anchor.map(splat), still, normal.map(splat), splat(0.0), grip);
        (firsts(held.correction), firsts(held.anchor))
    }

    #[test]
    fn friction_sticks_below_the_coulomb_limit_and_slips_at_it() {
        let (offset, anchor, normal) = ([0.01, 0.0, 0.99], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]);
        let (held, stays) = hold(offset, anchor, normal, GRIP);
        assert_eq!(stays, anchor);
        assert!((held[0] - 0.001).abs() < 1e-9 && held[2] == 0.0);
        let limit = 0.0004;
        let (slipped, moved) = hold(offset, anchor, normal, Grip { limit, ..GRIP });
        assert!((slipped[0] - limit).abs() < 1e-9);
        // The anchor follows so that the next substep starts exactly at the limit.
        let (again, _) = hold(offset, moved, normal, Grip { limit, ..GRIP });
        assert!((again[0] - slipped[0]).abs() < 1e-8);
    }

    #[test]
    fn friction_never_acts_along_the_normal() {
        let normal = [0.6, 0.0, 0.8];
        let (held, _) =
            hold([0.3, -0.2, 0.9], [0.1, 0.1, 0.7], normal, Grip { limit: 10.0, ..GRIP });
        assert!((held[0] * normal[0] + held[2] * normal[2]).abs() < 1e-7);
    }
}
