//! Waypoints of the spoon's two motions, for drivers whose robot takes a sampled path.

use flip_core::domain::FieldError;
use flip_core::domain::bounded;
use flip_core::domain::motion::{MotionLimits, Move, TurnLimits};

/// Allowed sample rates of a path, Hz: from a slow camera's rate to beyond a robot's control cycle.
const RATE_HZ: [f64; 2] = [10.0, 10_000.0];
/// Longest stroke, m: longer than any spoon's.
const STROKE_M_MAX: f64 = 0.1;

/// One sample of a path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Waypoint {
    /// Since the start of the motion, s.
    pub t_s: f64,
    /// m or deg.
    pub position: f64,
    /// m/s or deg/s.
    pub velocity: f64,
}

/// The turn from one pitch to another, in degrees and deg/s.
///
/// # Errors
/// A number that is not finite, a limit that is not positive, or a rate out of bounds.
pub fn pitch(
    from_deg: f64,
    to_deg: f64,
    limits: &TurnLimits,
    rate_hz: f64,
) -> Result<Vec<Waypoint>, FieldError> {
    bounded("from_deg", from_deg, -180.0, 180.0, "deg")?;
    bounded("to_deg", to_deg, -180.0, 180.0, "deg")?;
    let change = to_deg - from_deg;
    let turn = Move::new(change.abs(), checked((*limits).into())?);
    sampled(turn.duration_s(), rate_hz, |t_s| Waypoint {
        t_s,
        position: from_deg + change.signum() * turn.position_m(t_s),
        velocity: change.signum() * turn.velocity_m_s(t_s),
    })
}

/// The shake: out along the spoon's axis by the amplitude and back, at rest at both ends, in m and
/// m/s.
///
/// # Errors
/// A number that is not finite, a limit that is not positive, or a rate out of bounds.
pub fn shake(
    amplitude_m: f64,
    limits: &MotionLimits,
    rate_hz: f64,
) -> Result<Vec<Waypoint>, FieldError> {
    bounded("amplitude_m", amplitude_m, 0.0, STROKE_M_MAX, "m")?;
    let stroke = Stroke::new(amplitude_m, checked(*limits)?);
    sampled(stroke.duration_s(), rate_hz, |t_s| stroke.at(t_s))
}

/// An out-and-back shake as a function of time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stroke(Move);

impl Stroke {
    /// The fastest within these limits.
    pub fn new(amplitude_m: f64, limits: MotionLimits) -> Self {
        Self(Move::new(amplitude_m, limits))
    }

    /// Duration out and back, s.
    pub fn duration_s(&self) -> f64 {
        2.0 * self.0.duration_s()
    }

    /// Peak speed, m/s.
    pub fn top_m_s(&self) -> f64 {
        self.0.top_m_s()
    }

    /// Position of the spoon `t_s` after the start.
    pub fn at(&self, t_s: f64) -> Waypoint {
        let half = self.0.duration_s();
        let out = t_s < half;
        let (t, sign) = if out { (t_s, 1.0) } else { (2.0 * half - t_s, -1.0) };
        let t = t.max(0.0);
        Waypoint { t_s, position: self.0.position_m(t), velocity: sign * self.0.velocity_m_s(t) }
    }
}

fn checked(limits: MotionLimits) -> Result<MotionLimits, FieldError> {
    for (field, value) in [
        ("velocity", limits.velocity_m_s),
        ("acceleration", limits.acceleration_m_s2),
        ("jerk", limits.jerk_m_s3),
    ] {
        if !(value.is_finite() && value > 0.0) {
            return Err(FieldError::new(field, format!("must be a positive number, got {value}")));
        }
    }
    Ok(limits)
}

/// Samples from 0 to `duration_s`; the last is exactly at the end, so that the path ends at rest.
fn sampled(
    duration_s: f64,
    rate_hz: f64,
    at: impl Fn(f64) -> Waypoint,
) -> Result<Vec<Waypoint>, FieldError> {
    let rate = bounded("rate_hz", rate_hz, RATE_HZ[0], RATE_HZ[1], "Hz")?;
    let whole = (duration_s * rate).ceil() as usize;
    Ok((0..=whole).map(|k| at((k as f64 / rate).min(duration_s))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Check speed, acceleration and jerk between samples, by differences.
    fn check(path: &[Waypoint], limits: MotionLimits) {
        let (mut before, mut before_s) = (0.0, 0.0);
        for pair in path.windows(2) {
            let dt = pair[1].t_s - pair[0].t_s;
            if dt < 1e-4 {
                continue;
            }
            let travelled = (pair[1].position - pair[0].position) / dt;
            let acceleration = (pair[1].velocity - pair[0].velocity) / dt;
            assert!(travelled.abs() <= limits.velocity_m_s * 1.000_001, "{pair:?}");
            assert!(pair[0].velocity.abs() <= limits.velocity_m_s * 1.000_001, "{pair:?}");
            assert!(acceleration.abs() <= limits.acceleration_m_s2 * 1.000_001, "{pair:?}");
            // Means over two intervals are as far apart as their midpoints; the turning point joins
            // a move to its mirror image.
            assert!(
                (acceleration - before).abs() <= limits.jerk_m_s3 * (dt + before_s) / 2.0 * 1.01,
                "{pair:?}"
            );
            (before, before_s) = (acceleration, dt);
        }
        assert_eq!((path[0].velocity, path[path.len() - 1].velocity.abs() < 1e-9), (0.0, true));
    }

    #[test]
    fn a_shake_goes_out_by_its_amplitude_and_back_within_the_published_limits() {
        for amplitude_m in [0.0009, 0.004, 0.016] {
            let path = shake(amplitude_m, &MotionLimits::PAPER, 1000.0).unwrap();
            check(&path, MotionLimits::PAPER);
            let furthest = path.iter().map(|point| point.position).fold(0.0, f64::max);
            assert!(
                (furthest / amplitude_m - 1.0).abs() < 1e-3
                    && path[path.len() - 1].position.abs() < 1e-12
            );
        }
    }

    #[test]
    fn a_turn_goes_either_way_and_ends_at_its_pitch_at_rest() {
        for (from, to) in [(0.0, 8.0), (36.0, -10.0), (5.0, 5.0)] {
            let path = pitch(from, to, &TurnLimits::DEFAULT, 1000.0).unwrap();
            check(&path, TurnLimits::DEFAULT.into());
            assert!(
                (path[0].position - from).abs() < 1e-12
                    && (path[path.len() - 1].position - to).abs() < 1e-9
            );
        }
    }

    #[test]
    fn numbers_that_mean_nothing_are_refused_by_name() {
        let refused = |path: Result<Vec<Waypoint>, FieldError>| path.unwrap_err().field;
        let still = MotionLimits { jerk_m_s3: 0.0, ..MotionLimits::PAPER };
        assert_eq!(refused(shake(f64::NAN, &MotionLimits::PAPER, 1000.0)), "amplitude_m");
        assert_eq!(refused(shake(0.01, &still, 1000.0)), "jerk");
        assert_eq!(refused(shake(0.01, &MotionLimits::PAPER, 0.0)), "rate_hz");
        assert_eq!(refused(pitch(0.0, f64::INFINITY, &TurnLimits::DEFAULT, 1000.0)), "to_deg");
    }
}
