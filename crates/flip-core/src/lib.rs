//! What everything speaks of, and the statistics under it: no I/O, no clock, no async.

pub mod card;
pub mod domain;
pub mod learner;
pub mod stats;
