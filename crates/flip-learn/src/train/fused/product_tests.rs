//! Products beside plain sums in f64, and on every path.

use super::super::lanes::Path;
use super::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

fn numbers(count: usize, rng: &mut Pcg64Mcg) -> Vec<f32> {
    (0..count).map(|_| 2.0 * rng.random::<f32>() - 1.0).collect()
}

fn at(view: View, i: usize, j: usize) -> f64 {
    f64::from(view.data[i * view.down + j * view.right])
}

#[test]
fn products_are_sums_of_products_whatever_the_shape_and_the_path() {
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    let shapes = [(1, 1, 1), (8, 16, 32), (13, 5, 33), (4, 40, 7), (21, 0, 19), (16, 128, 65)];
    for (rows, inner, columns) in shapes {
        // As a part of a larger matrix, and with rows and columns exchanged.
        let stored = numbers((rows + 2) * (inner + 3), &mut rng);
        let turned = numbers(inner * rows, &mut rng);
        let lefts = [
            View::new(&stored, rows + 2, inner + 3).some_rows(1, rows).some_columns(2, inner),
            View::new(&turned, inner, rows).turned(),
        ];
        let (right, right_turned) =
            (numbers(inner * columns, &mut rng), numbers(inner * columns, &mut rng));
        let rights =
            [View::new(&right, inner, columns), View::new(&right_turned, columns, inner).turned()];
        let (bias, more) = (numbers(columns, &mut rng), numbers(columns, &mut rng));
        let mask = numbers(rows * columns, &mut rng);
        let mask = View::new(&mask, rows, columns);
        let before = numbers(rows * (columns + 4), &mut rng);
        let finishes = [Finish::Plain, Finish::Onto, Finish::Relu, Finish::Where(mask)];
        for (left, right) in lefts.iter().flat_map(|left| rights.iter().map(move |r| (left, r))) {
            for finish in finishes {
                let mut by_path = Vec::new();
                for (_, path) in Path::available() {
                    let mut panels = Panels::default();
                    panels.pack(path, *right, &[&bias, &more]);
                    let mut out = before.clone();
                    let into = Into { data: &mut out, down: columns + 4 };
                    Product { left: *left, right: &panels, into, finish }.compute(path);
                    by_path.push(out);
                }
                assert!(by_path.iter().all(|out| *out == by_path[0]));
                for (i, row) in by_path[0].chunks_exact(columns + 4).enumerate() {
                    assert_eq!(row[columns..], before[i * (columns + 4)..][columns..columns + 4]);
                    for (j, out) in row[..columns].iter().enumerate() {
                        let start = match finish {
                            Finish::Onto => f64::from(before[i * (columns + 4) + j]),
                            _ => f64::from(bias[j]) + f64::from(more[j]),
                        };
                        let terms = (0..inner).map(|k| at(*left, i, k) * at(*right, k, j));
                        let sum = start + terms.clone().sum::<f64>();
                        // Each step rounds by at most 2^-24 of what has been added up.
                        let size = start.abs() + terms.map(f64::abs).sum::<f64>();
                        let rounding = (inner + 2) as f64 * size * 2f64.powi(-24);
                        let expected = match finish {
                            Finish::Relu => sum.max(0.0),
                            Finish::Where(mask) if at(mask, i, j) <= 0.0 => 0.0,
                            _ => sum,
                        };
                        assert!((f64::from(*out) - expected).abs() <= rounding, "{out} {expected}");
                    }
                }
            }
        }
    }
}

#[test]
fn narrow_products_and_column_sums_are_sums_too() {
    let mut rng = Pcg64Mcg::seed_from_u64(2);
    for (rows, inner, columns) in [(3, 5, 1), (9, 40, 4), (2, 128, 2)] {
        let (a, b) = (numbers(rows * (inner + 1), &mut rng), numbers(columns * inner, &mut rng));
        let left = View::new(&a, rows, inner + 1).some_columns(1, inner);
        let right = View::new(&b, columns, inner);
        let starts = numbers(columns, &mut rng);
        let mut by_path = Vec::new();
        for (_, path) in Path::available() {
            let (mut out, mut sums) = (vec![0.0; rows * columns], vec![0.0; inner]);
            let into = Into { data: &mut out, down: columns };
            path.run(Narrow { left, right, starts: Some(&starts), into });
            path.run(ColumnSums { of: left, into: &mut sums });
            by_path.push((out, sums));
        }
        assert!(by_path.iter().all(|out| *out == by_path[0]));
        let (out, sums) = &by_path[0];
        for (place, out) in out.iter().enumerate() {
            let (i, j) = (place / columns, place % columns);
            let terms = (0..inner).map(|k| at(left, i, k) * at(right, j, k));
            let expected = f64::from(starts[j]) + terms.sum::<f64>();
            assert!((f64::from(*out) - expected).abs() < 4e-6);
        }
        for (j, sum) in sums.iter().enumerate() {
            let expected: f64 = (0..rows).map(|i| at(left, i, j)).sum();
            assert!((f64::from(*sum) - expected).abs() < 1e-6);
        }
    }
}

#[test]
#[should_panic(expected = "fits")]
fn a_product_that_would_read_beyond_its_matrix_is_refused() {
    let short = [1.0; 5];
    let left = View { data: &short, rows: 2, columns: 3, down: 3, right: 1 };
    let mut panels = Panels::default();
    panels.pack(Path::Portable, View::new(&[1.0; 3], 3, 1), &[]);
    let into = Into { data: &mut [0.0; 2], down: 1 };
    Product { left, right: &panels, into, finish: Finish::Plain }.compute(Path::Portable);
}
