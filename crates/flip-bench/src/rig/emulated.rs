//! A laboratory emulated in this process, around the simulator.

use super::devices::dose;
use super::wires::Wires;
use super::{OnEvent, PileStand, Poured, Pouring, Rig};
use crate::emulate::balance;
use crate::emulate::hidden::{self, Hidden};
use crate::emulate::lab::{self, Laboratory};
use crate::hardware::DeviceError;
use crate::hardware::clock::Clock;
use crate::hardware::wire::Exchange;
use flip_core::domain::bench::BenchKind;
use flip_sim::dispense;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// A new laboratory for each dose. Its time is virtual, so a dose is quick and deterministic.
pub struct Emulated {
    settings: lab::Settings,
    wires: Arc<Wires>,
    stand: PileStand,
}

impl Emulated {
    /// Laboratories with these settings.
    pub fn new(settings: lab::Settings) -> Self {
        let wires = Arc::<Wires>::default();
        let stand = PileStand::emulated(settings.clone(), wires.clone());
        Self { settings, wires, stand }
    }
}

impl Rig for Emulated {
    fn kind(&self) -> BenchKind {
        BenchKind::Emulated
    }

    fn exchanges_vials(&self) -> bool {
        true
    }

    fn pour(&self, pouring: &Pouring, on_event: OnEvent<'_>, stop: &AtomicBool) -> Poured {
        let clock = Clock::standing();
        let simulation = &pouring.simulation;
        let usual = simulation.spoon_for(&pouring.task.rules);
        // The powder is shaken as the arm moves, whatever it was simulated with.
        let shaken = dispense::Settings { shake: self.settings.arm.executed(), ..usual };
        let hidden = Hidden::drawn(self.settings.hidden);
        let spoon = hidden::spoon(hidden, &simulation.set, &shaken, simulation.seed);
        let balance = balance::Settings { seed: simulation.seed, ..self.settings.balance.clone() };
        let settings = lab::Settings { balance, ..self.settings.clone() };
        // A bench with uncalibrated shakes executes less than it is commanded, and the gentlest
        // shakes not at all: the spoon then climbs unshaken and releases the powder all at once.
        // This arm's shakes are known.
        let shakes = pouring.shakes.clone().or_else(|| settings.arm.shakes());
        let pouring = Pouring { shakes, ..pouring.clone() };
        match Laboratory::start(settings, clock.clone(), spoon) {
            Ok(laboratory) => {
                let poured = dose(&self.wires, &laboratory.file(), clock, &pouring, on_event, stop);
                Poured { dispensed_mg: Some(laboratory.dispensed_mg()), ..poured }
            }
            Err(error) => {
                Poured::not_begun(format!("the emulated laboratory cannot be set up: {error}"))
            }
        }
    }

    fn halt(&self) -> Result<(), DeviceError> {
        self.wires.halt()
    }

    fn devices(&self) -> BTreeMap<String, String> {
        self.wires.devices()
    }

    fn exchanges(&self) -> Vec<Exchange> {
        self.wires.recorder.take()
    }

    fn readability_mg(&self) -> Option<f64> {
        Some(self.settings.balance.readability_mg)
    }

    fn fills_spoon(&self) -> bool {
        self.settings.arm.scoops
    }

    fn remembers(&self) -> bool {
        self.settings.remembers
    }

    fn stand(&self) -> Option<&PileStand> {
        Some(&self.stand)
    }
}
