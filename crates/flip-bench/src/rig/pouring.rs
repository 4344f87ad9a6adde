//! What a dose needs.

use crate::weigh::earlier::Expected;
use crate::weigh::{self, Accuracy, Order};
use flip_core::domain::bench_check::ShakeCalibration;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::vial::PanCheck;
use flip_core::domain::weighing::Probe;
use flip_policy::{Controller, Rules};
use flip_sim::{balance, dispense};
use serde::{Deserialize, Serialize};

/// What to weigh, and what decides each step.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Task {
    /// The ordered dose.
    pub order: Order,
    /// Known accuracy of the balance, and how accurate the mass must be.
    pub accuracy: Accuracy,
    /// The controller that chooses the actions.
    pub controller: Controller,
    /// The rules that the controller was made for.
    pub rules: Rules,
}

impl Task {
    /// Smallest net mass that may be weighed at the requested accuracy, mg.
    pub fn minimum_mg(&self) -> f64 {
        let s = weigh::repeatability_mg(&self.accuracy, self.order.readability_mg);
        weigh::minimum_weight_mg(s, self.accuracy.class_pct / 100.0)
    }
}

/// The simulated powder, spoon and balance. A dose on them follows from these, its [`Task`] and
/// nothing else.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Simulation {
    /// The powder.
    pub set: ParameterSet,
    /// The spoon; its pitch range is narrowed by that of the rules.
    pub spoon: dispense::Settings,
    /// The balance.
    pub balance: balance::Settings,
    /// Seed.
    pub seed: u64,
}

impl Simulation {
    pub(super) fn spoon_for(&self, rules: &Rules) -> dispense::Settings {
        dispense::Settings { pitch: rules.pitch.within(self.spoon.pitch), ..self.spoon }
    }
}

/// One dose on any rig.
#[derive(Debug, Clone)]
pub struct Pouring {
    /// What to weigh, and how.
    pub task: Task,
    /// The powder, where it is simulated.
    pub simulation: Simulation,
    /// The arm's actual shakes against the commanded ones, if measured.
    pub shakes: Option<ShakeCalibration>,
    /// What is expected of the powder.
    pub expected: Expected,
    /// What the spoon holds of the powder, mg, if known.
    pub spoon_mg: Option<f64>,
    /// The check of the display before anything moves.
    pub pan: PanCheck,
    /// Probe the powder instead of dosing it.
    pub probe: Option<Probe>,
}
