//! Settled spoonfuls, from which spoons on a card are filled.

use crate::layout::{self, Kernel};
use flip_sim::dispense::Dispenser;
use flip_sim::dispense::outside::Spoon;

/// Most grains of a spoon on a card.
pub const GRAINS_MAX: usize = layout::GRAINS;

/// A filled spoon at rest, ready for a card.
#[derive(Debug, Clone)]
pub struct Bed {
    pub(crate) shape: Spoon,
    pub(crate) law: Vec<u32>,
    pub(crate) image: Vec<u32>,
    pub(crate) grains: u32,
    /// Of all grains, relative to a mean one.
    pub(crate) mass: f64,
    pub(crate) pitch_deg: f64,
}

/// Why a spoon cannot go onto a card: too many grains, or too many contacts of one grain.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "a spoon on a card has at most 2560 grains with 32 contacts each, this one has {0} grains; use the CPU"
)]
pub struct TooMany(pub usize);

impl Bed {
    /// Takes the spoon as it is.
    ///
    /// # Errors
    /// [`TooMany`]
    pub fn of(dispenser: &Dispenser) -> Result<Self, TooMany> {
        let shape = dispenser.spoon();
        let state = dispenser.state();
        let grains = state.grains.len();
        let image = layout::image(Kernel::of(&shape), &state).ok_or(TooMany(grains))?;
        Ok(Self {
            law: layout::law(&shape),
            mass: state.grains.iter().map(|grain| shape.mass(grain.id)).sum(),
            shape,
            image,
            grains: grains as u32,
            pitch_deg: dispenser.pitch_deg(),
        })
    }

    pub(crate) fn kernel(&self) -> Kernel {
        Kernel::of(&self.shape)
    }

    /// Grains in it.
    pub fn grains(&self) -> u32 {
        self.grains
    }

    /// Powder in it, mg.
    pub fn mg(&self) -> f64 {
        self.mass * self.shape.grain_mg
    }
}
