//! Walls: shapes that answer "how far is this grain's surface, and which way is out". Lengths in grain diameters.

use super::constraints::{Vector, dot, scale, sub, vector};

/// The nearest point of a wall to a grain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Touch {
    /// Distance between the surfaces, negative when they overlap.
    pub gap: f32,
    /// Unit vector from the wall to the grain.
    pub normal: Vector,
}

/// A fixed wall in the frame of the simulation.
pub(super) trait Wall {
    /// The contact of a grain of diameter 1 centred at `p`.
    fn touch(&self, p: Vector) -> Touch;
    /// Whether a grain centred at `p` has left the scene for good.
    fn has_left(&self, p: Vector) -> bool;
}

/// Radius of a grain in the kernel's unit of length.
const RADIUS: f32 = 0.5;

/// A horizontal round plate at z = 0 with a sharp rim; grains beyond it fall.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plate {
    /// Radius, grain diameters.
    pub radius: f32,
}

impl Wall for Plate {
    #[inline(always)]
    fn touch(&self, p: Vector) -> Touch {
        let r2 = p[0] * p[0] + p[1] * p[1];
        if r2 <= self.radius * self.radius {
            // A cohesive grain can crawl around the rim: below the plate it touches the underside.
            let side = if p[2] < -0.25 { -1.0 } else { 1.0 };
            return Touch { gap: side * p[2] - RADIUS, normal: vector(0.0, 0.0, side) };
        }
        let to_rim = self.radius / r2.sqrt();
        touch_point(p, vector(p[0] * to_rim, p[1] * to_rim, 0.0))
    }

    #[inline(always)]
    fn has_left(&self, p: Vector) -> bool {
        p[2] < -1.0
    }
}

/// The bowl of a spoon: the lower half of an ellipsoid, open at z = 0, centred at the origin, tip towards +x.
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

    /// (x/a)^2 + (y/b)^2: below 1 inside the rim.
    #[inline(always)]
    fn rim_level(&self, p: Vector) -> f32 {
        p[0] * p[0] * self.inverse_squares[0] + p[1] * p[1] * self.inverse_squares[1]
    }
}

impl Wall for Bowl {
    /// Inside, the distance to the ellipsoid is taken to first order, `f (1 - f) / |grad f^2 / 2|` with
    /// `f^2 = (x/a)^2 + (y/b)^2 + (z/c)^2`: exact at the surface, where contacts are. Above the bowl only the rim, a
    /// sharp edge, can be touched.
    #[inline(always)]
    fn touch(&self, p: Vector) -> Touch {
        let level = self.rim_level(p);
        let [ia, ib, ic] = self.inverse_squares;
        let f2 = level + p[2] * p[2] * ic;
        if p[2] < 0.0 && f2 < 1.0 {
            let gradient = vector(p[0] * ia, p[1] * ib, p[2] * ic);
            let steepness = dot(gradient, gradient).sqrt();
            if steepness < 1e-6 {
                return Touch { gap: self.semi_axes[2], normal: vector(0.0, 0.0, 1.0) };
            }
            let f = f2.sqrt();
            return Touch { gap: f * (1.0 - f) / steepness - RADIUS, normal: scale(gradient, -1.0 / steepness) };
        }
        if level < 0.25 {
            // Far above the middle: no contact, and the rim has no nearest point here.
            return Touch { gap: f32::MAX, normal: vector(0.0, 0.0, 1.0) };
        }
        let to_rim = 1.0 / level.sqrt();
        touch_point(p, vector(p[0] * to_rim, p[1] * to_rim, 0.0))
    }

    #[inline(always)]
    fn has_left(&self, p: Vector) -> bool {
        p[2] < -1.5 && self.rim_level(p) + p[2] * p[2] * self.inverse_squares[2] > 1.0
    }
}

/// Contact of a grain with a point.
#[inline(always)]
fn touch_point(p: Vector, point: Vector) -> Touch {
    let away = sub(p, point);
    let distance = dot(away, away).sqrt().max(1e-6);
    Touch { gap: distance - RADIUS, normal: scale(away, 1.0 / distance) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plate_is_touched_from_above_and_around_its_rim() {
        let plate = Plate { radius: 10.0 };
        let above = plate.touch(vector(3.0, 4.0, 0.6));
        assert!((above.gap - 0.1).abs() < 1e-6);
        let beside = plate.touch(vector(10.3, 0.0, 0.4));
        assert!((beside.gap - 0.0).abs() < 1e-6);
        assert!((beside.normal[0] - 0.6).abs() < 1e-6 && (beside.normal[2] - 0.8).abs() < 1e-6);
    }

    #[test]
    fn the_distance_to_a_spherical_bowl_is_exact_where_grains_touch_it() {
        let bowl = Bowl::new([10.0, 10.0, 10.0]);
        for z in [-9.5f32, -6.0, -0.1] {
            let x = (9.5f32 * 9.5 - z * z).max(0.0).sqrt();
            let touch = bowl.touch(vector(x, 0.0, z));
            assert!(touch.gap.abs() < 1e-4, "gap {} at z {z}", touch.gap);
            assert!((touch.normal[0] + x / 9.5).abs() < 1e-5);
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
            let p = vector(s[0] - 0.5 * n[0] / length, s[1] - 0.5 * n[1] / length, s[2] - 0.5 * n[2] / length);
            // First order: off by half of distance^2 times curvature, at most 0.5^2 / 2 * 18.5 / 7.4^2 = 0.04.
            assert!(bowl.touch(p).gap.abs() < 0.04, "gap {}", bowl.touch(p).gap);
        }
    }
}
