//! Exponential, tanh and their relatives, the same bits on every processor.
//!
//! From fused multiply-adds alone, within two units in the last place of the exact value where that
//! matters; the platform's own functions differ from one C library to the next. NaN stays NaN.
#![allow(clippy::inline_always)] // See `lanes`.

use super::lanes::{Lanes, Portable, WIDTH};

/// A polynomial, highest power first.
#[inline(always)]
fn polynomial<L: Lanes, const N: usize>(x: L, coefficients: [f32; N]) -> L {
    let mut sum = L::splat(coefficients[0]);
    for c in &coefficients[1..] {
        sum = sum.times_plus(x, L::splat(*c));
    }
    sum
}

/// e^x; as e^-87 below -87 and as e^88 above 88.
///
/// `x = n ln 2 + r` with `|r| <= ln 2 / 2`, where ln 2 has two parts so that `n` times the first is
/// exact, and a polynomial in `r` (Moshier, Cephes, `expf`).
#[inline(always)]
pub(super) fn exp<L: Lanes>(x: L) -> L {
    let x = L::splat(88.0).min(L::splat(-87.0).max(x));
    let n = x.times(L::splat(std::f32::consts::LOG2_E)).rounded();
    let r = n.times_plus(L::splat(-0.693_359_4), x);
    let r = n.times_plus(L::splat(2.121_944_4e-4), r);
    let p = polynomial(
        r,
        [1.987_569_1e-4, 1.398_2e-3, 8.333_452e-3, 4.166_579_6e-2, 1.666_666_5e-1, 5e-1],
    );
    let one = L::splat(1.0);
    p.times_plus(r.times(r), r.plus(one)).times(n.power_of_two())
}

/// e^x of one number.
pub(in crate::train) fn exponential(x: f32) -> f32 {
    let mut out = [0.0; WIDTH];
    exp(Portable::splat(x)).store(&mut out);
    out[0]
}

/// 1 / (1 + e^-x).
#[inline(always)]
pub(super) fn sigmoid<L: Lanes>(x: L) -> L {
    let one = L::splat(1.0);
    one.over(one.plus(exp(L::splat(0.0).minus(x))))
}

/// Hyperbolic tangent: a polynomial up to 0.625, beyond it `1 - 2 / (e^2|x| + 1)` (Cephes, `tanhf`).
#[inline(always)]
pub(super) fn tanh<L: Lanes>(x: L) -> L {
    let (zero, one, two) = (L::splat(0.0), L::splat(1.0), L::splat(2.0));
    let size = zero.minus(x).max(x);
    let far = one.minus(two.over(exp(size.times(two)).plus(one)));
    let far = x.if_below(zero, zero.minus(far), far);
    let z = x.times(x);
    let p = polynomial(
        z,
        [-5.704_988_7e-3, 2.063_908_8e-2, -5.373_971_6e-2, 1.333_144_2e-1, -0.333_332_8],
    );
    let near = p.times(z).times_plus(x, x);
    L::splat(0.625).if_below(size, far, near)
}

/// ln(1 + e^x): `max(x, 0) + ln(1 + t)` with `t = e^-|x|`, and `ln(1 + t) = 2 artanh(s)` with
/// `s = t / (2 + t)` up to a third, as a series.
#[inline(always)]
pub(super) fn softplus<L: Lanes>(x: L) -> L {
    let zero = L::splat(0.0);
    let size = zero.minus(x).max(x);
    let t = exp(zero.minus(size));
    let s = t.over(t.plus(L::splat(2.0)));
    const SERIES: [f32; 8] =
        [1.0 / 15.0, 1.0 / 13.0, 1.0 / 11.0, 1.0 / 9.0, 1.0 / 7.0, 1.0 / 5.0, 1.0 / 3.0, 1.0];
    let artanh = polynomial(s.times(s), SERIES).times(s);
    artanh.times_plus(L::splat(2.0), zero.max(x))
}

#[cfg(test)]
#[path = "curves_tests.rs"]
mod tests;
