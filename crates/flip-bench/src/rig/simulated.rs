//! The simulator, called directly.

use super::{OnEvent, Poured, Pouring, Rig, Simulation, Task};
use crate::hardware::DeviceError;
use crate::hardware::simulated::SimulatedBench;
use crate::weigh::{Settings, weigh};
use flip_core::domain::apparatus::Stroke;
use flip_core::domain::bench::{BenchKind, SHAKE_MM_MAX};
use flip_core::domain::weighing::Probe;
use flip_sim::balance;
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

fn carry_out(
    task: &Task,
    simulation: &Simulation,
    probe: Option<Probe>,
    on_event: OnEvent<'_>,
    stop: &AtomicBool,
) -> Poured {
    let Simulation { set, balance, seed, .. } = simulation;
    let spoon = simulation.spoon_for(&task.rules);
    let mut bench = SimulatedBench::new(set, &spoon, balance, *seed);
    let settings = Settings { accuracy: task.accuracy, probe, ..Settings::EPISODE };
    let Task { controller, rules, order, .. } = task;
    let weighed = weigh(&mut bench, controller, rules, order, &settings, on_event, stop);
    // A simulated spoon makes the strokes that it is asked for.
    let stroke = Stroke { shake_mm_max: SHAKE_MM_MAX, limits: spoon.shake, response: None };
    Poured { stroke: Some(stroke), ..Poured::of(weighed, Some(bench.vial_mg())) }
}
