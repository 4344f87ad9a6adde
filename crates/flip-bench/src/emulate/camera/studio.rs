//! Randomly drawn scenes: piles, rigs, cameras and operators as they vary from day to day.

use super::{Cone, Noise, Optics, Pose, Scene, Surface};
use crate::hardware::camera::Distortion;
use flip_core::domain::seed::derive;
use flip_core::stats::normal;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// One drawn scene, with the errors of the operator's ruler and of the camera's scale.
#[derive(Debug, Clone, PartialEq)]
pub struct Studio {
    /// The scene.
    pub scene: Scene,
    /// Its pile.
    pub cone: Cone,
    /// Pose of the camera.
    pub pose: Pose,
    /// Its lens, unit and scale error.
    pub optics: Optics,
    /// Its noise.
    pub noise: Noise,
    /// Stated minus true height of the tip, diameter of the base and height of the base, mm.
    pub ruler_mm: [f64; 3],
}

/// Standard deviation of each length measured by an operator, mm, and of the depth scale, relative.
const RULER_SD_MM: f64 = 0.1;
const SCALE_SD: f64 = 0.007;

impl Studio {
    /// A pile of this angle in the default rig. Uniform: elevation 27 to 33 deg, roll -4 to 4, yaw
    /// -4 to 4, distance 190 to 210 mm, rounding up to 0.15, apex up to 1 mm and spout up to 0.7 mm
    /// off centre, grains 0.2 to 0.6 mm, noise 0.3 to 1 mm, holes 2 to 10 % of the powder, any of
    /// the four distortions, steps of 0.1 mm (three of four) or 1 mm. Normal: the ruler by 0.1 mm,
    /// the depth scale by 0.7 %.
    pub fn drawn(tip_deg: f64, seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(derive(seed, &[tip_deg.to_bits()]));
        let mut between = |low: f64, high: f64| low + (high - low) * rng.random::<f64>();
        let cone = Cone {
            tip_deg,
            rounding: between(0.0, 0.15),
            off_centre_mm: [between(-0.7, 0.7), between(-0.7, 0.7)],
            grain_mm: between(0.2, 0.6),
            cover: 1.0,
        };
        let mut scene = Scene::of(Surface::Cone(cone));
        scene.overflow_mm = between(0.0, 5.0);
        if let Some(funnel) = &mut scene.funnel {
            funnel.off_centre_mm = [between(-0.5, 0.5), between(-0.5, 0.5)];
        }
        let pose = Pose {
            distance_mm: between(190.0, 210.0),
            aim_height_mm: between(20.0, 30.0),
            elevation_deg: between(27.0, 33.0),
            roll_deg: between(-4.0, 4.0),
            yaw_deg: between(-4.0, 4.0),
        };
        let noise = Noise {
            frame_mm: between(0.3, 1.0),
            fixed_mm: between(0.1, 0.25),
            missing: between(0.0, 0.05),
            textureless: between(0.02, 0.1),
            ..Noise::default()
        };
        let mut optics = Optics::default();
        let models = [
            Distortion::None,
            Distortion::BrownConrady,
            Distortion::InverseBrownConrady,
            Distortion::ModifiedBrownConrady,
        ];
        optics.intrinsics.model = models[between(0.0, 4.0) as usize % 4];
        optics.unit_mm = if between(0.0, 1.0) < 0.75 { 0.1 } else { 1.0 };
        let mut error = |sd: f64| sd * normal::quantile(between(1e-9, 1.0));
        optics.scale_error = error(SCALE_SD);
        let ruler_mm = std::array::from_fn(|_| error(RULER_SD_MM));
        Self { scene, cone, pose, optics, noise, ruler_mm }
    }
}
