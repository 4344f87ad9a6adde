//! A silo, open or closed. Lengths in grain diameters.

use super::constraints::{V3, Vector, choose};
use super::lanes::Lanes;
use super::walls::{NEAREST, RADIUS, Touch, Wall, touch_point};

/// Radius of the groove between the side and the floor of a silo: larger than a grain's, so that
/// every grain has a single nearest point.
const FILLET: f32 = 0.75;

/// The inside of an upright cylinder with a flat floor that has a round, sharp-edged orifice in its
/// middle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Silo {
    /// Radius of the cylinder.
    pub radius: f32,
    /// Radius of the orifice; zero for none.
    pub orifice: f32,
    /// Height of the floor.
    pub floor: f32,
}

impl Silo {
    /// A container without an orifice, its floor at zero.
    pub(super) fn closed(radius: f32) -> Self {
        Self { radius, orifice: 0.0, floor: 0.0 }
    }
}

impl Wall for Silo {
    /// Exact everywhere: side, floor and groove form one distance,
    /// `f - |(max(0, r - R + f), max(0, f - z))|` with f the groove's radius; over the orifice the
    /// edge is nearest, and below the floor its underside.
    #[inline(always)]
    fn touch<L: Lanes>(&self, p: V3<L>) -> Touch<L> {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let z = p[2] - L::splat(self.floor);
        let r2 = p[0] * p[0] + p[1] * p[1];
        let r = r2.sqrt().max(L::splat(NEAREST));
        let aside = zero.max(r - L::splat(self.radius - FILLET));
        let below = zero.max(L::splat(FILLET) - z);
        let depth = (aside * aside + below * below).sqrt().max(L::splat(NEAREST));
        let inward = (zero - aside) / (depth * r);
        let mut touch = Touch::still(
            L::splat(FILLET - RADIUS) - depth,
            [p[0] * inward, p[1] * inward, below / depth],
        );
        if self.orifice == 0.0 {
            return touch;
        }
        let under = z.below(L::splat(-0.25));
        touch.gap = L::select(under, zero - z - L::splat(RADIUS), touch.gap);
        touch.normal = choose(under, [zero, zero, zero - one], touch.normal);
        let over = r2.below(L::splat(self.orifice * self.orifice));
        if over == 0 {
            return touch;
        }
        let to_edge = L::splat(self.orifice) / r;
        let edge = touch_point([p[0], p[1], z], [p[0] * to_edge, p[1] * to_edge, zero]);
        // Around the axis nothing is near, and on it the edge has no nearest point.
        let middle = r2.below(L::splat(0.25 * self.orifice * self.orifice));
        let edge_gap = L::select(middle, L::splat(f32::MAX), edge.gap);
        Touch::still(L::select(over, edge_gap, touch.gap), choose(over, edge.normal, touch.normal))
    }

    fn has_left(&self, p: Vector) -> bool {
        p[2] < self.floor - 1.5
    }
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

    /// Gap and direction to the nearest of many points spread densely over the surface of a silo,
    /// in the half-plane y = 0, x > 0.
    fn brute_force(silo: &Silo, p: [f32; 3]) -> (f32, [f32; 3]) {
        let steps = 20_000u16;
        let share = |k: u16| f32::from(k) / f32::from(steps);
        let flat = silo.radius - FILLET;
        let floor = (0..=steps).map(|k| [silo.orifice + (flat - silo.orifice) * share(k), 0.0]);
        let groove = (0..=steps).map(|k| {
            let (sin, cos) = (share(k) * std::f32::consts::FRAC_PI_2).sin_cos();
            [flat + FILLET * sin, FILLET - FILLET * cos]
        });
        let side = (0..=steps).map(|k| [silo.radius, FILLET + 10.0 * share(k)]);
        let distance = |q: &[f32; 2]| (p[0] - q[0]).hypot(p[2] - q[1]);
        let points = floor.chain(groove).chain(side);
        let nearest = points.min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap();
        let length = distance(&nearest);
        (length - RADIUS, [(p[0] - nearest[0]) / length, 0.0, (p[2] - nearest[1]) / length])
    }

    #[test]
    fn the_distance_to_a_silo_agrees_with_a_brute_force_search() {
        let silo = Silo { radius: 10.0, orifice: 3.0, floor: 0.0 };
        for p in [
            [5.0, 0.0, 0.45],
            [9.52, 0.0, 4.0],
            [9.4, 0.0, 0.6],
            [9.6, 0.0, 0.4],
            [2.7, 0.0, 0.3],
            [2.6, 0.0, -0.1],
            [3.2, 0.0, -0.4],
        ] {
            let ((gap, normal), (expected, direction)) = (touch(&silo, p), brute_force(&silo, p));
            assert!((gap - expected).abs() < 2e-3, "gap {gap} for {expected} at {p:?}");
            assert!(
                (0..3).all(|k| (normal[k] - direction[k]).abs() < 5e-3),
                "{normal:?} for {direction:?} at {p:?}"
            );
        }
    }

    #[test]
    fn nothing_is_near_in_the_middle_of_a_silo() {
        let silo = Silo { radius: 10.0, orifice: 3.0, floor: -0.1 };
        assert!(touch(&silo, [0.0, 0.0, 5.0]).0 > 0.1 && touch(&silo, [0.0, 0.0, 0.0]).0 > 0.1);
        assert!((touch(&silo, [6.0, 0.0, 0.4]).0).abs() < 1e-6, "the floor is lower by a tenth");
        assert!(silo.has_left([0.0, 0.0, -1.7, 0.0]) && !silo.has_left([0.0, 0.0, -1.5, 0.0]));
    }
}
