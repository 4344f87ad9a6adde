//! What a spoon let fall, shake by shake: the measurements that a weighing makes of its powder.

use super::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// Largest mass of a spoonful, mg.
pub const SPOONFUL_MG_MAX: f64 = 1e5;

/// One step of a spoonful: the pitch it went to, then the shake made there.
///
/// A reading may be below zero and a shake may give nothing: both are measurements.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shake {
    /// Pitch of the spoon during the shake, degrees; positive is tip down.
    pub pitch_deg: f64,
    /// Amplitude as executed, mm; 0 where the step only changed the pitch.
    pub shake_mm: f64,
    /// How often it was made before the reading.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub strokes: u32,
    /// Largest acceleration of the stroke, m/s^2; `None` if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acceleration_m_s2: Option<f64>,
    /// Powder in the spoon before the step, mg: filled less fallen; `None` if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spoon_mg: Option<f64>,
    /// Mass that fell during the step, by the balance, mg.
    pub fell_mg: f64,
    /// Its standard uncertainty, mg.
    pub sd_mg: f64,
    /// Time from filling the spoon to the end of the step, s; `None` if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub since_filled_s: Option<f64>,
}

fn one() -> u32 {
    1
}

fn is_one(strokes: &u32) -> bool {
    *strokes == 1
}

/// The steps of one filling of the spoon, in order, and what it was filled with.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spoonful {
    /// Id of the weighing, or of the run in a file.
    pub weighing: String,
    /// Which spoonful of the weighing; the first is 1.
    pub spoonful: u32,
    /// Powder, by id.
    pub powder: String,
    /// Lot of the powder; `None` if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lot: Option<String>,
    /// Day, or another unit over which powder and bench are alike.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<String>,
    /// Step of the balance's display, mg; `None` if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub readability_mg: Option<f64>,
    /// In the order in which they were made.
    pub shakes: Vec<Shake>,
}

impl Shake {
    /// Validates the numbers.
    ///
    /// # Errors
    /// The first field that is not a number within its bounds.
    pub fn checked(self) -> Result<Self, FieldError> {
        bounded("pitch_deg", self.pitch_deg, -90.0, 180.0, "deg")?;
        bounded("shake_mm", self.shake_mm, 0.0, 100.0, "mm")?;
        bounded("fell_mg", self.fell_mg, -SPOONFUL_MG_MAX, SPOONFUL_MG_MAX, "mg")?;
        bounded("sd_mg", self.sd_mg, 1e-4, 1e3, "mg")?;
        bounded("strokes", f64::from(self.strokes), 1.0, 1000.0, "")?;
        let optional = [
            ("acceleration_m_s2", self.acceleration_m_s2, 0.0, 1e3, "m/s^2"),
            ("spoon_mg", self.spoon_mg, -SPOONFUL_MG_MAX, SPOONFUL_MG_MAX, "mg"),
            ("since_filled_s", self.since_filled_s, 0.0, 1e7, "s"),
        ];
        for (name, value, lower, upper, unit) in optional {
            value.map_or(Ok(0.0), |value| bounded(name, value, lower, upper, unit))?;
        }
        Ok(self)
    }
}

impl Spoonful {
    /// Mass that fell over all steps, mg.
    pub fn fell_mg(&self) -> f64 {
        self.shakes.iter().map(|shake| shake.fell_mg).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reading_below_zero_is_a_measurement_and_a_number_out_of_bounds_is_named() {
        let shake = Shake {
            pitch_deg: 40.0,
            shake_mm: 0.0,
            strokes: 1,
            acceleration_m_s2: None,
            spoon_mg: Some(-0.5),
            fell_mg: -1.0,
            sd_mg: 0.4,
            since_filled_s: None,
        };
        assert_eq!(shake.checked(), Ok(shake));
        let field = |bad: Shake| bad.checked().unwrap_err().field;
        assert_eq!(field(Shake { fell_mg: f64::NAN, ..shake }), "fell_mg");
        assert_eq!(field(Shake { sd_mg: 0.0, ..shake }), "sd_mg");
        assert_eq!(field(Shake { since_filled_s: Some(-1.0), ..shake }), "since_filled_s");
        let spoonful = Spoonful {
            weighing: "w".to_owned(),
            spoonful: 1,
            powder: "salt".to_owned(),
            lot: None,
            session: None,
            readability_mg: None,
            shakes: vec![shake, Shake { fell_mg: 3.5, ..shake }],
        };
        assert_eq!(spoonful.fell_mg(), 2.5);
    }
}
