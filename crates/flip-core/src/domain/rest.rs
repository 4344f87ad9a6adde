//! A display watched while nothing moved: its mean, its slope and its wander.
//!
//! A [`Rest`] keeps the underlying sums, so that several of them can be pooled
//! (`weigh/uncertainty.rs`). Balance readings are correlated in time: the effect of warmth, air and
//! the table fades within [`MEMORY_S`]. A mean of n readings is therefore worth much less than n
//! independent readings.
//!
//! ```text
//! k(dt) = exp(-|dt| / MEMORY_S)                                correlation of two readings dt apart, but for their noise
//! level = sum_ij k(t_i - t_j) / n^2                            variance of the mean, in units of the wander's
//! tilt  = sum_ij k(t_i - t_j) (t_i - t) (t_j - t) / T^2        variance of the slope, in the same units; T = sum (t_i - t)^2
//! ```

use super::bench::Moment;

/// Correlation time of the wander of a balance's readings, s (an enclosed A&D HR-100A at rest;
/// `docs/bench.md`).
pub const MEMORY_S: f64 = 6.0;

/// Statistics of a display while nothing moved, as sums over its readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rest {
    /// Number of readings.
    pub readings: usize,
    /// Mean time of the readings, bench time, s.
    pub at_s: f64,
    /// Time from the first to the last reading, s.
    pub seconds: f64,
    /// Mean reading, mg.
    pub mean_mg: f64,
    /// The last reading, mg.
    pub last_mg: f64,
    /// Slope of the straight line through the readings, mg/s; 0 if all were taken at one moment.
    pub slope_mg_s: f64,
    /// Sum of squares about the mean, mg^2.
    pub squares_mg2: f64,
    /// Sum of squared times about their mean, s^2.
    pub times_s2: f64,
    /// Sums over consecutive readings: squared differences, mg^2; differences times intervals, mg
    /// s; squared intervals, s^2.
    pub steps: [f64; 3],
    /// Variance of the mean of wandering readings, in units of the wander's variance.
    pub level: f64,
    /// Variance of the slope of wandering readings, in units of the wander's variance, 1/s^2.
    pub tilt: f64,
    /// Sum over consecutive readings of the lost correlation: 1 - exp(-dt / MEMORY_S).
    pub forgotten: f64,
}

impl Rest {
    /// Standard deviation of a reading about the mean, mg; 0 of a single one.
    pub fn sd_mg(&self) -> f64 {
        (self.squares_mg2 / (self.readings.max(2) - 1) as f64).sqrt()
    }

    /// Computes the statistics of these readings, which are in order of time; `None` if there are
    /// none or one is not a number.
    pub fn of(seen: &[Moment]) -> Option<Self> {
        let last = seen.last()?;
        if seen.iter().any(|one| !(one.t_s.is_finite() && one.mass_mg.is_finite())) {
            return None;
        }
        let n = seen.len() as f64;
        let mean = |of: fn(&Moment) -> f64| seen.iter().map(of).sum::<f64>() / n;
        let (at_s, mean_mg) = (mean(|one| one.t_s), mean(|one| one.mass_mg));
        let times_s2: f64 = seen.iter().map(|one| (one.t_s - at_s).powi(2)).sum();
        let both: f64 = seen.iter().map(|one| (one.t_s - at_s) * (one.mass_mg - mean_mg)).sum();
        let (level, tilt) = remembered(seen, at_s);
        let steps = seen
            .windows(2)
            .map(|pair| (pair[1].mass_mg - pair[0].mass_mg, pair[1].t_s - pair[0].t_s));
        Some(Self {
            readings: seen.len(),
            at_s,
            seconds: last.t_s - seen[0].t_s,
            mean_mg,
            last_mg: last.mass_mg,
            slope_mg_s: if times_s2 > 0.0 { both / times_s2 } else { 0.0 },
            squares_mg2: seen.iter().map(|one| (one.mass_mg - mean_mg).powi(2)).sum(),
            times_s2,
            steps: steps
                .clone()
                .fold([0.0; 3], |sum, (mg, s)| [sum[0] + mg * mg, sum[1] + mg * s, sum[2] + s * s]),
            level: level / (n * n),
            tilt: if times_s2 > 0.0 { tilt / times_s2.powi(2) } else { 0.0 },
            forgotten: steps.map(|(_, s)| 1.0 - kept(s)).sum(),
        })
    }
}

/// Correlation of two readings this far apart in time.
fn kept(seconds: f64) -> f64 {
    libm::exp(-seconds.abs() / MEMORY_S)
}

/// Sums of the correlation over all pairs of readings: plain, and weighted by both distances from
/// the mean time.
fn remembered(seen: &[Moment], at_s: f64) -> (f64, f64) {
    let mut sums = (0.0, 0.0);
    for a in seen {
        for b in seen {
            let kept = kept(a.t_s - b.t_s);
            sums.0 += kept;
            sums.1 += kept * (a.t_s - at_s) * (b.t_s - at_s);
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(n: u32, step_s: f64, slope_mg_s: f64) -> Vec<Moment> {
        (0..n)
            .map(|k| f64::from(k) * step_s)
            .map(|t_s| Moment { t_s, mass_mg: 3.0 + slope_mg_s * t_s })
            .collect()
    }

    #[test]
    fn a_straight_line_is_its_mean_and_its_slope() {
        let rest = Rest::of(&ramp(5, 2.0, 0.5)).unwrap();
        assert_eq!(
            (rest.readings, rest.at_s, rest.seconds, rest.mean_mg, rest.last_mg),
            (5, 4.0, 8.0, 5.0, 7.0)
        );
        assert!((rest.slope_mg_s - 0.5).abs() < 1e-12 && (rest.times_s2 - 40.0).abs() < 1e-12);
        assert!((rest.squares_mg2 - 10.0).abs() < 1e-12);
        assert_eq!(rest.steps, [4.0, 8.0, 16.0]);
    }

    #[test]
    fn readings_that_remember_are_worth_less_than_their_number() {
        // Two readings: (1 + k) / 2, and for the slope of times -dt/2 and dt/2: 2 (1 - k) / dt^2.
        let (dt_s, k) = (3.0, (-0.5f64).exp());
        let two = Rest::of(&ramp(2, dt_s, 0.0)).unwrap();
        assert!(
            (two.level - (1.0 + k) / 2.0).abs() < 1e-12
                && (two.tilt - 2.0 * (1.0 - k) / 9.0).abs() < 1e-12
        );
        assert!((two.forgotten - (1.0 - k)).abs() < 1e-12);
        // For many readings, the integral: 2/x (1 - (1 - e^-x) / x) with x = T / MEMORY_S.
        let many = Rest::of(&ramp(2001, 0.01, 0.0)).unwrap();
        let x: f64 = 20.0 / MEMORY_S;
        assert!(
            (many.level - 2.0 / x * (1.0 - (1.0 - (-x).exp()) / x)).abs() < 1e-3,
            "{}",
            many.level
        );
        assert!((Rest::of(&ramp(2, 600.0, 0.0)).unwrap().level - 0.5).abs() < 1e-9);
    }

    #[test]
    fn one_reading_has_no_slope_and_what_is_no_number_says_nothing() {
        let one = Rest::of(&ramp(1, 1.0, 9.0)).unwrap();
        assert_eq!((one.slope_mg_s, one.tilt, one.level, one.seconds), (0.0, 0.0, 1.0, 0.0));
        assert_eq!(Rest::of(&[]), None);
        assert_eq!(Rest::of(&[Moment { t_s: 0.0, mass_mg: f64::NAN }]), None);
    }
}
