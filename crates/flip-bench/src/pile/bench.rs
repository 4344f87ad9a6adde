//! The level surface around the base, and coordinates based on it.

use super::shot::Shot;
use super::{Limits, Refusal};
use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A plane in camera coordinates: the height of a point over it is `normal . point + camera_mm`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Plane {
    /// Unit vector away from the bench.
    pub normal: [f64; 3],
    /// Height of the camera, mm.
    pub camera_mm: f64,
}

/// Points within this distance of the plane belong to it, mm; half of that in the last fits.
const REACH_MM: f64 = 1.5;
/// Number of triples tried.
const TRIALS: usize = 400;
/// Number of points sampled, and fraction of them required for a bench.
const POINTS: usize = 6000;
const SHARE_MIN: f64 = 0.15;

impl Plane {
    pub fn height(&self, p: [f64; 3]) -> f64 {
        dot(self.normal, p) + self.camera_mm
    }

    /// Roll of the camera about its axis, and downward viewing angle, degrees.
    pub fn roll_and_elevation_deg(&self) -> [f64; 2] {
        let [x, y, z] = self.normal;
        [x.atan2(-y).to_degrees(), (-z).clamp(-1.0, 1.0).asin().to_degrees()]
    }

    fn through([a, b, c]: [[f64; 3]; 3]) -> Option<Self> {
        let side = |p: [f64; 3]| Vector3::from(p) - Vector3::from(a);
        let across = side(b).cross(&side(c));
        let normal = across.try_normalize(1e-6)?;
        Some(Self::facing(normal.into(), a))
    }

    /// Oriented so that the camera is above it.
    fn facing(normal: [f64; 3], at: [f64; 3]) -> Self {
        let height = -dot(normal, at);
        let sign = height.signum();
        Self { normal: normal.map(|c| sign * c), camera_mm: height.abs() }
    }

    /// Least-squares plane through these points: its normal is the direction of least spread.
    fn through_all(points: &[[f64; 3]]) -> Option<Self> {
        let n = points.len() as f64;
        let centre: Vector3<f64> =
            points.iter().map(|p| Vector3::from(*p)).sum::<Vector3<f64>>() / n;
        let spread: Matrix3<f64> =
            points.iter().map(|p| Vector3::from(*p) - centre).map(|d| d * d.transpose()).sum();
        let eigen = spread.symmetric_eigen();
        let least = eigen.eigenvalues.imin();
        (n >= 3.0).then(|| {
            Self::facing(eigen.eigenvectors.column(least).into_owned().into(), centre.into())
        })
    }
}

/// The plane with the most points in it and few below it, viewed from above by a camera that hangs
/// roughly upright.
pub(super) fn bench(shot: &Shot, limits: &Limits) -> Result<Plane, Refusal> {
    let step = (shot.depth_mm.len() / (4 * POINTS)).max(1);
    let points: Vec<[f64; 3]> = (0..shot.depth_mm.len())
        .step_by(step)
        .filter(|k| !shot.edge[*k])
        .filter_map(|k| shot.point(k))
        .collect();
    let thin: Vec<[f64; 3]> =
        points.iter().copied().step_by((points.len() / POINTS).max(1)).collect();
    let none = |found| Refusal::BenchNotFound { points: found, all: thin.len() };
    if thin.len() < 100 {
        return Err(none(0));
    }
    let mut rng = Pcg64Mcg::seed_from_u64(0);
    let mut pick = || thin[rng.random_range(0..thin.len() as u64) as usize];
    let trials: Vec<Plane> =
        (0..TRIALS).filter_map(|_| Plane::through([pick(), pick(), pick()])).collect();
    let score = |plane: &Plane| {
        let [roll, elevation] = plane.roll_and_elevation_deg();
        let heights = thin.iter().map(|p| plane.height(*p));
        let (on, below) = heights.fold((0_i64, 0_i64), |(on, below), h| {
            (on + i64::from(h.abs() < REACH_MM), below + i64::from(h < -3.0 * REACH_MM))
        });
        if roll.abs() < 60.0 && elevation > 0.0 { on - 3 * below } else { i64::MIN }
    };
    let mut plane = trials.into_iter().max_by_key(score).ok_or_else(|| none(0))?;
    for reach in [REACH_MM, REACH_MM, REACH_MM / 2.0] {
        let on: Vec<[f64; 3]> =
            points.iter().copied().filter(|p| plane.height(*p).abs() < reach).collect();
        plane = Plane::through_all(&on).ok_or_else(|| none(on.len()))?;
    }
    let found = thin.iter().filter(|p| plane.height(**p).abs() < REACH_MM).count();
    if (found as f64) < SHARE_MIN * thin.len() as f64 {
        return Err(none(found));
    }
    upright(plane, limits)
}

fn upright(plane: Plane, limits: &Limits) -> Result<Plane, Refusal> {
    let [roll_deg, elevation_deg] = plane.roll_and_elevation_deg();
    let [low, high] = limits.elevation_deg;
    match roll_deg.abs() <= limits.roll_max_deg && (low..=high).contains(&elevation_deg) {
        true => Ok(plane),
        false => Err(Refusal::Tilted {
            roll_deg,
            roll_max_deg: limits.roll_max_deg,
            elevation_deg,
            elevation_range_deg: limits.elevation_deg,
        }),
    }
}

/// Coordinates of the base: x to the right, y away from the camera, z up from the base's top; the
/// origin is under the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct View {
    axes: [[f64; 3]; 3],
    plane: Plane,
    base_height_mm: f64,
    /// True length over measured length.
    scale: f64,
}

impl View {
    pub fn over(plane: Plane, base_height_mm: f64, scale: f64) -> Self {
        let up = Vector3::from(plane.normal);
        let right = (Vector3::x() - up * up.x).normalize();
        let away = up.cross(&right);
        Self { axes: [right.into(), away.into(), up.into()], plane, base_height_mm, scale }
    }

    /// Convert a point from camera coordinates to base coordinates, mm.
    pub fn place(&self, p: [f64; 3]) -> [f64; 3] {
        let [x, y] = [0, 1].map(|k| self.scale * dot(self.axes[k], p));
        [x, y, self.scale * self.plane.height(p) - self.base_height_mm]
    }

    /// The inverse of [`View::place`].
    pub fn in_camera(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let up = (z + self.base_height_mm) / self.scale - self.plane.camera_mm;
        let along = [x / self.scale, y / self.scale, up];
        std::array::from_fn(|c| (0..3).map(|k| along[k] * self.axes[k][c]).sum())
    }

    /// The ray through a pixel: its origin, and its increment per mm of depth.
    pub fn ray(&self, [x, y]: [f64; 2]) -> [[f64; 3]; 2] {
        let (from, to) = (self.place([0.0; 3]), self.place([x, y, 1.0]));
        [from, std::array::from_fn(|k| to[k] - from[k])]
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
