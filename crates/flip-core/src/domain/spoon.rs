//! The dosing spoon, as measured by a person.

use super::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// Who fills the spoon.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FilledBy {
    /// The arm, from the powder's container, if it reports that it can.
    #[default]
    Arm,
    /// A person or a station, before each dose.
    Hand,
}

/// A spoon. Omitted values are those of FLIP's own spoon, which holds about 40 mg.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Spoon {
    /// Mass of one filling, mg, 1 to 100000; if omitted, the capacity of a bowl of these dimensions
    /// for the simulated powder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub capacity_mg: Option<f64>,
    /// Inner length of the bowl, mm, 2 to 60; requires `width_mm` and `depth_mm`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub length_mm: Option<f64>,
    /// Inner width of the bowl, mm, 2 to 60.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub width_mm: Option<f64>,
    /// Depth of the bowl, mm, 0.5 to 30.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth_mm: Option<f64>,
    /// Who fills it. Default the arm.
    #[serde(skip_serializing_if = "is_arm")]
    pub filled_by: FilledBy,
}

fn is_arm(by: &FilledBy) -> bool {
    *by == FilledBy::Arm
}

impl Spoon {
    /// Whether this is FLIP's own spoon, filled by the arm.
    pub fn is_usual(&self) -> bool {
        *self == Self::default()
    }

    /// Length, width and depth of the bowl, mm, if measured.
    pub fn bowl_mm(&self) -> Option<[f64; 3]> {
        Some([self.length_mm?, self.width_mm?, self.depth_mm?])
    }

    /// Validates the spoon.
    ///
    /// # Errors
    /// The first field that is out of its bounds, or missing while a related one is given.
    pub fn checked(self) -> Result<Self, FieldError> {
        if let Some(capacity_mg) = self.capacity_mg {
            bounded("capacity_mg", capacity_mg, 1.0, 100_000.0, "mg")?;
        }
        let sides = [
            ("length_mm", self.length_mm, 2.0, 60.0),
            ("width_mm", self.width_mm, 2.0, 60.0),
            ("depth_mm", self.depth_mm, 0.5, 30.0),
        ];
        for (field, side, lower, upper) in sides {
            match side {
                Some(side) => drop(bounded(field, side, lower, upper, "mm")?),
                None if sides.iter().any(|side| side.1.is_some()) => {
                    return Err(FieldError::new(
                        field,
                        "must be given too: a bowl has length_mm, width_mm and depth_mm",
                    ));
                }
                None => {}
            }
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bowl_has_three_sides_or_none() {
        let bowl = Spoon {
            length_mm: Some(12.0),
            width_mm: Some(9.0),
            depth_mm: Some(4.0),
            ..Spoon::default()
        };
        assert_eq!(bowl.checked().unwrap().bowl_mm(), Some([12.0, 9.0, 4.0]));
        assert_eq!(Spoon::default().checked(), Ok(Spoon::default()));
        for (field, wrong) in [
            ("depth_mm", Spoon { depth_mm: None, ..bowl }),
            ("width_mm", Spoon { width_mm: Some(0.1), ..bowl }),
            ("capacity_mg", Spoon { capacity_mg: Some(f64::NAN), ..bowl }),
        ] {
            assert_eq!(wrong.checked().unwrap_err().field, field);
        }
    }

    #[test]
    fn what_is_usual_is_not_written_down() {
        assert_eq!(serde_json::to_string(&Spoon::default()).unwrap(), "{}");
        let hand: Spoon =
            serde_json::from_str(r#"{"filled_by": "hand", "capacity_mg": 60}"#).unwrap();
        assert_eq!((hand.filled_by, hand.capacity_mg), (FilledBy::Hand, Some(60.0)));
    }
}
