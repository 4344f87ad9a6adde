//! From what was found to an extended simulator, whose amplitudes heaps find and verify.

pub(crate) mod claimed;
pub mod extension;
pub(crate) mod fit;
