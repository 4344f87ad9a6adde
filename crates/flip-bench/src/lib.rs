//! Everything that moves and is weighed: drivers and the devices that are emulated around the
//! simulator, piles seen by a camera, one dose from the first motion to the result, and the rigs
//! that carry it out.

pub mod emulate;
pub mod hardware;
pub mod pile;
pub mod rig;
pub mod weigh;
