//! The dosing experiment: a filled spoon over a vial, one action at a time.
//!
//! The spoon is solved in its own frame: pitching rotates gravity, shaking adds the inertial force
//! of its acceleration. A grain that leaves over the rim falls freely in the lab frame, and counts
//! as in the vial if it hits the mouth.

mod motion;
pub mod outside;

use super::constraints::{Vector, vector};
use super::film::Recorder;
use super::grains::Grains;
use super::law::{Law, SUBSTEP_S};
use super::mechanisms::{Extensions, Site};
use super::snapshot::{Camera, Snapshot};
use super::walls::{Bowl, Shape};
use flip_core::domain::bench::{Action, PitchLimits};
use flip_core::domain::bench_check::ShakeCalibration;
use flip_core::domain::motion::{MotionLimits, Move};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
pub(super) use motion::{Flight, Pose};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

/// Settings of the spoon, its motion and the vial; stored with every result.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Grains in the spoon at the start. Default 2500, about 37 mg.
    pub particles: u32,
    /// Semi-axes of the bowl along its length, width and depth, mm. Default 5, 3.5, 2.
    pub semi_axes_mm: [f64; 3],
    /// Coulomb coefficient of the spoon. Default 0.4.
    pub friction: f64,
    /// Range of the pitch.
    pub pitch: PitchLimits,
    /// Angular speed of pitching, deg/s. Default 60.
    pub pitch_deg_s: f64,
    /// Limits of the shake. Default [`MotionLimits::BRISK`].
    pub shake: MotionLimits,
    /// Radius of the vial's mouth, mm. Default 9 (a 20 ml vial).
    pub vial_radius_mm: f64,
    /// Distance of the mouth's axis from the spoon's middle along its length at rest, mm. Default
    /// 10: the tip, at 5 mm, shakes by up to 16 mm.
    pub vial_offset_mm: f64,
    /// Height of the level spoon's rim above the mouth, mm. Default 10.
    pub drop_height_mm: f64,
    /// Substep of the solver, s. Default 0.00008.
    pub substep_s: f64,
    /// Longest wait for the powder to rest after a motion, s. Default 0.5.
    pub settle_max_s: f64,
    /// Mechanisms not in the base simulator. Default none.
    #[serde(skip_serializing_if = "Extensions::is_none")]
    pub extensions: Extensions,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            particles: 2500,
            semi_axes_mm: [5.0, 3.5, 2.0],
            friction: 0.4,
            pitch: PitchLimits::WIDE,
            pitch_deg_s: 60.0,
            shake: MotionLimits::BRISK,
            vial_radius_mm: 9.0,
            vial_offset_mm: 10.0,
            drop_height_mm: 10.0,
            substep_s: SUBSTEP_S,
            settle_max_s: 0.5,
            extensions: Extensions::default(),
        }
    }
}

impl Settings {
    /// The same spoon on an arm whose executed shakes were measured: a shake reaches the peak speed
    /// measured for its executed amplitude.
    ///
    /// ```text
    /// s = sum(peak top) / sum(top^2)       top: of the move over the executed amplitude within the present limits
    /// ```
    ///
    /// The limits are then those [at this speed](MotionLimits::at_speed).
    ///
    /// Difference: one factor for all amplitudes; an arm with other ratios of its limits is matched
    /// only on average.
    #[must_use]
    pub fn as_executed(self, calibration: &ShakeCalibration) -> Self {
        let limits = self.shake;
        let top_m_s = |executed_mm: f64| Move::new(executed_mm.max(0.0) * 1e-3, limits).top_m_s();
        let pairs =
            calibration.shakes.iter().map(|it| (top_m_s(it.executed_mm), it.peak_mm_s * 1e-3));
        let (both, squares) = pairs.fold((0.0, 0.0), |(both, squares), (top, peak)| {
            (both + peak * top, squares + top * top)
        });
        // Shakes that were not executed carry no information about speed.
        let s = if both > 0.0 && squares > 0.0 { both / squares } else { 1.0 };
        Self { shake: limits.at_speed(s), ..self }
    }
}

/// Result of one action.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Poured {
    /// Mass that fell into the vial during the action, mg.
    pub vial_mg: f64,
    /// Mass that missed the vial, mg.
    pub spilled_mg: f64,
    /// Duration of the motion and of the powder coming to rest, s.
    pub duration_s: f64,
}

/// A spoon filled with a simulated powder, over a vial. Clone it to replay from the same heap.
#[derive(Debug, Clone)]
pub struct Dispenser {
    settings: Settings,
    law: Law,
    bowl: Bowl,
    grains: Grains,
    grain_mg: f64,
    pitch_deg: f64,
    /// In units of a mean grain's mass.
    vial: f64,
    spilled: f64,
    /// How long the last grain of a loose heap falls, s; 0 once it has settled.
    fall_s: f64,
    fault: Option<String>,
    substeps: u32,
    camera: Option<Camera>,
    recorder: Option<Recorder>,
}

/// Substeps between two checks for departed grains and for rest.
const SLICE: u32 = 8;
/// A powder rests if no grain was faster than this for [`REST_S`], m/s.
const REST_M_S: f64 = 0.01;
/// Longest wait for a heap to rest, in waits after a motion.
const SETTLE_WAITS: f64 = 2.0;
/// Time over which rest is judged, s.
const REST_S: f64 = 0.02;

impl Dispenser {
    /// Fills the level spoon and lets the powder rest (under a second of CPU; clone to reuse).
    pub fn new(set: &ParameterSet, settings: &Settings, seed: u64) -> Self {
        Self::empty(set, settings).filled(seed)
    }

    /// The same before the powder has fallen: [`Self::settle`] is what is left to do.
    pub fn loose(set: &ParameterSet, settings: &Settings, seed: u64) -> Self {
        let mut spoon = Self::empty(set, settings);
        spoon.pour(seed);
        spoon
    }

    /// Creates a spoon without powder.
    pub(super) fn empty(set: &ParameterSet, settings: &Settings) -> Self {
        let law = Law::new(set, settings.friction, settings.substep_s);
        let law = law.extended(&settings.extensions, set, Site::Spoon);
        let bowl = Bowl::new(settings.semi_axes_mm.map(|mm| (mm * 1e-3 / law.diameter_m) as f32));
        Self {
            settings: *settings,
            law,
            bowl,
            grains: Grains::default(),
            grain_mg: set.particle_mass_ug() / 1000.0,
            pitch_deg: 0.0,
            vial: 0.0,
            spilled: 0.0,
            fall_s: 0.0,
            fault: None,
            substeps: 0,
            camera: None,
            recorder: None,
        }
    }

    /// The same spoon under a modified law.
    pub(super) fn revised(self, revise: fn(Law) -> Law) -> Self {
        Self { law: revise(self.law), ..self }
    }

    /// Fills the level spoon and lets the powder rest.
    pub(super) fn filled(mut self, seed: u64) -> Self {
        self.pour(seed);
        self.settle();
        self
    }

    /// Puts these grains in the level spoon (centres and velocities in its frame) and lets them
    /// come to rest.
    pub(super) fn holding(mut self, grains: impl Iterator<Item = [Vector; 2]>) -> Self {
        grains.for_each(|[x, v]| self.grains.pour(&self.law, x, v));
        self.rest(SETTLE_WAITS * self.settings.settle_max_s);
        (self.vial, self.spilled) = (0.0, 0.0);
        self
    }

    /// Lets a camera watch the grains in the spoon from now on, in the spoon's frame; none ends that.
    pub fn watch(&mut self, camera: impl Into<Option<Camera>>) {
        self.camera = camera.into();
    }

    /// The grains in the spoon as they are now, in the spoon's frame.
    pub fn snapshot(&self) -> Snapshot {
        let time_s = f64::from(self.substeps) * self.law.substep_s;
        Snapshot::of(self.grains.ids(), self.grains.centres(), self.law.diameter_m, time_s)
    }

    /// Records the grains from now on.
    pub(super) fn record(&mut self, every_s: f64, most: usize) {
        let mut recorder = Recorder::new(every_s, most, self.substeps, &self.law);
        let pose = self.standing();
        recorder.look(&self.grains, &self.law, pose, self.substeps);
        self.recorder = Some(recorder);
    }

    /// What was recorded, with the grains as they lie now at its end.
    pub(super) fn recorded(&mut self) -> Option<Recorder> {
        let (pose, substeps) = (self.standing(), self.substeps);
        let mut recorder = self.recorder.take()?;
        recorder.end(&self.grains, &self.law, pose, substeps);
        Some(recorder)
    }

    fn standing(&self) -> Pose {
        Pose { pitch_rad: self.pitch_deg.to_radians(), ..Pose::default() }
    }

    /// Holds grains in a loose lattice over the middle of the bowl.
    pub(super) fn pour(&mut self, seed: u64) {
        let mut rng = Pcg64Mcg::seed_from_u64(derive(seed, &[0xF111]));
        let [a, b, _] = self.bowl.semi_axes;
        let mut left = self.settings.particles;
        let mut height = 1.0f32;
        while left > 0 {
            for (i, j) in (-40..=40).flat_map(|i| (-40..=40).map(move |j| (i, j))) {
                let jitter = [rng.random_range(-0.05..0.05f32), rng.random_range(-0.05..0.05f32)];
                let (x, y) = (i as f32 * 1.15 + jitter[0], j as f32 * 1.15 + jitter[1]);
                let inside = (x / (0.8 * a)).powi(2) + (y / (0.8 * b)).powi(2) < 1.0;
                if inside && left > 0 {
                    self.grains.pour(&self.law, vector(x, y, height), [0.0; 4]);
                    left -= 1;
                }
            }
            height += 1.15;
        }
        self.fall_s = (2.0 * f64::from(height + self.bowl.semi_axes[2]) * self.law.diameter_m
            / super::law::GRAVITY)
            .sqrt();
    }

    /// Lets a loose heap fall into the level spoon and come to rest; returns how long that took, s.
    /// Grains that roll off meanwhile are not counted.
    pub fn settle(&mut self) -> f64 {
        let fall_s = std::mem::take(&mut self.fall_s);
        self.run(fall_s, |_| (Pose::default(), 0.0));
        let rested_s = self.rest(SETTLE_WAITS * self.settings.settle_max_s);
        (self.vial, self.spilled) = (0.0, 0.0);
        fall_s + rested_s
    }

    /// Carries out one action: first the pitch, clamped to its limits, then each stroke, until the
    /// powder rests after it.
    pub fn step(&mut self, action: Action) -> Poured {
        let limits = self.settings.pitch;
        let pitch =
            (self.pitch_deg + action.incline_change_deg).clamp(limits.lower_deg, limits.upper_deg);
        self.carry_out(pitch, action.executed_shake_mm(), action.strokes)
    }

    /// Makes the next shakes within these limits.
    pub(super) fn shake_within(&mut self, limits: MotionLimits) {
        self.settings.shake = limits;
    }

    /// Returns the spoon to level.
    pub fn level(&mut self) -> Poured {
        self.carry_out(0.0, 0.0, 0)
    }

    /// Pitches to an angle within no limits, then shakes.
    pub(super) fn carry_out(&mut self, pitch_deg: f64, shake_mm: f64, strokes: u32) -> Poured {
        let before = (self.vial, self.spilled);
        let mut duration_s = 0.0;
        if pitch_deg != self.pitch_deg {
            duration_s += self.incline(pitch_deg);
        }
        if shake_mm > 0.0 && strokes > 0 {
            duration_s += self.shake(shake_mm * 1e-3);
        }
        if duration_s > 0.0 {
            duration_s += self.rest(self.settings.settle_max_s);
        }
        if shake_mm > 0.0 {
            for _ in 1..strokes {
                duration_s += self.shake(shake_mm * 1e-3);
                duration_s += self.rest(self.settings.settle_max_s);
            }
        }
        Poured {
            vial_mg: (self.vial - before.0) * self.grain_mg,
            spilled_mg: (self.spilled - before.1) * self.grain_mg,
            duration_s,
        }
    }

    fn incline(&mut self, pitch_deg: f64) -> f64 {
        let (duration, motion) = motion::incline(&self.settings, [self.pitch_deg, pitch_deg]);
        self.run(duration, motion);
        self.pitch_deg = pitch_deg;
        duration
    }

    fn shake(&mut self, amplitude_m: f64) -> f64 {
        let (duration, motion) =
            motion::shake(&self.settings, &self.law, self.pitch_deg, amplitude_m);
        self.run(duration, motion);
        duration
    }

    /// Waits until the powder rests; returns the time taken, s.
    fn rest(&mut self, limit_s: f64) -> f64 {
        let pose = self.standing();
        let (limit, quiet) = (self.law.substeps(limit_s), self.law.substeps(REST_S));
        let (mut spent, mut calm) = (0, 0);
        while spent < limit && calm < quiet && self.fault.is_none() {
            self.run(f64::from(SLICE) * self.law.substep_s, |_| (pose, 0.0));
            spent += SLICE;
            let (fastest, _) = self.grains.speeds();
            calm = if self.law.speed_m_s(fastest) < REST_M_S { calm + SLICE } else { 0 };
        }
        f64::from(spent) * self.law.substep_s
    }

    /// Advances by `duration_s`; `motion` returns the pose and the spoon's acceleration along its
    /// axis at each time.
    fn run(&mut self, duration_s: f64, mut motion: impl FnMut(f64) -> (Pose, f64)) {
        for substep in 0..self.law.substeps(duration_s) {
            let (pose, acceleration) = motion(f64::from(substep) * self.law.substep_s);
            let body = motion::body(&self.law, pose, acceleration);
            self.grains.substep(&self.law, body, &Shape::Bowl(self.bowl));
            if substep % SLICE == SLICE - 1 {
                self.collect(pose);
            }
            if let Some(camera) = &self.camera {
                camera.look(&self.grains, &self.law, self.substeps);
            }
            self.substeps += 1;
            if let Some(recorder) = &mut self.recorder {
                recorder.look(&self.grains, &self.law, pose, self.substeps);
            }
        }
        if self.fault.is_none() {
            self.fault = self.grains.fault();
        }
    }

    fn collect(&mut self, pose: Pose) {
        for departure in self.grains.take_departed(&Shape::Bowl(self.bowl)) {
            let flight = pose.flight(&departure, &self.law);
            let meets = flight.meets_the_mouth(&self.settings);
            match meets {
                true => self.vial += departure.mass(),
                false => self.spilled += departure.mass(),
            }
            if let Some(recorder) = &mut self.recorder {
                recorder.falls(departure.id, flight, meets, self.substeps);
            }
        }
    }

    /// The grains in it.
    #[cfg(test)]
    pub(super) fn grains(&self) -> &Grains {
        &self.grains
    }

    /// The range of its pitch.
    pub fn pitch(&self) -> PitchLimits {
        self.settings.pitch
    }

    /// Current pitch, degrees; positive is tip down.
    pub fn pitch_deg(&self) -> f64 {
        self.pitch_deg
    }

    /// Powder in the vial, mg: the true mass, not the balance's reading.
    pub fn vial_mg(&self) -> f64 {
        self.vial * self.grain_mg
    }

    /// Powder that missed the vial, mg.
    pub fn spilled_mg(&self) -> f64 {
        self.spilled * self.grain_mg
    }

    /// Powder left in the spoon, mg.
    pub fn spoon_mg(&self) -> f64 {
        self.grains.mass() * self.grain_mg
    }

    /// The reason why the simulation is no longer meaningful, if any.
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }
}

/// Mass of the grains in a full spoon of this powder, mg: the largest possible dose.
pub fn capacity_mg(set: &ParameterSet, settings: &Settings) -> f64 {
    f64::from(settings.particles) * set.particle_mass_ug() / 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_core::domain::bench_check::ExecutedShake;

    #[test]
    fn a_shake_has_the_speed_that_was_measured_for_its_amplitude() {
        let usual = Settings::default();
        let top_mm_s = |mm: f64, of| 1e3 * Move::new(mm * 1e-3, of).top_m_s();
        let executed = |commanded_mm: f64| {
            let executed_mm = 0.94 * commanded_mm - 0.1;
            let (planned_mm_s, peak_mm_s) =
                (top_mm_s(commanded_mm, usual.shake), 0.6 * top_mm_s(executed_mm, usual.shake));
            ExecutedShake { commanded_mm, executed_mm, planned_mm_s, peak_mm_s }
        };
        let calibration =
            ShakeCalibration::of([2.0, 4.0, 8.0, 16.0].map(executed).to_vec()).unwrap();
        let found = usual.as_executed(&calibration);
        for shake in &calibration.shakes {
            assert!(
                (top_mm_s(shake.executed_mm, found.shake) / shake.peak_mm_s - 1.0).abs() < 1e-9,
                "{shake:?}"
            );
        }
        assert_eq!(Settings { shake: usual.shake, ..found }, usual);
        let still =
            calibration.shakes.iter().map(|it| ExecutedShake { peak_mm_s: 0.0, ..*it }).collect();
        assert_eq!(usual.as_executed(&ShakeCalibration::of(still).unwrap()), usual);
    }
}
