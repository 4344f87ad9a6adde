//! What is done to each number of a block by itself. No operation is fused here: the bits are those
//! of the same formula as a plain loop.
#![allow(clippy::inline_always)] // See `lanes`.

use super::lanes::{Lanes, Path, Task, put, take, vectors};

/// One step of Adam ([`crate::train::Adam`]) on a block.
#[derive(Debug)]
pub(in crate::train) struct Descent<'a> {
    pub theta: &'a mut [f32],
    pub gradient: &'a [f32],
    pub m: &'a mut [f32],
    pub v: &'a mut [f32],
    /// Decay of either mean.
    pub decays: [f32; 2],
    /// Learning rate over the first mean's correction.
    pub size: f32,
    /// One over the root of the second mean's correction.
    pub scale: f32,
    pub eps: f32,
    /// Moments below this are flushed to zero.
    pub tiny: f32,
}

impl Descent<'_> {
    pub(in crate::train) fn take_step(self) {
        Path::best().run(self);
    }
}

impl Task for Descent<'_> {
    #[inline(always)]
    fn with<L: Lanes>(self) {
        let [b1, b2] = self.decays.map(L::splat);
        let [rest1, rest2] = self.decays.map(|decay| L::splat(1.0 - decay));
        let [size, scale, eps] = [self.size, self.scale, self.eps].map(L::splat);
        let (zero, tiny) = (L::splat(0.0), L::splat(self.tiny));
        for (at, count) in vectors(self.theta.len()) {
            let g: L = take(self.gradient, at, count);
            let m = b1.times(take(self.m, at, count)).plus(rest1.times(g));
            let v = b2.times(take(self.v, at, count)).plus(rest2.times(g).times(g));
            let m = zero.minus(m).max(m).if_below(tiny, zero, m);
            let v = zero.minus(v).max(v).if_below(tiny, zero, v);
            put(m, self.m, at, count);
            put(v, self.v, at, count);
            let by = size.times(m).over(v.root().times(scale).plus(eps));
            let theta: L = take(self.theta, at, count);
            put(theta.minus(by), self.theta, at, count);
        }
    }
}

/// Moves a block by the share `tau` towards another.
#[derive(Debug)]
pub(in crate::train) struct Approach<'a> {
    pub slow: &'a mut [f32],
    pub fast: &'a [f32],
    pub tau: f32,
}

impl Approach<'_> {
    pub(in crate::train) fn take_step(self) {
        Path::best().run(self);
    }
}

impl Task for Approach<'_> {
    #[inline(always)]
    fn with<L: Lanes>(self) {
        let tau = L::splat(self.tau);
        for (at, count) in vectors(self.slow.len()) {
            let slow: L = take(self.slow, at, count);
            let fast: L = take(self.fast, at, count);
            put(slow.plus(tau.times(fast.minus(slow))), self.slow, at, count);
        }
    }
}
