//! What was measured, and under which conditions.

pub mod campaign;
pub(crate) mod flow;
pub mod reading;
#[cfg(test)]
pub(crate) mod sample;
pub(crate) mod scenario;
