//! Position-based powder: pure, deterministic, no I/O, one simulation on one thread.
//!
//! # Theory
//!
//! A powder is N equal spheres that do not rotate. One substep of length h is one relaxed Jacobi
//! iteration of position-based dynamics ("small steps": many substeps with one iteration each,
//! Macklin et al. 2019):
//!
//! ```text
//! u = (v + g h) (1 - c h)                     gravity, drag: predicted velocity
//! p = x + u h                                 predicted positions
//! for every pair and every wall contact, at p, with C = gap - onset:
//!     push  = max(0, -k C - c_n u_n h)  if C < 0    contact: an overlap is undone, an approach slowed down
//!     pull  = Bo g0 h^2 ramp(gap)                   cohesion and adhesion: a bounded attraction near contact
//!     slip  = -(k_t s + c_t u_t h),  at most mu push    friction: the contact's anchor is held up to Coulomb's limit
//! v <- u + sum(corrections) / h
//! x <- x + v h
//! ```
//!
//! Contacts act like springs of stiffness k m / h^2, so an overlap at rest shrinks as h^2. Anchors
//! (Cundall and Strack 1979) give friction a memory, which is what keeps a heap at rest. The
//! damping makes impacts inelastic; a contact between grains with m and n contacts gets the share 1
//! / sqrt(m n) of it, so that the one iteration stays stable in a dense packing. `onset` is where
//! attraction and elastic push balance to zero force at gap zero: attracted grains rest touching,
//! not overlapping.
//!
//! | symbol | meaning | unit | where |
//! |---|---|---|---|
//! | x, v, p, u | centre, velocity, and both predicted | d, d/substep | [`grains`](self) |
//! | gap | distance between surfaces, negative in contact | d | `constraints`, `walls` |
//! | k, k_t | relaxation: share of overlap or stretch removed per substep | 1 | [`law`] |
//! | c_n, c_t | damping: share of approach or slip velocity removed per substep | 1 | [`law`] |
//! | s | tangential stretch since the contact stuck | d | `constraints` |
//! | mu, Bo, c, g | friction, bond number, drag, gravity | 1, 1, 1/s, m/s^2 | [`law`] |
//! | h | substep | s | [`law::SUBSTEP_S`] |
//!
//! Non-rotating grains are equivalent to infinite rolling resistance: heaps are steeper than those
//! of rolling spheres with the same mu, and [`law`] maps the published `friction` range
//! accordingly.
//!
//! # Implementation
//!
//! Every pair of near grains is listed once (`neighbours`, `pairs`). Sixteen pairs are solved at a
//! time and their impulses are added to their grains one after another, so that every sum has a
//! fixed order. `lanes` is the only processor-specific module; its paths give the same bits.
//!
//! # Alternative solver
//!
//! `physx` implements the published engine's own semantics, for comparison: `compat` in the
//! settings of the heap experiment switches it on. `engine` is the solver interface used by that
//! experiment.
//!
//! # The nine parameters
//!
//! Each acts by one law with a unit, documented in [`law`]; the tests in `sim/tests.rs` show each
//! effect on a measurable quantity. `particle_mass_ug` only converts counts to milligrams, because
//! equal masses cancel.

pub mod balance;
pub mod batch;
pub mod column;
mod constraints;
mod contacts;
mod cup;
mod directions;
pub mod dispense;
mod engine;
pub mod film;
mod flank;
mod grains;
mod grid;
pub mod heap_film;
mod lanes;
pub mod law;
pub mod mechanisms;
mod neighbours;
pub mod observe;
mod pairs;
mod physx;
pub mod replay;
pub mod repose;
mod scene;
pub mod scoop;
mod shapes;
pub mod snapshot;
pub mod validate;
mod walls;

pub use directions::{DIRECTIONS, directions};
pub use lanes::Work;

#[cfg(test)]
mod tests;

/// Version of the simulator's physics; results of different versions are never mixed.
pub const VERSION: &str = "pbd-3";
