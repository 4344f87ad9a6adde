//! Depth camera frames: uploaded, checked and decoded.
//!
//! Frames may come from any source, so every frame carries what is needed to interpret it:
//! intrinsics, distortion, unit of depth. None of this is assumed; a D405 may be set to 0.1 mm or
//! to 1 mm per step, and a factor of ten in a pile is not a detail.

mod decode;
mod intrinsics;

pub use decode::{Upload, description};
pub use intrinsics::{Distortion, Intrinsics, SIDE_MAX, SIDE_MIN};

use flip_core::domain::timestamp::Timestamp;

/// Depth and colour at one moment, pixel-aligned.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Lens and sensor of both images: the D405 captures colour with the imager that depth refers
    /// to.
    pub intrinsics: Intrinsics,
    /// Length of one step of depth, m.
    pub depth_unit_m: f64,
    /// Depth along the optical axis, steps, row by row; 0 is invalid.
    pub depth: Vec<u16>,
    /// Red, green, blue, row by row.
    pub colour: Vec<[u8; 3]>,
    /// When it was captured, by the clock of the camera's host.
    pub taken_at: Timestamp,
}

impl Frame {
    /// Length of one step of depth, mm.
    pub fn unit_mm(&self) -> f64 {
        self.depth_unit_m * 1e3
    }

    /// Fraction of the pixels without depth, 0 to 1.
    pub fn invalid_share(&self) -> f64 {
        self.depth.iter().filter(|depth| **depth == 0).count() as f64
            / self.depth.len().max(1) as f64
    }
}
