//! Angles of repose by camera.

use super::{Answer, Awaited, BenchKind, Flowability, Job, Labels, Timestamp};
use crate::app;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Result of a measurement by camera.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ReposeResult {
    /// Angles by both estimators.
    pub repeats: Repeats,
    /// Whether it is now the powder's newest measurement. Not on an emulated bench, where no real
    /// powder was measured.
    pub registered: bool,
}

answer! { app::ReposeResult => ReposeResult { repeats, registered } }

/// A measurement by camera to make. Everything but the powder has a default.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ReposeRequest {
    /// Powder id.
    pub powder: String,
    /// Which measurement of this powder, from 1; repeating a number returns the existing
    /// measurement and makes no new piles. Default the next.
    #[serde(default)]
    pub run: Option<u32>,
    /// How piles are made and imaged.
    #[serde(default)]
    pub procedure: Procedure,
    /// The rig, as measured with a ruler or calipers.
    #[serde(default)]
    pub rig: Rig,
    /// What frames must show.
    #[serde(default)]
    pub limits: Limits,
    /// The bench reservation under which the request is made, `rs-…`, if any.
    #[serde(default)]
    pub reservation: Option<String>,
    /// What the caller writes on it, to find it again.
    #[serde(default)]
    pub labels: Labels,
}

request! { ReposeRequest => app::ReposeRequest {
    powder, run, procedure, rig, limits, reservation, labels,
} }

/// A measurement by camera: its job, its piles, and the angle once it has succeeded.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ReposeMeasurement {
    /// The job; the measurement has the same id.
    pub job: Job,
    /// Powder id.
    pub powder: String,
    /// Which measurement of this powder.
    pub run: u32,
    /// The bench that makes the piles.
    pub bench: BenchKind,
    /// How piles are made and imaged.
    pub procedure: Procedure,
    /// The rig.
    pub rig: Rig,
    /// What frames must show.
    pub limits: Limits,
    /// The pile waiting for frames now.
    pub awaits: Option<Awaited>,
    /// Piles so far, including those without an angle; left out of lists.
    pub piles: Vec<Pile>,
    /// Result; absent until it has succeeded.
    pub result: Option<ReposeResult>,
}

answer! { app::ReposeMeasurement => ReposeMeasurement {
    job, powder, run, bench, procedure, rig, limits, awaits, piles, result,
} }

/// Repeats of one powder, a pile each.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Repeats {
    /// From the apex: mean, standard deviation and number of repeats.
    pub tip: Flowability,
    /// From the cone.
    pub cone: Flowability,
    /// Standard uncertainty of the mean of `tip`, degrees: the spread of the repeats plus the
    /// uncertainty of a single measurement, which is not reduced by their number.
    pub tip_u_deg: f64,
    /// Standard uncertainty of the mean of `cone`, degrees.
    pub cone_u_deg: f64,
}

answer! { flip_bench::pile::Repeats => Repeats { tip, cone, tip_u_deg, cone_u_deg } }

/// One powder measured both ways.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Compared {
    /// Powder id.
    pub powder: String,
    /// By camera.
    pub automated: Flowability,
    /// By hand.
    pub manual: Flowability,
    /// Automated minus manual, degrees.
    pub difference_deg: f64,
    /// Standard error of the difference, degrees; absent where a single repeat gives no spread.
    pub standard_error_deg: Option<f64>,
}

answer! { flip_bench::pile::Compared => Compared {
    powder, automated, manual, difference_deg, standard_error_deg,
} }

/// How lengths seen by the camera are scaled to true lengths.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Lengths {
    /// By the depth unit stated in the frames, as published. A scale error of 1 % is an error of
    /// the angle of 0.5 deg.
    Stated,
    /// Scaled so that the tip is at the height stated for the rig, D over the base: an error of the
    /// depth scale cancels.
    #[default]
    ByTipHeight,
}

answer! { flip_bench::pile::Lengths => enum Lengths { Stated, ByTipHeight } }
request! { enum Lengths => flip_bench::pile::Lengths { Stated, ByTipHeight } }

/// The rig, measured with a ruler or calipers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Rig {
    /// D: height of the funnel's tip over the top of the base, 10 to 500 mm. Default 60.
    pub tip_height_mm: f64,
    /// Its standard uncertainty, 0 to 5 mm. Default 0.1.
    pub tip_height_u_mm: f64,
    /// d_base: diameter of the base, which the pile covers, 5 to 500 mm. Default 60.
    pub base_diameter_mm: f64,
    /// Its standard uncertainty, 0 to 5 mm. Default 0.1.
    pub base_diameter_u_mm: f64,
    /// Height of the base's top over the level bench around it, 0 to 200 mm. Default 15.
    pub base_height_mm: f64,
    /// Its standard uncertainty, 0 to 5 mm. Default 0.1.
    pub base_height_u_mm: f64,
    /// Outer diameter of the spout at its tip, 1 to 100 mm: the camera sees its near side, while
    /// the tip is on its axis. Default 10.
    pub spout_diameter_mm: f64,
    /// Relative standard uncertainty of the camera's depth scale, 0 to 0.1. Default 0.007: half of
    /// the 1.4 % within which the maker keeps depth.
    pub depth_scale_u: f64,
    /// How lengths are scaled. Default by the tip's height.
    pub lengths: Lengths,
}

impl Default for Rig {
    fn default() -> Self {
        flip_bench::pile::Dimensions::default().wire()
    }
}

answer! { flip_bench::pile::Dimensions => Rig {
    tip_height_mm, tip_height_u_mm, base_diameter_mm, base_diameter_u_mm, base_height_mm,
    base_height_u_mm, spout_diameter_mm, depth_scale_u, lengths,
} }
request! { Rig => flip_bench::pile::Dimensions {
    tip_height_mm, tip_height_u_mm, base_diameter_mm, base_diameter_u_mm, base_height_mm,
    base_height_u_mm, spout_diameter_mm, depth_scale_u, lengths,
} }

/// Requirements on the frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Minimum number of frames, 3 to 100. Default 10, as published.
    pub frames_min: u32,
    /// Maximum fraction of the pixels of the pile, and of all pixels, without depth in the mean of
    /// the frames, 0 to 0.9. Default 0.3 and 0.8.
    pub pile_invalid_max: f64,
    /// See `pile_invalid_max`: much of a frame may lie beyond the camera's range.
    pub frame_invalid_max: f64,
    /// Maximum standard deviation of depth from frame to frame, median over the pile, 0.01 to
    /// 20 mm. Default 3.
    pub noise_max_mm: f64,
    /// Maximum roll of the camera about its axis, 1 to 45 deg. Default 12.
    pub roll_max_deg: f64,
    /// Range of its elevation over the bench, 5 to 85 deg. Default 12 to 60: any lower it does not
    /// see the flank, any higher it does not see the tip.
    pub elevation_deg: [f64; 2],
    /// Maximum displacement of the spout's edges between frames, 0.1 to 20 pixels. Default 1.
    pub move_max_pixels: f64,
    /// Maximum displacement of the bench between frames, 0.05 to 20 mm. Default 0.7.
    pub move_max_mm: f64,
    /// Maximum distance of the apex from the spout's axis, fraction of the base's radius, 0.01
    /// to 1. Default 0.15.
    pub off_centre_max: f64,
    /// Maximum relative difference between D as seen and as stated, 0.001 to 0.2. Default 0.04.
    pub scale_error_max: f64,
}

impl Default for Limits {
    fn default() -> Self {
        flip_bench::pile::Limits::default().wire()
    }
}

answer! { flip_bench::pile::Limits => Limits {
    frames_min, pile_invalid_max, frame_invalid_max, noise_max_mm, roll_max_deg, elevation_deg,
    move_max_pixels, move_max_mm, off_centre_max, scale_error_max,
} }
request! { Limits => flip_bench::pile::Limits {
    frames_min, pile_invalid_max, frame_invalid_max, noise_max_mm, roll_max_deg, elevation_deg,
    move_max_pixels, move_max_mm, off_centre_max, scale_error_max,
} }

/// How piles are made and imaged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Procedure {
    /// Number of piles, 1 to 20. Default 5, as published.
    pub repeats: u32,
    /// Frames per pile, 3 to 100. Default 10, as published.
    pub frames: u32,
    /// How long the gate stays open, 1 to 300 s. Default 20.
    pub open_s: f64,
    /// How long the pile rests before frames are taken, 0 to 300 s. Default 5.
    pub rest_s: f64,
}

impl Default for Procedure {
    fn default() -> Self {
        flip_bench::hardware::stand::Procedure::default().wire()
    }
}

answer! { flip_bench::hardware::stand::Procedure => Procedure { repeats, frames, open_s, rest_s } }
request! { Procedure => flip_bench::hardware::stand::Procedure { repeats, frames, open_s, rest_s } }

/// One pile.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Pile {
    /// Number within its measurement, from 1.
    pub number: u32,
    /// When its frames had arrived.
    pub at: Timestamp,
    /// Result from the frames; absent if they were refused.
    pub measured: Option<PileMeasurement>,
    /// Why they were refused.
    pub refusal: Option<String>,
    /// Its raw frames, in order of arrival.
    pub frames: Vec<FrameFiles>,
    /// Where in the picture is what was measured; absent if the frames were refused, and for a pile
    /// measured before it was kept.
    pub outline: Option<PileOutline>,
}

answer! { flip_store::piles::Pile => Pile { number, at, measured, refusal, frames, outline } }

/// What a picture of a pile shows where: pixels of its frames, right and down from the middle of the
/// first.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PileOutline {
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
    /// Pixels that it was fitted to, at most 400 of them, evenly chosen.
    pub points: Vec<[u32; 2]>,
}

answer! { flip_core::domain::pile::Outline => PileOutline {
    size, tip, apex, base, rim, cone, flank, points,
} }

/// The three files of a frame as received, each by its SHA-256.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct FrameFiles {
    /// A 16-bit grey PNG, or raw Z16.
    pub depth: String,
    /// An 8-bit RGB PNG.
    pub colour: String,
    /// JSON: intrinsics, unit of depth, time.
    pub description: String,
}

answer! { flip_store::piles::FrameFiles => FrameFiles { depth, colour, description } }

/// An angle and its uncertainty.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Angle {
    /// Degrees.
    pub deg: f64,
    /// Combined standard uncertainty of one measurement, degrees: frames, fit and calibration.
    /// Twice this covers about 95 %.
    pub u_deg: f64,
    /// Uncertainty of the mean from the frame-to-frame spread alone, degrees.
    pub u_frames_deg: f64,
}

answer! { flip_core::domain::pile::Angle => Angle { deg, u_deg, u_frames_deg } }

/// Measurements of a pile in the frames.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct PileMeasurement {
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

answer! { flip_core::domain::pile::Measurement => PileMeasurement {
    tip, cone, height_mm, tip_to_apex_mm, tip_height_seen_mm, off_centre_mm, elevation_deg,
    roll_deg, flank_pixels, pile_invalid, frames,
} }
