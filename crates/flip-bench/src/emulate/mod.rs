//! Emulated devices: each speaks its real wire protocol over a pseudo-terminal, TCP or gRPC, and
//! fails the way the real one does.
//!
//! Drivers cannot tell the difference: they open a path or an address. Behind it is a
//! [`Pan`](pan::Pan) that powder falls on, read by an emulated balance and filled by an emulated
//! arm, whose spoon is simulated.

pub mod arm;
pub mod balance;
pub mod camera;
mod fault;
pub mod gate;
pub mod gripper;
pub mod hidden;
pub mod lab;
mod motion;
pub mod pan;
pub mod port;
