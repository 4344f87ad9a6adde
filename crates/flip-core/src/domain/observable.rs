//! Measurable properties of a powder besides its angle of repose.

use super::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// A quantity measured in an experiment, with the experiment's settings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Observable {
    /// Time for a mass to run out of a flat-bottomed cup through a round hole, s. A Hall flow meter
    /// uses 50 g, 2.54 mm (ASTM B213).
    FlowTime {
        /// Mass that runs out, 0.01 to 1000 g.
        mass_g: f64,
        /// Diameter of the hole, 1.5 to 4 mm.
        orifice_mm: f64,
    },
    /// Mass that falls from a full spoon in one shake, mg.
    ShakeMass {
        /// Pitch of the spoon, tip down, 0 to 50 deg.
        pitch_deg: f64,
        /// Amplitude of the shake along the spoon, 0.9 to 16 mm.
        shake_mm: f64,
    },
    /// Slope of the powder left in a flat-bottomed cup after draining through a hole in the middle,
    /// deg.
    DrainedAngle {},
    /// Height of a heap that covers a round base to its rim, mm.
    PileHeight {
        /// Diameter of the base, 5 to 500 mm.
        base_diameter_mm: f64,
        /// Distance from the funnel's tip down to the apex of the finished heap, mm; 0.05 to 0.5
        /// base diameters.
        fall_mm: f64,
    },
}

/// A measured quantity: the mean of `n` repeats and their standard deviation, in the quantity's
/// unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Observation {
    /// What was measured.
    pub observable: Observable,
    /// Mean over the repeats, in the observable's unit.
    pub mean: f64,
    /// Standard deviation over the repeats, above 0.
    pub sd: f64,
    /// Number of repeats, 2 to 10000: a single one has no spread.
    pub n: u32,
}

/// Smallest standard deviation of repeats; no balance, clock or protractor resolves less.
pub const SD_MIN: f64 = 1e-4;

impl Observable {
    /// The experiment without factors that only scale the result, so that equal experiments at this
    /// scale compare equal.
    pub fn experiment(self) -> Self {
        match self {
            Self::FlowTime { orifice_mm, .. } => Self::FlowTime { mass_g: 1.0, orifice_mm },
            Self::PileHeight { base_diameter_mm, fall_mm } => {
                let fall_mm = (1000.0 * fall_mm / base_diameter_mm).round() / 100.0;
                Self::PileHeight { base_diameter_mm: 10.0, fall_mm }
            }
            other => other,
        }
    }

    /// The unit of the observable.
    pub fn unit(&self) -> &'static str {
        match self {
            Self::FlowTime { .. } => "s",
            Self::ShakeMass { .. } => "mg",
            Self::DrainedAngle {} => "deg",
            Self::PileHeight { .. } => "mm",
        }
    }

    /// The name of the kind, as in JSON.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::FlowTime { .. } => "flow_time",
            Self::ShakeMass { .. } => "shake_mass",
            Self::DrainedAngle {} => "drained_angle",
            Self::PileHeight { .. } => "pile_height",
        }
    }

    fn check(&self) -> Result<(), FieldError> {
        match *self {
            Self::FlowTime { mass_g, orifice_mm } => {
                bounded("mass_g", mass_g, 0.01, 1000.0, "g")?;
                bounded("orifice_mm", orifice_mm, 1.5, 4.0, "mm")?;
            }
            Self::ShakeMass { pitch_deg, shake_mm } => {
                bounded("pitch_deg", pitch_deg, 0.0, 50.0, "deg")?;
                bounded("shake_mm", shake_mm, 0.9, 16.0, "mm")?;
            }
            Self::DrainedAngle {} => {}
            Self::PileHeight { base_diameter_mm, fall_mm } => {
                bounded("base_diameter_mm", base_diameter_mm, 5.0, 500.0, "mm")?;
                bounded("fall_mm", fall_mm, 0.05 * base_diameter_mm, 0.5 * base_diameter_mm, "mm")?;
            }
        }
        Ok(())
    }

    /// Possible range of the mean.
    fn range(&self) -> [f64; 2] {
        match *self {
            Self::FlowTime { .. } => [0.01, 1e5],
            Self::ShakeMass { .. } => [0.0, 50.0],
            Self::DrainedAngle {} => [5.0, 85.0],
            Self::PileHeight { base_diameter_mm, .. } => {
                [0.04, 5.0].map(|share| share * base_diameter_mm)
            }
        }
    }
}

impl Observation {
    /// Validates the observation: each number must be possible.
    ///
    /// # Errors
    /// The first number that is not, by name.
    pub fn checked(self) -> Result<Self, FieldError> {
        self.observable.check()?;
        let [lower, upper] = self.observable.range();
        bounded("mean", self.mean, lower, upper, self.observable.unit())?;
        bounded("sd", self.sd, SD_MIN, upper, self.observable.unit())?;
        if !(2..=10_000).contains(&self.n) {
            return Err(FieldError::new(
                "n",
                format!("must be from 2 to 10000 repeats, got {}", self.n),
            ));
        }
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAKE: Observable = Observable::ShakeMass { pitch_deg: 30.0, shake_mm: 4.0 };

    #[test]
    fn impossible_observations_are_refused_by_field() {
        let field = |observable, mean, sd, n| {
            Observation { observable, mean, sd, n }.checked().unwrap_err().field
        };
        assert_eq!(field(SHAKE, -1.0, 0.1, 5), "mean");
        assert_eq!(field(SHAKE, 1.0, f64::NAN, 5), "sd");
        assert_eq!(field(SHAKE, 1.0, 0.0, 5), "sd");
        assert_eq!(field(SHAKE, 1.0, 0.1, 1), "n");
        assert_eq!(
            field(Observable::ShakeMass { pitch_deg: 30.0, shake_mm: 0.1 }, 1.0, 0.1, 5),
            "shake_mm"
        );
        assert_eq!(
            field(Observable::FlowTime { mass_g: 50.0, orifice_mm: 9.0 }, 30.0, 1.0, 5),
            "orifice_mm"
        );
        assert_eq!(field(Observable::DrainedAngle {}, 2.0, 1.0, 5), "mean");
        let pile = |fall_mm| Observable::PileHeight { base_diameter_mm: 40.0, fall_mm };
        assert_eq!(field(pile(1.0), 12.0, 1.0, 5), "fall_mm");
        assert_eq!(field(pile(8.0), 0.0, 1.0, 5), "mean");
    }

    #[test]
    fn the_same_experiment_at_another_scale_is_the_same() {
        let pile = |base_diameter_mm, fall_mm| {
            Observable::PileHeight { base_diameter_mm, fall_mm }.experiment()
        };
        assert_eq!(pile(40.0, 8.0), pile(60.0, 12.0));
        let flow = |mass_g| Observable::FlowTime { mass_g, orifice_mm: 2.5 }.experiment();
        assert_eq!(flow(50.0), flow(1.0));
        assert_eq!(SHAKE.experiment(), SHAKE);
    }

    #[test]
    fn an_observation_reads_as_it_is_written_and_nothing_more() {
        let hall = Observable::FlowTime { mass_g: 50.0, orifice_mm: 2.54 };
        for observable in [SHAKE, hall, Observable::DrainedAngle {}] {
            let observation =
                Observation { observable, mean: 20.0, sd: 1.0, n: 5 }.checked().unwrap();
            let text = serde_json::to_string(&observation).unwrap();
            assert!(text.contains(observable.kind()), "{text}");
            assert_eq!(serde_json::from_str::<Observation>(&text).unwrap(), observation);
        }
        let stray = r#"{"observable": {"kind": "drained_angle", "pitch_deg": 1}, "mean": 30, "sd": 1, "n": 5}"#;
        assert!(serde_json::from_str::<Observation>(stray).is_err());
    }
}
