//! What a powder was weighed with: the display, the spoon, and the strokes that the arm executes.

use super::bench::Action;
use super::bench_check::ShakeCalibration;
use super::motion::{MotionLimits, Move};
use serde::{Deserialize, Serialize};

/// The conditions of a weighing that its readings and actions do not show.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Apparatus {
    /// Step of the balance's display, mg.
    pub readability_mg: f64,
    /// SD of repeated readings of one weight, mg; absent if it was not checked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeatability_mg: Option<f64>,
    /// Mass of one filling of the spoon, mg; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub capacity_mg: Option<f64>,
    /// The strokes of the arm; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stroke: Option<Stroke>,
}

/// How an arm strokes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Stroke {
    /// Largest amplitude that may be commanded, mm.
    pub shake_mm_max: f64,
    /// The limits within which a commanded stroke is planned.
    pub limits: MotionLimits,
    /// The arm's response, by which commands were corrected; absent if it was not measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub response: Option<StrokeResponse>,
}

/// A measured response to commanded strokes: the line of a [`ShakeCalibration`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StrokeResponse {
    /// Executed over commanded amplitude.
    pub gain: f64,
    /// Executed amplitude at zero commanded amplitude, mm.
    pub offset_mm: f64,
    /// Executed over planned peak speed.
    pub speed_gain: f64,
}

/// A stroke as the spoon makes it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Executed {
    /// Amplitude, mm; 0 for no stroke.
    pub shake_mm: f64,
    /// Largest acceleration, m/s^2; `None` without a stroke, or if unknown.
    pub acceleration_m_s2: Option<f64>,
}

impl From<&ShakeCalibration> for StrokeResponse {
    fn from(line: &ShakeCalibration) -> Self {
        Self { gain: line.gain, offset_mm: line.offset_mm, speed_gain: line.speed_gain }
    }
}

impl Apparatus {
    /// Standard uncertainty of the difference of two readings, mg.
    ///
    /// ```text
    /// u^2 = 2 (d^2 / 12 + s^2)
    /// ```
    ///
    /// Each reading is rounded to a step d of the display, which is a rectangular distribution of
    /// half-width d / 2 and variance d^2 / 12, and repeats with the SD s, 0 if that was not checked.
    /// The two are independent, so their variances add; s contains some of the rounding, so u is
    /// rather too large than too small. Differences that share a reading have errors with a
    /// correlation of -1/2. Source: JCGM 100:2008 (GUM), 4.3.7 and 5.1.2.
    pub fn difference_sd_mg(&self) -> f64 {
        let repeats_mg2 = self.repeatability_mg.unwrap_or(0.0).powi(2);
        (2.0 * (self.readability_mg.powi(2) / 12.0 + repeats_mg2)).sqrt()
    }

    /// The stroke of this action. Without knowledge of the arm it is taken as asked for.
    pub fn executed(&self, action: &Action) -> Executed {
        let asked_mm = action.executed_shake_mm();
        match self.stroke {
            _ if asked_mm <= 0.0 => Executed { shake_mm: 0.0, acceleration_m_s2: None },
            None => Executed { shake_mm: asked_mm, acceleration_m_s2: None },
            Some(stroke) => stroke.executed(asked_mm),
        }
    }
}

impl Stroke {
    /// The stroke when this amplitude is asked for, mm.
    ///
    /// With a measured response the command is corrected so that the amplitude asked for is
    /// executed, as far as the arm may be commanded. A stroke whose peak speed is s times that of a
    /// planned one of the same length takes 1 / s of its time:
    ///
    /// ```text
    /// acceleration = s^2 (that of a planned stroke of the executed length)
    /// s = speed_gain (planned peak speed at the commanded length) / (the same at the executed length)
    /// ```
    fn executed(&self, asked_mm: f64) -> Executed {
        let planned = |mm: f64| Move::new(mm * 1e-3, self.limits);
        let (shake_mm, s) = match self.response {
            None => (asked_mm.min(self.shake_mm_max), 1.0),
            Some(response) => {
                let commanded_mm = response.commanded_mm(asked_mm).min(self.shake_mm_max);
                let shake_mm = response.executed_mm(commanded_mm);
                let planned_m_s = planned(shake_mm).top_m_s();
                let peak_m_s = response.speed_gain * planned(commanded_mm).top_m_s();
                (shake_mm, if planned_m_s > 0.0 { peak_m_s / planned_m_s } else { 1.0 })
            }
        };
        let acceleration_m_s2 = s * s * planned(shake_mm).peak_m_s2();
        let is_known = shake_mm > 0.0 && acceleration_m_s2.is_finite();
        Executed { shake_mm, acceleration_m_s2: is_known.then_some(acceleration_m_s2) }
    }
}

impl StrokeResponse {
    /// As [`ShakeCalibration::executed_mm`].
    fn executed_mm(&self, commanded_mm: f64) -> f64 {
        (self.offset_mm + self.gain * commanded_mm).max(0.0)
    }

    /// As [`ShakeCalibration::commanded_mm`].
    fn commanded_mm(&self, asked_mm: f64) -> f64 {
        ((asked_mm - self.offset_mm) / self.gain).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BARE: Apparatus =
        Apparatus { readability_mg: 1.0, repeatability_mg: None, capacity_mg: None, stroke: None };
    const RESPONSE: StrokeResponse =
        StrokeResponse { gain: 0.94, offset_mm: -0.1, speed_gain: 0.9 };

    fn shake(shake_mm: f64) -> Action {
        Action::once(2.0, shake_mm)
    }

    #[test]
    fn a_difference_has_the_rounding_and_the_repeatability_of_two_readings() {
        assert!((BARE.difference_sd_mg() - (1.0f64 / 6.0).sqrt()).abs() < 1e-12);
        let checked = Apparatus { repeatability_mg: Some(0.3), ..BARE };
        assert!((checked.difference_sd_mg() - (1.0f64 / 6.0 + 0.18).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn a_stroke_is_what_was_asked_for_as_far_as_the_arm_may_be_commanded() {
        let nothing = Executed { shake_mm: 0.0, acceleration_m_s2: None };
        assert_eq!(BARE.executed(&shake(0.5)), nothing, "below the least amplitude");
        assert_eq!(BARE.executed(&shake(4.0)).shake_mm, 4.0);
        let stroke =
            Stroke { shake_mm_max: 16.0, limits: MotionLimits::BRISK, response: Some(RESPONSE) };
        let known = Apparatus { stroke: Some(stroke), ..BARE };
        assert!((known.executed(&shake(4.0)).shake_mm - 4.0).abs() < 1e-12);
        assert!((known.executed(&shake(16.0)).shake_mm - (0.94 * 16.0 - 0.1)).abs() < 1e-12);
        let uncorrected = Stroke { shake_mm_max: 10.0, response: None, ..stroke };
        let known = Apparatus { stroke: Some(uncorrected), ..BARE };
        assert_eq!(known.executed(&shake(12.0)).shake_mm, 10.0);
        // 10 mm is long enough for the full acceleration of the limits.
        assert_eq!(known.executed(&shake(12.0)).acceleration_m_s2, Some(4.5));
    }

    #[test]
    fn a_slower_stroke_of_the_same_length_has_the_square_of_its_speed_as_acceleration() {
        let same = StrokeResponse { gain: 1.0, offset_mm: 0.0, speed_gain: 0.5 };
        let stroke =
            |response| Stroke { shake_mm_max: 16.0, limits: MotionLimits::BRISK, response };
        let of = |response| stroke(response).executed(8.0).acceleration_m_s2.unwrap();
        assert!((of(Some(same)) / of(None) - 0.25).abs() < 1e-12);
    }
}
