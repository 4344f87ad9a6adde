//! Spoon motion: smooth rest-to-rest moves within velocity, acceleration and jerk limits.

use serde::{Deserialize, Serialize};

/// Limits of a straight move.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionLimits {
    /// Maximum speed, m/s.
    pub velocity_m_s: f64,
    /// Maximum acceleration, m/s^2.
    pub acceleration_m_s2: f64,
    /// Maximum jerk, m/s^3.
    pub jerk_m_s3: f64,
}

impl MotionLimits {
    /// The published robot's relative dynamics 0.25 / 0.13 / 0.05 of an FR3's maxima 3 m/s, 9
    /// m/s^2, 4500 m/s^3.
    pub const PAPER: Self =
        Self { velocity_m_s: 0.25 * 3.0, acceleration_m_s2: 0.13 * 9.0, jerk_m_s3: 0.05 * 4500.0 };
    /// FLIP's default, 0.25 / 0.5 / 0.35 of the same maxima: 0.46 g. At the published 0.12 g a
    /// smooth shake acts like 7 deg more tilt, and simulated salt yields 3 mg in five shakes at 45
    /// deg; the published robot's arm adds vibration that a rigid spoon does not have.
    pub const BRISK: Self =
        Self { velocity_m_s: 0.25 * 3.0, acceleration_m_s2: 0.5 * 9.0, jerk_m_s3: 0.35 * 4500.0 };

    /// Limits under which every move is the same one, made in 1 / s of its time:
    ///
    /// ```text
    /// v <- s v,  a <- s^2 a,  j <- s^3 j
    /// ```
    #[must_use]
    pub fn at_speed(self, s: f64) -> Self {
        Self {
            velocity_m_s: s * self.velocity_m_s,
            acceleration_m_s2: s * s * self.acceleration_m_s2,
            jerk_m_s3: s * s * s * self.jerk_m_s3,
        }
    }
}

/// Limits of a rotation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TurnLimits {
    /// Maximum angular speed, deg/s.
    pub velocity_deg_s: f64,
    /// Maximum angular acceleration, deg/s^2.
    pub acceleration_deg_s2: f64,
    /// Maximum angular jerk, deg/s^3.
    pub jerk_deg_s3: f64,
}

impl TurnLimits {
    /// FLIP's default: at most 60 deg/s, reached within a tenth of a second.
    pub const DEFAULT: Self =
        Self { velocity_deg_s: 60.0, acceleration_deg_s2: 1200.0, jerk_deg_s3: 24_000.0 };
}

/// A [`Move`] is unit-agnostic: given limits in degrees, its "metres" are degrees.
impl From<TurnLimits> for MotionLimits {
    fn from(turn: TurnLimits) -> Self {
        Self {
            velocity_m_s: turn.velocity_deg_s,
            acceleration_m_s2: turn.acceleration_deg_s2,
            jerk_m_s3: turn.jerk_deg_s3,
        }
    }
}

/// A rest-to-rest move: jerk-limited ramp to constant acceleration, an optional cruise, and the
/// mirror image back to rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Move {
    limits: MotionLimits,
    distance_m: f64,
    /// Duration of each jerk phase, s.
    ramp_s: f64,
    /// Peak acceleration, m/s^2.
    peak_m_s2: f64,
    /// Peak speed, m/s.
    top_m_s: f64,
    /// Time from rest to peak speed, s.
    rise_s: f64,
    /// Time at peak speed, s.
    cruise_s: f64,
}

impl Move {
    /// Plans the fastest move over `distance_m`, which must be zero or more.
    ///
    /// ```text
    /// long enough for full acceleration a and below top speed v:   s = v^2/a + v a/j,  rise = v/a + a/j
    /// shorter than 2 a^3 / j^2:                                    a = (s j^2 / 2)^(1/3), rise = 2 a/j
    /// ```
    ///
    /// Limits whose top speed is reached before full acceleration (`v < a^2/j`) keep their speed
    /// and jerk and use less acceleration than allowed.
    pub fn new(distance_m: f64, limits: MotionLimits) -> Self {
        let MotionLimits { velocity_m_s: v_max, acceleration_m_s2: a, jerk_m_s3: j } = limits;
        let s = distance_m;
        let (mut peak, mut speed) = if s < 2.0 * a.powi(3) / (j * j) {
            let peak = libm::cbrt(s * j * j / 2.0);
            (peak, peak * peak / j)
        } else {
            let ramp = a / j;
            (a, a / 2.0 * ((ramp * ramp + 4.0 * s / a).sqrt() - ramp))
        };
        let mut cruise = 0.0;
        if speed > v_max {
            speed = v_max;
            if peak * peak > speed * j {
                peak = (speed * j).sqrt();
            }
            cruise = (s - (speed * speed / peak + speed * (peak / j))) / speed;
        }
        let ramp = peak / j;
        let rise = speed / peak.max(1e-12) + ramp;
        Self {
            limits,
            distance_m,
            ramp_s: ramp,
            peak_m_s2: peak,
            top_m_s: speed,
            rise_s: rise,
            cruise_s: cruise,
        }
    }

    /// Time from rest to rest, s.
    pub fn duration_s(&self) -> f64 {
        2.0 * self.rise_s + self.cruise_s
    }

    /// Peak speed of the move, m/s.
    pub fn top_m_s(&self) -> f64 {
        self.top_m_s
    }

    /// Largest acceleration of the move, m/s^2.
    pub fn peak_m_s2(&self) -> f64 {
        self.peak_m_s2
    }

    /// Acceleration at `t` after the start, m/s^2; zero outside the move.
    pub fn acceleration_m_s2(&self, t: f64) -> f64 {
        let fall_starts = self.rise_s + self.cruise_s;
        match t {
            t if t < self.rise_s => self.pulse(t),
            t if t < fall_starts => 0.0,
            t => -self.pulse(t - fall_starts),
        }
    }

    /// Speed at `t` after the start, m/s; zero outside the move.
    pub fn velocity_m_s(&self, t: f64) -> f64 {
        let fall_starts = self.rise_s + self.cruise_s;
        match t {
            t if t < self.rise_s => self.rising(t)[0],
            t if t < fall_starts => self.top_m_s,
            t => self.rising(self.duration_s() - t)[0],
        }
    }

    /// Distance travelled at `t` after the start, m.
    pub fn position_m(&self, t: f64) -> f64 {
        let fall_starts = self.rise_s + self.cruise_s;
        match t {
            t if t < self.rise_s => self.rising(t)[1],
            t if t < fall_starts => self.rising(self.rise_s)[1] + self.top_m_s * (t - self.rise_s),
            t => self.distance_m - self.rising(self.duration_s() - t)[1],
        }
    }

    /// One trapezoidal acceleration pulse.
    fn pulse(&self, t: f64) -> f64 {
        if !(0.0..=self.rise_s).contains(&t) {
            return 0.0;
        }
        (self.limits.jerk_m_s3 * t.min(self.rise_s - t)).min(self.peak_m_s2)
    }

    /// Speed and distance at `t` within the trapezoid: its first and second integral.
    ///
    /// ```text
    /// t < T_j          v = j t^2 / 2,               x = j t^3 / 6
    /// t < rise - T_j   v = a (t - T_j / 2),         x = a (t^2 / 2 - t T_j / 2 + T_j^2 / 6)
    /// t < rise         v = v_top - j u^2 / 2,       x = x_rise - v_top u + j u^3 / 6,   u = rise - t
    /// ```
    fn rising(&self, t: f64) -> [f64; 2] {
        let (j, a, ramp) = (self.limits.jerk_m_s3, self.peak_m_s2, self.ramp_s);
        let t = t.clamp(0.0, self.rise_s);
        let left = self.rise_s - t;
        if t < ramp {
            return [j * t * t / 2.0, j * t * t * t / 6.0];
        }
        if left > ramp {
            return [a * (t - ramp / 2.0), a * (t * t / 2.0 - t * ramp / 2.0 + ramp * ramp / 6.0)];
        }
        let whole = self.top_m_s * self.rise_s / 2.0;
        [
            self.top_m_s - j * left * left / 2.0,
            whole - self.top_m_s * left + j * left * left * left / 6.0,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Moves of every kind: full acceleration, too short for it, with a cruise, top speed before
    /// full acceleration, a rotation.
    fn cases() -> Vec<(f64, MotionLimits)> {
        let slow = MotionLimits { velocity_m_s: 0.05, ..MotionLimits::PAPER };
        let crawling = MotionLimits { velocity_m_s: 0.002, ..MotionLimits::PAPER };
        let turn = MotionLimits::from(TurnLimits::DEFAULT);
        vec![
            (0.016, MotionLimits::PAPER),
            (0.0009, MotionLimits::PAPER),
            (0.000_02, MotionLimits::PAPER),
            (0.016, slow),
            (0.016, crawling),
            (0.016, MotionLimits::BRISK),
            (8.0, turn),
            (0.01, turn),
            (50.0, turn),
        ]
    }

    #[test]
    fn the_closed_form_is_the_sum_of_the_acceleration() {
        for (distance, limits) in cases() {
            let plan = Move::new(distance, limits);
            let steps = 200_000;
            let dt = plan.duration_s() / f64::from(steps);
            let (mut x, mut v) = (0.0, 0.0);
            for k in 0..steps {
                v += plan.acceleration_m_s2((f64::from(k) + 0.5) * dt) * dt;
                x += v * dt;
                if k % 1000 == 0 {
                    let t = f64::from(k + 1) * dt;
                    // The sum is first-order accurate in the step.
                    assert!(
                        (plan.velocity_m_s(t) - v).abs() < 1e-4 * plan.top_m_s(),
                        "speed at {t} of {distance}"
                    );
                    assert!(
                        (plan.position_m(t) - x).abs() < 1e-4 * distance,
                        "way at {t} of {distance}"
                    );
                }
            }
        }
    }

    #[test]
    fn no_sample_exceeds_a_limit_and_the_move_ends_at_its_distance_at_rest() {
        for (distance, limits) in cases() {
            let plan = Move::new(distance, limits);
            let dt = plan.duration_s() / 10_000.0;
            let mut before = 0.0;
            for k in 0..=10_000 {
                let t = f64::from(k) * dt;
                let acceleration = plan.acceleration_m_s2(t);
                assert!(
                    plan.velocity_m_s(t) <= limits.velocity_m_s * (1.0 + 1e-12),
                    "speed at {t} of {distance}"
                );
                assert!(
                    acceleration.abs() <= limits.acceleration_m_s2 * (1.0 + 1e-12),
                    "at {t} of {distance}"
                );
                let jerk = (acceleration - before).abs() / dt;
                assert!(
                    jerk <= limits.jerk_m_s3 * (1.0 + 1e-6),
                    "jerk {jerk} at {t} of {distance}"
                );
                before = acceleration;
            }
            let end = plan.duration_s();
            assert!((plan.position_m(end) - distance).abs() <= 1e-12 * distance);
            assert!(plan.velocity_m_s(end).abs() <= 1e-9 * limits.velocity_m_s);
            assert_eq!((plan.velocity_m_s(end + 1.0), plan.position_m(end + 1.0)), (0.0, distance));
        }
    }

    #[test]
    fn no_way_takes_no_time() {
        let plan = Move::new(0.0, MotionLimits::PAPER);
        assert_eq!(
            (plan.duration_s(), plan.position_m(0.0), plan.velocity_m_s(1.0)),
            (0.0, 0.0, 0.0)
        );
    }
}
