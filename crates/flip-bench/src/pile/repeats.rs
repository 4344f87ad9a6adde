//! Combine repeats of one powder into its flowability.

use super::Measurement;
use flip_core::domain::FieldError;
use flip_core::domain::powder::Flowability;
use serde::{Deserialize, Serialize};

/// Repeats of one powder, a pile each.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
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

/// Combine the measurements of several piles of one powder; the published number is five.
///
/// ```text
/// u^2 = s^2 / n + mean of u_i^2
/// ```
///
/// All repeats use the same rig, so its errors do not average out.
///
/// # Errors
/// No measurements, or an angle outside the range of a powder.
pub fn repeats(measurements: &[Measurement]) -> Result<Repeats, FieldError> {
    let of = |angle: fn(&Measurement) -> super::Angle| {
        let angles: Vec<super::Angle> = measurements.iter().map(angle).collect();
        let flowability = Flowability::of_repeats(
            "measurements",
            &angles.iter().map(|a| a.deg).collect::<Vec<_>>(),
        )?;
        let own = angles.iter().map(|a| a.u_deg * a.u_deg).sum::<f64>() / angles.len() as f64;
        let spread = flowability.sd_deg.powi(2) / f64::from(flowability.n);
        Ok((flowability, (spread + own).sqrt()))
    };
    let ((tip, tip_u_deg), (cone, cone_u_deg)) = (of(|m| m.tip)?, of(|m| m.cone)?);
    Ok(Repeats { tip, cone, tip_u_deg, cone_u_deg })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pile::Angle;

    fn measured(tip_deg: f64, u_deg: f64) -> Measurement {
        let angle = |deg| Angle { deg, u_deg, u_frames_deg: 0.0 };
        Measurement {
            tip: angle(tip_deg),
            cone: angle(tip_deg - 1.0),
            height_mm: 20.0,
            tip_to_apex_mm: 40.0,
            tip_height_seen_mm: 60.0,
            off_centre_mm: 0.0,
            elevation_deg: 30.0,
            roll_deg: 0.0,
            flank_pixels: 1000,
            pile_invalid: 0.0,
            frames: 10,
        }
    }

    #[test]
    fn five_repeats_make_a_mean_a_spread_and_an_uncertainty_that_the_rig_bounds() {
        let five = [34.0, 35.0, 36.0, 37.0, 38.0].map(|deg| measured(deg, 0.3));
        let found = repeats(&five).unwrap();
        assert_eq!((found.tip.repose_deg, found.cone.repose_deg, found.tip.n), (36.0, 35.0, 5));
        assert!((found.tip.sd_deg - 2.5_f64.sqrt()).abs() < 1e-12);
        assert!((found.tip_u_deg - (0.5_f64 + 0.09).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn no_repeats_and_impossible_ones_are_refused() {
        assert_eq!(repeats(&[]).unwrap_err().field, "measurements");
        assert_eq!(repeats(&[measured(2.0, 0.1)]).unwrap_err().field, "measurements[0]");
    }
}
