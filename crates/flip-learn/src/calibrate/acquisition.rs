//! The value of a simulation at a point.

use flip_core::stats::gaussian_process::Prediction;
use flip_core::stats::normal::{cdf, pdf};

/// Expected improvement of the absolute error |f - t| over `incumbent`.
///
/// ```text
/// EI = E[max(tau - |f - t|, 0)],   f ~ N(mu, s^2)
///    = (tau - d) (Phi(b) - Phi(c)) + (tau + d) (Phi(c) - Phi(a)) + s (phi(a) + phi(b) - 2 phi(c))
/// d = mu - t,   a = (-tau - d) / s,   b = (tau - d) / s,   c = -d / s
/// ```
///
/// | symbol | argument | unit | range |
/// |--------|----------|------|-------|
/// | mu, s | `at` | deg | s >= 0 |
/// | t | `target` | deg | finite |
/// | tau | `incumbent` | deg | > 0 |
///
/// Never negative, at most `incumbent`; max(tau - |d|, 0) for s = 0. |f - t| is a folded normal, so
/// this is its lower partial moment; the usual EI on a Gaussian process of the error itself would
/// consider an angle of zero error as likely as one beyond zero.
///
/// Source: the integral is elementary, split at f = t; the idea of modelling the output instead of
/// its distance to the target is from Uhrenholt and Jensen, "Efficient Bayesian Optimization for
/// Target Vector Estimation" (2019).
pub fn expected_improvement(at: Prediction, target: f64, incumbent: f64) -> f64 {
    let d = at.mean - target;
    if at.sd <= 0.0 {
        return (incumbent - d.abs()).max(0.0);
    }
    let [a, b, c] = [-incumbent - d, incumbent - d, -d].map(|z| z / at.sd);
    let value = (incumbent - d) * (cdf(b) - cdf(c))
        + (incumbent + d) * (cdf(c) - cdf(a))
        + at.sd * (pdf(a) + pdf(b) - 2.0 * pdf(c));
    // In the far tails the terms cancel to rounding noise of either sign.
    value.clamp(0.0, incumbent)
}

/// Probability that |f - t| <= `tolerance`, with f and t as in [`expected_improvement`].
pub fn probability_within(at: Prediction, target: f64, tolerance: f64) -> f64 {
    let d = at.mean - target;
    match at.sd > 0.0 {
        true => cdf((tolerance - d) / at.sd) - cdf((-tolerance - d) / at.sd),
        false => f64::from(d.abs() <= tolerance),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_core::stats::normal::quantile;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    #[test]
    fn both_formulas_agree_with_monte_carlo() {
        let mut rng = Pcg64::seed_from_u64(4);
        let draws: Vec<f64> = (0..200_000).map(|_| quantile(rng.random::<f64>())).collect();
        for (mean, sd, target, tau) in [
            (30.0, 2.0, 30.0, 1.5),
            (33.0, 2.0, 30.0, 1.5),
            (28.0, 0.7, 30.0, 4.0),
            (31.0, 6.0, 36.0, 0.5),
        ] {
            let errors = draws.iter().map(|z| (mean + sd * z - target).abs());
            let gains: Vec<f64> = errors.map(|e| (tau - e).max(0.0)).collect();
            let n = gains.len() as f64;
            let (sampled, hits) = (
                gains.iter().sum::<f64>() / n,
                gains.iter().filter(|g| **g > 0.0).count() as f64 / n,
            );
            let at = Prediction { mean, sd };
            // Four standard errors of 200 000 draws of a number with SD below tau / 2, and of a
            // proportion.
            assert!(
                (expected_improvement(at, target, tau) - sampled).abs()
                    < 4.0 * tau / 2.0 / n.sqrt()
            );
            assert!((probability_within(at, target, tau) - hits).abs() < 4.0 * 0.5 / n.sqrt());
        }
    }

    #[test]
    fn certainty_and_hopelessness_are_limits_without_surprises() {
        let ei = |mean, sd| expected_improvement(Prediction { mean, sd }, 30.0, 1.5);
        assert_eq!((ei(30.5, 0.0), ei(40.0, 0.0)), (1.0, 0.0));
        assert!((ei(30.5, 1e-9) - 1.0).abs() < 1e-6);
        assert!(ei(300.0, 1.0) == 0.0 && ei(30.0, 1e12) < 1e-9);
        assert!(ei(31.0, 1.0) > ei(32.0, 1.0) && (ei(31.0, 1.0) - ei(29.0, 1.0)).abs() < 1e-12);
    }
}
