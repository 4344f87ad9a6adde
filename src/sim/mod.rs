//! Position-based powder: pure, deterministic, no I/O, one simulation on one thread.

pub mod balance;
pub mod dispense;
pub mod repose;

/// Version of the simulator's physics: results of different versions are never mixed.
pub const VERSION: &str = "pbd-1";
