//! Limits on what an arm may be commanded to do. Numbers outside them never leave this process.

use super::proto;
use super::remote::{DEVICE, forbidden};
use crate::hardware::DeviceError;
use flip_core::domain::bench::{PitchLimits, Reach, SHAKE_MM_MAX};
use flip_core::domain::bounded;
use flip_core::domain::motion::MotionLimits;

/// The driver's limits, clipped to those of any action.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Pitch range.
    pub pitch: PitchLimits,
    /// Maximum pitch rate, deg/s.
    pub pitch_deg_s_max: f64,
    /// Maximum shake amplitude, mm.
    pub shake_mm_max: f64,
    /// Motion limits of a shake.
    pub motion: MotionLimits,
}

impl Limits {
    /// Clip the driver's own limits: pitch to -90 to 90 deg, shakes to the limits of an action.
    ///
    /// # Errors
    /// [`DeviceError::Garbled`] when they are missing, not finite, not positive, or do not allow a
    /// level spoon.
    pub fn narrowed(theirs: Option<&proto::Limits>) -> Result<Self, DeviceError> {
        let garbled = || DeviceError::Garbled { device: DEVICE, got: format!("limits {theirs:?}") };
        let limits = theirs.ok_or_else(garbled)?;
        let positive = [
            limits.pitch_deg_s_max,
            limits.shake_mm_max,
            limits.velocity_m_s_max,
            limits.acceleration_m_s2_max,
            limits.jerk_m_s3_max,
        ];
        if !positive.iter().all(|number| number.is_finite() && *number > 0.0) {
            return Err(garbled());
        }
        let theirs =
            PitchLimits { lower_deg: limits.pitch_deg_min, upper_deg: limits.pitch_deg_max };
        let pitch = theirs.within(Reach::FULL.pitch);
        let numbers = limits.pitch_deg_min.is_finite() && limits.pitch_deg_max.is_finite();
        if !numbers || !(pitch.lower_deg..=pitch.upper_deg).contains(&0.0) {
            return Err(garbled());
        }
        Ok(Self {
            pitch,
            pitch_deg_s_max: limits.pitch_deg_s_max,
            shake_mm_max: limits.shake_mm_max.min(SHAKE_MM_MAX),
            motion: MotionLimits {
                velocity_m_s: limits.velocity_m_s_max,
                acceleration_m_s2: limits.acceleration_m_s2_max,
                jerk_m_s3: limits.jerk_m_s3_max,
            },
        })
    }

    /// Returns the pitch if it is within limits.
    ///
    /// # Errors
    /// [`DeviceError::Forbidden`]
    pub fn pitch_deg(&self, asked: f64) -> Result<f64, DeviceError> {
        let PitchLimits { lower_deg, upper_deg } = self.pitch;
        bounded("pitch_deg", asked, lower_deg, upper_deg, "deg")
            .map_err(|error| forbidden(error.to_string()))
    }

    /// Returns the amplitude if it is within limits.
    ///
    /// # Errors
    /// [`DeviceError::Forbidden`]
    pub fn shake_mm(&self, asked: f64) -> Result<f64, DeviceError> {
        bounded("shake_mm", asked, 0.0, self.shake_mm_max, "mm")
            .map_err(|error| forbidden(error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const THEIRS: proto::Limits = proto::Limits {
        pitch_deg_min: -30.0,
        pitch_deg_max: 36.0,
        pitch_deg_s_max: 60.0,
        shake_mm_max: 20.0,
        velocity_m_s_max: 0.75,
        acceleration_m_s2_max: 1.17,
        jerk_m_s3_max: 225.0,
    };

    #[test]
    fn the_narrower_bound_counts() {
        let limits = Limits::narrowed(Some(&THEIRS)).unwrap();
        assert_eq!(limits.pitch, PitchLimits { lower_deg: -30.0, upper_deg: 36.0 });
        let steep = proto::Limits { pitch_deg_max: 70.0, pitch_deg_min: -120.0, ..THEIRS };
        assert_eq!(
            Limits::narrowed(Some(&steep)).unwrap().pitch,
            PitchLimits { lower_deg: -90.0, upper_deg: 70.0 }
        );
        assert_eq!((limits.shake_mm_max, limits.motion), (SHAKE_MM_MAX, MotionLimits::PAPER));
    }

    #[test]
    fn numbers_out_of_bounds_or_no_numbers_are_refused_by_name() {
        let limits = Limits::narrowed(Some(&THEIRS)).unwrap();
        for pitch in [-30.1, 36.1, f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(
                limits
                    .pitch_deg(pitch)
                    .unwrap_err()
                    .to_string()
                    .contains("pitch_deg: must be a number from -30 to 36")
            );
        }
        for shake in [-0.1, 16.1, f64::NAN, f64::INFINITY] {
            assert!(
                limits
                    .shake_mm(shake)
                    .unwrap_err()
                    .to_string()
                    .contains("shake_mm: must be a number from 0 to 16")
            );
        }
        assert_eq!((limits.pitch_deg(36.0), limits.shake_mm(0.0)), (Ok(36.0), Ok(0.0)));
    }

    #[test]
    fn a_driver_whose_limits_mean_nothing_is_not_used() {
        let refused = |change: fn(&mut proto::Limits)| {
            let mut limits = THEIRS;
            change(&mut limits);
            matches!(Limits::narrowed(Some(&limits)), Err(DeviceError::Garbled { .. }))
        };
        assert!(matches!(Limits::narrowed(None), Err(DeviceError::Garbled { .. })));
        assert!(refused(|limits| limits.pitch_deg_max = f64::NAN));
        assert!(refused(|limits| limits.pitch_deg_min = 5.0), "such a spoon is never level");
        assert!(refused(|limits| limits.shake_mm_max = 0.0));
        assert!(refused(|limits| limits.velocity_m_s_max = f64::INFINITY));
        assert!(refused(|limits| limits.jerk_m_s3_max = -1.0));
    }
}
