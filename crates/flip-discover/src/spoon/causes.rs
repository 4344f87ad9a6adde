//! What can make a spoon let fall something else than its calibrated simulation.
//!
//! | cause | family | in the simulator | amplitudes | proved by |
//! |---|---|---|---|---|
//! | `cohesion` | attraction | parameter `cohesion`, more | 0.3, 0.6, 1.2 | drying |
//! | `humidity` | attraction | liquid bridges | 0.25, 0.5, 1 | drying |
//! | `consolidation` | attraction | bond number of an ageing contact | 2, 4, 8 | waiting |
//! | `stickiness` | attraction | the same bond number between ageing contacts and at the spoon | 1, 3, 6 | drying |
//! | `shape` | shape | rotation 1 and rolling friction | 0.2, 0.5, 1 | a microscope |
//! | `size_spread` | sizes | SD of the logarithm of the radii | 0.1, 0.2, 0.3 | a sieve |
//! | `spoon_adhesion` | spoon | bond number of grains to the spoon | 1, 3, 6 | another spoon |
//! | `charge` | spoon | bond number by image charges | 1, 3, 6 | an ioniser |
//! | `spoon_holdup` | spoon | share of grains that stay on the spoon | 0.1, 0.3, 0.6 | weighing the emptied spoon |
//! | `spoon_friction` | spoon | Coulomb coefficient of the spoon, more | 0.2, 0.4, 0.8 | another spoon |
//! | `gravity_scale` | motion | parameter `gravity_scale`, more or less | -0.4, -0.2, 0.2 | earth's is 1 |
//! | `actuator` | motion | strokes shorter than recorded, share missing | 0.2, 0.4, 0.6 | a rule at the spoon |
//! | `fill_level` | filling | a spoon filled with less, share missing | 0.2, 0.4, 0.6 | weighing the full spoon |
//!
//! Amplitudes are equally probable a priori, up to the last, which is the largest that the
//! simulator takes or about the largest reported of powders that are handled at all; so are the
//! causes. What changes a heap as well is compensated by friction so that the angle stays as
//! measured, as far as friction can.

use super::ask::Change;
pub use crate::report::spoon::SpoonCause;
use flip_core::domain::conditions::Patch;

/// Number of amplitudes of each cause.
pub(super) const AMPLITUDES: usize = 3;

impl SpoonCause {
    /// The catalogue.
    pub const ALL: [Self; 13] = [
        Self::Cohesion,
        Self::Humidity,
        Self::Consolidation,
        Self::Stickiness,
        Self::Shape,
        Self::SizeSpread,
        Self::SpoonAdhesion,
        Self::Charge,
        Self::SpoonHoldup,
        Self::SpoonFriction,
        Self::GravityScale,
        Self::Actuator,
        Self::FillLevel,
    ];

    /// Name in reports, and the family within which causes look alike.
    pub fn name(self) -> (&'static str, &'static str) {
        match self {
            Self::Cohesion => ("cohesion", "attraction"),
            Self::Humidity => ("humidity", "attraction"),
            Self::Consolidation => ("consolidation", "attraction"),
            Self::Stickiness => ("stickiness", "attraction"),
            Self::Shape => ("shape", "shape"),
            Self::SizeSpread => ("size_spread", "sizes"),
            Self::SpoonAdhesion => ("spoon_adhesion", "spoon"),
            Self::Charge => ("charge", "spoon"),
            Self::SpoonHoldup => ("spoon_holdup", "spoon"),
            Self::SpoonFriction => ("spoon_friction", "spoon"),
            Self::GravityScale => ("gravity_scale", "motion"),
            Self::Actuator => ("actuator", "motion"),
            Self::FillLevel => ("fill_level", "filling"),
        }
    }

    /// The amplitudes that are simulated, in order from none.
    pub fn amplitudes(self) -> [f64; AMPLITUDES] {
        match self {
            Self::Cohesion => [0.3, 0.6, 1.2],
            Self::Humidity => [0.25, 0.5, 1.0],
            Self::Consolidation => [2.0, 4.0, 8.0],
            Self::Shape => [0.2, 0.5, 1.0],
            Self::SizeSpread => [0.1, 0.2, 0.3],
            Self::Stickiness | Self::SpoonAdhesion | Self::Charge => [1.0, 3.0, 6.0],
            Self::SpoonHoldup => [0.1, 0.3, 0.6],
            Self::SpoonFriction => [0.2, 0.4, 0.8],
            Self::GravityScale => [-0.4, -0.2, 0.2],
            Self::Actuator | Self::FillLevel => [0.2, 0.4, 0.6],
        }
    }

    /// Whether a heap knows of it.
    pub fn moves_heaps(self) -> bool {
        !matches!(self.name().1, "spoon" | "filling") && self != Self::Actuator
            || self == Self::Charge
    }

    /// Whether nodes next to each other continue one another from zero: gravity has two sides.
    pub(super) fn is_continuous(self) -> bool {
        self != Self::GravityScale
    }

    /// What it changes.
    pub fn change(self, amplitude: f64) -> Change {
        let usual = Change::default();
        let grains = |pairs: &[(&str, f64)]| Change {
            patch: Patch { amplitudes: named(pairs), ..Patch::default() },
            ..Change::default()
        };
        let parameter = |name| Change {
            patch: Patch { parameters: named(&[(name, amplitude)]), ..Patch::default() },
            ..Change::default()
        };
        match self {
            Self::Cohesion => parameter("cohesion"),
            Self::GravityScale => parameter("gravity_scale"),
            Self::Shape => grains(&[("rotation", 1.0), ("rolling_friction", amplitude)]),
            Self::Stickiness => {
                grains(&[("consolidation", amplitude), ("spoon_adhesion", amplitude)])
            }
            Self::SpoonHoldup => grains(&[("hold_up", amplitude)]),
            Self::SpoonFriction => Change { spoon_friction: amplitude, ..usual },
            Self::Actuator => Change { stroke: 1.0 - amplitude, ..usual },
            Self::FillLevel => Change { fill: 1.0 - amplitude, ..usual },
            Self::Humidity
            | Self::Consolidation
            | Self::SizeSpread
            | Self::SpoonAdhesion
            | Self::Charge => grains(&[(self.name().0, amplitude)]),
        }
    }

    /// The experiment that would prove it.
    pub fn experiment(self) -> &'static str {
        match self {
            Self::Cohesion | Self::Humidity | Self::Stickiness => {
                "Dry part of the powder for a day, make the same spoonfuls of both on one day, and compare the pitch at which they begin to flow."
            }
            Self::Consolidation => {
                "Fill the spoon and begin at once, and again after ten minutes: ageing contacts begin to flow later."
            }
            Self::Shape => {
                "Look at grains under a microscope, and make the same spoonfuls of round grains of this size."
            }
            Self::SizeSpread => "Sieve the powder and make the same spoonfuls of the middle sizes.",
            Self::SpoonAdhesion | Self::SpoonFriction => {
                "Make the same spoonfuls with a polished metal spoon of this shape."
            }
            Self::Charge => "Make the same spoonfuls with an ioniser on and off.",
            Self::SpoonHoldup => {
                "Empty the spoon as far as it goes and weigh it against the clean spoon."
            }
            Self::GravityScale => {
                "Calibrate the powder again with gravity_scale fixed at 1: no bench has another."
            }
            Self::Actuator => {
                "Film the spoon beside a rule and compare its strokes with the commanded ones."
            }
            Self::FillLevel => "Weigh the spoon before and after filling it.",
        }
    }
}

fn named(pairs: &[(&str, f64)]) -> std::collections::BTreeMap<String, f64> {
    pairs.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_core::domain::parameters::ParameterSet;
    use flip_sim::mechanisms::Extensions;

    #[test]
    fn every_cause_is_something_that_the_simulator_has_and_changes() {
        for cause in SpoonCause::ALL {
            for amplitude in cause.amplitudes() {
                let change = cause.change(amplitude);
                assert_ne!(change, Change::default(), "{cause:?}");
                let none = Extensions::default();
                let asked = change.patch.amplitudes.len();
                let mut extended = none.patched(&change.patch).unwrap();
                let given = extended.amplitudes().iter().filter(|it| *it.1 != 0.0).count();
                assert_eq!(given, asked, "{cause:?} {amplitude}");
                // Not capped: a capped amplitude would be another than the one reported.
                for (name, value) in &change.patch.amplitudes {
                    assert!(none.with(name, *value).is_ok(), "{name} {value}");
                }
            }
            let names = SpoonCause::ALL.iter().filter(|it| it.name().0 == cause.name().0);
            assert_eq!(names.count(), 1);
        }
        let cohesive = SpoonCause::Cohesion.change(0.6).patch.powder(&ParameterSet::default());
        assert_eq!(cohesive.cohesion(), 0.6);
    }
}
