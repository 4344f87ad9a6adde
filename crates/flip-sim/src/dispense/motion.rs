//! How the spoon moves, what the powder in it feels, and where a grain that leaves it falls.

use super::super::constraints::{Vector, vector};
use super::super::grains::Departure;
use super::super::law::{GRAVITY, Law};
use super::Settings;
use flip_core::domain::motion::Move;

/// Pose of the spoon at one moment.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Pose {
    pub pitch_rad: f64,
    /// Position and velocity along the spoon's axis, m and m/s.
    pub shift_m: f64,
    pub shift_m_s: f64,
}

/// A grain that has left the spoon and falls freely: along the spoon's length at rest, across it,
/// and up from the middle of the level rim.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Flight {
    /// Position at departure, m.
    pub at_m: [f64; 3],
    /// Velocity at departure, m/s.
    pub speed_m_s: [f64; 3],
}

impl Pose {
    /// The flight of a grain that departs from a spoon in this pose.
    pub(super) fn flight(self, departure: &Departure, law: &Law) -> Flight {
        let metres = |v: Vector| [0, 1, 2].map(|k| f64::from(v[k]) * law.diameter_m);
        let x = metres(departure.x);
        let v = metres(departure.v).map(|d| d / law.substep_s);
        let (sin, cos) = libm::sincos(self.pitch_rad);
        // The spoon's frame is rotated about its width and shifted along its own axis.
        let room = |along: f64, up: f64| [along * cos + up * sin, -along * sin + up * cos];
        let [at_x, at_z] = room(x[0] + self.shift_m, x[2]);
        let [speed_x, speed_z] = room(v[0] + self.shift_m_s, v[2]);
        Flight { at_m: [at_x, x[1], at_z], speed_m_s: [speed_x, v[1], speed_z] }
    }
}

impl Flight {
    /// Whether free fall from the point of departure hits the vial's mouth.
    pub(super) fn meets_the_mouth(self, settings: &Settings) -> bool {
        let Self { at_m, speed_m_s } = self;
        let height = at_m[2] + settings.drop_height_mm * 1e-3;
        let rise = speed_m_s[2];
        let fall = (rise + (rise * rise + 2.0 * GRAVITY * height.max(0.0)).sqrt()) / GRAVITY;
        let miss_x = at_m[0] + speed_m_s[0] * fall - settings.vial_offset_mm * 1e-3;
        let miss_y = at_m[1] + speed_m_s[1] * fall;
        libm::hypot(miss_x, miss_y) <= settings.vial_radius_mm * 1e-3
    }
}

/// Pitches at a speed that rises and falls smoothly: pitch(t) = p0 + dp (1 - cos(pi t / T)) / 2.
///
/// Returns the duration, s, and the pose and the spoon's acceleration along its axis at each time.
pub(super) fn incline(
    settings: &Settings,
    [from_deg, to_deg]: [f64; 2],
) -> (f64, impl FnMut(f64) -> (Pose, f64) + use<>) {
    let (start, change) = (from_deg.to_radians(), (to_deg - from_deg).to_radians());
    let duration = (to_deg - from_deg).abs() / settings.pitch_deg_s;
    let motion = move |t: f64| {
        let share = (1.0 - libm::cos(std::f64::consts::PI * (t / duration).min(1.0))) / 2.0;
        (Pose { pitch_rad: start + change * share, ..Pose::default() }, 0.0)
    };
    (duration, motion)
}

/// Moves out along the spoon's axis by the amplitude and back.
///
/// Returns the same as [`incline`]; the times must be those of consecutive substeps.
pub(super) fn shake(
    settings: &Settings,
    law: &Law,
    pitch_deg: f64,
    amplitude_m: f64,
) -> (f64, impl FnMut(f64) -> (Pose, f64) + use<>) {
    let stroke = Move::new(amplitude_m, settings.shake);
    let (half, pitch_rad) = (stroke.duration_s(), pitch_deg.to_radians());
    let (mut shift_m, mut shift_m_s, dt) = (0.0, 0.0, law.substep_s);
    let motion = move |t: f64| {
        let a = if t < half {
            stroke.acceleration_m_s2(t)
        } else {
            -stroke.acceleration_m_s2(t - half)
        };
        shift_m_s += a * dt;
        shift_m += shift_m_s * dt;
        (Pose { pitch_rad, shift_m, shift_m_s }, a)
    };
    (2.0 * half, motion)
}

/// Gravity and inertia in the spoon's frame, diameters per substep squared.
pub(super) fn body(law: &Law, pose: Pose, acceleration_m_s2: f64) -> Vector {
    let inertia = acceleration_m_s2 * law.substep_s * law.substep_s / law.diameter_m;
    let (sin, cos) = libm::sincos(pose.pitch_rad);
    let gravity = f64::from(law.gravity);
    vector((gravity * sin - inertia) as f32, 0.0, (-gravity * cos) as f32)
}
