//! Position-based powder: pure, deterministic, no I/O, one simulation on one thread.
//!
//! # Theory
//!
//! A powder is N equal spheres that do not rotate. One substep of length h is one relaxed Jacobi iteration of
//! position-based dynamics ("small steps": many substeps with one iteration each, Macklin et al. 2019):
//!
//! ```text
//! v <- (v + g h) (1 - c h)                    gravity, drag
//! p  = x + v h                                predicted positions
//! for every pair and every wall contact, at p:
//!     push  = k_n max(-gap, 0)                contact: an overlap is pushed apart
//!     pull  = Bo g0 h^2 ramp(gap)             cohesion and adhesion: a bounded attraction near contact
//!     slip  = -k_t s,  k_t |s| <= mu push     friction: the contact's anchor is held up to Coulomb's limit
//! v <- v + sum(corrections) / h
//! x <- x + v h
//! ```
//!
//! Contacts act like springs of stiffness k_n m / h^2 with the damping that the prediction brings; an overlap at rest
//! shrinks as h^2. Anchors (Cundall and Strack 1979) give friction a memory, which is what lets a heap stand still.
//!
//! | symbol | meaning | unit | where |
//! |---|---|---|---|
//! | x, v, p | centre, velocity, predicted centre | d, d/substep, d | [`grains`](self) |
//! | gap | distance between surfaces, negative in contact | d | `constraints`, `walls` |
//! | k_n, k_t | relaxation: share of overlap or stretch removed per substep | 1 | [`law`] |
//! | mu, Bo, c, g | friction, bond number, drag, gravity | 1, 1, 1/s, m/s^2 | [`law`] |
//! | h | substep | s | [`law::SUBSTEP_S`] |
//!
//! Grains do not rotate, which equals infinite rolling resistance: heaps are steeper than those of rolling spheres with
//! the same mu, and [`law`] maps the published `friction` range accordingly.
//!
//! # The nine parameters
//!
//! Each acts by one law with a unit, written in [`law`]; the tests in `sim/tests.rs` show each effect on something that
//! can be measured. `particle_mass_ug` converts counts to milligrams and does nothing else, because equal masses cancel.

pub mod balance;
mod constraints;
pub mod dispense;
mod grains;
mod lanes;
pub mod law;
pub mod motion;
mod neighbours;
pub mod repose;
mod walls;

#[cfg(test)]
mod tests;

/// Version of the simulator's physics: results of different versions are never mixed.
pub const VERSION: &str = "pbd-2";
