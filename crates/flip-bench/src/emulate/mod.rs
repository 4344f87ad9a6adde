//! Devices that are not there: each speaks its true wire protocol over a pseudo-terminal, TCP or gRPC, and misbehaves as the real one does.
//!
//! Drivers cannot tell: they open a path or an address. What lies behind is a [`Pan`](pan::Pan) that powder falls on, read by an emulated balance and filled
//! by an emulated arm, whose spoon is the simulator.

pub mod arm;
pub mod balance;
pub mod camera;
pub mod gate;
pub mod gripper;
pub mod lab;
mod motion;
pub mod pan;
pub mod port;
