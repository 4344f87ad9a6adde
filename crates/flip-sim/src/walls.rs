//! Walls: shapes that return the distance to a grain's surface and the outward direction. Lengths
//! in grain diameters.

use super::constraints::{V3, Vector, choose, inner, scale, sub};
use super::lanes::Lanes;
use super::scoop::Trough;
use super::shapes::Silo;

/// The nearest point of a wall to each of sixteen grains.
#[derive(Clone, Copy)]
pub(super) struct Touch<L> {
    /// Distance between the surfaces, negative when they overlap.
    pub gap: L,
    /// Unit vector from the wall to the grain.
    pub normal: V3<L>,
    /// Velocity of the wall there, diameters per substep.
    pub velocity: V3<L>,
}

impl<L: Lanes> Touch<L> {
    /// A contact with a wall at rest.
    #[inline(always)]
    pub(super) fn still(gap: L, normal: V3<L>) -> Self {
        Self { gap, normal, velocity: [L::splat(0.0); 3] }
    }
}

/// A fixed wall in the frame of the simulation.
pub(super) trait Wall {
    /// Computes the contacts of grains of diameter 1 centred at `p`.
    fn touch<L: Lanes>(&self, p: V3<L>) -> Touch<L>;
    /// Whether a grain centred at `p` has left the scene for good.
    fn has_left(&self, p: Vector) -> bool;
}

/// The walls of a scene. One type for all of them, so that the kernel is compiled only once.
#[derive(Debug, Clone, Copy)]
pub(super) enum Shape {
    /// No wall anywhere.
    Nowhere,
    Plate(Plate),
    Bowl(Bowl),
    Plane(Plane),
    Trough(Trough),
    Silo(Silo),
}

impl Shape {
    /// The infinite plane z = 0.
    pub(super) const FLAT: Self = Self::Plane(Plane { normal: [0.0, 0.0, 1.0] });
}

impl Wall for Shape {
    #[inline(always)]
    fn touch<L: Lanes>(&self, p: V3<L>) -> Touch<L> {
        match self {
            Self::Nowhere => {
                Touch::still(L::splat(f32::MAX), [L::splat(0.0), L::splat(0.0), L::splat(1.0)])
            }
            Self::Plate(plate) => plate.touch(p),
            Self::Bowl(bowl) => bowl.touch(p),
            Self::Plane(plane) => plane.touch(p),
            Self::Trough(trough) => trough.touch(p),
            Self::Silo(silo) => silo.touch(p),
        }
    }

    fn has_left(&self, p: Vector) -> bool {
        match self {
            Self::Nowhere => false,
            Self::Plate(plate) => plate.has_left(p),
            Self::Bowl(bowl) => bowl.has_left(p),
            Self::Plane(plane) => plane.has_left(p),
            Self::Trough(trough) => trough.has_left(p),
            Self::Silo(silo) => silo.has_left(p),
        }
    }
}

/// An infinite plane through the origin.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane {
    /// Unit vector out of the wall.
    pub normal: [f32; 3],
}

impl Wall for Plane {
    #[inline(always)]
    fn touch<L: Lanes>(&self, p: V3<L>) -> Touch<L> {
        let normal = [L::splat(self.normal[0]), L::splat(self.normal[1]), L::splat(self.normal[2])];
        Touch::still(inner(p, normal) - L::splat(RADIUS), normal)
    }

    fn has_left(&self, _: Vector) -> bool {
        false
    }
}

/// Radius of a grain in the kernel's unit of length.
pub(super) const RADIUS: f32 = 0.5;
/// Lower limit of distances, to keep divisions finite.
pub(super) const NEAREST: f32 = 1e-6;

/// A horizontal round plate at z = 0 with a sharp rim; grains beyond it fall.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plate {
    /// Radius, grain diameters.
    pub radius: f32,
}

impl Wall for Plate {
    #[inline(always)]
    fn touch<L: Lanes>(&self, p: V3<L>) -> Touch<L> {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let radius = L::splat(self.radius);
        let r2 = p[0] * p[0] + p[1] * p[1];
        let over = r2.below(radius * radius);
        // A cohesive grain can crawl around the rim: below the plate it touches the underside.
        let side = L::select(p[2].below(L::splat(-0.25)), L::splat(-1.0), one);
        let flat = Touch::still(side * p[2] - L::splat(RADIUS), [zero, zero, side]);
        if over == u16::MAX {
            return flat;
        }
        let to_rim = radius / r2.sqrt().max(L::splat(NEAREST));
        let rim = touch_point(p, [p[0] * to_rim, p[1] * to_rim, zero]);
        Touch::still(L::select(over, flat.gap, rim.gap), choose(over, flat.normal, rim.normal))
    }

    fn has_left(&self, p: Vector) -> bool {
        p[2] < -1.0
    }
}

/// The bowl of a spoon: the lower half of an ellipsoid, open at z = 0, centred at the origin, tip
/// towards +x.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bowl {
    /// Semi-axes along x (length), y (width) and z (depth), grain diameters.
    pub semi_axes: [f32; 3],
    /// 1 / semi-axis^2.
    inverse_squares: [f32; 3],
}

impl Bowl {
    pub(super) fn new(semi_axes: [f32; 3]) -> Self {
        Self { semi_axes, inverse_squares: semi_axes.map(|a| 1.0 / (a * a)) }
    }
}

impl Wall for Bowl {
    /// Inside, the distance to the ellipsoid is first order, `f (1 - f) / |grad f^2 / 2|` with
    /// `f^2 = (x/a)^2 + (y/b)^2 + (z/c)^2`: exact at the surface, where contacts occur. Above the
    /// bowl only the rim, a sharp edge, can be touched.
    #[inline(always)]
    fn touch<L: Lanes>(&self, p: V3<L>) -> Touch<L> {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let [ia, ib, ic] = self.inverse_squares;
        let inverse: V3<L> = [L::splat(ia), L::splat(ib), L::splat(ic)];
        let level = p[0] * p[0] * inverse[0] + p[1] * p[1] * inverse[1];
        let f2 = level + p[2] * p[2] * inverse[2];
        let inside = p[2].below(zero) & f2.below(one);
        let gradient = [p[0] * inverse[0], p[1] * inverse[1], p[2] * inverse[2]];
        let steepness = inner(gradient, gradient).sqrt().max(L::splat(NEAREST));
        let f = f2.sqrt();
        let bowl = Touch::still(
            f * (one - f) / steepness - L::splat(RADIUS),
            scale(gradient, (zero - one) / steepness),
        );
        // Very close to the middle the first-order distance vanishes, but the bowl is deep.
        let middle = f2.below(L::splat(0.01));
        let bowl = Touch { gap: L::select(middle, L::splat(self.semi_axes[2]), bowl.gap), ..bowl };
        if inside == u16::MAX {
            return bowl;
        }
        let to_rim = one / level.sqrt().max(L::splat(NEAREST));
        let rim = touch_point(p, [p[0] * to_rim, p[1] * to_rim, zero]);
        // Far above the middle: no contact, and the rim has no nearest point there.
        let rim_gap = L::select(level.below(L::splat(0.25)), L::splat(f32::MAX), rim.gap);
        Touch::still(L::select(inside, bowl.gap, rim_gap), choose(inside, bowl.normal, rim.normal))
    }

    fn has_left(&self, p: Vector) -> bool {
        let f2: f32 = (0..3).map(|k| p[k] * p[k] * self.inverse_squares[k]).sum();
        p[2] < -1.5 && f2 > 1.0
    }
}

impl Bowl {
    /// Like [`Wall::touch`], but with an outside too: the bowl is a thin shell.
    #[inline(always)]
    pub(super) fn shell<L: Lanes>(&self, p: V3<L>) -> Touch<L> {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let [ia, ib, ic] = self.inverse_squares;
        let gradient = [p[0] * L::splat(ia), p[1] * L::splat(ib), p[2] * L::splat(ic)];
        let f2 = inner(p, gradient);
        let beneath = p[2].below(zero) & !f2.below(one);
        let steepness = inner(gradient, gradient).sqrt().max(L::splat(NEAREST));
        let f = f2.sqrt();
        let inside = self.touch(p);
        let gap = f * (f - one) / steepness - L::splat(RADIUS);
        let normal = scale(gradient, one / steepness);
        Touch::still(L::select(beneath, gap, inside.gap), choose(beneath, normal, inside.normal))
    }

    /// Whether a grain centred at `p` lies in the bowl or on its contents.
    pub(super) fn holds(&self, p: [f32; 3]) -> bool {
        let level: f32 = (0..2).map(|k| p[k] * p[k] * self.inverse_squares[k]).sum();
        level + p[2].min(0.0).powi(2) * self.inverse_squares[2] < 1.0
    }
}

/// Contacts of grains with points.
#[inline(always)]
pub(super) fn touch_point<L: Lanes>(p: V3<L>, point: V3<L>) -> Touch<L> {
    let away = sub(p, point);
    let distance = inner(away, away).sqrt().max(L::splat(NEAREST));
    Touch::still(distance - L::splat(RADIUS), scale(away, L::splat(1.0) / distance))
}

#[cfg(test)]
mod tests {
    use super::super::lanes::{Portable, WIDTH};
    use super::*;

    /// The contact of one grain.
    fn touch(wall: &impl Wall, p: [f32; 3]) -> (f32, [f32; 3]) {
        let first = |x: Portable| {
            let mut lanes = [0.0; WIDTH];
            x.store(&mut lanes);
            lanes[0]
        };
        let touch = wall.touch(p.map(Portable::splat));
        (first(touch.gap), touch.normal.map(first))
    }

    #[test]
    fn a_plate_is_touched_from_above_and_around_its_rim() {
        let plate = Plate { radius: 10.0 };
        assert!((touch(&plate, [3.0, 4.0, 0.6]).0 - 0.1).abs() < 1e-6);
        let (gap, normal) = touch(&plate, [10.3, 0.0, 0.4]);
        assert!(gap.abs() < 1e-6);
        assert!((normal[0] - 0.6).abs() < 1e-6 && (normal[2] - 0.8).abs() < 1e-6);
    }

    #[test]
    fn the_distance_to_a_spherical_bowl_is_exact_where_grains_touch_it() {
        let bowl = Bowl::new([10.0, 10.0, 10.0]);
        for z in [-9.5f32, -6.0, -0.1] {
            let x = (9.5f32 * 9.5 - z * z).max(0.0).sqrt();
            let (gap, normal) = touch(&bowl, [x, 0.0, z]);
            assert!(gap.abs() < 1e-4, "gap {gap} at z {z}");
            assert!((normal[0] + x / 9.5).abs() < 1e-5);
        }
    }

    #[test]
    fn the_distance_to_the_ellipsoid_agrees_with_a_brute_force_search() {
        let bowl = Bowl::new([18.5, 13.0, 7.4]);
        for (u, v) in [(0.3f32, 0.2f32), (1.0, 0.7), (2.5, 1.1), (4.0, 0.5)] {
            let s = [18.5 * u.cos() * v.cos(), 13.0 * u.sin() * v.cos(), -7.4 * v.sin()];
            let n = [s[0] / (18.5f32 * 18.5), s[1] / (13.0 * 13.0), s[2] / (7.4 * 7.4)];
            let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
            // A centre half a diameter inside the surface point: its true gap is zero.
            let (gap, _) = touch(&bowl, std::array::from_fn(|k| s[k] - 0.5 * n[k] / length));
            // First order: off by half of distance^2 times curvature, at most 0.5^2 / 2 * 18.5 /
            // 7.4^2 = 0.04.
            assert!(gap.abs() < 0.04, "gap {gap}");
        }
    }

    #[test]
    fn above_the_middle_of_a_bowl_nothing_is_near() {
        let bowl = Bowl::new([18.5, 13.0, 7.4]);
        assert!(touch(&bowl, [0.0, 0.0, 2.0]).0 > 1.0 && touch(&bowl, [0.01, 0.0, -0.01]).0 > 1.0);
    }
}
