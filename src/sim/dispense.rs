//! The dosing experiment: a filled spoon over a vial, one action at a time.

use crate::domain::bench::{Action, PitchLimits};
use crate::domain::parameters::ParameterSet;
use serde::{Deserialize, Serialize};

/// Settings of the spoon and its motion; stored with every result.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = SpoonSettings)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Grains in the spoon at the start.
    pub particles: u32,
    /// Range of the pitch.
    pub pitch: PitchLimits,
}

impl Default for Settings {
    fn default() -> Self {
        Self { particles: 2500, pitch: PitchLimits::WIDE }
    }
}

/// What one action did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Poured {
    /// Mass that fell into the vial during the action, mg.
    pub vial_mg: f64,
    /// Mass that missed the vial, mg.
    pub spilled_mg: f64,
    /// Time of the motion and of the powder coming to rest, s.
    pub duration_s: f64,
}

/// A spoon filled with a simulated powder over a vial. Clone it to replay from the same heap.
#[derive(Debug, Clone)]
pub struct Dispenser {
    set: ParameterSet,
    settings: Settings,
    seed: u64,
    steps: u64,
    pitch_deg: f64,
    spoon_mg: f64,
    vial_mg: f64,
}

impl Dispenser {
    /// Fill the level spoon and let the powder rest (about a second of CPU; clone to reuse).
    pub fn new(set: &ParameterSet, settings: &Settings, seed: u64) -> Self {
        let spoon_mg = capacity_mg(set, settings);
        Self { set: *set, settings: *settings, seed, steps: 0, pitch_deg: 0.0, spoon_mg, vial_mg: 0.0 }
    }

    /// Carry out one action, until the powder rests. Pitch is clamped to the limits.
    pub fn step(&mut self, action: Action) -> Poured {
        // Placeholder until the kernel lands: log-linear in tilt with noise, as the salt-tap data are.
        self.steps += 1;
        let limits = self.settings.pitch;
        self.pitch_deg = (self.pitch_deg + action.incline_change_deg).clamp(limits.lower_deg, limits.upper_deg);
        let noise = (crate::domain::seed::derive(self.seed, &[self.steps]) >> 11) as f64 / (1u64 << 53) as f64;
        let stiffness = 0.05 * 28.0 / (20.0 + 18.0 * self.set.friction());
        let mean = action.executed_shake_mm() * 0.04 * (stiffness * self.pitch_deg).exp();
        let poured = (mean * (0.5 + noise)).min(self.spoon_mg);
        self.spoon_mg -= poured;
        self.vial_mg += poured;
        Poured { vial_mg: poured, spilled_mg: 0.0, duration_s: 0.6 }
    }

    /// Bring the spoon back to level.
    pub fn level(&mut self) -> Poured {
        self.pitch_deg = 0.0;
        Poured { vial_mg: 0.0, spilled_mg: 0.0, duration_s: 0.3 }
    }

    /// Pitch now, degrees, positive is tip down.
    pub fn pitch_deg(&self) -> f64 {
        self.pitch_deg
    }
    /// Powder in the vial, mg: the truth, not the balance's reading.
    pub fn vial_mg(&self) -> f64 {
        self.vial_mg
    }
    /// Powder left in the spoon, mg.
    pub fn spoon_mg(&self) -> f64 {
        self.spoon_mg
    }
}

/// What a full spoon of this powder weighs, mg.
pub fn capacity_mg(set: &ParameterSet, settings: &Settings) -> f64 {
    f64::from(settings.particles) * set.particle_mass_ug() / 1000.0
}
