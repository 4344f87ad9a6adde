//! One pure function per constraint. Lengths in grain diameters, time in substeps, so a velocity is a displacement.
//!
//! A vector is four lanes with the last one zero: the compiler then keeps it in one register.

/// A vector; the fourth lane is zero.
pub(super) type Vector = [f32; 4];

/// A vector from its three components.
#[inline(always)]
pub(super) fn vector(x: f32, y: f32, z: f32) -> Vector {
    [x, y, z, 0.0]
}

#[inline(always)]
pub(super) fn add(a: Vector, b: Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]]
}

#[inline(always)]
pub(super) fn sub(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]]
}

#[inline(always)]
pub(super) fn scale(a: Vector, k: f32) -> Vector {
    [a[0] * k, a[1] * k, a[2] * k, a[3] * k]
}

#[inline(always)]
pub(super) fn dot(a: Vector, b: Vector) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Strengths of one kind of contact (grain-grain or grain-wall), in the kernel's units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Contact {
    /// Share of an overlap that one substep removes from one side, 0..0.5.
    pub normal: f32,
    /// Share of a tangential stretch that one substep removes from one side, 0..0.5.
    pub tangential: f32,
    /// Coulomb friction coefficient.
    pub friction: f32,
    /// Attraction of touching bodies, diameters per substep squared.
    pub attraction: f32,
    /// Gap at which the attraction has fallen to zero, diameters.
    pub reach: f32,
}

/// Push along the normal that undoes an overlap; zero when there is a gap.
///
/// ```text
/// C = gap >= 0          push = -k C   if C < 0, else 0
/// ```
///
/// | symbol | argument | unit | range |
/// |---|---|---|---|
/// | C | `gap` | grain diameters | surface to surface, negative when overlapping |
/// | k | `stiffness` | 1 | 0 < k < 0.5; a share of the overlap per substep and side |
///
/// One relaxed Jacobi iteration per substep ("small steps", Macklin et al. 2019): the gap is taken at the predicted
/// positions, so the push also takes out approach speed: the restitution is about 0.4 between grains and 0.5 at a wall.
#[inline(always)]
pub(super) fn separate(gap: f32, stiffness: f32) -> f32 {
    stiffness * (-gap).max(0.0)
}

/// Pull along the normal between bodies that touch or nearly touch.
///
/// ```text
/// pull(gap) = b                      gap <= 0
///           = b (1 - gap / reach)    0 < gap < reach
///           = 0                      gap >= reach
/// ```
///
/// A bounded force, the same in loading and unloading: the simplest law with a pull-off force and a rupture distance.
#[inline(always)]
pub(super) fn attract(gap: f32, contact: &Contact) -> f32 {
    contact.attraction * (1.0 - gap.max(0.0) / contact.reach).max(0.0)
}

/// Tangential correction from the stretch of a contact since it stuck, and where it is anchored afterwards.
///
/// ```text
/// s  = (I - n n^T) (r - a)             stretch
/// s' = s min(1, mu push / (k_t |s|))   Coulomb: k_t |s'| <= mu push
/// correction = -k_t s'                 a' = r - s' on slip, a on stick
/// ```
///
/// | symbol | argument | unit | |
/// |---|---|---|---|
/// | r | `offset` | diameters | relative position of the two bodies now |
/// | a | `anchor` | diameters | relative position where the contact last stuck |
/// | n | `normal` | 1 | unit normal |
/// | push | `push` | diameters | from [`separate`]: without the attraction, so the cone rests on load plus attraction |
///
/// The memory of the anchor is what holds a heap at rest (Cundall and Strack 1979, in position form): friction on the
/// displacement of one substep alone lets a heap creep.
#[inline(always)]
pub(super) fn stick(offset: Vector, anchor: Vector, normal: Vector, push: f32, contact: &Contact) -> (Vector, Vector) {
    let stretch = sub(offset, anchor);
    let s = sub(stretch, scale(normal, dot(stretch, normal)));
    let limit = contact.friction * push;
    let held = contact.tangential * contact.tangential * dot(s, s);
    if held <= limit * limit {
        return (scale(s, -contact.tangential), anchor);
    }
    let s = scale(s, limit / held.sqrt());
    (scale(s, -contact.tangential), sub(offset, s))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONTACT: Contact = Contact { normal: 0.15, tangential: 0.1, friction: 0.4, attraction: 0.01, reach: 0.05 };

    #[test]
    fn an_overlap_is_pushed_apart_in_proportion_and_a_gap_is_left_alone() {
        assert_eq!(separate(0.01, 0.15), 0.0);
        assert!((separate(-0.02, 0.15) - 0.003).abs() < 1e-9);
    }

    #[test]
    fn attraction_is_full_in_contact_half_way_in_the_middle_and_gone_at_its_reach() {
        assert_eq!(attract(-0.1, &CONTACT), 0.01);
        assert!((attract(0.025, &CONTACT) - 0.005).abs() < 1e-8);
        assert_eq!(attract(0.05, &CONTACT), 0.0);
        assert_eq!(attract(1.0, &CONTACT), 0.0);
    }

    #[test]
    fn friction_sticks_below_the_coulomb_limit_and_slips_at_it() {
        let normal = vector(0.0, 0.0, 1.0);
        let offset = vector(0.01, 0.0, 0.99);
        let (held, anchor) = stick(offset, vector(0.0, 0.0, 1.0), normal, 1.0, &CONTACT);
        assert_eq!(anchor, vector(0.0, 0.0, 1.0));
        assert!((held[0] + 0.001).abs() < 1e-9 && held[2] == 0.0);
        let push = 0.001;
        let (slipped, moved) = stick(offset, vector(0.0, 0.0, 1.0), normal, push, &CONTACT);
        assert!((dot(slipped, slipped).sqrt() - CONTACT.friction * push).abs() < 1e-9);
        // The anchor follows so that the next substep starts exactly at the limit.
        let (again, _) = stick(offset, moved, normal, push, &CONTACT);
        assert!((again[0] - slipped[0]).abs() < 1e-8);
    }

    #[test]
    fn friction_never_acts_along_the_normal() {
        let normal = vector(0.6, 0.0, 0.8);
        let (held, _) = stick(vector(0.3, -0.2, 0.9), vector(0.1, 0.1, 0.7), normal, 10.0, &CONTACT);
        assert!(dot(held, normal).abs() < 1e-7);
    }
}
