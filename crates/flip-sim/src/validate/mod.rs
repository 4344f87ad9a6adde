//! The validation suite: physical laws that the simulator must obey, each with a number, its
//! allowed range and its source.
//!
//! One powder, one solver setting and one friction map serve every check: the default
//! [`ParameterSet`] (Coulomb coefficient 0.16 between grains, diameter 0.27 mm, no attraction), the
//! simulator's own substep, and two walls, [`SMOOTH`] and [`ROUGH`]. A check of a parameter changes
//! only that parameter; beds deeper than a heap are lighter, [`LIGHT`].
//!
//! | file | what it checks |
//! |---|---|
//! | `single` | exact laws of one and two grains |
//! | `discharge` | does a silo empty and bear load like a silo: Beverloo, Janssen |
//! | `collapse` | does a released column spread like sand |
//! | `packing` | how densely do poured grains lie |
//! | `heap` | is the angle of repose a property of the powder, and does a heap rest |
//! | `rotation` | grains that may roll |
//! | `tilt` | when does a bed at rest start to flow |
//! | `dose` | does what a spoon gives depend on the substep |
//!
//! Experiments are pure and independent of each other; a caller can run them in any order, on any
//! thread, and gets the same bytes.

mod collapse;
mod discharge;
mod dose;
mod engine;
mod heap;
mod packing;
mod rotation;
mod single;
mod tilt;

#[cfg(test)]
mod tests;

pub use dose::{Convergence, Difference, Level, Verdict};

use super::law::{Law, SUBSTEP_S};
use super::mechanisms::{Extensions, Site};
use super::repose::{Refusal, Repose, Settings, repose_under};
use flip_core::domain::parameters::ParameterSet;
use serde::Serialize;

/// Gravity scale of beds deeper than a heap. Their laws hold for hard grains of any weight, and
/// overlaps grow with the weight above: at full gravity a bed of eighty diameters would be a tenth
/// too dense.
const LIGHT: f64 = 0.3;
/// Coulomb coefficient of silo walls and inclines.
const SMOOTH: f64 = 0.4;
/// Coulomb coefficient of a base that grains stick to, as under the heaps of [`super::repose`].
const ROUGH: f64 = 0.8;

/// One law, with its measured value.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// Stable name.
    pub name: &'static str,
    /// Measured value in the simulator, in `unit`; NaN if the experiment failed.
    pub measured: f64,
    /// Value according to the law, or the middle of the allowed range.
    pub expected: f64,
    /// Largest difference between the two.
    pub tolerance: f64,
    /// Unit of the three numbers; empty if dimensionless.
    pub unit: &'static str,
    /// Whether `measured` is within `tolerance` of `expected`.
    pub passed: bool,
    /// Known reason for a miss, if it is no larger than documented.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub known_deviation: Option<KnownDeviation>,
    /// Source of the law and its range.
    pub source: &'static str,
    /// The same quantity at other substeps, if that is what the check is about.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub convergence: Option<Convergence>,
}

/// A documented deviation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct KnownDeviation {
    /// Largest documented distance from the allowed range, in the check's unit.
    pub miss: f64,
    /// Its cause.
    pub reason: &'static str,
}

/// Reason of a dose that the usual substep gets wrong.
const COARSE: &str = "a shortfall: at the usual substep the spoon gives another mass than at a quarter of it; `flip evaluate --substep-us` weighs at a finer one";
/// Reason of a dose of which it is not known.
const SCATTER: &str = "undecided: eight spoons scatter too much to show a difference as small as the goal, or its absence";

/// Checks that the simulator is known to miss, with the largest deviation and the reason.
const KNOWN: &[(&str, KnownDeviation)] = &[
    (
        "collapse_height_exponent",
        KnownDeviation {
            miss: 0.11,
            reason: "angular sand stands higher the taller the column was; spheres do not, see collapse_height_beads_exponent; missed with rotation too",
        },
    ),
    (
        "repose_funnel",
        KnownDeviation {
            miss: 0.35,
            reason: "grains that fall five diameters flatten the top of a heap that is only six high; missed with rotation too",
        },
    ),
    ("dose_free_flowing_4mm", KnownDeviation { miss: 0.69, reason: COARSE }),
    ("dose_free_flowing_8mm", KnownDeviation { miss: 1.84, reason: COARSE }),
    ("dose_free_flowing_steeper_4mm", KnownDeviation { miss: 0.62, reason: SCATTER }),
    ("dose_free_flowing_steeper_8mm", KnownDeviation { miss: 0.74, reason: COARSE }),
    ("dose_frictional_4mm", KnownDeviation { miss: 0.37, reason: COARSE }),
    ("dose_frictional_8mm", KnownDeviation { miss: 0.038, reason: SCATTER }),
    ("dose_frictional_steeper_4mm", KnownDeviation { miss: 3.39, reason: COARSE }),
    ("dose_frictional_steeper_8mm", KnownDeviation { miss: 1.85, reason: SCATTER }),
];

fn known(name: &str) -> Option<KnownDeviation> {
    KNOWN.iter().find(|(known, _)| *known == name).map(|(_, deviation)| *deviation)
}

impl Check {
    /// A quantity predicted by a law.
    fn near(
        name: &'static str,
        measured: f64,
        [expected, tolerance]: [f64; 2],
        unit: &'static str,
        source: &'static str,
    ) -> Self {
        let passed = (measured - expected).abs() <= tolerance;
        let mut check = Self {
            name,
            measured,
            expected,
            tolerance,
            unit,
            passed,
            known_deviation: None,
            source,
            convergence: None,
        };
        check.known_deviation =
            known(name).filter(|deviation| !passed && check.miss() <= deviation.miss);
        check
    }

    /// A quantity that must lie in a range.
    fn within(
        name: &'static str,
        measured: f64,
        [low, high]: [f64; 2],
        unit: &'static str,
        source: &'static str,
    ) -> Self {
        Self::near(name, measured, [0.5 * (low + high), 0.5 * (high - low)], unit, source)
    }

    /// Distance of the measured value from the allowed range, zero within it; NaN if the experiment
    /// failed.
    pub fn miss(&self) -> f64 {
        let beyond = (self.measured - self.expected).abs() - self.tolerance;
        if beyond < 0.0 { 0.0 } else { beyond }
    }

    /// Whether the suite may pass with this check: it holds, or its miss is documented.
    pub fn is_accounted_for(&self) -> bool {
        self.passed || self.known_deviation.is_some()
    }
}

/// The powder and the solver shared by all experiments.
#[derive(Debug, Clone)]
pub struct Suite {
    powder: ParameterSet,
    extensions: Extensions,
    /// Applied to every law used by an experiment, to inject a fault that a check must detect.
    revise: fn(Law) -> Law,
    /// What computes heaps and spoons, if not the caller's thread.
    on: Option<engine::On>,
}

impl Default for Suite {
    fn default() -> Self {
        Self::extended(Extensions::default())
    }
}

impl Suite {
    /// The same experiments with mechanisms added to the base simulator.
    pub fn extended(extensions: Extensions) -> Self {
        let revise = std::convert::identity;
        Self { powder: ParameterSet::default(), extensions, revise, on: None }
    }

    /// The same experiments under modified physics.
    #[cfg(test)]
    fn revised(revise: fn(Law) -> Law) -> Self {
        Self { revise, ..Self::default() }
    }

    /// The reference powder with some parameters changed.
    fn powder(&self, changes: &[(&str, f64)]) -> ParameterSet {
        changes.iter().fold(self.powder, |set, (key, value)| {
            set.with(key, *value).expect("a value within its bounds")
        })
    }

    /// The law of the reference powder against a wall of this Coulomb coefficient.
    fn law(&self, wall_friction: f64) -> Law {
        self.law_of(&self.powder, wall_friction)
    }

    /// The same for a deep bed.
    fn law_of_deep_bed(&self, wall_friction: f64) -> Law {
        self.law_of(&self.powder(&[("gravity_scale", LIGHT)]), wall_friction)
    }

    fn law_of(&self, powder: &ParameterSet, wall_friction: f64) -> Law {
        self.law_with(powder, wall_friction, SUBSTEP_S)
    }

    fn law_with(&self, powder: &ParameterSet, wall_friction: f64, substep_s: f64) -> Law {
        let law = Law::new(powder, wall_friction, substep_s);
        (self.revise)(law.extended(&self.extensions, powder, Site::Base))
    }

    /// The heap experiment of [`super::repose`].
    fn heap(
        &self,
        powder: &ParameterSet,
        settings: &Settings,
        seed: u64,
    ) -> Result<Repose, Refusal> {
        repose_under(
            self.law_with(powder, settings.base_friction, settings.substep_s),
            settings,
            seed,
        )
    }
}

/// An independent part of the suite: one scene or one family of scenes, and the checks derived from
/// it.
#[derive(Debug, Clone, Copy)]
pub struct Experiment {
    /// Stable name.
    pub name: &'static str,
    /// Names of its checks, in the order returned.
    pub checks: &'static [&'static str],
    run: fn(&Suite) -> Vec<Check>,
}

impl Experiment {
    /// Runs the experiment. Pure: the same suite gives the same bytes.
    pub fn run(&self, suite: &Suite) -> Vec<Check> {
        (self.run)(suite)
    }
}

/// All experiments, longest first.
pub fn experiments() -> Vec<Experiment> {
    [
        dose::EXPERIMENTS,
        collapse::EXPERIMENTS,
        heap::EXPERIMENTS,
        discharge::EXPERIMENTS,
        tilt::EXPERIMENTS,
        packing::EXPERIMENTS,
        rotation::EXPERIMENTS,
        single::EXPERIMENTS,
    ]
    .concat()
}
