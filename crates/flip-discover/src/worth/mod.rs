//! How large what was found is, what it is worth on other days, and what to measure next.

pub(crate) mod detectable;
pub(crate) mod effects;
pub(crate) mod experiment;
pub(crate) mod held_out;
pub(crate) mod law;
