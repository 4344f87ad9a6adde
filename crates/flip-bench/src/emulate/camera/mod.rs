//! An emulated depth camera over a virtual pile: rendered frames of a known surface, with the
//! noise, holes and edges of passive stereo.
//!
//! Millimetres throughout; the scene's axis is the base's, z is up from the top of the base. The
//! same scene and seed yield the same frames.

mod encode;
mod faults;
mod noise;
mod render;
mod studio;
mod surface;

pub use encode::upload;
pub use faults::{CameraFault, faulty_frames, faulty_uploads};
pub use noise::Noise;
pub use studio::Studio;
pub use surface::{Cone, Heap, Surface};

use crate::hardware::camera::{Distortion, Frame, Intrinsics};
use flip_core::domain::seed::derive;
use flip_core::domain::timestamp::Timestamp;
use render::Picture;

/// The scene before the camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// The pile.
    pub surface: Surface,
    /// Diameter of the round base, mm.
    pub base_diameter_mm: f64,
    /// Height of the base's top over the bench, mm.
    pub base_height_mm: f64,
    /// Height of the powder that spilled over the rim, at the foot of the base, mm.
    pub overflow_mm: f64,
    /// The funnel, if there is one.
    pub funnel: Option<Funnel>,
}

/// A funnel whose spout ends over the base.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Funnel {
    /// Height of the tip over the base, mm.
    pub tip_height_mm: f64,
    /// Outer diameter of the spout at the tip, mm.
    pub spout_diameter_mm: f64,
    /// Where the spout's axis meets the base, mm from its centre.
    pub off_centre_mm: [f64; 2],
}

/// Position and orientation of the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Distance from the camera to its aim point, mm.
    pub distance_mm: f64,
    /// Height of the aim point over the base, mm.
    pub aim_height_mm: f64,
    /// Downward viewing angle, degrees from horizontal.
    pub elevation_deg: f64,
    /// Rotation about its optical axis, degrees.
    pub roll_deg: f64,
    /// Rotation about the vertical, degrees: the pile moves sideways in the frame.
    pub yaw_deg: f64,
}

/// The camera itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Optics {
    /// As reported by the camera.
    pub intrinsics: Intrinsics,
    /// Depth step reported by the camera, mm.
    pub unit_mm: f64,
    /// True over reported depth, minus one: an error that does not show in the frames.
    pub scale_error: f64,
    /// Maximum depth it sees, mm.
    pub range_mm: f64,
}

impl Scene {
    /// A base of 60 mm, 15 mm over the bench, under a tip 60 mm above it.
    pub fn of(surface: Surface) -> Self {
        let funnel =
            Funnel { tip_height_mm: 60.0, spout_diameter_mm: 10.0, off_centre_mm: [0.0; 2] };
        Self {
            surface,
            base_diameter_mm: 60.0,
            base_height_mm: 15.0,
            overflow_mm: 3.0,
            funnel: Some(funnel),
        }
    }
}

impl Default for Pose {
    /// 200 mm away, 30 degrees down: tip, apex and the near flank are all visible.
    fn default() -> Self {
        Self {
            distance_mm: 200.0,
            aim_height_mm: 25.0,
            elevation_deg: 30.0,
            roll_deg: 0.0,
            yaw_deg: 0.0,
        }
    }
}

impl Default for Optics {
    /// 848 x 480 with a horizontal field of view of 89 degrees, 0.1 mm per step, range 500 mm:
    /// about those of a D405 (actual values vary by device).
    fn default() -> Self {
        let coefficients = [-0.055, 0.062, -0.0004, 0.0006, -0.02];
        let model = Distortion::InverseBrownConrady;
        let (width, height) = (848, 480);
        let intrinsics = Intrinsics {
            width,
            height,
            fx: 431.2,
            fy: 430.7,
            ppx: 425.3,
            ppy: 238.6,
            model,
            coefficients,
        };
        Self { intrinsics, unit_mm: 0.1, scale_error: 0.0, range_mm: 500.0 }
    }
}

impl Optics {
    /// The same view with fewer pixels: for tests that are not about accuracy.
    pub fn coarse() -> Self {
        let mut optics = Self::default();
        let lens = &mut optics.intrinsics;
        (lens.width, lens.height) = (424, 240);
        (lens.fx, lens.fy, lens.ppx, lens.ppy) =
            (lens.fx / 2.0, lens.fy / 2.0, lens.ppx / 2.0, lens.ppy / 2.0);
        optics
    }
}

/// When the first frame of a series is taken, ms; frames follow at thirty per second.
const BEGAN_UNIX_MS: i64 = 1_795_248_000_000;

/// Frames of a scene at rest: one picture, with separate noise for each frame.
pub fn frames(
    scene: &Scene,
    pose: &Pose,
    optics: &Optics,
    noise: &Noise,
    seed: u64,
    count: usize,
) -> Vec<Frame> {
    let picture = Picture::of(scene, pose, optics);
    let flaws = noise.flaws(&picture, derive(seed, &[0]));
    (0..count)
        .map(|k| {
            let (depth, colour) =
                noise.expose(&picture, &flaws, optics, derive(seed, &[1, k as u64]));
            let taken_at = Timestamp::from_unix_ms(BEGAN_UNIX_MS + k as i64 * 1000 / 30);
            Frame {
                intrinsics: optics.intrinsics,
                depth_unit_m: optics.unit_mm * 1e-3,
                depth,
                colour,
                taken_at,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests;
