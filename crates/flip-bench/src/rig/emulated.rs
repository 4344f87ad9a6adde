//! A laboratory emulated in this process, around the simulator.

use super::devices::dose;
use super::wires::Wires;
use super::{OnEvent, Order, PileStand, Poured, Pouring, Rig, Shown, scale};
use crate::emulate::balance::{self, Socket};
use crate::emulate::hidden::{self, Hidden};
use crate::emulate::lab::{self, Laboratory};
use crate::emulate::pan::Pan;
use crate::hardware::DeviceError;
use crate::hardware::balance as driver;
use crate::hardware::clock::Clock;
use crate::hardware::wire::Exchange;
use flip_core::domain::bench::BenchKind;
use flip_sim::dispense;
use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};

/// A new laboratory for each dose. Its time is virtual, so a dose is quick and deterministic.
pub struct Emulated {
    settings: lab::Settings,
    wires: Arc<Wires>,
    stand: PileStand,
    /// Started by the first question to it.
    idle: Mutex<Option<Idle>>,
}

/// The balance between doses, with an empty vial on it.
struct Idle {
    _plugged: balance::Balance,
    settings: driver::Settings,
    clock: Clock,
}

impl Idle {
    fn start(settings: &lab::Settings) -> std::io::Result<Self> {
        let clock = Clock::standing();
        let pan = Pan::holding(settings.vial.mass_mg, clock.clone());
        let balance = balance::Balance::start(settings.balance.clone(), pan, Socket::Pty)?;
        let settings = settings.balance.found_at(balance.address());
        Ok(Self { _plugged: balance, settings, clock })
    }
}

impl Emulated {
    /// Laboratories with these settings.
    pub fn new(settings: lab::Settings) -> Self {
        let wires = Arc::<Wires>::default();
        let stand = PileStand::emulated(settings.clone(), wires.clone());
        Self { settings, wires, stand, idle: Mutex::default() }
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

    fn balance(&self, order: Order) -> Result<Shown, DeviceError> {
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        let idle = match &mut *idle {
            Some(idle) => idle,
            none => none.insert(Idle::start(&self.settings).map_err(|error| {
                let cause = format!("the emulated balance cannot be set up: {error}");
                DeviceError::Faulted { device: "the balance", cause }
            })?),
        };
        let noise_mg = self.settings.balance.noise_mg;
        scale::order(&self.wires, &idle.settings, noise_mg, idle.clock.clone(), order)
    }

    fn remembers(&self) -> bool {
        self.settings.remembers
    }

    fn stand(&self) -> Option<&PileStand> {
        Some(&self.stand)
    }
}
