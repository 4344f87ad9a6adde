//! The published engine's semantics: solid position-based particles as PhysX 5 solves them,
//! switched on by `compat = "physx"`.
//!
//! Written from the equations in the engine's open source (NVIDIA-Omniverse/PhysX, commit a3d8a64,
//! kernels of particlesystem.cu); where that source does something odd, this module does it too and
//! notes it. One frame of length dt is N iterations of length h:
//!
//! ```text
//! v <- (v + g dt) (1 - min(1, c dt))                          once per frame
//! pairs:  |xi - xj| <= 2 contact neighbourhood at x + v dt/2   once per frame; f = t = 0, D = 0
//! walls:  gap and normal n of each grain at x                 once per frame; F = T = 0; the wall is that plane until the next
//! N times, every contact at the same x (Jacobi):
//!     |v| <- min(|v|, v_max);   x += h v;   D += h v
//!     pair, e = |xi - xj| - d, w = 1/2:
//!         m  = clamp(min(e, max(-f, pull(e))), -d, d)          e < 0 repels; e > 0 gives back at most what repelled in this frame
//!         f' = f + m;   dxi -= w m n;   f = min(f', 0)
//!         j  = tangential part of Di - Dj                     slip since the frame began
//!         q  = min(mu max(-f', 0), |j| + t) - t;   t += q;   dxi -= w q j/|j|
//!     dxi *= beta / max(1, number of pairs with f' != 0)
//!     wall, s = gap + n . D:
//!         m  = max(min(-F, -a(s)), -s);   F = max(0, F + m);   dxi += beta_w m n
//!         q  = min(mu F, |Dt| + T) - T;   T += q;   dxi -= beta_w q Dt/|Dt|
//!     x += dx;   D += dx;   v += dx/h
//!
//! pull(e) = max(0, A k (1 - e/aura)^8 e)   if |xi - xj| < s d,  aura = (s - 1) d
//! a(sep)  = A (1 - sep/R)^4 max(0, sep)    if sep < s in metres,  R = (s - 1) d/2,  and A > 0, s > 0
//! beta    = min(0.9, 2/sqrt(N)),   beta_w = min(0.7, beta)
//! ```
//!
//! | symbol | meaning | unit here | comes from |
//! |---|---|---|---|
//! | x, v, D | centre, velocity, displacement since the frame began | d, d/frame, d | [`solver`] |
//! | f, t; F, T | normal and tangential sums of a pair's and a wall contact's corrections in this frame | d | [`solver`] |
//! | d | distance at which grains rest, twice the rest offset | 1 | `particle_diameter_mm` |
//! | contact | particle contact offset, 1.5 rest offsets | 0.75 d | [`law`] |
//! | mu | Coulomb coefficient, of pairs *and* of walls | 1 | `friction` |
//! | A, k, s | adhesion, particle adhesion scale, adhesion radius scale | 1 | `adhesion`, `particle_adhesion_scale`, `adhesion_offset_scale` |
//! | g, c | gravity, damping | d/frame^2, 1/s | `gravity_scale`, `damping` |
//! | N, dt | iterations per frame, frame | 1, s | `iterations`, `frame_s` of the settings |
//!
//! Consequences, each shown by a test in `physx/tests.rs`:
//!
//! * `particle_mass_ug` is inert: masses are equal and walls do not move, so every weight is 1/2
//!   or 1.
//! * `cohesion` is inert: the engine applies it between fluid particles only.
//! * `base_friction` of the experiment is inert: the engine uses the grains' own coefficient at
//!   walls too.
//! * Between grains, A and k act as their product, and only for s > 1. The published bounds end at
//!   s = 0.00005: no grain there ever attracts another, and k is inert.
//! * At walls, s < 1 makes the radius R negative, and the pull grows with distance instead of
//!   fading. It is ended by the guard `sep < s`, which compares a length in metres with a scale:
//!   within the published bounds s is in effect the *range of wall adhesion in metres*, 0 to 50
//!   micrometres. For s > 1 the even power lets the pull grow again beyond R.
//! * Without damping and attraction, gravity, frame and diameter act only as g dt^2/d: less gravity
//!   is equivalent to a shorter frame.
//! * Friction has no memory from one frame to the next, and the sums start from zero: a heap
//!   creeps, and its angle depends on the frame, on N and on how long it stood.
//! * The tangential sums have no direction: slip to and fro within a frame adds up. A single grain
//!   rests on a slope up to half of mu, *climbs* between that and slightly above mu, and beyond
//!   that slides with the acceleration of Coulomb's law.
//! * Grains do not rotate, and impacts are inelastic except for what remains at the end of the
//!   frame in which they happen: an impact n iterations before its end keeps at most 2^(-n/2) of
//!   the closing speed (N = 16).
//!
//! Not implemented, because solid grains of equal mass on one fixed wall never need it: fluid
//! constraints, moving bodies, velocity iterations (the engine's do not move particles in this
//! solver), sleeping (compiled out there). Differences: a grain touches at most one plane per
//! frame; sums run in another order and without fused multiply-add; a grain may have more than 96
//! neighbours; the plate has no thickness, so that a grain which falls more than a diameter in a
//! frame can pass it.

mod law;
mod solver;

#[cfg(test)]
mod tests;

pub(super) use law::{FRAME_S, ITERATIONS, Law};
pub(super) use solver::Solver;
