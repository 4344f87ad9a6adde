//! Where in the picture the parts of a measured pile are.

use super::Pile;
use super::fit::Point;
use super::flank::Flank;
use flip_core::domain::pile::Outline;
use std::f64::consts::TAU;

/// Corners of a circle.
const CORNERS: usize = 72;
/// Maximum number of points.
const POINTS_MAX: usize = 400;
/// Part of the pile's height between which the cone is fitted.
const FLANK: [f64; 2] = [0.2, 0.8];
/// Decimal places of a pixel: a hundredth is finer than any screen.
const PLACES: f64 = 100.0;

impl Pile<'_> {
    /// What was fitted to `flank` by `cone`, and the `apex`, in pixels.
    pub(super) fn outline(&self, apex: [f64; 3], cone: &Flank, flank: &[Point]) -> Outline {
        let [axis_x, axis_y, _] = self.tip.at;
        let radius = self.rig.base_diameter_mm / 2.0;
        let [point_z, slope, x, y] = cone.parameters;
        let level = |z: f64| self.circle([x, y, z], (point_z - z) / slope);
        let point = self.pixel([x, y, point_z]);
        // Across the view: a camera that looks down steeply sees no silhouette of the cone.
        let foot = point_z / slope;
        let [left, right] = [-foot, foot].map(|r| self.pixel([x + r, y, 0.0]));
        let chosen = flank.iter().step_by(flank.len().div_ceil(POINTS_MAX).max(1));
        let width = self.shot.width();
        Outline {
            size: [self.shot.width() as u32, self.shot.height() as u32],
            tip: self.pixel(self.tip.at),
            apex: self.pixel(apex),
            base: [-radius, radius].map(|r| self.pixel([axis_x + r, axis_y, 0.0])),
            rim: self.circle([axis_x, axis_y, 0.0], radius),
            cone: [left, point, right],
            flank: FLANK.map(|part| level(part * apex[2])),
            points: chosen.map(|p| [p.pixel % width, p.pixel / width].map(|k| k as u32)).collect(),
        }
    }

    /// The pixel that shows this point of base coordinates.
    fn pixel(&self, at: [f64; 3]) -> [f64; 2] {
        let pixel = self.shot.lens.project(self.view.in_camera(at));
        pixel.map(|k| (k * PLACES).round() / PLACES)
    }

    /// A level circle.
    fn circle(&self, [x, y, z]: [f64; 3], radius: f64) -> Vec<[f64; 2]> {
        let corner = |k: usize| {
            let (sin, cos) = (TAU * k as f64 / CORNERS as f64).sin_cos();
            self.pixel([x + radius * cos, y + radius * sin, z])
        };
        (0..CORNERS).map(corner).collect()
    }
}
