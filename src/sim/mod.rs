//! Position-based powder: pure, deterministic, no I/O, one simulation on one thread.

pub mod balance;
mod constraints;
pub mod dispense;
mod grains;
pub mod law;
pub mod motion;
mod neighbours;
pub mod repose;
mod walls;

/// Version of the simulator's physics: results of different versions are never mixed.
pub const VERSION: &str = "pbd-1";
