//! A complete emulated laboratory: balance, arm, gripper and gate around one vial, each on its own
//! wire.

use super::arm::{self, Arm, Spoon as Powder};
use super::balance::{self, Balance, Socket};
use super::gate::{self, EmulatedGate, Slide};
use super::gripper::{EmulatedGripper, Fingers};
use super::pan::Pan;
use super::port::Port;
use crate::hardware::bench_file::{ArmAddress, BenchFile, PortAddress, Readings};
use crate::hardware::clock::Clock;
use flip_core::domain::spoon::Spoon;
use serde::{Deserialize, Serialize};

/// Longest time of a motion, wall-clock s: a simulated one takes long on a busy machine.
const MOTION_S: f64 = 120.0;

/// Settings of a laboratory.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// The balance.
    pub balance: balance::Settings,
    /// The arm.
    pub arm: arm::Settings,
    /// An empty vial.
    pub vial: Vial,
    /// FLIP's reading settings.
    pub readings: Readings,
    /// FLIP bases its expectations of a powder on earlier doses, as it does on devices. Default
    /// false: a dose depends only on its seed.
    pub remembers: bool,
    /// Seed of the [mechanism](super::hidden::Hidden) hidden in the powder. Default 0: none.
    pub hidden: u64,
}

/// A vial.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vial {
    /// Its mass, mg.
    pub mass_mg: f64,
}

impl Default for Vial {
    /// About twelve grams, like one of 20 ml.
    fn default() -> Self {
        Self { mass_mg: 12_000.0 }
    }
}

/// A running laboratory. Every plug is pulled when it is dropped.
pub struct Laboratory {
    settings: Settings,
    pan: Pan,
    /// The balance under the vial.
    pub balance: Balance,
    /// The arm with the spoon.
    pub arm: Arm,
    /// The fingers that hold the spoon.
    pub fingers: Fingers,
    /// The gate under the funnel.
    pub slide: Slide,
    gripper: Port,
    gate: Port,
}

impl Laboratory {
    /// Connect everything; the spoon belongs to the powder.
    ///
    /// # Errors
    /// The system has no pseudo-terminal, port or thread left.
    pub fn start(
        settings: Settings,
        clock: Clock,
        spoon: Box<dyn Powder>,
    ) -> std::io::Result<Self> {
        let pan = Pan::holding(settings.vial.mass_mg, clock.clone());
        let balance = Balance::start(settings.balance.clone(), pan.clone(), Socket::Pty)?;
        let arm = Arm::start(settings.arm, pan.clone(), spoon)?;
        let fingers = Fingers::holding(clock.clone());
        let gripper = Port::pty(EmulatedGripper::new(fingers.clone()))?;
        let slide = Slide::new(gate::Settings::default(), clock);
        let gate = Port::pty(EmulatedGate::new(slide.clone()))?;
        Ok(Self { settings, pan, balance, arm, fingers, slide, gripper, gate })
    }

    /// The bench file through which FLIP finds the devices.
    pub fn file(&self) -> BenchFile {
        let Settings { balance, .. } = &self.settings;
        let address = |port: &Port| Some(PortAddress { port: port.address().to_owned() });
        BenchFile {
            balance: balance.found_at(self.balance.address()),
            arm: ArmAddress { url: self.arm.url().to_owned(), motion_s: Some(MOTION_S) },
            spoon: Spoon::default(),
            gripper: address(&self.gripper),
            gate: address(&self.gate),
            readings: Readings { noise_mg: balance.noise_mg, ..self.settings.readings },
            vial: None,
        }
    }

    /// Put an empty vial on the balance, and another spoon into the arm's hand.
    pub fn prepare(&self, spoon: Box<dyn Powder>) {
        self.pan.add_mg(self.settings.vial.mass_mg - self.pan.final_load_mg());
        self.arm.set_spoon(spoon);
    }

    /// Powder in the vial, mg, which no balance shows.
    pub fn dispensed_mg(&self) -> f64 {
        self.pan.final_load_mg() - self.settings.vial.mass_mg
    }

    /// The load on the balance.
    pub fn pan(&self) -> &Pan {
        &self.pan
    }
}
