//! The standard normal distribution, based on `statrs`' error functions.

use statrs::function::erf::{erfc, erfc_inv};
use std::f64::consts::{SQRT_2, TAU};

/// Density of the standard normal at `z`.
///
/// ```text
/// phi(z) = exp(-z^2 / 2) / sqrt(2 pi)
/// ```
pub fn pdf(z: f64) -> f64 {
    (-0.5 * z * z).exp() / TAU.sqrt()
}

/// Probability that a standard normal number is at most `z`.
///
/// ```text
/// Phi(z) = erfc(-z / sqrt 2) / 2
/// ```
///
/// Numerics: uses the complement, so that the lower tail keeps its relative precision.
pub fn cdf(z: f64) -> f64 {
    0.5 * erfc(-z / SQRT_2)
}

/// The `z` with `cdf(z) = p`; minus and plus infinity at 0 and 1, NaN outside 0..=1.
///
/// ```text
/// Phi^-1(p) = -sqrt(2) erfc^-1(2 p)
/// ```
pub fn quantile(p: f64) -> f64 {
    if !(0.0..=1.0).contains(&p) {
        return f64::NAN;
    }
    -SQRT_2 * erfc_inv(2.0 * p)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `(z, phi(z), Phi(z))`: Abramowitz and Stegun, Handbook of Mathematical Functions, table 26.1
    /// (15 decimals).
    const TABLE: [(f64, f64, f64); 4] = [
        (0.0, 0.398_942_280_401_433, 0.5),
        (1.0, 0.241_970_724_519_143, 0.841_344_746_068_543),
        (2.0, 0.053_990_966_513_188, 0.977_249_868_051_821),
        (3.0, 0.004_431_848_411_938, 0.998_650_101_968_370),
    ];

    #[test]
    fn density_and_distribution_match_the_published_table() {
        for (z, density, probability) in TABLE {
            assert!((pdf(z) - density).abs() < 1e-14 && (pdf(-z) - density).abs() < 1e-14);
            // statrs' erfc is accurate to about 1e-11 here.
            assert!((cdf(z) - probability).abs() < 1e-10, "{z}: {}", cdf(z));
            assert!((cdf(-z) - (1.0 - probability)).abs() < 1e-10);
        }
    }

    #[test]
    fn the_quantile_inverts_the_distribution_and_knows_its_domain() {
        for p in [1e-6, 0.025, 0.5, 0.8, 0.975, 1.0 - 1e-6] {
            assert!((cdf(quantile(p)) - p).abs() < 1e-9 * p.max(1e-3), "{p}");
        }
        assert_eq!(quantile(0.0), f64::NEG_INFINITY);
        assert_eq!(quantile(1.0), f64::INFINITY);
        assert!(quantile(1.1).is_nan() && quantile(f64::NAN).is_nan());
    }

    #[test]
    fn the_lower_tail_keeps_its_relative_precision() {
        // Phi(-8) = 6.22096057427178e-16 (mpmath, 15 digits); 1 - Phi(8) would be 0.
        assert!((cdf(-8.0) / 6.220_960_574_271_78e-16 - 1.0).abs() < 1e-6);
    }
}
