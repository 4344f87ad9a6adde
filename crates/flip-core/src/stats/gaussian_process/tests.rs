use super::evidence::{Prior, objective};
use super::*;
use crate::stats::latin_hypercube::latin_hypercube;
use crate::stats::normal;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

fn known<const D: usize>(lengthscale: f64, noise_sd: f64) -> Hyperparameters<D> {
    Hyperparameters { lengthscales: [lengthscale; D], signal_sd: 2.0, noise_sd, mean: 5.0 }
}

#[test]
fn one_observation_gives_the_closed_form() {
    let h = known::<1>(0.5, 0.3);
    let gp = GaussianProcess::new(&[[0.2]], &[7.0], h).unwrap();
    // a = sqrt(5) 0.3 / 0.5; k = 4 (1 + a + a^2/3) e^-a; mean = 5 + k / 4.09 * 2; var = 4 - k^2 /
    // 4.09.
    let a = 5f64.sqrt() * 0.6;
    let k = 4.0 * (1.0 + a + a * a / 3.0) * (-a).exp();
    let at = gp.predict(&[0.5]);
    assert!((at.mean - (5.0 + k / 4.09 * 2.0)).abs() < 1e-8);
    assert!((at.sd - (4.0 - k * k / 4.09).sqrt()).abs() < 1e-8);
}

#[test]
fn the_posterior_is_that_of_the_formula_with_an_explicit_inverse() {
    let mut rng = Pcg64::seed_from_u64(3);
    let x: Vec<[f64; 3]> = latin_hypercube(12, &mut rng);
    let y: Vec<f64> = x.iter().map(|p| 4.0 + 3.0 * p[0] - p[1] * p[2]).collect();
    let h =
        Hyperparameters { lengthscales: [0.7, 1.3, 2.0], signal_sd: 1.7, noise_sd: 0.2, mean: 4.5 };
    let gp = GaussianProcess::new(&x, &y, h.clone()).unwrap();
    let kernel = |a: &[f64; 3], b: &[f64; 3]| {
        let r2: f64 = (0..3).map(|j| (a[j] - b[j]).powi(2) / h.lengthscales[j].powi(2)).sum();
        1.7 * 1.7 * (1.0 + (5.0 * r2).sqrt() + 5.0 * r2 / 3.0) * (-(5.0 * r2).sqrt()).exp()
    };
    let k = DMatrix::from_fn(12, 12, |i, j| kernel(&x[i], &x[j]) + if i == j { 0.04 } else { 0.0 });
    let inverse = k.try_inverse().unwrap();
    for q in latin_hypercube::<3>(20, &mut rng) {
        let c = DVector::from_fn(12, |i, _| kernel(&x[i], &q));
        let mean = 4.5 + (c.transpose() * &inverse * DVector::from_fn(12, |i, _| y[i] - 4.5))[0];
        let sd = (1.7 * 1.7 - (c.transpose() * &inverse * &c)[0]).sqrt();
        let got = gp.predict(&q);
        assert!((gp.mean(&q) - mean).abs() < 1e-7);
        assert!(
            (got.mean - mean).abs() < 1e-7 && (got.sd - sd).abs() < 1e-7,
            "{got:?} {mean} {sd}"
        );
    }
}

#[test]
fn without_noise_it_interpolates_and_far_away_it_returns_to_the_prior() {
    let gp =
        GaussianProcess::new(&[[0.0], [1.0], [2.5]], &[1.0, 4.0, 2.0], known(0.5, 0.0)).unwrap();
    for (x, y) in [(0.0, 1.0), (1.0, 4.0), (2.5, 2.0)] {
        let at = gp.predict(&[x]);
        assert!((at.mean - y).abs() < 1e-6 && at.sd < 1e-3, "{at:?}");
    }
    let far = gp.predict(&[100.0]);
    assert!((far.mean - 5.0).abs() < 1e-9 && (far.sd - 2.0).abs() < 1e-9);
}

#[test]
fn the_gradient_of_the_evidence_is_that_of_central_differences() {
    let mut rng = Pcg64::seed_from_u64(8);
    let x: Vec<[f64; 4]> = latin_hypercube(15, &mut rng);
    let y: Vec<f64> = x
        .iter()
        .map(|p| p[0].sin() * 2.0 + p[1] * p[2] + 0.1 * rng.random::<f64>() - 1.0)
        .collect();
    let noise: Vec<f64> = x.iter().map(|p| 0.2 + p[3]).collect();
    for spread in [0.3, 1.0] {
        let theta = DVector::from_fn(6, |_, _| spread * (rng.random::<f64>() - 0.5) * 2.0 - 0.5);
        let (_, gradient) = objective(&x, &y, &noise, &theta, &Prior::default());
        for j in 0..6 {
            let step = |h: f64| {
                let mut moved = theta.clone();
                moved[j] += h;
                objective(&x, &y, &noise, &moved, &Prior::default()).0
            };
            let numeric = (step(1e-5) - step(-1e-5)) / 2e-5;
            assert!(
                (gradient[j] - numeric).abs() < 1e-5 * numeric.abs().max(1.0),
                "{j}: {} {numeric}",
                gradient[j]
            );
        }
    }
}

#[test]
fn the_evidence_is_the_density_of_a_multivariate_normal() {
    // Two observations: the bivariate normal density, written out.
    let (x, y) = ([[0.1], [0.6]], [0.4, -0.7]);
    let theta = DVector::from_vec(vec![0.8f64.ln(), 1.2f64.ln(), 0.3f64.ln()]);
    let wide = Prior { lengthscale: (1.0, 1e9), signal_sd: (1.0, 1e9), noise_sd: (1.0, 1e9) };
    let a = 5f64.sqrt() * 0.5 / 0.8;
    let c = 1.44 * (1.0 + a + a * a / 3.0) * (-a).exp();
    let v: f64 = 1.44 + 0.09;
    let determinant = v * v - c * c;
    let quadratic = (v * y[0] * y[0] - 2.0 * c * y[0] * y[1] + v * y[1] * y[1]) / determinant;
    let minus_log_density = 0.5 * quadratic + 0.5 * determinant.ln() + std::f64::consts::TAU.ln();
    assert!((objective(&x, &y, &[1.0; 2], &theta, &wide).0 - minus_log_density).abs() < 1e-8);
}

#[test]
fn fitting_finds_which_inputs_matter_and_how_noisy_the_outputs_are() {
    let mut rng = Pcg64::seed_from_u64(21);
    let truth = |p: &[f64; 5]| 30.0 + 20.0 * p[1].sqrt() + 8.0 * p[3];
    let x: Vec<[f64; 5]> = latin_hypercube(60, &mut rng);
    let y: Vec<f64> = x.iter().map(|p| truth(p) + normal::quantile(rng.random::<f64>())).collect();
    let gp = GaussianProcess::fit(&x, &y, &Prior::default()).unwrap();
    let l = gp.hyperparameters().lengthscales;
    assert!(l[1].max(l[3]) < l[0].min(l[2]).min(l[4]), "{l:?}");
    assert!(
        (0.6..1.6).contains(&gp.hyperparameters().noise_sd),
        "{}",
        gp.hyperparameters().noise_sd
    );
    let fresh: Vec<[f64; 5]> = latin_hypercube(200, &mut rng);
    let inside = fresh
        .iter()
        .filter(|p| (gp.predict(p).mean - truth(p)).abs() < 2.0 * gp.predict(p).sd)
        .count();
    // 95 % if the posterior is right; 200 points of one function are far from independent.
    assert!(inside >= 160, "{inside} of 200");
    let error = fresh.iter().map(|p| (gp.predict(p).mean - truth(p)).powi(2)).sum::<f64>() / 200.0;
    assert!(error.sqrt() < 0.8, "{}", error.sqrt());
}

#[test]
fn believing_a_point_keeps_the_mean_and_shrinks_the_doubt() {
    let gp = GaussianProcess::new(&[[0.0], [1.0]], &[1.0, 4.0], known(0.5, 0.1)).unwrap();
    let (before, after) = (gp.predict(&[0.5]), gp.believe(&[0.5]).predict(&[0.5]));
    assert!((before.mean - after.mean).abs() < 1e-6 && after.sd < 0.2 * before.sd);
}

#[test]
fn repeated_and_constant_observations_are_no_trouble_and_nonsense_is_refused() {
    let same = GaussianProcess::fit(&[[0.5, 0.5]; 6], &[3.0; 6], &Prior::default()).unwrap();
    assert!((same.predict(&[0.5, 0.5]).mean - 3.0).abs() < 1e-9);
    assert_eq!(
        GaussianProcess::<1>::fit(&[], &[], &Prior::default()).unwrap_err(),
        GaussianProcessError::Shape
    );
    let nan =
        GaussianProcess::fit(&[[0.0], [f64::NAN]], &[1.0, 2.0], &Prior::default()).unwrap_err();
    assert_eq!(nan, GaussianProcessError::NotFinite);
    assert!(GaussianProcess::new(&[[0.0]], &[1.0], known(-1.0, 0.1)).is_err());
}

#[test]
fn the_mean_of_four_observations_is_as_good_as_the_four() {
    let h = known::<1>(0.5, 0.6);
    let four = GaussianProcess::new(
        &[[0.2], [0.2], [0.2], [0.2], [0.9]],
        &[7.0, 6.0, 6.5, 6.1, 4.0],
        h.clone(),
    )
    .unwrap();
    let mean =
        GaussianProcess::with_noise(&[[0.2], [0.9]], &[6.4, 4.0], &[0.25, 1.0], h.clone()).unwrap();
    let grown = GaussianProcess::new(&[[0.9]], &[4.0], h).unwrap().observe(&[([0.2], 6.4, 0.25)]);
    for x in [[0.1], [0.5], [1.4]] {
        for other in [mean.predict(&x), grown.predict(&x)] {
            let of_four = four.predict(&x);
            assert!(
                (of_four.mean - other.mean).abs() < 1e-8 && (of_four.sd - other.sd).abs() < 1e-8
            );
        }
    }
}
