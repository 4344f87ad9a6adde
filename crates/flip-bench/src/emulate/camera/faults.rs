//! Faults of a depth camera and of the scene before it.

use super::{Cone, Noise, Optics, Pose, Scene, Surface, frames, upload};
use crate::hardware::camera::{Frame, Upload};
use flip_core::domain::seed::derive;
use std::str::FromStr;

/// One fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraFault {
    /// Most of the powder has no depth.
    Holes,
    /// Depth jumps by a centimetre from frame to frame.
    HeavyNoise,
    /// No funnel stands over the base.
    FunnelMissing,
    /// The base is empty.
    PileMissing,
    /// The powder ends before the rim.
    BaseNotCovered,
    /// Every frame repeats the first.
    FrozenFrames,
    /// Someone pushes the camera half way through.
    CameraMoved,
    /// The camera hangs askew.
    Tilted,
    /// Three frames, and no more.
    FewFrames,
    /// One frame has another size than the others.
    WrongSize,
    /// The last upload is truncated.
    TruncatedFile,
}

impl CameraFault {
    /// All faults, by name.
    pub const ALL: [(&'static str, Self); 11] = [
        ("holes", Self::Holes),
        ("heavy_noise", Self::HeavyNoise),
        ("funnel_missing", Self::FunnelMissing),
        ("pile_missing", Self::PileMissing),
        ("base_not_covered", Self::BaseNotCovered),
        ("frozen_frames", Self::FrozenFrames),
        ("camera_moved", Self::CameraMoved),
        ("tilted", Self::Tilted),
        ("few_frames", Self::FewFrames),
        ("wrong_size", Self::WrongSize),
        ("truncated_file", Self::TruncatedFile),
    ];
}

impl FromStr for CameraFault {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.iter().find(|(name, _)| *name == text);
        let names = || Self::ALL.map(|(name, _)| name).join(", ");
        found
            .map(|(_, fault)| *fault)
            .ok_or_else(|| format!("no camera fault is called {text}: one of {}", names()))
    }
}

/// Ten frames of the scene with this fault; a [`CameraFault::TruncatedFile`] shows only in
/// [`faulty_uploads`].
pub fn faulty_frames(fault: CameraFault, scene: &Scene, optics: &Optics, seed: u64) -> Vec<Frame> {
    let (mut scene, mut pose, mut noise) = (scene.clone(), Pose::default(), Noise::default());
    match fault {
        CameraFault::Holes => noise.textureless = 0.8,
        CameraFault::HeavyNoise => noise.frame_mm = 10.0,
        CameraFault::FunnelMissing => scene.funnel = None,
        CameraFault::PileMissing => scene.surface = Surface::Bare,
        CameraFault::BaseNotCovered => {
            scene.surface = Surface::Cone(Cone { cover: 0.75, ..Cone::of_deg(35.0) })
        }
        CameraFault::Tilted => pose.roll_deg = 20.0,
        _ => {}
    }
    let mut taken = frames(&scene, &pose, optics, &noise, seed, 10);
    match fault {
        CameraFault::FrozenFrames => {
            let first = taken[0].clone();
            taken.iter_mut().for_each(|frame| frame.depth.clone_from(&first.depth));
        }
        CameraFault::CameraMoved => {
            let pushed = Pose { distance_mm: 203.0, yaw_deg: 0.0, aim_height_mm: 26.0, ..pose };
            let later = frames(&scene, &pushed, optics, &noise, derive(seed, &[2]), 10);
            taken.splice(5.., later.into_iter().skip(5));
        }
        CameraFault::FewFrames => taken.truncate(3),
        CameraFault::WrongSize => {
            let other =
                if *optics == Optics::coarse() { Optics::default() } else { Optics::coarse() };
            taken[4] = frames(&scene, &pose, &other, &noise, seed, 1).remove(0);
        }
        _ => {}
    }
    taken
}

/// The same as uploads.
///
/// # Errors
/// The encoder refuses.
pub fn faulty_uploads(
    fault: CameraFault,
    scene: &Scene,
    optics: &Optics,
    seed: u64,
) -> Result<Vec<Upload>, png::EncodingError> {
    let mut uploads = faulty_frames(fault, scene, optics, seed)
        .iter()
        .map(upload)
        .collect::<Result<Vec<_>, _>>()?;
    if let (CameraFault::TruncatedFile, Some(last)) = (fault, uploads.last_mut()) {
        last.depth.truncate(last.depth.len() / 2);
    }
    Ok(uploads)
}
