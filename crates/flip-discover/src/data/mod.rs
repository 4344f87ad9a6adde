//! What was measured, and under which conditions.

pub mod campaign;
pub(crate) mod flow;
pub mod reading;
pub(crate) mod scenario;
