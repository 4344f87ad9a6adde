use super::*;
use crate::stats::normal;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::Deserialize;

#[derive(Deserialize)]
struct Case {
    powder: Vec<usize>,
    day: Vec<usize>,
    weights: Vec<f64>,
    ratios: [f64; 2],
    features: Vec<Vec<f64>>,
    amplitude: f64,
    sign: f64,
    observations: Vec<f64>,
    log_null: f64,
    log_evidence: f64,
}

/// One indicator column for each of `count` groups.
fn one_hot(of: &[usize], count: usize) -> DMatrix<f64> {
    DMatrix::from_fn(of.len(), count, |i, k| f64::from(u8::from(of[i] == k)))
}

fn column(values: &[f64]) -> DMatrix<f64> {
    DMatrix::from_column_slice(values.len(), 1, values)
}

#[test]
fn evidence_equals_quadrature_by_an_independent_implementation() {
    let cases: Vec<Case> =
        serde_json::from_str(include_str!("../../../../../tests/reference/mixed_model.json"))
            .unwrap();
    assert!(cases.len() >= 20);
    for (number, case) in cases.iter().enumerate() {
        let both: Vec<usize> =
            case.day.iter().zip(&case.powder).map(|(day, powder)| 3 * day + powder).collect();
        let groups = [
            Group { of: &case.day, ratio: case.ratios[0] },
            Group { of: &both, ratio: case.ratios[1] },
        ];
        let noise = Whitening::new(&case.weights, &groups, &one_hot(&case.powder, 3)).unwrap();
        let features = DMatrix::from_fn(case.features.len(), case.features[0].len(), |i, k| {
            case.features[i][k]
        });
        let observations = column(&case.observations);
        let squares = noise.squares(&observations)[0];
        assert!((noise.log_null(squares) - case.log_null).abs() < 1e-6, "case {number}");
        let signature = noise.signature(&features).unwrap();
        let seen = signature.seen(&observations);
        let sign: Vec<(usize, f64)> =
            (case.sign != 0.0).then_some((0, case.sign)).into_iter().collect();
        let found = noise.log_evidence(&signature, seen.column(0), squares, case.amplitude, &sign);
        assert!(
            (found - case.log_evidence).abs() < 1e-6,
            "case {number}: {found}, quadrature {}",
            case.log_evidence
        );
    }
}

#[test]
fn what_the_fixed_part_spans_changes_nothing() {
    let powder = [0, 0, 0, 1, 1, 1, 1];
    let noise = Whitening::new(&[1.0; 7], &[], &one_hot(&powder, 2)).unwrap();
    let y = [1.0, 2.5, 0.3, 7.0, 9.0, 8.2, 6.1];
    let moved: Vec<f64> =
        y.iter().zip(powder).map(|(y, powder)| y + 100.0 * powder as f64 - 3.0).collect();
    let squares = [noise.squares(&column(&y))[0], noise.squares(&column(&moved))[0]];
    assert!((squares[0] - squares[1]).abs() < 1e-9);
    // The same by hand: sums of squares around the two means.
    let around = |values: &[f64]| {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter().map(|x| (x - mean).powi(2)).sum::<f64>()
    };
    assert!((squares[0] - around(&y[..3]) - around(&y[3..])).abs() < 1e-12);
    let explained = DMatrix::from_fn(7, 1, |i, _| if powder[i] == 0 { 2.0 } else { -1.0 });
    assert!(noise.signature(&explained).is_none());
}

#[test]
fn noise_that_cannot_be_is_refused() {
    let powder = one_hot(&[0, 0, 1], 2);
    let refused =
        |weights: &[f64], fixed: &DMatrix<f64>| Whitening::new(weights, &[], fixed).unwrap_err();
    assert_eq!(refused(&[1.0, 0.0, 1.0], &powder), MixedModelError::Covariance);
    assert_eq!(refused(&[1.0, f64::NAN, 1.0], &powder), MixedModelError::Covariance);
    assert_eq!(refused(&[1.0; 3], &one_hot(&[0, 0, 0], 2)), MixedModelError::Fixed);
    assert_eq!(refused(&[1.0; 3], &DMatrix::identity(3, 3)), MixedModelError::Fixed);
}

/// Differences between days look like an effect of anything else that differs between days, unless
/// the noise model includes days.
#[test]
fn shared_draws_are_not_taken_for_an_effect() {
    let mut rng = Pcg64::seed_from_u64(5);
    let mut normal_draw = || normal::quantile(rng.random::<f64>());
    let (days, runs) = (12, 10);
    let day: Vec<usize> = (0..days * runs).map(|i| i / runs).collect();
    let fixed = DMatrix::from_element(day.len(), 1, 1.0);
    let weights = vec![1.0; day.len()];
    let blind = Whitening::new(&weights, &[], &fixed).unwrap();
    let aware = Whitening::new(&weights, &[Group { of: &day, ratio: 1.0 }], &fixed).unwrap();
    let mut favoured = [0, 0];
    for _ in 0..100 {
        let humidity: Vec<f64> = (0..days).map(|_| normal_draw()).collect();
        let shift: Vec<f64> = (0..days).map(|_| normal_draw()).collect();
        let y = DMatrix::from_fn(day.len(), 1, |i, _| shift[day[i]] + normal_draw());
        let feature = DMatrix::from_fn(day.len(), 1, |i, _| humidity[day[i]]);
        for (count, noise) in favoured.iter_mut().zip([&blind, &aware]) {
            let signature = noise.signature(&feature).unwrap();
            let squares = noise.squares(&y)[0];
            let with =
                noise.log_evidence(&signature, signature.seen(&y).column(0), squares, 0.6, &[]);
            *count += usize::from(with > noise.log_null(squares) + 20f64.ln());
        }
    }
    println!(
        "evidence above 20 to 1 for humidity that does nothing: {favoured:?} of 100 (blind, aware of days)"
    );
    // A Bayes factor above 20 has a probability below 1/20 if the noise model is right (Ville); 12
    // of 100 is three standard errors above.
    assert!(favoured[0] > 12 && favoured[1] <= 12, "{favoured:?}");
}

#[test]
fn columns_that_say_nothing_change_nothing() {
    let (powder, day) = ([0, 0, 0, 1, 1, 1, 1, 0], [0, 1, 2, 3, 0, 1, 2, 3]);
    let noise =
        Whitening::new(&[1.0; 8], &[Group { of: &day, ratio: 0.2 }], &one_hot(&powder, 2)).unwrap();
    let y = column(&[1.0, 2.5, 0.3, 7.0, 9.0, 8.2, 6.1, 1.1]);
    let squares = noise.squares(&y)[0];
    let told = DMatrix::from_fn(8, 2, |i, k| ((i * (k + 2)) % 5) as f64);
    // The same among columns that are empty or a powder's mean.
    let hidden = DMatrix::from_fn(8, 60, |i, k| match k {
        7 => told[(i, 0)],
        31 => told[(i, 1)],
        _ if k % 3 == 0 => f64::from(u8::from(powder[i] == 1)),
        _ => 0.0,
    });
    let of = |features: &DMatrix<f64>, signs: &[(usize, f64)]| {
        let signature = noise.signature(features).unwrap();
        noise.log_evidence(&signature, signature.seen(&y).column(0), squares, 0.6, signs)
    };
    assert!((of(&told, &[]) - of(&hidden, &[])).abs() < 1e-9);
    assert!((of(&told, &[(1, -1.0)]) - of(&hidden, &[(31, -1.0)])).abs() < 1e-9);
}
