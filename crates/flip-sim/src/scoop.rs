//! Scooping: a spoon is lowered into a bed of powder, pushed through it and lifted, so that a
//! weighing starts from a real heap.
//!
//! Solved in the frame of the trough; the spoon is a moving wall.

use super::constraints::{V3, Vector, choose, sub, vector};
use super::dispense::{self, Dispenser};
use super::grains::Grains;
use super::lanes::{Lanes, Mask};
use super::law::Law;
use super::mechanisms::Site;
use super::repose::Refusal;
use super::snapshot::Camera;
use super::walls::{Bowl, Shape, Touch, Wall};
use flip_core::domain::FieldError;
use flip_core::domain::motion::{MotionLimits, Move};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

/// Settings of the bed and of the spoon's path through it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// The spoon and the steps after scooping; `particles` is not used.
    pub spoon: dispense::Settings,
    /// Depth of the bed, mm. Default 5.
    pub bed_depth_mm: f64,
    /// Depth of the rim below the surface of the bed during the push, mm. Default 2: at a depth of
    /// a few grain diameters a steep powder does not flow into the spoon.
    pub immersion_mm: f64,
    /// Length of the push, mm. Default 8.
    pub push_mm: f64,
    /// Clearance between the spoon and the sides of the trough, mm. Default 2.
    pub margin_mm: f64,
    /// Limits of the spoon's motion. Default [`MotionLimits::PAPER`].
    pub motion: MotionLimits,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            spoon: dispense::Settings::default(),
            bed_depth_mm: 5.0,
            immersion_mm: 2.0,
            push_mm: 8.0,
            margin_mm: 2.0,
            motion: MotionLimits::PAPER,
        }
    }
}

/// A filled spoon and the scooped mass.
#[derive(Debug, Clone)]
pub struct Scooped {
    /// The spoon over the vial, level and at rest.
    pub dispenser: Dispenser,
    /// Mass in the bed before scooping, mg.
    pub bed_mg: f64,
    /// Mass scooped, mg.
    pub taken_mg: f64,
    /// Simulated time, s.
    pub simulated_s: f64,
}

/// Why scooping failed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Failure {
    /// The spoon would touch the bottom, or the bed would have no sides.
    #[error(transparent)]
    Settings(#[from] FieldError),
    /// The simulation left the range where its numbers are meaningful.
    #[error(transparent)]
    Diverged(#[from] Refusal),
}

/// Minimum distance of the spoon from the floor and the sides, grain diameters, so that a grain
/// between them is not squeezed.
const CLEARANCE: f64 = 2.5;
/// Time for the bed, and for the lifted powder, to come to rest, s.
const REST_S: f64 = 0.15;
/// Spacing of the lattice from which the bed is rained, grain diameters.
const SPACING: f64 = 1.12;
/// Volume of a rained bed per grain, in grain diameters cubed: a packing fraction of 0.58.
const VOLUME_PER_GRAIN: f64 = std::f64::consts::PI / 6.0 / 0.58;

/// Scoops. Same inputs, same bytes. The cost grows with the volume of the bed: tens of thousands of
/// grains at the default size.
///
/// # Errors
/// [`Failure`]: settings in which the spoon would touch the trough, or a solver that diverged.
pub fn scoop(
    set: &ParameterSet,
    settings: &Settings,
    seed: u64,
    camera: Option<Camera>,
) -> Result<Scooped, Failure> {
    let spoon = &settings.spoon;
    let law = Law::new(set, spoon.friction, spoon.substep_s).extended(
        &spoon.extensions,
        set,
        Site::Spoon,
    );
    let mut bed = Bed::new(law, settings, camera)?;
    let grain_mg = set.particle_mass_ug() / 1000.0;
    bed.fill(seed)?;
    let bed_mg = bed.grains.mass() * grain_mg;
    let surface = bed.surface();
    let above = surface + bed.trough.bowl.semi_axes[2] + 2.0;
    bed.trough.at = [-0.5 * bed.diameters(settings.push_mm), 0.0, above];
    let depth = surface - bed.diameters(settings.immersion_mm);
    bed.go([0.0, 0.0, depth - above])?;
    bed.go([bed.diameters(settings.push_mm), 0.0, 0.0])?;
    bed.go([0.0, 0.0, above - depth])?;
    bed.rest(REST_S)?;
    let dispenser = Dispenser::empty(set, spoon).holding(bed.held());
    let taken_mg = dispenser.spoon_mg();
    Ok(Scooped { dispenser, bed_mg, taken_mg, simulated_s: bed.elapsed_s() })
}

/// A trough open at the top, with its floor at z = 0 and its middle at the origin, and a spoon in
/// it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Trough {
    bowl: Bowl,
    /// Middle of the spoon's rim.
    at: [f32; 3],
    /// The spoon's velocity, diameters per substep.
    velocity: [f32; 3],
    /// Half of the trough's length and width.
    half: [f32; 2],
}

impl Wall for Trough {
    #[inline(always)]
    fn touch<L: Lanes>(&self, p: V3<L>) -> Touch<L> {
        let (zero, one, radius) = (L::splat(0.0), L::splat(1.0), L::splat(0.5));
        let mut nearest = Touch::still(p[2] - radius, [zero, zero, one]);
        for axis in 0..2 {
            let side = L::select(p[axis].below(zero), one, zero - one);
            let gap = L::splat(self.half[axis]) + side * p[axis] - radius;
            let mut normal = [zero; 3];
            normal[axis] = side;
            nearest = nearer(nearest, Touch::still(gap, normal));
        }
        let at = [L::splat(self.at[0]), L::splat(self.at[1]), L::splat(self.at[2])];
        let velocity =
            [L::splat(self.velocity[0]), L::splat(self.velocity[1]), L::splat(self.velocity[2])];
        nearer(nearest, Touch { velocity, ..self.bowl.shell(sub(p, at)) })
    }

    fn has_left(&self, p: Vector) -> bool {
        p[2] < -1.0
    }
}

/// The nearer of two walls.
#[inline(always)]
fn nearer<L: Lanes>(a: Touch<L>, b: Touch<L>) -> Touch<L> {
    let b_is: Mask = b.gap.below(a.gap);
    Touch {
        gap: L::select(b_is, b.gap, a.gap),
        normal: choose(b_is, b.normal, a.normal),
        velocity: choose(b_is, b.velocity, a.velocity),
    }
}

struct Bed<'a> {
    law: Law,
    settings: &'a Settings,
    trough: Trough,
    grains: Grains,
    substeps: u32,
    camera: Option<Camera>,
}

impl<'a> Bed<'a> {
    fn new(law: Law, settings: &'a Settings, camera: Option<Camera>) -> Result<Self, FieldError> {
        let mm = law.diameter_m * 1e3;
        let [a, b, c] = settings.spoon.semi_axes_mm;
        let clear = CLEARANCE * mm;
        let least = c + settings.immersion_mm + clear;
        // Written so that NaN is rejected too.
        if !(settings.bed_depth_mm >= least && settings.bed_depth_mm <= 50.0) {
            let message = format!(
                "must be from {least:.2} mm (spoon depth {c}, immersion {} and {CLEARANCE} grains) to 50 mm, got {}",
                settings.immersion_mm, settings.bed_depth_mm
            );
            return Err(FieldError::new("bed_depth_mm", message));
        }
        if !(settings.margin_mm >= clear && settings.margin_mm <= 50.0) {
            let message = format!("must be from {clear:.2} to 50 mm, got {}", settings.margin_mm);
            return Err(FieldError::new("margin_mm", message));
        }
        if !(settings.push_mm > 0.0 && settings.push_mm <= 200.0) {
            return Err(FieldError::new(
                "push_mm",
                format!("must be above 0, up to 200 mm, got {}", settings.push_mm),
            ));
        }
        let half = [a + settings.push_mm / 2.0 + settings.margin_mm, b + settings.margin_mm];
        let trough = Trough {
            bowl: Bowl::new([a, b, c].map(|axis| (axis / mm) as f32)),
            at: [0.0, 0.0, 1e4],
            velocity: [0.0; 3],
            half: half.map(|length| (length / mm) as f32),
        };
        Ok(Self { law, settings, trough, grains: Grains::default(), substeps: 0, camera })
    }

    fn diameters(&self, mm: f64) -> f32 {
        (mm * 1e-3 / self.law.diameter_m) as f32
    }

    fn elapsed_s(&self) -> f64 {
        f64::from(self.substeps) * self.law.substep_s
    }

    /// Rains grains from a loose lattice until the bed has the requested depth.
    fn fill(&mut self, seed: u64) -> Result<(), Refusal> {
        let mut rng = Pcg64Mcg::seed_from_u64(derive(seed, &[0x5C00]));
        let [length, width] = self.trough.half.map(|half| 2.0 * f64::from(half));
        let depth = self.settings.bed_depth_mm * 1e-3 / self.law.diameter_m;
        let mut left = (length * width * depth / VOLUME_PER_GRAIN) as u32;
        let [columns, rows] = [length, width].map(|side| ((side - 1.0) / SPACING) as u32 + 1);
        let mut layer = 0;
        while left > 0 {
            for k in 0..(columns * rows).min(left) {
                let place = |index: u32, count: u32| {
                    (f64::from(index) - f64::from(count - 1) / 2.0) * SPACING
                };
                let mut at = |centre: f64| centre as f32 + rng.random_range(-0.05..0.05f32);
                let (x, y) = (at(place(k % columns, columns)), at(place(k / columns, rows)));
                let z = 0.6 + (f64::from(layer) * SPACING) as f32;
                self.grains.pour(&self.law, vector(x, y, z), [0.0; 4]);
            }
            left -= (columns * rows).min(left);
            layer += 1;
        }
        let fall_m = f64::from(layer) * SPACING * self.law.diameter_m;
        self.rest((2.0 * fall_m / super::law::GRAVITY).sqrt() + REST_S)
    }

    /// Height below which 98 % of the grains lie, plus a radius.
    fn surface(&self) -> f32 {
        let mut heights: Vec<f32> = self.grains.centres().iter().map(|x| x[2]).collect();
        heights.sort_unstable_by(f32::total_cmp);
        heights[heights.len() * 98 / 100] + 0.5
    }

    fn rest(&mut self, seconds: f64) -> Result<(), Refusal> {
        self.trough.velocity = [0.0; 3];
        (0..self.law.substeps(seconds)).for_each(|_| self.substep());
        self.check()
    }

    /// Moves the spoon by a distance, from rest to rest.
    fn go(&mut self, by: [f32; 3]) -> Result<(), Refusal> {
        let length = by.iter().map(|x| x * x).sum::<f32>().sqrt();
        let way = Move::new(f64::from(length) * self.law.diameter_m, self.settings.motion);
        let per_substep = self.law.substep_s / self.law.diameter_m;
        let (start, mut speed, mut gone) = (self.trough.at, 0.0f64, 0.0f64);
        for substep in 0..self.law.substeps(way.duration_s()) {
            let t = f64::from(substep) * self.law.substep_s;
            speed += way.acceleration_m_s2(t) * self.law.substep_s * per_substep;
            gone += speed;
            let share = (gone / f64::from(length)).min(1.0) as f32;
            let next: [f32; 3] = std::array::from_fn(|k| start[k] + by[k] * share);
            self.trough.velocity = std::array::from_fn(|k| next[k] - self.trough.at[k]);
            // Contacts are computed at the predicted positions, so the spoon is placed where it
            // will be then.
            self.trough.at = next;
            self.substep();
        }
        self.check()
    }

    fn substep(&mut self) {
        let gravity = vector(0.0, 0.0, -self.law.gravity);
        self.grains.substep(&self.law, gravity, &Shape::Trough(self.trough));
        self.substeps += 1;
        if let Some(camera) = &self.camera {
            camera.look(&self.grains, &self.law, self.substeps);
        }
    }

    fn check(&self) -> Result<(), Refusal> {
        self.grains
            .fault()
            .map_or(Ok(()), |cause| Err(Refusal::Diverged { at_s: self.elapsed_s(), cause }))
    }

    /// Centres and velocities of the grains on the spoon, in its frame, in the order of pouring.
    fn held(&self) -> impl Iterator<Item = [Vector; 2]> {
        let at = self.trough.at;
        let grains = self
            .grains
            .ids()
            .iter()
            .zip(self.grains.centres().iter().zip(self.grains.velocities()));
        let mut held: Vec<(u32, [Vector; 2])> = grains
            .map(|(id, (x, v))| (*id, [vector(x[0] - at[0], x[1] - at[1], x[2] - at[2]), *v]))
            .filter(|(_, [x, _])| self.trough.bowl.holds([x[0], x[1], x[2]]))
            .collect();
        held.sort_unstable_by_key(|(id, _)| *id);
        held.into_iter().map(|(_, grain)| grain)
    }
}

#[cfg(test)]
mod tests {
    use super::super::law::SUBSTEP_S;
    use super::*;
    use flip_core::domain::bench::Action;

    fn small() -> Settings {
        let spoon = dispense::Settings { semi_axes_mm: [2.2, 1.6, 1.0], ..Default::default() };
        Settings {
            spoon,
            bed_depth_mm: 2.5,
            immersion_mm: 0.6,
            push_mm: 3.0,
            margin_mm: 1.0,
            ..Default::default()
        }
    }

    /// Free-flowing: such a small spoon would push a steep powder along.
    fn set() -> ParameterSet {
        ParameterSet::default().with("friction", 0.2).unwrap()
    }

    #[test]
    fn a_grain_lies_as_still_in_a_spoon_that_moves_steadily_as_in_one_at_rest() {
        let law = Law::new(&set(), 0.4, SUBSTEP_S);
        let strays = |speed: f32| {
            let mut trough = Trough {
                bowl: Bowl::new([16.0, 16.0, 4.0]),
                at: [0.0, 0.0, 20.0],
                velocity: [speed, 0.0, 0.0],
                half: [100.0; 2],
            };
            let mut grains = Grains::default();
            grains.pour(&law, vector(0.0, 0.0, 16.5), vector(speed, 0.0, 0.0));
            for _ in 0..3000 {
                trough.at[0] += speed;
                let gravity = vector(0.0, 0.0, -law.gravity);
                grains.substep(&law, gravity, &Shape::Trough(trough));
            }
            (grains.centres()[0][0] - trough.at[0]).abs()
        };
        // 30 diameters of way; an anchor left behind would drag the grain to where the bowl's slope
        // is its friction.
        assert_eq!(strays(0.0), 0.0);
        assert!(strays(0.01) < 0.05, "{} diameters", strays(0.01));
    }

    #[test]
    fn a_scooped_spoon_holds_about_its_bowl_and_can_be_poured() {
        let Scooped { mut dispenser, bed_mg, taken_mg, .. } =
            scoop(&set(), &small(), 3, None).unwrap();
        // Half an ellipsoid at a packing fraction of 0.6, minus the rim, plus the heap.
        let bowl_mm3 = 2.0 / 3.0 * std::f64::consts::PI * 2.2 * 1.6 * 1.0;
        let grain_mm3 = std::f64::consts::PI / 6.0 * 0.27f64.powi(3);
        let level_mg = 0.6 * bowl_mm3 / grain_mm3 * set().particle_mass_ug() / 1000.0;
        assert!(taken_mg > 0.6 * level_mg && taken_mg < 1.8 * level_mg, "{taken_mg} of {level_mg}");
        assert!(taken_mg < 0.5 * bed_mg);
        assert_eq!(dispenser.step(Action::default()), dispense::Poured::default());
        let poured: f64 = (0..6)
            .map(|_| dispenser.step(Action::once(8.0, 8.0)))
            .map(|poured| poured.vial_mg + poured.spilled_mg)
            .sum();
        assert!(
            poured > 0.3 * taken_mg && (dispenser.spoon_mg() + poured - taken_mg).abs() < 1e-6,
            "{poured}"
        );
        assert_eq!(dispenser.fault(), None);
    }

    #[test]
    fn a_spoon_that_would_touch_the_floor_is_refused_by_name() {
        let shallow = Settings { bed_depth_mm: 1.9, ..small() };
        let failure = scoop(&set(), &shallow, 3, None).unwrap_err();
        assert!(
            matches!(&failure, Failure::Settings(error) if error.field == "bed_depth_mm"),
            "{failure}"
        );
        assert!(scoop(&set(), &Settings { margin_mm: f64::NAN, ..small() }, 3, None).is_err());
    }

    #[test]
    fn the_shell_is_as_far_from_outside_as_from_inside() {
        use crate::lanes::{Portable, WIDTH};
        let bowl = Bowl::new([10.0, 10.0, 10.0]);
        let gap = |r: f32| {
            let touch = bowl.shell([0.6 * r, 0.0, -0.8 * r].map(Portable::splat));
            let mut lanes = [0.0; WIDTH];
            touch.gap.store(&mut lanes);
            let (gap, mut z) = (lanes[0], [0.0; WIDTH]);
            touch.normal[2].store(&mut z);
            (gap, z[0])
        };
        assert!(
            gap(9.5).0.abs() < 1e-4 && (gap(9.5).1 - 0.8).abs() < 1e-5,
            "inside pushes up: {:?}",
            gap(9.5)
        );
        assert!(
            gap(10.5).0.abs() < 1e-4 && (gap(10.5).1 + 0.8).abs() < 1e-5,
            "outside pushes down: {:?}",
            gap(10.5)
        );
    }
}
