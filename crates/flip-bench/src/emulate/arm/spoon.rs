//! The spoon of an emulated arm: what falls from it, under any model.

use flip_core::domain::bench::Action;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_sim::dispense::{Dispenser, Settings};

/// Powder released by one motion.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pour {
    /// Mass that falls through the vial's mouth if the spoon is over it, mg.
    pub mass_mg: f64,
}

/// A spoon with powder in it.
pub trait Spoon: Send {
    /// Carry out one action, pitch first; the amplitude is the executed one.
    fn step(&mut self, action: Action) -> Pour;

    /// Take back this much of the powder released by the last step, mg: the motion was ended. It
    /// stays in the spoon and does not fall later.
    fn keep(&mut self, mass_mg: f64);

    /// Fill the level spoon from the container.
    fn refill(&mut self);

    /// Return the remaining powder to the container.
    fn empty(&mut self);

    /// Pitch, degrees, positive is tip down.
    fn pitch_deg(&self) -> f64;

    /// Powder in it, mg.
    fn held_mg(&self) -> f64;
}

/// A spoon whose powder is simulated: seconds of CPU time per dose. Empty until it is filled.
pub struct GrainsSpoon {
    set: ParameterSet,
    settings: Settings,
    seed: u64,
    /// Number of fills.
    fills: u64,
    full: Option<Dispenser>,
    /// Pitch while it is empty.
    pitch_deg: f64,
    kept_mg: f64,
}

impl GrainsSpoon {
    /// An empty spoon for this powder; each fill has its own seed.
    pub fn new(set: &ParameterSet, settings: &Settings, seed: u64) -> Self {
        Self {
            set: *set,
            settings: *settings,
            seed,
            fills: 0,
            full: None,
            pitch_deg: 0.0,
            kept_mg: 0.0,
        }
    }
}

impl Spoon for GrainsSpoon {
    fn step(&mut self, action: Action) -> Pour {
        match &mut self.full {
            Some(grains) => Pour { mass_mg: grains.step(action).vial_mg },
            None => {
                self.pitch_deg += action.incline_change_deg;
                Pour::default()
            }
        }
    }

    fn keep(&mut self, mass_mg: f64) {
        self.kept_mg += mass_mg;
    }

    fn refill(&mut self) {
        self.full =
            Some(Dispenser::new(&self.set, &self.settings, derive(self.seed, &[self.fills])));
        self.fills += 1;
        self.kept_mg = 0.0;
    }

    fn empty(&mut self) {
        self.pitch_deg = self.pitch_deg();
        self.full = None;
        self.kept_mg = 0.0;
    }

    fn pitch_deg(&self) -> f64 {
        self.full.as_ref().map_or(self.pitch_deg, Dispenser::pitch_deg)
    }

    fn held_mg(&self) -> f64 {
        self.full.as_ref().map_or(0.0, Dispenser::spoon_mg) + self.kept_mg
    }
}
