//! From pixels to directions and back, with the distortion models of librealsense.

use flip_core::domain::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// Lens distortion model that the five coefficients belong to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distortion {
    /// Pinhole pixels; the coefficients are not used.
    None,
    /// Radial and tangential terms, both of the undistorted direction.
    BrownConrady,
    /// Tangential terms of the direction after the radial ones. librealsense once used the same
    /// polynomial for the way back; this is what its present version does.
    InverseBrownConrady,
    /// The same polynomial as the inverse one. librealsense projects with it and declines to
    /// deproject; here it is inverted like the others.
    ModifiedBrownConrady,
}

impl Distortion {
    const NAMES: [(&'static str, Self); 4] = [
        ("none", Self::None),
        ("brown_conrady", Self::BrownConrady),
        ("inverse_brown_conrady", Self::InverseBrownConrady),
        ("modified_brown_conrady", Self::ModifiedBrownConrady),
    ];

    /// Parse a name, as written here or as printed by librealsense (`Inverse Brown Conrady`).
    ///
    /// # Errors
    /// Any other name.
    pub fn named(field: &str, name: &str) -> Result<Self, FieldError> {
        let plain = name.trim().to_ascii_lowercase().replace([' ', '-'], "_");
        let found = Self::NAMES.iter().find(|(known, _)| *known == plain);
        found.map(|(_, distortion)| *distortion).ok_or_else(|| {
            FieldError::new(
                field,
                "must be none, brown_conrady, inverse_brown_conrady or modified_brown_conrady",
            )
        })
    }

    /// Name used in JSON.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, known)| *known == self).map_or("none", |(name, _)| name)
    }
}

/// Lens and sensor parameters reported by a camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Intrinsics {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Focal length along a row, pixels.
    pub fx: f64,
    /// Focal length along a column, pixels.
    pub fy: f64,
    /// Column of the optical axis, pixels; 0 is the centre of the first.
    pub ppx: f64,
    /// Row of the optical axis, pixels.
    pub ppy: f64,
    /// Distortion model of the coefficients.
    pub model: Distortion,
    /// k1, k2, p1, p2, k3.
    pub coefficients: [f64; 5],
}

/// Bounds on the sides of a frame, pixels: the smallest mode of the D405 is 256 x 144, the largest
/// 1280 x 720.
pub const SIDE_MIN: u32 = 64;
/// See [`SIDE_MIN`].
pub const SIDE_MAX: u32 = 2048;

/// Steps of the fixed-point iteration that inverts a lens, `p <- p - (distorted(p) - wanted)`; real
/// lenses need about ten.
const STEPS: usize = 40;

impl Intrinsics {
    /// Check the parameters.
    ///
    /// # Errors
    /// A side, focal length, centre or coefficient outside the range of a camera; a distortion that
    /// cannot be inverted at the corners.
    pub fn checked(self) -> Result<Self, FieldError> {
        for (field, side) in [("intrinsics.width", self.width), ("intrinsics.height", self.height)]
        {
            bounded(field, f64::from(side), f64::from(SIDE_MIN), f64::from(SIDE_MAX), "pixels")?;
        }
        let longest = f64::from(self.width.max(self.height));
        bounded("intrinsics.fx", self.fx, 0.2 * longest, 10.0 * longest, "pixels")?;
        bounded("intrinsics.fy", self.fy, 0.2 * longest, 10.0 * longest, "pixels")?;
        bounded("intrinsics.ppx", self.ppx, 0.0, f64::from(self.width), "pixels")?;
        bounded("intrinsics.ppy", self.ppy, 0.0, f64::from(self.height), "pixels")?;
        for (k, &coefficient) in self.coefficients.iter().enumerate() {
            bounded(&format!("intrinsics.coefficients[{k}]"), coefficient, -10.0, 10.0, "")?;
        }
        let [right, bottom] = [self.width - 1, self.height - 1].map(f64::from);
        let lost =
            [[0.0, 0.0], [right, 0.0], [0.0, bottom], [right, bottom]].into_iter().find(|corner| {
                let [x, y] = self.direction(*corner);
                let back = self.project([x, y, 1.0]);
                !(back[0] - corner[0]).hypot(back[1] - corner[1]).le(&0.01)
            });
        match lost {
            None => Ok(self),
            Some(_) => Err(FieldError::new(
                "intrinsics.coefficients",
                "bend the corners so far that no direction belongs to them: read the coefficients from the camera again",
            )),
        }
    }

    /// Apply the lens distortion to a direction, in the plane at depth 1.
    ///
    /// ```text
    /// f = 1 + k1 r^2 + k2 r^4 + k3 r^6
    /// x' = f x + 2 p1 a b + p2 (r^2 + 2 a^2)      (a, b) = (x, y) for Brown-Conrady, f (x, y) for the other two
    /// y' = f y + 2 p2 a b + p1 (r^2 + 2 b^2)
    /// ```
    fn distorted(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [k1, k2, p1, p2, k3] = self.coefficients;
        let r2 = x * x + y * y;
        let f = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let (a, b) = match self.model {
            Distortion::None => return [x, y],
            Distortion::BrownConrady => (x, y),
            Distortion::InverseBrownConrady | Distortion::ModifiedBrownConrady => (f * x, f * y),
        };
        [
            f * x + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a),
            f * y + 2.0 * p2 * a * b + p1 * (r2 + 2.0 * b * b),
        ]
    }

    /// Direction through a pixel as (x, y) in the plane at depth 1; x to the right, y down.
    pub fn direction(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let wanted = [(u - self.ppx) / self.fx, (v - self.ppy) / self.fy];
        let mut at = wanted;
        for _ in 0..STEPS {
            let seen = self.distorted(at);
            let miss = [seen[0] - wanted[0], seen[1] - wanted[1]];
            at = [at[0] - miss[0], at[1] - miss[1]];
            if miss[0].abs().max(miss[1].abs()) < 1e-12 {
                break;
            }
        }
        at
    }

    /// The point at this pixel and depth. Depth is along the optical axis, not along the ray;
    /// lengths have the unit of `depth`.
    pub fn deproject(&self, pixel: [f64; 2], depth: f64) -> [f64; 3] {
        let [x, y] = self.direction(pixel);
        [x * depth, y * depth, depth]
    }

    /// The pixel onto which this point projects.
    pub fn project(&self, [x, y, z]: [f64; 3]) -> [f64; 2] {
        let [x, y] = self.distorted([x / z, y / z]);
        [x * self.fx + self.ppx, y * self.fy + self.ppy]
    }

    /// Number of pixels in a frame.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// [`Intrinsics::direction`] of every pixel, row by row.
    pub fn directions(&self) -> Vec<[f64; 2]> {
        let pixel = |k: usize| [(k % self.width as usize) as f64, (k / self.width as usize) as f64];
        (0..self.pixels()).map(|k| self.direction(pixel(k))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens(model: Distortion) -> Intrinsics {
        let coefficients = [-0.055, 0.062, -0.0006, 0.0011, -0.02];
        Intrinsics {
            width: 848,
            height: 480,
            fx: 431.0,
            fy: 430.0,
            ppx: 426.2,
            ppy: 238.1,
            model,
            coefficients,
        }
    }

    #[test]
    fn deprojection_undoes_projection_for_every_distortion() {
        for (_, model) in Distortion::NAMES {
            let lens = lens(model).checked().unwrap();
            for point in [[0.0, 0.0, 200.0], [80.0, -60.0, 210.0], [-190.0, 100.0, 200.0]] {
                let back = lens.deproject(lens.project(point), point[2]);
                assert!(
                    (0..3).all(|k| (back[k] - point[k]).abs() < 1e-7),
                    "{model:?} {point:?} {back:?}"
                );
            }
        }
    }

    /// Computed by hand from the formulas of librealsense's rsutil.h at x = 0.4, y = -0.3: r2 =
    /// 0.25.
    #[test]
    fn a_known_direction_lands_on_the_pixel_that_librealsense_computes() {
        let f = 1.0 - 0.055 * 0.25 + 0.062 * 0.0625 - 0.02 * 0.015_625;
        for (model, a, b) in [
            (Distortion::BrownConrady, 0.4, -0.3),
            (Distortion::InverseBrownConrady, 0.4 * f, -0.3 * f),
            (Distortion::ModifiedBrownConrady, 0.4 * f, -0.3 * f),
        ] {
            let x = 0.4 * f + 2.0 * -0.0006 * a * b + 0.0011 * (0.25 + 2.0 * a * a);
            let y = -0.3 * f + 2.0 * 0.0011 * a * b + -0.0006 * (0.25 + 2.0 * b * b);
            let seen = lens(model).project([0.8, -0.6, 2.0]);
            assert!(
                (seen[0] - (x * 431.0 + 426.2)).abs() < 1e-9
                    && (seen[1] - (y * 430.0 + 238.1)).abs() < 1e-9
            );
        }
        let seen = lens(Distortion::None).project([0.8, -0.6, 2.0]);
        assert!(
            (seen[0] - (0.4 * 431.0 + 426.2)).abs() < 1e-9,
            "without distortion the coefficients do nothing"
        );
    }

    #[test]
    fn names_are_those_of_librealsense_and_nothing_else() {
        assert_eq!(
            Distortion::named("m", "Inverse Brown Conrady"),
            Ok(Distortion::InverseBrownConrady)
        );
        assert_eq!(
            Distortion::named("m", "modified_brown_conrady"),
            Ok(Distortion::ModifiedBrownConrady)
        );
        assert!(
            Distortion::NAMES
                .iter()
                .all(|(name, model)| Distortion::named("m", name) == Ok(*model))
        );
        assert_eq!(
            Distortion::named("intrinsics.model", "fisheye").unwrap_err().field,
            "intrinsics.model"
        );
    }

    #[test]
    fn impossible_lenses_are_refused_by_field() {
        let field = |change: fn(&mut Intrinsics)| {
            let mut lens = lens(Distortion::BrownConrady);
            change(&mut lens);
            lens.checked().unwrap_err().field
        };
        assert_eq!(field(|l| l.width = 4000), "intrinsics.width");
        assert_eq!(field(|l| l.height = 1), "intrinsics.height");
        assert_eq!(field(|l| l.fx = 0.0), "intrinsics.fx");
        assert_eq!(field(|l| l.fy = f64::NAN), "intrinsics.fy");
        assert_eq!(field(|l| l.ppx = -1.0), "intrinsics.ppx");
        assert_eq!(field(|l| l.coefficients[2] = f64::INFINITY), "intrinsics.coefficients[2]");
        assert_eq!(
            field(|l| l.coefficients = [-5.0, 0.0, 0.0, 0.0, 0.0]),
            "intrinsics.coefficients"
        );
    }
}
