//! Calibration finds simulated powders that pile like a measured one; training finds policies that weigh them.

pub mod calibrate;
pub mod train;
