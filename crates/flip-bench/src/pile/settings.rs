//! Rig dimensions known to the operator, and requirements on the frames.

use flip_core::domain::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// How lengths seen by the camera are scaled to true lengths.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
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

/// The rig, measured with a ruler or calipers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Dimensions {
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

impl Default for Dimensions {
    fn default() -> Self {
        Self {
            tip_height_mm: 60.0,
            tip_height_u_mm: 0.1,
            base_diameter_mm: 60.0,
            base_diameter_u_mm: 0.1,
            base_height_mm: 15.0,
            base_height_u_mm: 0.1,
            spout_diameter_mm: 10.0,
            depth_scale_u: 0.007,
            lengths: Lengths::ByTipHeight,
        }
    }
}

impl Dimensions {
    /// Returns the settings if they are valid.
    ///
    /// # Errors
    /// A number outside the bounds in its field's description.
    pub fn checked(self) -> Result<Self, FieldError> {
        for (field, value, low, high, unit) in [
            ("tip_height_mm", self.tip_height_mm, 10.0, 500.0, "mm"),
            ("tip_height_u_mm", self.tip_height_u_mm, 0.0, 5.0, "mm"),
            ("base_diameter_mm", self.base_diameter_mm, 5.0, 500.0, "mm"),
            ("base_diameter_u_mm", self.base_diameter_u_mm, 0.0, 5.0, "mm"),
            ("base_height_mm", self.base_height_mm, 0.0, 200.0, "mm"),
            ("base_height_u_mm", self.base_height_u_mm, 0.0, 5.0, "mm"),
            ("spout_diameter_mm", self.spout_diameter_mm, 1.0, 100.0, "mm"),
            ("depth_scale_u", self.depth_scale_u, 0.0, 0.1, ""),
        ] {
            bounded(field, value, low, high, unit)?;
        }
        Ok(self)
    }
}

/// Requirements on the frames.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
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
        Self {
            frames_min: 10,
            pile_invalid_max: 0.3,
            frame_invalid_max: 0.8,
            noise_max_mm: 3.0,
            roll_max_deg: 12.0,
            elevation_deg: [12.0, 60.0],
            move_max_pixels: 1.0,
            move_max_mm: 0.7,
            off_centre_max: 0.15,
            scale_error_max: 0.04,
        }
    }
}

impl Limits {
    /// Returns the limits if they are valid.
    ///
    /// # Errors
    /// A number outside the bounds in its field's description.
    pub fn checked(self) -> Result<Self, FieldError> {
        for (field, value, low, high, unit) in [
            ("frames_min", f64::from(self.frames_min), 3.0, 100.0, "frames"),
            ("pile_invalid_max", self.pile_invalid_max, 0.0, 0.9, ""),
            ("frame_invalid_max", self.frame_invalid_max, 0.0, 0.9, ""),
            ("noise_max_mm", self.noise_max_mm, 0.01, 20.0, "mm"),
            ("roll_max_deg", self.roll_max_deg, 1.0, 45.0, "deg"),
            ("elevation_deg[0]", self.elevation_deg[0], 5.0, 85.0, "deg"),
            ("elevation_deg[1]", self.elevation_deg[1], self.elevation_deg[0], 85.0, "deg"),
            ("move_max_pixels", self.move_max_pixels, 0.1, 20.0, "pixels"),
            ("move_max_mm", self.move_max_mm, 0.05, 20.0, "mm"),
            ("off_centre_max", self.off_centre_max, 0.01, 1.0, ""),
            ("scale_error_max", self.scale_error_max, 0.001, 0.2, ""),
        ] {
            bounded(field, value, low, high, unit)?;
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_settings_are_refused_by_field() {
        assert!(Dimensions::default().checked().is_ok() && Limits::default().checked().is_ok());
        let rig = |change: fn(&mut Dimensions)| {
            let mut rig = Dimensions::default();
            change(&mut rig);
            rig.checked().unwrap_err().field
        };
        assert_eq!(rig(|r| r.tip_height_mm = 0.0), "tip_height_mm");
        assert_eq!(rig(|r| r.base_diameter_mm = f64::NAN), "base_diameter_mm");
        assert_eq!(rig(|r| r.depth_scale_u = 1.0), "depth_scale_u");
        let limits = Limits { elevation_deg: [50.0, 40.0], ..Limits::default() };
        assert_eq!(limits.checked().unwrap_err().field, "elevation_deg[1]");
    }
}
