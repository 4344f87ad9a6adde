//! Shared parts of the scenes: tilted gravity, rain, settling, and some statistics. Lengths in
//! grain diameters.

use super::constraints::{Vector, vector};
use super::grains::Grains;
use super::law::Law;
use super::repose::layer;
use super::shapes::Silo;
use super::walls::Shape;
use flip_core::domain::seed::derive;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Clearance of the rain's sources above the existing grains.
const CLEARANCE: f32 = 2.0;

/// Gravity tilted from straight down towards +x by an angle.
pub(super) fn leaning(law: &Law, degrees: f64) -> Vector {
    let (sin, cos) = libm::sincos(degrees.to_radians());
    vector(law.gravity * sin as f32, 0.0, -law.gravity * cos as f32)
}

/// Gravity straight down.
pub(super) fn down(law: &Law) -> Vector {
    leaning(law, 0.0)
}

/// Time in which a resting grain falls half a diameter, substeps: sqrt(d / g).
pub(super) fn fall_time(law: &Law) -> f64 {
    f64::from(law.gravity).powf(-0.5)
}

/// Grains at rest.
pub(super) fn at_rest(law: &Law, centres: impl IntoIterator<Item = Vector>) -> Grains {
    let mut grains = Grains::default();
    for x in centres {
        grains.pour(law, x, [0.0; 4]);
    }
    grains
}

/// Advances by `substeps` under one acceleration.
pub(super) fn advance(
    grains: &mut Grains,
    law: &Law,
    acceleration: Vector,
    wall: &Shape,
    substeps: u32,
) {
    for _ in 0..substeps {
        grains.substep(law, acceleration, wall);
    }
}

/// Advances until the grains' root-mean-square speed is below one percent of sqrt(g d), or
/// `substeps_max` have passed.
pub(super) fn settle(
    grains: &mut Grains,
    law: &Law,
    acceleration: Vector,
    wall: &Shape,
    substeps_max: u32,
) {
    let rest = 0.01 * law.gravity.sqrt();
    for _ in 0..substeps_max / 100 {
        advance(grains, law, acceleration, wall, 100);
        if grains.speeds().1 < rest {
            return;
        }
    }
}

/// Fills a container by rain until `full` returns true, and lets it come to rest.
///
/// Layers of grains start at sqrt(g d) slightly above the existing grains; a share `density` of
/// each layer's places, drawn at random, holds a grain, so that grains do not fall exactly onto
/// those of the layer before.
pub(super) fn rain(
    law: &Law,
    silo: &Silo,
    density: f64,
    seed: u64,
    full: impl Fn(&Grains) -> bool,
) -> Grains {
    let mut rng = Pcg64Mcg::seed_from_u64(derive(seed, &[0x5EED]));
    let mut grains = Grains::default();
    let speed = law.gravity.sqrt();
    let per_layer = (1.15 / speed).ceil() as u32;
    while !full(&grains) {
        let height = top(&grains) + CLEARANCE;
        for x in layer(&mut rng, silo.radius - 0.6, height) {
            if rng.random_bool(density) {
                grains.pour(law, x, vector(0.0, 0.0, -speed));
            }
        }
        advance(&mut grains, law, down(law), &Shape::Silo(*silo), per_layer);
    }
    settle(&mut grains, law, down(law), &Shape::Silo(*silo), 4000);
    grains
}

/// Height of the highest grain that rests on others, or of the floor.
pub(super) fn top(grains: &Grains) -> f32 {
    let mut top = 0.0f32;
    for (x, v) in grains.centres().iter().zip(grains.velocities()) {
        if v[3] >= 2.0 {
            top = top.max(x[2]);
        }
    }
    top
}

/// The grains whose top is below a height, at rest, with their contacts' memory reset.
pub(super) fn cut(law: &Law, grains: &Grains, height: f64) -> Grains {
    at_rest(law, grains.centres().iter().filter(|x| f64::from(x[2]) + 0.5 <= height).copied())
}

/// Packing fraction between two heights and within a radius.
pub(super) fn packing_fraction(grains: &Grains, radius: f64, [low, high]: [f64; 2]) -> f64 {
    let inside = |x: &&Vector| {
        f64::from(x[0]).hypot(f64::from(x[1])) < radius && (low..high).contains(&f64::from(x[2]))
    };
    let count = grains.centres().iter().filter(inside).count() as f64;
    count / 6.0 / (radius * radius * (high - low))
}

/// Mean of measurements with its standard error.
#[derive(Debug, Clone, Copy)]
pub(super) struct Mean {
    /// Mean.
    pub mean: f64,
    /// Standard error.
    pub error: f64,
}

impl Mean {
    pub(super) fn of(values: &[f64]) -> Self {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
        Self { mean, error: (variance / n).sqrt() }
    }

    /// This mean minus another, in standard errors of the difference.
    pub(super) fn above(&self, other: &Self) -> f64 {
        (self.mean - other.mean) / self.error.hypot(other.error)
    }
}

/// Least-squares line through points: slope and value at zero.
pub(super) fn line(points: &[[f64; 2]]) -> [f64; 2] {
    let n = points.len() as f64;
    let mean = |k: usize| points.iter().map(|p| p[k]).sum::<f64>() / n;
    let (x, y) = (mean(0), mean(1));
    let spread: f64 = points.iter().map(|p| (p[0] - x).powi(2)).sum();
    let slope = points.iter().map(|p| (p[0] - x) * (p[1] - y)).sum::<f64>() / spread;
    [slope, y - slope * x]
}

/// Exponent and prefactor of a power law through points, from a line through their logarithms.
pub(super) fn power_law(points: &[[f64; 2]]) -> [f64; 2] {
    let logarithms: Vec<[f64; 2]> = points.iter().map(|p| p.map(f64::ln)).collect();
    let [exponent, at_one] = line(&logarithms);
    [exponent, at_one.exp()]
}

/// Finds where a function that is false at `low` and true at `high` changes, by halving the
/// interval `steps` times.
pub(super) fn threshold(
    [mut low, mut high]: [f64; 2],
    steps: u32,
    is_beyond: impl Fn(f64) -> bool,
) -> f64 {
    for _ in 0..steps {
        let middle = 0.5 * (low + high);
        if is_beyond(middle) {
            high = middle;
        } else {
            low = middle;
        }
    }
    0.5 * (low + high)
}
