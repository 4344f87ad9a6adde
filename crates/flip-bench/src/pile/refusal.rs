//! Reasons why frames yield no angle of repose.

use flip_core::domain::FieldError;

/// Why frames cannot be measured: what was seen, what was expected, what to do.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// Invalid values of the rig or the limits.
    #[error("{0}")]
    Settings(FieldError),
    /// Too few frames.
    #[error("{got} frames of at least {wanted}: take more")]
    TooFewFrames {
        /// Number of frames received.
        got: usize,
        /// Number of frames required.
        wanted: usize,
    },
    /// Frames of different cameras or modes.
    #[error(
        "frame {frame} has other intrinsics, depth unit or size than the first: take all frames in one mode"
    )]
    UnlikeFrames {
        /// Frame index, from 0.
        frame: usize,
    },
    /// The same image twice: noise alone makes two images differ.
    #[error("frame {frame} repeats the depth of an earlier one: the camera's stream stands still")]
    Frozen {
        /// Frame index, from 0.
        frame: usize,
    },
    /// Too little depth.
    #[error(
        "{invalid_percent:.0} % of the pixels of the {part} have no depth, at most {allowed_percent:.0} % may: more light, texture or distance"
    )]
    TooManyInvalid {
        /// `frame` or `pile`.
        part: &'static str,
        /// Fraction without depth, %.
        invalid_percent: f64,
        /// Allowed fraction, %.
        allowed_percent: f64,
    },
    /// Depth differs too much between frames.
    #[error(
        "depth varies by {sd_mm:.1} mm from frame to frame, at most {allowed_mm:.1} mm may: more light or less distance"
    )]
    TooNoisy {
        /// Median over the pile of the standard deviation, mm.
        sd_mm: f64,
        /// Allowed value, mm.
        allowed_mm: f64,
    },
    /// No level surface around the base.
    #[error(
        "no bench found: {points} of {all} points lie in one plane; a flat surface must be seen around the base"
    )]
    BenchNotFound {
        /// Points in the best plane.
        points: usize,
        /// Points sampled.
        all: usize,
    },
    /// The camera is tilted.
    #[error("the camera is tilted: roll {roll_deg:.1} deg (at most {roll_max_deg}), elevation {elevation_deg:.1} deg ({} to {})", .elevation_range_deg[0], .elevation_range_deg[1])]
    Tilted {
        /// Rotation about the optical axis, degrees.
        roll_deg: f64,
        /// Allowed value, degrees.
        roll_max_deg: f64,
        /// Downward viewing angle, degrees.
        elevation_deg: f64,
        /// Allowed range, degrees.
        elevation_range_deg: [f64; 2],
    },
    /// The camera moved.
    #[error(
        "the camera or the rig moved: frame {frame} is off by {pixels:.1} pixels and {mm:.1} mm"
    )]
    CameraMoved {
        /// Frame index, from 0.
        frame: usize,
        /// Displacement of the spout's edges, pixels.
        pixels: f64,
        /// Displacement of the bench along the optical axis, mm.
        mm: f64,
    },
    /// No spout where one should be.
    #[error("no funnel found near {tip_height_mm} mm over the base: {cause}")]
    FunnelNotFound {
        /// Expected height, mm.
        tip_height_mm: f64,
        /// What is missing.
        cause: &'static str,
    },
    /// The tip is not where the rig settings place it.
    #[error(
        "the tip is seen {seen_mm:.1} mm over the base, the rig says {stated_mm:.1} mm: measure D again, or check the depth unit"
    )]
    TipMisplaced {
        /// Measured, mm.
        seen_mm: f64,
        /// Stated, mm.
        stated_mm: f64,
    },
    /// Nothing on the base.
    #[error("no pile found: what lies under the funnel is {height_mm:.1} mm high")]
    PileNotFound {
        /// Height over the base, mm.
        height_mm: f64,
    },
    /// The top of the pile is not visible.
    #[error("the apex is not seen: {pixels} pixels near it have depth, {wanted} are needed")]
    ApexNotFound {
        /// Pixels with depth.
        pixels: usize,
        /// Pixels required.
        wanted: usize,
    },
    /// The pile is not under the funnel.
    #[error(
        "the apex is {offset_mm:.1} mm from the funnel's axis, at most {allowed_mm:.1} mm may be: centre the base"
    )]
    NotCentred {
        /// Distance, mm.
        offset_mm: f64,
        /// Allowed value, mm.
        allowed_mm: f64,
    },
    /// The pile does not reach the rim.
    #[error(
        "the pile covers {covered} of {sectors} sectors of the rim that are seen: pour more, d_base is not its diameter"
    )]
    BaseNotCovered {
        /// Sectors with powder at the rim.
        covered: usize,
        /// Visible sectors.
        sectors: usize,
    },
    /// The flank is not a cone.
    #[error("no cone fits the flank: {pixels} pixels, {rms_mm:.1} mm from it")]
    NoCone {
        /// Pixels of the flank.
        pixels: usize,
        /// Root-mean-square distance, mm.
        rms_mm: f64,
    },
}
