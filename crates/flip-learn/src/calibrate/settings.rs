//! Settings of a calibration.

use super::space::Space;
use super::trial::Phase;
use flip_core::domain::{FieldError, bounded};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// How parameter sets are searched for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Reads sets off one emulator of the angle, shared by all calibrations, and verifies them.
    Emulator,
    /// Algorithm 1 of the publication: Bayesian optimisation of the error within shrinking bounds.
    Paper,
    /// Bayesian optimisation of the angle for one powder alone, with verification and diversity.
    #[default]
    Sequential,
}

impl Method {
    /// The name used in JSON and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Emulator => "emulator",
            Self::Paper => "paper",
            Self::Sequential => "sequential",
        }
    }
}

/// Settings of one calibration; stored with the job and the result. [`Settings::of`] has a method's
/// defaults.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// How parameter sets are searched for.
    pub method: Method,
    /// Parameter sets wanted, 1 to 100. Default 10 (the paper's).
    pub sets: u32,
    /// Largest accepted |AoR simulated - AoR measured|, degrees, 0.1 to 10. Default 1.5 (the
    /// paper's); 0.5 with the emulator.
    pub tolerance_deg: f64,
    /// Maximum number of simulations, search and verification together, 1 to 20 000. Default 150
    /// (the paper needed 52 to 150 per powder). With the published method, which verifies
    /// afterwards, it limits the search alone; with the emulator, which searches little, the
    /// default is three times what the verification of all sets takes, and at least 300.
    pub trials_max: u32,
    /// Space-filling simulations before the first fit, 2 to 500. Default 6: on an emulator of 456
    /// simulated heaps, five powders and eight seeds, ten sets took 46.0 simulations with 6, 46.7
    /// with 4, 47.1 with 8 and 47.6 with 10.
    pub initial: u32,
    /// Simulations proposed together, 1 to 32; they can run in parallel. Fixed, rather than the
    /// number of threads, so that the result does not depend on the machine. Default 4; the
    /// published method proposes one.
    pub batch: u32,
    /// Fresh simulations that verify each candidate, with seeds not used in the search, 1 to 50.
    /// Default 2; 8 with the emulator and the published method.
    pub verify_repeats: u32,
    /// Readings of each of these heaps, 1 to 64: see `sim/repose.rs`. Default 1; 4 with the
    /// emulator and the published method, as in the emulator's own heaps: later readings are a
    /// little steeper than the first.
    pub readings: u32,
    /// Error below which the published method accepts a set, degrees, 0.1 to 10; it ends when it
    /// has enough of them. Default 1 (the paper's).
    pub accept_deg: f64,
    /// Iterations after which the published method shrinks its bounds, 1 to 1000. Default 100 (the
    /// paper's).
    pub stagnation: u32,
    /// Seed of every random choice and, derived from it, of every simulation. Default 1.
    pub seed: u64,
    /// Grains in each simulated heap, 100 to 100 000; the caller passes it to the simulator.
    /// Default 2000.
    pub particles: u32,
    /// Grains in each heap that verifies a set, 100 to 100 000; default as in the other heaps.
    /// Heaps of more grains are flatter: the emulator learns by how much and compensates. Not for
    /// the method `sequential`, whose own process would mix up the two sizes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub verify_particles: Option<u32>,
    /// Most points of which the emulator is unsure and one heap is poured before the heaps that verify
    /// it: fewer heaps in all, and one more wait. Default 10; 0 on a graphics card, on which one heap
    /// takes as long as eighty.
    #[serde(skip_serializing_if = "is_usual")]
    pub tried_first: u32,
    /// Parameters that are not searched, by key with the value at which they are held, each within
    /// its published bounds. Default none: all nine are searched.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub fixed: BTreeMap<String, f64>,
}

/// See [`Settings::tried_first`].
const TRIED_FIRST: u32 = 10;

#[allow(clippy::trivially_copy_pass_by_ref)] // serde hands a reference.
fn is_usual(tried_first: &u32) -> bool {
    *tried_first == TRIED_FIRST
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            method: Method::Sequential,
            sets: 10,
            tolerance_deg: 1.5,
            trials_max: 150,
            initial: 6,
            batch: 4,
            verify_repeats: 2,
            readings: 1,
            accept_deg: 1.0,
            stagnation: 100,
            seed: 1,
            particles: 2000,
            verify_particles: None,
            tried_first: TRIED_FIRST,
            fixed: BTreeMap::new(),
        }
    }
}

impl Settings {
    /// The defaults of a method.
    pub fn of(method: Method) -> Self {
        let default = Self { method, ..Self::default() };
        match method {
            Method::Sequential => default,
            Method::Paper => Self { verify_repeats: 8, readings: 4, batch: 1, ..default },
            Method::Emulator => Self {
                tolerance_deg: 0.5,
                trials_max: 300,
                verify_repeats: 8,
                readings: 4,
                ..default
            },
        }
    }

    /// Default maximum number of simulations for these settings: see `trials_max`.
    pub fn budget(&self) -> u32 {
        match self.method {
            Method::Emulator => {
                self.sets.saturating_mul(self.verify_repeats).saturating_mul(3).clamp(300, 20_000)
            }
            Method::Paper | Method::Sequential => self.trials_max,
        }
    }

    /// Whether [`Settings::tried_first`] is the default.
    pub fn tries_as_usual(&self) -> bool {
        is_usual(&self.tried_first)
    }

    /// Number of grains in the heaps of a phase.
    pub fn particles_of(&self, phase: Phase) -> u32 {
        match phase {
            Phase::Search => self.particles,
            Phase::Verification => self.verify_particles.unwrap_or(self.particles),
        }
    }

    /// The searched part of the box.
    ///
    /// # Errors
    /// As [`Space::of`].
    pub fn space(&self) -> Result<Space, FieldError> {
        Space::of(&self.fixed)
    }

    /// Validates the settings.
    ///
    /// # Errors
    /// The first setting that is out of bounds, by name.
    pub fn checked(self) -> Result<Self, FieldError> {
        let count = |field, value: u32, lower: u32, upper: u32| match (lower..=upper)
            .contains(&value)
        {
            true => Ok(()),
            false => {
                Err(FieldError::new(field, format!("must be from {lower} to {upper}, got {value}")))
            }
        };
        count("sets", self.sets, 1, 100)?;
        bounded("tolerance_deg", self.tolerance_deg, 0.1, 10.0, "deg")?;
        count("trials_max", self.trials_max, 1, 20_000)?;
        count("initial", self.initial, 2, 500)?;
        count("batch", self.batch, 1, 32)?;
        count("verify_repeats", self.verify_repeats, 1, 50)?;
        count("readings", self.readings, 1, 64)?;
        bounded("accept_deg", self.accept_deg, 0.1, 10.0, "deg")?;
        count("stagnation", self.stagnation, 1, 1000)?;
        count("particles", self.particles, 100, 100_000)?;
        self.space()?;
        if let Some(particles) = self.verify_particles {
            count("verify_particles", particles, 100, 100_000)?;
            if self.method == Method::Sequential {
                let advice = "is not for the method `sequential`: leave it out, or take the method `emulator`";
                return Err(FieldError::new("verify_particles", advice));
            }
        }
        Ok(self)
    }
}
