//! Measurements of a pile under a funnel from a depth camera's frames.

use serde::{Deserialize, Serialize};

/// An angle and its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Angle {
    /// Degrees.
    pub deg: f64,
    /// Combined standard uncertainty of one measurement, degrees: frames, fit and calibration.
    /// Twice this covers about 95 %.
    pub u_deg: f64,
    /// Uncertainty of the mean from the frame-to-frame spread alone, degrees.
    pub u_frames_deg: f64,
}

/// Measurements of a pile in the frames.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// atan(2 h / d_base), from the apex.
    pub tip: Angle,
    /// Slope of the cone fitted between 20 % and 80 % of the height.
    pub cone: Angle,
    /// h: height of the apex above the base, mm.
    pub height_mm: f64,
    /// Distance between apex and funnel tip, mm.
    pub tip_to_apex_mm: f64,
    /// Height of the funnel tip above the base as measured in the frames, mm; compare with D.
    pub tip_height_seen_mm: f64,
    /// Distance of the apex from the spout's axis, mm.
    pub off_centre_mm: f64,
    /// Downward angle of the camera, degrees.
    pub elevation_deg: f64,
    /// Roll of the camera about its axis, degrees.
    pub roll_deg: f64,
    /// Number of pixels on the flank.
    pub flank_pixels: u32,
    /// Share of the pile's pixels without depth.
    pub pile_invalid: f64,
    /// Number of frames.
    pub frames: u32,
}

/// What a picture of a pile shows where: pixels of its frames, 0 being the middle of the first.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Outline {
    /// Width and height of the frames.
    pub size: [u32; 2],
    /// The funnel's tip, on its axis.
    pub tip: [f64; 2],
    /// The apex.
    pub apex: [f64; 2],
    /// Left and right end of the base's diameter across the view.
    pub base: [[f64; 2]; 2],
    /// The base's rim, closed.
    pub rim: Vec<[f64; 2]>,
    /// The cone: where its left side meets the level of the base, its point, and its right side.
    pub cone: [[f64; 2]; 3],
    /// Lower and upper end of the flank that it was fitted to, closed.
    pub flank: [Vec<[f64; 2]>; 2],
    /// Pixels that it was fitted to: all, or as many as are shown, evenly chosen.
    pub points: Vec<[u32; 2]>,
}
