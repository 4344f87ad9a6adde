//! The curves beside f64, and on every path.

use super::super::lanes::{Path, Task, put, take, vectors};
use super::*;

/// All four curves of each number.
struct All<'a> {
    x: &'a [f32],
    out: &'a mut [Vec<f32>; 4],
}

impl Task for All<'_> {
    fn with<L: Lanes>(self) {
        for (at, count) in vectors(self.x.len()) {
            let x: L = take(self.x, at, count);
            for (y, out) in
                [exp(x), sigmoid(x), tanh(x), softplus(x)].into_iter().zip(&mut *self.out)
            {
                put(y, out, at, count);
            }
        }
    }
}

fn all(path: Path, x: &[f32]) -> [Vec<f32>; 4] {
    let mut out = std::array::from_fn(|_| vec![0.0; x.len()]);
    path.run(All { x, out: &mut out });
    out
}

#[test]
fn curves_are_the_exact_ones_to_a_few_units_in_the_last_place() {
    let x: Vec<f32> = (-86_500..=87_500)
        .map(|k| k as f32 * 1e-3)
        .chain((-30..0).flat_map(|e| [2f32.powi(e), -1.37 * 2f32.powi(e)]))
        .collect();
    let [exps, sigmoids, tanhs, softpluses] = all(Path::best(), &x);
    // Error over the exact value, in units of 2^-23.
    let mut worst = [0.0f64; 4];
    for (k, x) in x.iter().map(|x| f64::from(*x)).enumerate() {
        let exact =
            [x.exp(), 1.0 / (1.0 + (-x).exp()), x.tanh(), x.max(0.0) + (-x.abs()).exp().ln_1p()];
        for (c, ours) in [exps[k], sigmoids[k], tanhs[k], softpluses[k]].into_iter().enumerate() {
            let off = (f64::from(ours) - exact[c]).abs() / exact[c].abs() * 2f64.powi(23);
            worst[c] = worst[c].max(off);
        }
    }
    println!("{worst:?}");
    assert!(worst.iter().all(|off| *off < 4.0), "{worst:?}");
}

#[test]
fn curves_end_where_they_should_and_keep_nan() {
    let far = [f32::INFINITY, f32::NEG_INFINITY, 1e30, -1e30, 0.0, f32::NAN];
    let [exps, sigmoids, tanhs, softpluses] = all(Path::best(), &far);
    assert!(exps[0] > 1e38 && exps[1] < 2e-38 && exps[2] == exps[0] && exps[4] == 1.0);
    assert!(sigmoids[0] == 1.0 && sigmoids[1] < 1e-37 && sigmoids[4] == 0.5);
    assert_eq!(tanhs[..5], [1.0, -1.0, 1.0, -1.0, 0.0]);
    assert!(softpluses[2] == 1e30 && softpluses[3] < 2e-38);
    for curve in [exps, sigmoids, tanhs, softpluses] {
        assert!(curve[5].is_nan());
    }
}

#[test]
fn every_path_draws_the_same_curves() {
    let x: Vec<f32> = (0..4001).map(|k| (k as f32 - 2000.0) * 0.0513).collect();
    let expected = all(Path::Portable, &x);
    for (name, path) in Path::available() {
        assert!(all(path, &x) == expected, "{name}");
    }
}
