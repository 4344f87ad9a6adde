//! The heap experiment: from a parameter set and a seed to an angle of repose.
//!
//! Grains pour through a round opening that rises above a fixed round base; surplus grains fall off
//! the rim. Once the heap rests, its angle is measured twice: from the apex, as the published
//! camera does, and from a cone fitted to its flank. Everything is scaled in grain diameters, so
//! the number of grains does not change with their size.

use super::constraints::{Vector, vector};
use super::engine::{Engine, Physical, Physx};
use super::flank::{Cone, SECTORS, cone, cone_deg, sector};
use super::law::{Law, SUBSTEP_S};
use super::mechanisms::Extensions;
use super::physx;
use super::snapshot::{Camera, Snapshot};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

/// Solver semantics.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Compat {
    /// FLIP's own: friction with a memory, so that heaps rest; every parameter acts by one
    /// documented law.
    #[default]
    Physical,
    /// The published engine's: PhysX 5 solid particles, including its inert parameters and its
    /// creep; see `sim/physx/mod.rs`.
    Physx,
}

/// Settings of the heap experiment; stored with every result.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Grains poured. Default 2000.
    pub particles: u32,
    /// Radius of the base, grain diameters. Default 9: 2000 grains cover it and overflow for angles
    /// up to 50 deg.
    pub base_radius_diameters: f64,
    /// Coulomb coefficient of the base. Default 0.8: a rough plate, so that the heap fails and not
    /// its footing. No effect with `compat` physx, where the grains' own coefficient applies at
    /// walls.
    pub base_friction: f64,
    /// Height of the opening above the apex, grain diameters; it rises with the heap. Default 3.
    pub funnel_clearance_diameters: f64,
    /// Radius of the opening, grain diameters. Default 1.8.
    pub funnel_radius_diameters: f64,
    /// Substep of the solver, s. Default 0.00008.
    pub substep_s: f64,
    /// Longest wait for rest after the last grain, s. Default 1. With `compat` physx, whose heaps
    /// creep, the full time is always used.
    pub settle_max_s: f64,
    /// Number of readings of each heap's angle, 1 to 64. Between two readings 15 % more grains are
    /// poured on the heap: they knock as many off the base and form a new top. Default 1.
    #[serde(skip_serializing_if = "is_one")]
    pub readings: u32,
    /// Whether a layer of fixed grains covers the base. Default no: a smooth plate.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub rough_base: bool,
    /// Mechanisms not in the base simulator. Default none.
    #[serde(skip_serializing_if = "Extensions::is_none")]
    pub extensions: Extensions,
    /// Solver semantics. Default physical.
    pub compat: Compat,
    /// Frame of `compat` physx, s. Default 0.001.
    pub frame_s: f64,
    /// Iterations per such frame. Default 16, the engine's.
    pub iterations: u32,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde asks for a reference")]
fn is_one(readings: &u32) -> bool {
    *readings == 1
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            particles: 2000,
            base_radius_diameters: 9.0,
            base_friction: 0.8,
            funnel_clearance_diameters: 3.0,
            funnel_radius_diameters: 1.8,
            substep_s: SUBSTEP_S,
            settle_max_s: 1.0,
            readings: 1,
            rough_base: false,
            extensions: Extensions::default(),
            compat: Compat::Physical,
            frame_s: physx::FRAME_S,
            iterations: physx::ITERATIONS,
        }
    }
}

impl Settings {
    /// The default experiment with a different number of grains: the base scales with its cube
    /// root, so that the grains overflow it as far as in the default. The stream is unchanged.
    pub fn with_particles(particles: u32) -> Self {
        let default = Self::default();
        let scale = libm::cbrt(f64::from(particles) / f64::from(default.particles));
        Self { particles, base_radius_diameters: default.base_radius_diameters * scale, ..default }
    }
}

/// One simulated heap.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Repose {
    /// atan(2 h / d_base) from the apex, degrees; mean over the readings.
    pub tip_deg: f64,
    /// Standard deviation of the tip angle over the readings of this heap, degrees; absent for a
    /// single one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tip_sd_deg: Option<f64>,
    /// Slope of a cone fitted between 20 % and 80 % of the height over 12 sectors, degrees; mean
    /// over the readings.
    pub cone_deg: f64,
    /// Change of the cone angle over the last 0.2 s, degrees per second.
    pub creep_deg_per_s: f64,
    /// Root-mean-square speed of the grains at the end, mm/s.
    pub speed_rms_mm_s: f64,
    /// Number of grains that stayed on the base.
    pub particles_on_base: u32,
    /// Mean overlap of overlapping grains, in diameters.
    pub overlap_mean: f64,
    /// Largest overlap, in diameters.
    pub overlap_max: f64,
    /// Simulated time, s.
    pub simulated_s: f64,
}

/// Why a heap has no angle.
#[derive(Debug, Clone, PartialEq, thiserror::Error, Serialize, Deserialize)]
pub enum Refusal {
    /// The base is not covered.
    #[error(
        "the pile covers {covered} of {sectors} sectors of the base rim: pour more particles or use a smaller base"
    )]
    BaseNotCovered {
        /// Sectors of the rim that hold a grain.
        covered: u32,
        /// Total number of sectors.
        sectors: u32,
    },
    /// The simulation left the range where its numbers are meaningful.
    #[error("the simulation diverged at {at_s} s: {cause}")]
    Diverged {
        /// Simulated time, s.
        at_s: f64,
        /// The symptom.
        cause: String,
    },
}

/// Time over which rest is checked and creep measured, s.
const HOLD_S: f64 = 0.2;
/// Grains slower than this (root mean square) count as resting, m/s.
const REST_RMS_M_S: f64 = 0.0005;

/// Share of the grains that is poured again between two readings of a heap: a third of those on it.
/// With fewer, later readings are steeper than the first, as after a pour that trickles out; with
/// this share, by 0.1 to 0.4 deg.
const RENEWAL: f64 = 0.15;
/// Share of the grains poured through the wide opening.
const QUICK: f64 = 0.6;
/// Steps between two checks for grains that fell off the base.
pub(super) const DEPARTURE_CHECK: u32 = 16;

/// Pours, waits until the heap rests, and measures. Same inputs, same bytes.
///
/// ```text
/// AoR = atan(2 h / d_base)      h = D - |p_apex - p_tip|
/// ```
///
/// with D the height of the opening above the base and p_tip on the axis at the opening, at its
/// current height: h is the height of the apex. The publication prints `2 h / d_base` without the
/// arctangent; its numbers are in degrees, so the arctangent is taken.
///
/// # Errors
/// [`Refusal`] if the heap has no angle: a base that is not covered, or a solver that diverged.
pub fn repose(set: &ParameterSet, settings: &Settings, seed: u64) -> Result<Repose, Refusal> {
    pile(set, settings, seed, None).map(|pile| pile.repose)
}

/// [`repose`] of grains that follow `law`; `settings` must have the base friction and substep the
/// law was made with.
pub(super) fn repose_under(law: Law, settings: &Settings, seed: u64) -> Result<Repose, Refusal> {
    repose_of(Physical::under(law, settings), settings, seed)
}

/// A heap and the positions of its grains.
#[derive(Debug, Clone, PartialEq)]
pub struct Pile {
    /// The measurement.
    pub repose: Repose,
    /// The grains at the end.
    pub snapshot: Snapshot,
}

/// Like [`repose`], also returning the positions of the grains; `camera` watches them during the
/// simulation.
///
/// # Errors
/// As [`repose`].
pub fn pile(
    set: &ParameterSet,
    settings: &Settings,
    seed: u64,
    camera: Option<Camera>,
) -> Result<Pile, Refusal> {
    match settings.compat {
        Compat::Physical => {
            Heap { engine: Physical::new(set, settings), settings, steps: 0, camera }.run(seed)
        }
        Compat::Physx => {
            Heap { engine: Physx::new(set, settings), settings, steps: 0, camera }.run(seed)
        }
    }
}

/// [`repose`] of what an engine computes.
pub(super) fn repose_of<E: Engine>(
    engine: E,
    settings: &Settings,
    seed: u64,
) -> Result<Repose, Refusal> {
    Heap { engine, settings, steps: 0, camera: None }.run(seed).map(|pile| pile.repose)
}

/// The heap of an engine, and the cone through its flank, after a single reading.
pub(super) fn heap_of<E: Engine>(
    engine: E,
    settings: &Settings,
    seed: u64,
) -> Result<(Repose, Cone, E), Refusal> {
    let mut heap = Heap { engine, settings, steps: 0, camera: None };
    heap.pour(seed)?;
    heap.settle()?;
    let repose = heap.measure()?;
    Ok((repose, cone(&heap.engine.heap(), settings.base_radius_diameters), heap.engine))
}

struct Heap<'a, E> {
    engine: E,
    settings: &'a Settings,
    steps: u32,
    camera: Option<Camera>,
}

impl<E: Engine> Heap<'_, E> {
    fn run(mut self, seed: u64) -> Result<Pile, Refusal> {
        let mut rng = self.pour(seed)?;
        self.settle()?;
        let mut repose = self.measure()?;
        let mut angles = vec![[repose.tip_deg, repose.cone_deg]];
        let renewal = (RENEWAL * f64::from(self.settings.particles)) as usize;
        for _ in 1..self.settings.readings {
            self.stream(&mut rng, renewal, renewal, self.settings.funnel_radius_diameters as f32)?;
            self.settle()?;
            angles.push(self.angles());
        }
        if self.settings.readings > 1 {
            let n = angles.len() as f64;
            let sum = |of: &dyn Fn(&[f64; 2]) -> f64| angles.iter().map(of).sum::<f64>();
            repose.tip_deg = sum(&|angle| angle[0]) / n;
            repose.cone_deg = sum(&|angle| angle[1]) / n;
            repose.tip_sd_deg =
                Some((sum(&|angle| (angle[0] - repose.tip_deg).powi(2)) / (n - 1.0)).sqrt());
            repose.simulated_s = self.elapsed_s();
        }
        Ok(Pile { repose, snapshot: self.engine.snapshot(self.elapsed_s()) })
    }

    fn advance(&mut self, steps: u32) -> Result<(), Refusal> {
        match &self.camera {
            None => self.engine.advance(steps),
            Some(camera) => {
                let step_s = self.engine.scales().step_s;
                for step in 0..steps {
                    self.engine.step();
                    if step % DEPARTURE_CHECK == 0 {
                        self.engine.drop_departed();
                    }
                    if camera.is_due(self.steps + step, step_s) {
                        let time_s = f64::from(self.steps + step) * step_s;
                        (camera.see)(self.engine.snapshot(time_s));
                    }
                }
            }
        }
        self.steps += steps;
        match self.engine.fault() {
            Some(cause) => Err(Refusal::Diverged { at_s: self.elapsed_s(), cause }),
            None => Ok(()),
        }
    }

    fn elapsed_s(&self) -> f64 {
        f64::from(self.steps) * self.engine.scales().step_s
    }

    /// The first grains, which end up inside or below, are poured quickly through a wide opening;
    /// those that shape the heap, through the narrow one. Layers leave the opening at the speed of
    /// a free-flowing orifice, sqrt(g D). The opening rises with the apex: grains that fall far
    /// would dig into a heap that is only tens of grains wide, which does not affect a heap of
    /// hundreds.
    fn pour(&mut self, seed: u64) -> Result<Pcg64Mcg, Refusal> {
        let mut rng = Pcg64Mcg::seed_from_u64(derive(seed, &[0x0EAF]));
        let narrow = self.settings.funnel_radius_diameters as f32;
        let wide = narrow.max(self.settings.base_radius_diameters as f32 / 3.0);
        let all = self.settings.particles as usize;
        let quick = (QUICK * all as f64) as usize;
        let poured = self.stream(&mut rng, quick, all, wide)?;
        self.stream(&mut rng, all - poured, all - poured, narrow)?;
        Ok(rng)
    }

    /// Pours layer after layer until at least `grains` have left the opening, at most `most`;
    /// returns how many did.
    fn stream(
        &mut self,
        rng: &mut Pcg64Mcg,
        grains: usize,
        most: usize,
        radius: f32,
    ) -> Result<usize, Refusal> {
        let speed = (self.engine.scales().gravity * 2.0 * radius).sqrt();
        let per_layer = (1.15 / speed).ceil() as u32;
        let mut poured = 0;
        while poured < grains {
            let height = self.engine.apex() + self.settings.funnel_clearance_diameters as f32;
            for position in layer(rng, radius, height).into_iter().take(most - poured) {
                self.engine.pour(position, vector(0.0, 0.0, -speed));
                poured += 1;
            }
            self.advance(per_layer)?;
        }
        Ok(poured)
    }

    fn settle(&mut self) -> Result<(), Refusal> {
        let scales = self.engine.scales();
        let slice = scales.steps(0.01).max(1);
        let fall =
            (2.0 * self.settings.funnel_clearance_diameters * scales.diameter_m / 9.81).sqrt();
        self.advance(scales.steps(fall))?;
        let limit = self.steps + scales.steps(self.settings.settle_max_s);
        let may_stop = self.settings.compat == Compat::Physical;
        let mut calm = 0;
        while calm < 10 && self.steps < limit {
            self.advance(slice)?;
            let rests = scales.speed_m_s(self.engine.speed_rms()) < REST_RMS_M_S;
            calm = if may_stop && rests { calm + 1 } else { 0 };
        }
        Ok(())
    }

    fn measure(&mut self) -> Result<Repose, Refusal> {
        let scales = self.engine.scales();
        let base = self.settings.base_radius_diameters;
        let before = cone_deg(&self.engine.heap(), base);
        self.advance(scales.steps(HOLD_S))?;
        self.check_cover()?;
        let [tip_deg, cone] = self.angles();
        let (overlap_mean, overlap_max) = self.engine.overlaps();
        Ok(Repose {
            tip_deg,
            tip_sd_deg: None,
            cone_deg: cone,
            creep_deg_per_s: (cone - before) / HOLD_S,
            speed_rms_mm_s: scales.speed_m_s(self.engine.speed_rms()) * 1e3,
            particles_on_base: self.engine.heap().len() as u32,
            overlap_mean,
            overlap_max,
            simulated_s: self.elapsed_s(),
        })
    }

    /// Tip angle and cone angle of the heap in its current state, degrees.
    fn angles(&self) -> [f64; 2] {
        let (heap, base) = (self.engine.heap(), self.settings.base_radius_diameters);
        let height = heap.iter().fold(0.0f64, |top, x| top.max(f64::from(x[2]) + f64::from(x[3])));
        [libm::atan(2.0 * height / (2.0 * base)).to_degrees(), cone_deg(&heap, base)]
    }

    /// Checks that every sector of the outermost two diameters holds a grain; otherwise the heap is
    /// not as wide as its base.
    fn check_cover(&self) -> Result<(), Refusal> {
        let mut seen = [false; SECTORS];
        let inner = self.settings.base_radius_diameters as f32 - 2.0;
        for x in self.engine.heap().iter().filter(|x| x[0] * x[0] + x[1] * x[1] >= inner * inner) {
            seen[sector([f64::from(x[0]), f64::from(x[1])])] = true;
        }
        match seen.iter().filter(|s| **s).count() {
            SECTORS => Ok(()),
            covered => {
                Err(Refusal::BaseNotCovered { covered: covered as u32, sectors: SECTORS as u32 })
            }
        }
    }
}

/// Positions of one layer: a hexagonal lattice over the opening, randomly rotated and shifted.
pub(super) fn layer(rng: &mut Pcg64Mcg, radius: f32, height: f32) -> Vec<Vector> {
    let spacing = 1.12f32;
    let (sin, cos) = libm::sincosf(rng.random_range(0.0..std::f32::consts::TAU));
    let shift = [rng.random_range(0.0..spacing), rng.random_range(0.0..spacing)];
    let mut positions = Vec::new();
    let rows = (radius / spacing) as i32 + 2;
    for row in -rows..=rows {
        for column in -rows..=rows {
            let x = (column as f32 + 0.5 * (row & 1) as f32) * spacing + shift[0];
            let y = row as f32 * spacing * 0.866 + shift[1];
            let (x, y) = (x * cos - y * sin, x * sin + y * cos);
            if x * x + y * y <= radius * radius {
                positions.push(vector(x, y, height + rng.random_range(-0.02..0.02f32)));
            }
        }
    }
    positions
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_layer_holds_no_overlapping_grains() {
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        for _ in 0..20 {
            let grains = layer(&mut rng, 3.0, 18.0);
            assert!(grains.len() >= 15, "{}", grains.len());
            for (i, a) in grains.iter().enumerate() {
                for b in &grains[..i] {
                    let d2: f32 = (0..3).map(|k| (a[k] - b[k]) * (a[k] - b[k])).sum();
                    assert!(d2 > 1.0);
                }
            }
        }
    }

    #[test]
    fn a_heap_that_is_read_again_begins_like_one_that_is_not_and_stays_about_as_steep() {
        let heap = |readings, seed| {
            let settings = Settings { readings, ..Settings::with_particles(600) };
            repose(&ParameterSet::default(), &settings, seed).unwrap()
        };
        let [once, again] =
            [1, 4].map(|readings| (1..=6).map(|seed| heap(readings, seed)).collect::<Vec<_>>());
        for (a, b) in once.iter().zip(&again) {
            assert_eq!(
                (a.creep_deg_per_s, a.overlap_mean, a.tip_sd_deg),
                (b.creep_deg_per_s, b.overlap_mean, None)
            );
            assert!(
                b.simulated_s > a.simulated_s
                    && b.tip_sd_deg.is_some_and(|sd| sd > 0.0 && sd < 6.0),
                "{b:?}"
            );
        }
        let mean = |heaps: &[Repose]| {
            heaps.iter().map(|heap| heap.tip_deg).sum::<f64>() / heaps.len() as f64
        };
        // A single reading of such a small heap scatters by about 2 deg.
        assert!((mean(&once) - mean(&again)).abs() < 3.0, "{} {}", mean(&once), mean(&again));
        assert_eq!(heap(4, 3), again[2]);
    }

    #[test]
    fn too_few_grains_are_refused_with_what_to_do() {
        let settings = Settings { particles: 20, ..Settings::default() };
        let refusal = repose(&ParameterSet::default(), &settings, 1).unwrap_err();
        assert!(refusal.to_string().contains("pour more particles"), "{refusal}");
    }
}
