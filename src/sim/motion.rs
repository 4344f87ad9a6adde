//! How the spoon moves: smooth point-to-point moves within velocity, acceleration and jerk limits.

use serde::{Deserialize, Serialize};

/// Limits of a straight move.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MotionLimits {
    /// Largest speed, m/s.
    pub velocity_m_s: f64,
    /// Largest acceleration, m/s^2.
    pub acceleration_m_s2: f64,
    /// Largest jerk, m/s^3.
    pub jerk_m_s3: f64,
}

impl MotionLimits {
    /// The published robot's relative dynamics 0.25 / 0.13 / 0.05 of an FR3's maxima 3 m/s, 9 m/s^2, 4500 m/s^3.
    pub const PAPER: Self = Self { velocity_m_s: 0.25 * 3.0, acceleration_m_s2: 0.13 * 9.0, jerk_m_s3: 0.05 * 4500.0 };
    /// FLIP's default, 0.25 / 0.5 / 0.35 of the same maxima: 0.46 g. At the published 0.12 g a smooth shake acts like
    /// 7 deg more tilt and simulated salt gives 3 mg in five shakes at 45 deg; the published robot's arm adds vibration
    /// that a rigid spoon does not have.
    pub const BRISK: Self = Self { velocity_m_s: 0.25 * 3.0, acceleration_m_s2: 0.5 * 9.0, jerk_m_s3: 0.35 * 4500.0 };
}

/// A rest-to-rest move: jerk-limited up to constant acceleration, perhaps a cruise, and the mirror image back to rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Move {
    limits: MotionLimits,
    /// Duration of each jerk phase, s.
    ramp_s: f64,
    /// Acceleration reached, m/s^2.
    peak_m_s2: f64,
    /// From rest to the largest speed, s.
    rise_s: f64,
    /// At the largest speed, s.
    cruise_s: f64,
}

impl Move {
    /// The fastest such move over `distance_m`.
    ///
    /// ```text
    /// long enough for full acceleration a and below top speed v:   s = v^2/a + v a/j,  rise = v/a + a/j
    /// shorter than 2 a^3 / j^2:                                    a = (s j^2 / 2)^(1/3), rise = 2 a/j
    /// ```
    pub(super) fn new(distance_m: f64, limits: MotionLimits) -> Self {
        let MotionLimits { velocity_m_s: v_max, acceleration_m_s2: a, jerk_m_s3: j } = limits;
        let s = distance_m;
        let (peak, mut speed) = if s < 2.0 * a.powi(3) / (j * j) {
            let peak = libm::cbrt(s * j * j / 2.0);
            (peak, peak * peak / j)
        } else {
            let ramp = a / j;
            (a, a / 2.0 * ((ramp * ramp + 4.0 * s / a).sqrt() - ramp))
        };
        let mut cruise = 0.0;
        let ramp = peak / j;
        if speed > v_max {
            speed = v_max;
            cruise = (s - (speed * speed / peak + speed * ramp)) / speed;
        }
        Self { limits, ramp_s: ramp, peak_m_s2: peak, rise_s: speed / peak.max(1e-12) + ramp, cruise_s: cruise }
    }

    /// From rest to rest, s.
    pub(super) fn duration_s(&self) -> f64 {
        2.0 * self.rise_s + self.cruise_s
    }

    /// Acceleration at `t` after the start, m/s^2; zero outside the move.
    pub(super) fn acceleration_m_s2(&self, t: f64) -> f64 {
        let fall_starts = self.rise_s + self.cruise_s;
        match t {
            t if t < self.rise_s => self.pulse(t),
            t if t < fall_starts => 0.0,
            t => -self.pulse(t - fall_starts),
        }
    }

    /// One trapezoid of acceleration.
    fn pulse(&self, t: f64) -> f64 {
        if !(0.0..=self.rise_s).contains(&t) {
            return 0.0;
        }
        (self.limits.jerk_m_s3 * t.min(self.rise_s - t)).min(self.peak_m_s2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Distance, end speed and top speed by summing the acceleration.
    fn travel(distance_m: f64, limits: MotionLimits) -> [f64; 3] {
        let plan = Move::new(distance_m, limits);
        let steps = 200_000;
        let dt = plan.duration_s() / f64::from(steps);
        let (mut x, mut v, mut top) = (0.0, 0.0, 0.0f64);
        for k in 0..steps {
            v += plan.acceleration_m_s2((f64::from(k) + 0.5) * dt) * dt;
            x += v * dt;
            top = top.max(v);
        }
        [x, v, top]
    }

    #[test]
    fn a_move_ends_at_its_distance_at_rest_within_its_limits() {
        let slow = MotionLimits { velocity_m_s: 0.05, ..MotionLimits::PAPER };
        for (distance, limits) in [
            (0.016, MotionLimits::PAPER),
            (0.0009, MotionLimits::PAPER),
            (0.000_02, MotionLimits::PAPER),
            (0.016, slow),
        ] {
            let [x, v, top] = travel(distance, limits);
            assert!((x / distance - 1.0).abs() < 1e-3, "{x} for {distance}");
            assert!(v.abs() < 1e-5 && top <= limits.velocity_m_s * 1.0001);
        }
    }
}
