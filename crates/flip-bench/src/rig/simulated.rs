//! The simulator, called directly.

use super::{OnEvent, Poured, Pouring, Rig, Simulation, Task};
use crate::hardware::DeviceError;
use crate::hardware::simulated::{SimulatedBench, bed_seed};
use crate::weigh::{Settings, weigh};
use flip_core::domain::apparatus::Stroke;
use flip_core::domain::bench::{BenchKind, SHAKE_MM_MAX};
use flip_core::domain::weighing::Probe;
use flip_policy::Rules;
use flip_sim::balance;
use flip_sim::batch::Filled;
use flip_sim::dispense::Dispenser;
use std::sync::atomic::AtomicBool;

/// A rig without devices. A dose runs as in training: no watching, no forecast.
#[derive(Debug, Clone, Copy, Default)]
pub struct Simulated;

impl Rig for Simulated {
    fn kind(&self) -> BenchKind {
        BenchKind::Simulated
    }

    fn exchanges_vials(&self) -> bool {
        true
    }

    fn pour(&self, pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool) -> Poured {
        carry_out(&pouring.task, &pouring.simulation, pouring.probe, on_event, stop)
    }

    /// The flag is enough: no motion takes time.
    fn halt(&self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn readability_mg(&self) -> Option<f64> {
        Some(balance::Settings::default().readability_mg)
    }
}

/// One dose on the simulator.
pub fn simulate(
    task: &Task,
    simulation: &Simulation,
    on_event: OnEvent<'_>,
    stop: &AtomicBool,
) -> Poured {
    carry_out(task, simulation, None, on_event, stop)
}

/// One dose on the simulator from a spoon that holds [`Simulation::filled`]: with that of this
/// machine's cores the same dose as [`simulate`].
pub fn simulate_from(
    spoon: impl Filled,
    task: &Task,
    simulation: &Simulation,
    on_event: OnEvent<'_>,
    stop: &AtomicBool,
) -> Poured {
    dose(spoon, task, simulation, None, on_event, stop)
}

impl Simulation {
    /// The filled spoon of a dose under these rules (about half a second of CPU time).
    pub fn filled(&self, rules: &Rules) -> Dispenser {
        Dispenser::new(&self.set, &self.spoon_for(rules), bed_seed(self.seed))
    }

    /// The same before the powder has fallen ([`Dispenser::loose`]).
    pub fn loose(&self, rules: &Rules) -> Dispenser {
        Dispenser::loose(&self.set, &self.spoon_for(rules), bed_seed(self.seed))
    }
}

fn carry_out(
    task: &Task,
    simulation: &Simulation,
    probe: Option<Probe>,
    on_event: OnEvent<'_>,
    stop: &AtomicBool,
) -> Poured {
    dose(simulation.filled(&task.rules), task, simulation, probe, on_event, stop)
}

fn dose(
    spoon: impl Filled,
    task: &Task,
    simulation: &Simulation,
    probe: Option<Probe>,
    on_event: OnEvent<'_>,
    stop: &AtomicBool,
) -> Poured {
    let Simulation { balance, seed, .. } = simulation;
    let mut bench = SimulatedBench::with_spoon(spoon, balance, *seed);
    let settings = Settings { accuracy: task.accuracy, probe, ..Settings::EPISODE };
    let Task { controller, rules, order, .. } = task;
    let weighed = weigh(&mut bench, controller, rules, order, &settings, on_event, stop);
    // A simulated spoon makes the strokes that it is asked for.
    let limits = simulation.spoon_for(rules).shake;
    let stroke = Stroke { shake_mm_max: SHAKE_MM_MAX, limits, response: None };
    Poured { stroke: Some(stroke), ..Poured::of(weighed, Some(bench.vial_mg())) }
}
