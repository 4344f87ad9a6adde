//! Bench checks that are kept on record: repeatability of the balance, and the arm's response to
//! commanded shakes.

use super::FieldError;
use serde::{Deserialize, Serialize};

/// Kind of check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CheckKind {
    /// Ten weighings of one test weight.
    Repeatability,
    /// Commanded against executed shakes.
    Shakes,
    /// Whether the devices comply with their protocols.
    Conformance,
}

/// Fewest weighings of a repeatability check (USP <41>).
pub const REPEATABILITY_N_MIN: usize = 10;

/// Result of a repeatability check.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Repeatability {
    /// The readings, mg.
    pub readings_mg: Vec<f64>,
    /// Their standard deviation, mg.
    pub sd_mg: f64,
    /// Readability (display step) of the balance, mg.
    pub readability_mg: f64,
}

impl Repeatability {
    /// Computes the result from the readings of one test weight, put on again for each.
    ///
    /// # Errors
    /// `readings_mg`: fewer than ten, or one that is not a number.
    pub fn of(readings_mg: Vec<f64>, readability_mg: f64) -> Result<Self, FieldError> {
        let n = readings_mg.len();
        if n < REPEATABILITY_N_MIN || readings_mg.iter().any(|mg| !mg.is_finite()) {
            let advice = format!(
                "must hold at least {REPEATABILITY_N_MIN} weighings of one test weight, got {n}"
            );
            return Err(FieldError::new("readings_mg", advice));
        }
        let mean = readings_mg.iter().sum::<f64>() / n as f64;
        let squares: f64 = readings_mg.iter().map(|mg| (mg - mean).powi(2)).sum();
        Ok(Self { readings_mg, sd_mg: (squares / (n as f64 - 1.0)).sqrt(), readability_mg })
    }

    /// Smallest net mass that may be weighed to within this share of itself, mg.
    ///
    /// ```text
    /// m_min = 2 max(s, 0.41 d) / share        share 0.001 for "accurately weighed" (USP <41>)
    /// ```
    pub fn minimum_mg(&self, share: f64) -> f64 {
        minimum_weight_mg(repeatability_mg(self.sd_mg, self.readability_mg), share)
    }
}

/// Repeatability as defined by USP <41>, mg: at least 0.41 display steps.
pub fn repeatability_mg(sd_mg: f64, readability_mg: f64) -> f64 {
    sd_mg.max(0.41 * readability_mg)
}

/// Smallest net weight, mg, for which twice the repeatability is at most this share: 2000 s for the
/// 0.10 % of USP <41>.
pub fn minimum_weight_mg(repeatability_mg: f64, share: f64) -> f64 {
    2.0 * repeatability_mg / share
}

/// The arm's response to a commanded shake: a straight line fitted to the measurements.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ShakeCalibration {
    /// Commanded and executed amplitudes, mm, and the peak speed, mm/s, of each shake.
    pub shakes: Vec<ExecutedShake>,
    /// Executed over commanded amplitude.
    pub gain: f64,
    /// Executed amplitude at zero commanded amplitude, mm.
    pub offset_mm: f64,
    /// SD of the executed amplitudes about the line, mm.
    pub scatter_mm: f64,
    /// Executed over planned peak speed.
    pub speed_gain: f64,
}

/// One shake, commanded and executed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ExecutedShake {
    /// Commanded, mm.
    pub commanded_mm: f64,
    /// Executed, mm.
    pub executed_mm: f64,
    /// Planned peak speed, mm/s.
    pub planned_mm_s: f64,
    /// Executed peak speed, mm/s.
    pub peak_mm_s: f64,
}

impl ShakeCalibration {
    /// Fits the least-squares line through these shakes.
    ///
    /// # Errors
    /// `shakes`: fewer than three amplitudes, all alike, or not numbers.
    pub fn of(shakes: Vec<ExecutedShake>) -> Result<Self, FieldError> {
        let refuse = |why: &str| FieldError::new("shakes", why.to_owned());
        let n = shakes.len() as f64;
        let finite = |s: &ExecutedShake| {
            [s.commanded_mm, s.executed_mm, s.planned_mm_s, s.peak_mm_s]
                .iter()
                .all(|value| value.is_finite())
        };
        if shakes.len() < 3 || !shakes.iter().all(finite) {
            return Err(refuse("must hold at least three shakes, all of them measured"));
        }
        let mean = |of: fn(&ExecutedShake) -> f64| shakes.iter().map(of).sum::<f64>() / n;
        let (x, y) = (mean(|s| s.commanded_mm), mean(|s| s.executed_mm));
        let spread: f64 = shakes.iter().map(|s| (s.commanded_mm - x).powi(2)).sum();
        if spread < 1e-6 {
            return Err(refuse("must differ in amplitude: a line needs two ends"));
        }
        let both: f64 = shakes.iter().map(|s| (s.commanded_mm - x) * (s.executed_mm - y)).sum();
        let gain = both / spread;
        let offset_mm = y - gain * x;
        let off = |s: &ExecutedShake| (s.executed_mm - offset_mm - gain * s.commanded_mm).powi(2);
        let scatter_mm = (shakes.iter().map(off).sum::<f64>() / (n - 2.0)).sqrt();
        let speed = |s: &ExecutedShake| s.peak_mm_s * s.planned_mm_s;
        let planned: f64 = shakes.iter().map(|s| s.planned_mm_s.powi(2)).sum();
        let speed_gain = shakes.iter().map(speed).sum::<f64>() / planned.max(1e-12);
        Ok(Self { shakes, gain, offset_mm, scatter_mm, speed_gain })
    }

    /// The amplitude executed for this commanded amplitude, mm.
    pub fn executed_mm(&self, commanded_mm: f64) -> f64 {
        (self.offset_mm + self.gain * commanded_mm).max(0.0)
    }

    /// The amplitude to command for this executed amplitude, mm.
    pub fn commanded_mm(&self, wanted_mm: f64) -> f64 {
        ((wanted_mm - self.offset_mm) / self.gain).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smallest_mass_follows_the_scatter_and_at_least_the_display() {
        let exact = Repeatability::of(vec![100.0; 10], 1.0).unwrap();
        assert!(
            (exact.minimum_mg(0.001) - 820.0).abs() < 1e-9
                && (exact.minimum_mg(0.01) - 82.0).abs() < 1e-9
        );
        let readings = (0..10).map(|k| 100.0 + f64::from(k % 2)).collect();
        let scattered = Repeatability::of(readings, 0.1).unwrap();
        assert!((scattered.sd_mg - (2.5f64 / 9.0).sqrt()).abs() < 1e-12);
        assert!(Repeatability::of(vec![1.0; 9], 1.0).is_err());
        assert!(Repeatability::of([vec![1.0; 9], vec![f64::NAN]].concat(), 1.0).is_err());
    }

    #[test]
    fn a_line_is_found_and_its_inverse_commands_what_is_wanted() {
        let shake = |commanded_mm: f64| ExecutedShake {
            commanded_mm,
            executed_mm: 0.94 * commanded_mm - 0.1,
            planned_mm_s: 40.0,
            peak_mm_s: 36.0,
        };
        let line = ShakeCalibration::of([2.0, 4.0, 8.0, 16.0].map(shake).to_vec()).unwrap();
        assert!(
            (line.gain - 0.94).abs() < 1e-12
                && (line.offset_mm + 0.1).abs() < 1e-12
                && line.scatter_mm < 1e-9
        );
        assert!((line.speed_gain - 0.9).abs() < 1e-12);
        assert!((line.executed_mm(line.commanded_mm(5.0)) - 5.0).abs() < 1e-12);
        assert!(
            ShakeCalibration::of(vec![shake(2.0); 5]).is_err()
                && ShakeCalibration::of(vec![shake(2.0)]).is_err()
        );
    }
}
