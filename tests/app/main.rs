//! The application from outside, on a real database in a temporary folder, with formulas in place
//! of the physics.

mod asked;
mod bench;
mod benches;
mod calibration;
mod cards;
mod endings;
mod harness;
mod investigation;
mod ledger;
mod limits;
mod portions;
mod queue;
mod registry;
mod simulator;
mod spoons;
mod training;
mod training_films;
mod vials;
mod weighing;
mod workers;
