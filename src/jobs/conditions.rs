//! The spoon of an evaluation: grain counts, mechanisms that a policy may never have met, and the
//! solver's substep.

use super::spoon::{measured, simulated};
use flip_core::domain::bench_check::ShakeCalibration;
use flip_core::domain::motion::MotionLimits;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::spoon::Spoon;
use flip_core::domain::{FieldError, bounded};
use flip_sim::dispense;
use flip_sim::mechanisms::Extensions;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Fewest grains on a spoon: about 7 mg, less than a dose.
pub const PARTICLES_MIN: u32 = 500;
/// Most grains on a spoon. With grains of 0.27 mm this many fill the bowl; more would run over the
/// rim during filling.
pub const PARTICLES_MAX: u32 = 4000;

/// Shortest substep of a spoon, us: an eighth of the usual one, at eight times its cost.
pub const SUBSTEP_US_MIN: u32 = 10;
/// Longest substep of a spoon, us. At this one, spoons that hardly flow already give several times
/// as much as at a quarter of the usual one.
pub const SUBSTEP_US_MAX: u32 = 160;

/// What is on the spoon, and mechanisms added to the simulator.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Conditions {
    /// Grains on the spoon. Their mass is the powder's, so twice the grains is twice the powder.
    pub particles: u32,
    /// Mechanisms missing from the base simulator, with their amplitudes.
    #[serde(default)]
    pub extensions: Extensions,
    /// Limits of a shake as executed by the bench's arm; absent: those of the simulator.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shake: Option<MotionLimits>,
    /// The spoon; absent: FLIP's own.
    #[serde(default, skip_serializing_if = "Spoon::is_usual")]
    pub spoon: Spoon,
    /// Substep of the solver, us; absent: the usual 80.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub substep_us: Option<u32>,
}

impl Default for Conditions {
    /// The conditions of ordinary weighings and trainings.
    fn default() -> Self {
        let spoon = dispense::Settings::default();
        Self {
            particles: spoon.particles,
            extensions: spoon.extensions,
            shake: None,
            spoon: Spoon::default(),
            substep_us: None,
        }
    }
}

impl Conditions {
    /// Conditions given in a request; omitted ones take their usual values.
    ///
    /// # Errors
    /// Every field that is out of bounds: `particles`, `extensions.<name>`.
    pub fn named(
        particles: Option<u32>,
        extensions: &BTreeMap<String, f64>,
    ) -> Result<Self, Vec<FieldError>> {
        let mut errors = Vec::new();
        let mut conditions = Self::default();
        if let Some(particles) = particles {
            let checked = bounded(
                "particles",
                particles.into(),
                PARTICLES_MIN.into(),
                PARTICLES_MAX.into(),
                "grains",
            );
            checked.map_or_else(|error| errors.push(error), |_| conditions.particles = particles);
        }
        for (name, amplitude) in extensions {
            match conditions.extensions.with(name, *amplitude) {
                Ok(extended) => conditions.extensions = extended,
                Err(error) => {
                    errors.push(FieldError::new(format!("extensions.{name}"), error.message))
                }
            }
        }
        if errors.is_empty() { Ok(conditions) } else { Err(errors) }
    }

    /// The same with another spoon.
    ///
    /// # Errors
    /// `spoon.…`: such a spoon is impossible, or cannot be simulated.
    pub fn with_spoon(self, spoon: Spoon) -> Result<Self, FieldError> {
        measured(
            &spoon,
            dispense::Settings { particles: self.particles, ..dispense::Settings::default() },
        )?;
        Ok(Self { spoon, ..self })
    }

    /// The same with another substep of the solver, us. The usual one means the same as none, so
    /// that it is the same evaluation.
    ///
    /// # Errors
    /// `substep_us`: shorter than [`SUBSTEP_US_MIN`] or longer than [`SUBSTEP_US_MAX`].
    pub fn with_substep(self, substep_us: u32) -> Result<Self, FieldError> {
        let [lower, upper] = [SUBSTEP_US_MIN, SUBSTEP_US_MAX].map(f64::from);
        bounded("substep_us", substep_us.into(), lower, upper, "us")?;
        let usual = (dispense::Settings::default().substep_s * 1e6).round() as u32;
        Ok(Self { substep_us: (substep_us != usual).then_some(substep_us), ..self })
    }

    /// The same with shakes as measured on the arm.
    #[must_use]
    pub fn as_calibrated(self, calibration: &ShakeCalibration) -> Self {
        Self { shake: Some(self.spoon().as_executed(calibration).shake), ..self }
    }

    /// The non-zero amplitudes.
    pub fn amplitudes(mut self) -> BTreeMap<String, f64> {
        let all = self.extensions.amplitudes();
        all.into_iter()
            .filter(|(_, amplitude, _)| **amplitude != 0.0)
            .map(|(name, a, _)| (name.to_owned(), *a))
            .collect()
    }

    /// Whether they are those of ordinary weighings.
    pub fn are_usual(&self) -> bool {
        *self == Self::default()
    }

    /// The spoon under these conditions.
    pub fn spoon(&self) -> dispense::Settings {
        let usual = dispense::Settings::default();
        let shake = self.shake.unwrap_or(usual.shake);
        let settings = dispense::Settings {
            particles: self.particles,
            extensions: self.extensions,
            shake,
            substep_s: self.substep_us.map_or(usual.substep_s, |us| f64::from(us) / 1e6),
            ..usual
        };
        // It was checked when the spoon was given.
        simulated(&self.spoon, settings).unwrap_or(settings)
    }

    /// Capacity of the spoon, whichever of these sets is the powder, mg; `None` without sets.
    pub fn spoon_holds_mg<'a>(&self, sets: impl Iterator<Item = &'a ParameterSet>) -> Option<f64> {
        let spoon = self.spoon();
        let holds_mg = sets.map(|set| dispense::capacity_mg(set, &spoon)).reduce(f64::min)?;
        Some(self.spoon.capacity_mg.map_or(holds_mg, |capacity_mg| capacity_mg.min(holds_mg)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(
        particles: Option<u32>,
        extensions: &[(&str, f64)],
    ) -> Result<Conditions, Vec<FieldError>> {
        let extensions =
            extensions.iter().map(|(name, amplitude)| ((*name).to_owned(), *amplitude)).collect();
        Conditions::named(particles, &extensions)
    }

    #[test]
    fn what_is_left_out_is_usual_and_what_is_named_reaches_the_spoon() {
        assert!(named(None, &[]).unwrap().are_usual());
        let conditions = named(Some(1500), &[("rotation", 1.0), ("humidity", 0.5)]).unwrap();
        assert!(!conditions.are_usual());
        let spoon = conditions.spoon();
        assert_eq!(
            (spoon.particles, spoon.extensions.rotation, spoon.extensions.humidity),
            (1500, 1.0, 0.5)
        );
        let amplitudes: Vec<(String, f64)> = conditions.amplitudes().into_iter().collect();
        assert_eq!(amplitudes, [("humidity".to_owned(), 0.5), ("rotation".to_owned(), 1.0)]);
        let sets = [ParameterSet::default()];
        let holds = |conditions: Conditions| conditions.spoon_holds_mg(sets.iter()).unwrap();
        assert!((holds(conditions) / holds(Conditions::default()) - 1500.0 / 2500.0).abs() < 1e-12);
    }

    #[test]
    fn another_substep_reaches_the_spoon_and_the_usual_one_is_none() {
        let usual = Conditions::default();
        assert_eq!(usual.with_substep(80), Ok(usual));
        assert!(!serde_json::to_string(&usual).unwrap().contains("substep"));
        let finer = usual.with_substep(20).unwrap();
        assert!(!finer.are_usual());
        assert_eq!(finer.spoon().substep_s, 20e-6);
        assert_eq!(finer.with_substep(80), Ok(usual));
        let text = serde_json::to_string(&finer).unwrap();
        assert_eq!(serde_json::from_str::<Conditions>(&text).unwrap(), finer);
        for refused in [9, 161] {
            let error = usual.with_substep(refused).unwrap_err();
            assert_eq!(error.field, "substep_us");
            assert!(error.message.contains("from 10 to 160 us"), "{error:?}");
        }
    }

    #[test]
    fn every_value_out_of_its_bounds_is_named() {
        let fields = |refused: Result<Conditions, Vec<FieldError>>| -> Vec<(String, String)> {
            refused.unwrap_err().into_iter().map(|error| (error.field, error.message)).collect()
        };
        let found = fields(named(Some(499), &[("rotation", 1.5), ("wind", 1.0)]));
        assert_eq!(
            found.iter().map(|it| it.0.as_str()).collect::<Vec<_>>(),
            ["particles", "extensions.rotation", "extensions.wind"]
        );
        assert!(
            found[0].1.contains("from 500 to 4000") && found[1].1.contains("from 0 to 1"),
            "{found:?}"
        );
        assert!(found[2].1.contains("rolling_friction"), "{found:?}");
    }

    #[test]
    fn a_bowl_of_the_most_grains_spills_little_while_it_is_filled() {
        let spoon = Conditions { particles: PARTICLES_MAX, ..Conditions::default() }.spoon();
        let filled = dispense::Dispenser::new(&ParameterSet::default(), &spoon, 1);
        let share = filled.spoon_mg() / dispense::capacity_mg(&ParameterSet::default(), &spoon);
        assert!(share > 0.9, "only {share} of the grains stayed on the spoon");
    }
}
