//! Is anything wrong, what is it, and what of it may be claimed.

pub(crate) mod claim;
pub(crate) mod noise;
pub(crate) mod posterior;
pub(crate) mod prepared;
pub(crate) mod screen;
pub(crate) mod verdict;
