//! Spoons and heaps of simulated powder on a graphics card, many at once.
//!
//! The physics is that of [`flip_sim`], whose theory the kernels under `cuda/` follow: the same
//! contacts, friction with memory, cohesion, damping and bowl, the same motion of the spoon, and the
//! same judgement of what falls into the vial. One block of threads carries out one spoon's whole
//! action in one launch. A spoon is filled with a bed that the CPU has settled, or with a loose heap
//! ([`flip_sim::dispense::Dispenser::loose`]) that comes to rest on the card; its state stays there between actions.
//!
//! # What is equal and what is not
//!
//! Results are the same bytes for the same inputs on one card and driver, whatever other spoons are
//! in the batch and however many threads a block has. They are not those of the CPU: sums are in
//! another order, and anchors of pairs are kept to 1.9e-6 grain diameters. A few thousand substeps
//! later two such runs differ like two seeds; their statistics are compared by the program
//! `gpu_report`.
//!
//! # Heaps
//!
//! [`Heaps`] pours heaps of the experiment of [`flip_sim::repose`]: the same kernel, built with a round
//! base instead of a bowl, adds grains and advances every heap by its next layer in one launch.
//!
//! # Learners
//!
//! [`Learners`] makes updates of Soft Actor-Critic, of many trainings in one launch. Its results are
//! those of `flip-learn` on a processor in every bit. A training whose engine ([`flip_sim::batch`]) is
//! a card has its updates made by one.
//!
//! # The twin
//!
//! The same source compiles for a processor (`cuda/twin.cpp`). The tests step it beside
//! [`flip_sim`], and the exact kernel ([`Card::open_exact`]) beside it on a card.
//!
//! # Limits
//!
//! A spoon or heap has at most 2560 grains. Those with mechanisms beyond the base simulator have kernels of
//! their own.

/// Version of what a card computes of spoons and heaps. It is raised whenever the same inputs give other bytes.
pub const VERSION: u32 = 5;

mod bed;
mod card;
#[cfg(test)]
mod card_tests;
mod engine;
#[cfg(test)]
mod engine_tests;
mod found;
mod heaps;
#[cfg(test)]
mod heaps_tests;
mod layout;
mod learner;
mod learner_layout;
#[cfg(test)]
mod learner_training_tests;
#[cfg(test)]
#[path = "learner_twin_for_tests.rs"]
mod learner_twin;
mod orders;
mod spoons;
#[cfg(test)]
#[path = "twin_for_tests.rs"]
mod twin;

pub use bed::{Bed, GRAINS_MAX, TooMany};
pub use card::{Card, CardError};
pub use found::{Found, find, find_all};
pub use heaps::Heaps;
pub use learner::Learners;
pub use spoons::{Poured, Spoons};

/// Result of something asked from a card.
pub type Result<T> = std::result::Result<T, CardError>;

/// Why a spoon's simulation is no longer meaningful.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// A grain has no position, or moves more than a diameter in one substep.
    #[error("a grain moves more than a diameter in one substep")]
    TooFast,
    /// Grains have more neighbours than the list has room for.
    #[error("grains have fallen into each other")]
    Overfull,
}
