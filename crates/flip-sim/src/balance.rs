//! The simulated balance: readability, settling, noise.

use flip_core::domain::bench::Reading;
use flip_core::domain::seed::derive;
use serde::{Deserialize, Serialize};

/// Settings of the simulated balance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Display step, mg. Default 1 (the published bench's balance).
    pub readability_mg: f64,
    /// Time constant of the first-order response, s. Default 0.16 (measured on an A&D analytical
    /// balance, 28 steps).
    pub settling_tau_s: f64,
    /// SD of one reading's noise before rounding, mg. Default 0.1 (same rig, enclosed: 0.08-0.15).
    pub noise_mg: f64,
    /// Wait after each motion before reading, s. Default 1.5: the response is then within 0.01 % of
    /// its final value.
    pub wait_s: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self { readability_mg: 1.0, settling_tau_s: 0.16, noise_mg: 0.1, wait_s: 1.5 }
    }
}

impl Settings {
    /// Returns the reading `wait_s` after the load changed from `before_mg` to `after_mg`.
    ///
    /// ```text
    /// m(t) = after + (before - after) exp(-t / tau) + noise, shown as the nearest multiple of the readability
    /// ```
    pub fn read(&self, before_mg: f64, after_mg: f64, seed: u64, index: u64) -> Reading {
        let decay = libm::exp(-self.wait_s / self.settling_tau_s);
        let mass = after_mg + (before_mg - after_mg) * decay + self.noise_mg * normal(seed, index);
        let shown = (mass / self.readability_mg).round() * self.readability_mg;
        // Rounding in decimal prevents 0.3 from becoming 0.30000000000000004, and adding zero
        // prevents -0.
        Reading {
            mass_mg: (shown * 1e6).round() / 1e6 + 0.0,
            stable: (before_mg - after_mg).abs() * decay < self.readability_mg / 2.0,
        }
    }
}

/// A standard normal number from two derived uniform ones (Box and Muller 1958).
fn normal(seed: u64, index: u64) -> f64 {
    let uniform = |k| ((derive(seed, &[index, k]) >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
    (-2.0 * libm::log(uniform(0))).sqrt() * libm::cos(std::f64::consts::TAU * uniform(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readings_are_multiples_of_the_readability_and_unbiased() {
        for readability_mg in [1.0, 0.1] {
            let balance = Settings { readability_mg, ..Settings::default() };
            let mut sum = 0.0;
            for index in 0..4000 {
                let true_mg = 7.0 + index as f64 / 4000.0;
                let shown = balance.read(true_mg, true_mg, 3, index).mass_mg;
                let steps = shown / readability_mg;
                assert!((steps - steps.round()).abs() < 1e-9);
                let empty = balance.read(0.0, 0.0, 3, index).mass_mg;
                assert!(empty != 0.0 || empty.is_sign_positive(), "an empty vial shows -0");
                sum += shown - true_mg;
            }
            // SD of one error is at most 0.31 mg, so 4 standard errors over 4000 readings are 0.02
            // mg.
            assert!((sum / 4000.0).abs() < 0.02, "bias {}", sum / 4000.0);
        }
    }

    #[test]
    fn a_reading_taken_too_early_lags_and_says_so() {
        let balance =
            Settings { wait_s: 0.16, noise_mg: 0.0, readability_mg: 0.1, ..Settings::default() };
        let reading = balance.read(0.0, 10.0, 1, 1);
        assert!((reading.mass_mg - 10.0 * (1.0 - (-1.0f64).exp())).abs() < 0.051);
        assert!(!reading.stable);
    }
}
