//! The heap experiment: parameter set and seed in, angle of repose out.
//!
//! Grains pour through a round opening that rises above a fixed round base; what does not find room falls off the rim. When the
//! heap rests, its angle is read twice: from the apex, as the published camera does, and from a cone fitted to its
//! flank. Everything is scaled in grain diameters, so the number of grains does not change with their size.

use super::constraints::{Vector, vector};
use super::grains::Grains;
use super::law::{Law, SUBSTEP_S};
use super::walls::Plate;
use crate::domain::parameters::ParameterSet;
use crate::domain::seed::derive;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

/// Settings of the heap experiment; stored with every result.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = ReposeSettings)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Grains poured. Default 2000.
    pub particles: u32,
    /// Radius of the base, grain diameters. Default 9: 2000 grains cover it and overflow up to 50 deg.
    pub base_radius_diameters: f64,
    /// Coulomb coefficient of the base. Default 0.8: a rough plate, so that the heap fails and not its footing.
    pub base_friction: f64,
    /// Height of the opening above the apex, grain diameters; it rises with the heap. Default 3.
    pub funnel_clearance_diameters: f64,
    /// Radius of the opening, grain diameters. Default 1.8.
    pub funnel_radius_diameters: f64,
    /// Substep of the solver, s. Default 0.00008.
    pub substep_s: f64,
    /// Longest wait for rest after the last grain, s. Default 1.
    pub settle_max_s: f64,
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
        }
    }
}

impl Settings {
    /// The default experiment with another number of grains: the base scales with its cube root, so that the grains overflow it as far
    /// as the default's do. The stream stays as it is.
    pub fn with_particles(particles: u32) -> Self {
        let default = Self::default();
        let scale = (f64::from(particles) / f64::from(default.particles)).cbrt();
        Self { particles, base_radius_diameters: default.base_radius_diameters * scale, ..default }
    }
}

/// One simulated heap.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Repose {
    /// atan(2 h / d_base) from the apex, degrees.
    pub tip_deg: f64,
    /// Slope of a cone fitted between 20 % and 80 % of the height over 12 sectors, degrees.
    pub cone_deg: f64,
    /// Change of the cone angle over the last 0.2 s, degrees per second.
    pub creep_deg_per_s: f64,
    /// Root-mean-square speed of the grains at the end, mm/s.
    pub speed_rms_mm_s: f64,
    /// Grains that stayed on the base.
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
        /// All sectors.
        sectors: u32,
    },
    /// The simulation left the range where its numbers mean anything.
    #[error("the simulation diverged at {at_s} s: {cause}")]
    Diverged {
        /// Simulated time, s.
        at_s: f64,
        /// What was seen.
        cause: String,
    },
}

/// Sectors around the axis for the cone fit and for the cover of the rim.
const SECTORS: usize = 12;
/// Time over which rest is judged and creep measured, s.
const HOLD_S: f64 = 0.2;
/// Grains slower than this (root mean square) count as resting, m/s.
const REST_RMS_M_S: f64 = 0.0005;

/// Share of the grains that come through the wide opening.
const QUICK: f64 = 0.6;
/// Substeps between two looks for grains that fell off the base.
const DEPARTURE_CHECK: u32 = 16;

/// Pour, wait until the heap rests, measure. Same inputs, same bytes.
///
/// ```text
/// AoR = atan(2 h / d_base)      h = D - |p_apex - p_tip|
/// ```
///
/// with D the height of the opening over the base and p_tip on the axis at the opening, wherever it stands: h is the height of the apex.
/// The publication prints `2 h / d_base` without the arctangent; its numbers are degrees, so the arctangent is taken.
///
/// # Errors
/// [`Refusal`] when the heap has no angle: a base that is not covered, or a solver that diverged.
pub fn repose(set: &ParameterSet, settings: &Settings, seed: u64) -> Result<Repose, Refusal> {
    repose_under(Law::new(set, settings.base_friction, settings.substep_s), settings, seed)
}

/// [`repose`] of grains that follow `law`; the settings' base friction and substep are those the law was made with.
pub(super) fn repose_under(law: Law, settings: &Settings, seed: u64) -> Result<Repose, Refusal> {
    let mut heap = Heap::new(law, settings);
    heap.pour(seed)?;
    heap.settle()?;
    heap.measure()
}

struct Heap<'a> {
    law: Law,
    settings: &'a Settings,
    plate: Plate,
    grains: Grains,
    substeps: u32,
}

impl<'a> Heap<'a> {
    fn new(law: Law, settings: &'a Settings) -> Self {
        let plate = Plate { radius: settings.base_radius_diameters as f32 };
        Self { law, settings, plate, grains: Grains::default(), substeps: 0 }
    }

    fn advance(&mut self, substeps: u32) -> Result<(), Refusal> {
        let gravity = vector(0.0, 0.0, -self.law.gravity);
        for substep in 0..substeps {
            self.grains.substep(&self.law, gravity, &self.plate);
            if substep % DEPARTURE_CHECK == 0 {
                self.grains.take_departed(&self.plate);
            }
        }
        self.substeps += substeps;
        match self.grains.fault() {
            Some(cause) => Err(Refusal::Diverged { at_s: self.elapsed_s(), cause }),
            None => Ok(()),
        }
    }

    fn elapsed_s(&self) -> f64 {
        f64::from(self.substeps) * self.law.substep_s
    }

    /// The first grains, which end up inside or below, come quickly through a wide opening; those that shape the heap through the narrow
    /// one. Layers leave the opening at the speed of a free-flowing orifice, sqrt(g D). The opening rises with the apex: grains that fall
    /// far would dig into a heap that is only tens of grains wide, which a heap of hundreds does not feel.
    fn pour(&mut self, seed: u64) -> Result<(), Refusal> {
        let mut rng = Pcg64Mcg::seed_from_u64(derive(seed, &[0x0EAF]));
        let narrow = self.settings.funnel_radius_diameters as f32;
        let wide = narrow.max(self.settings.base_radius_diameters as f32 / 3.0);
        let mut left = self.settings.particles as usize;
        let fill = left - (QUICK * left as f64) as usize;
        while left > 0 {
            let radius = if left > fill { wide } else { narrow };
            let speed = (self.law.gravity * 2.0 * radius).sqrt();
            let per_layer = (1.15 / speed).ceil() as u32;
            let height = self.apex() + self.settings.funnel_clearance_diameters as f32;
            for position in layer(&mut rng, radius, height).into_iter().take(left) {
                self.grains.pour(position, vector(0.0, 0.0, -speed));
                left -= 1;
            }
            self.advance(per_layer)?;
        }
        Ok(())
    }

    /// Height of the highest grain that rests on others, or of the base.
    fn apex(&self) -> f32 {
        let lying = self.grains.centres().iter().zip(self.grains.velocities()).filter(|(_, v)| v[3] >= 2.0);
        lying.fold(0.0, |top, (x, _)| top.max(x[2]))
    }

    fn settle(&mut self) -> Result<(), Refusal> {
        let slice = self.law.substeps(0.01);
        let fall = (2.0 * self.settings.funnel_clearance_diameters * self.law.diameter_m / 9.81).sqrt();
        self.advance(self.law.substeps(fall))?;
        let limit = self.substeps + self.law.substeps(self.settings.settle_max_s);
        let mut calm = 0;
        while calm < 10 && self.substeps < limit {
            self.advance(slice)?;
            let (_, rms) = self.grains.speeds();
            calm = if self.law.speed_m_s(rms) < REST_RMS_M_S { calm + 1 } else { 0 };
        }
        Ok(())
    }

    fn measure(&mut self) -> Result<Repose, Refusal> {
        let before = cone_deg(self.grains.centres(), self.settings.base_radius_diameters);
        self.advance(self.law.substeps(HOLD_S))?;
        self.check_cover()?;
        let base = self.settings.base_radius_diameters;
        let cone = cone_deg(self.grains.centres(), base);
        let height = f64::from(self.grains.centres().iter().fold(0.0f32, |top, x| top.max(x[2]))) + 0.5;
        let (overlap_mean, overlap_max) = self.grains.overlaps();
        let (_, rms) = self.grains.speeds();
        Ok(Repose {
            tip_deg: (2.0 * height / (2.0 * base)).atan().to_degrees(),
            cone_deg: cone,
            creep_deg_per_s: (cone - before) / HOLD_S,
            speed_rms_mm_s: self.law.speed_m_s(rms) * 1e3,
            particles_on_base: self.grains.centres().len() as u32,
            overlap_mean,
            overlap_max,
            simulated_s: self.elapsed_s(),
        })
    }

    /// Every sector of the outermost two diameters must hold a grain, or the heap is not as wide as its base.
    fn check_cover(&self) -> Result<(), Refusal> {
        let mut seen = [false; SECTORS];
        let inner = self.settings.base_radius_diameters as f32 - 2.0;
        for x in self.grains.centres().iter().filter(|x| x[0] * x[0] + x[1] * x[1] >= inner * inner) {
            seen[sector([f64::from(x[0]), f64::from(x[1])])] = true;
        }
        match seen.iter().filter(|s| **s).count() {
            SECTORS => Ok(()),
            covered => Err(Refusal::BaseNotCovered { covered: covered as u32, sectors: SECTORS as u32 }),
        }
    }
}

/// Positions of one layer: a hexagonal lattice over the opening, turned and shifted at random.
pub(super) fn layer(rng: &mut Pcg64Mcg, radius: f32, height: f32) -> Vec<Vector> {
    let spacing = 1.12f32;
    let (sin, cos) = rng.random_range(0.0..std::f32::consts::TAU).sin_cos();
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

fn sector(at: [f64; 2]) -> usize {
    let turn = at[1].atan2(at[0]) / std::f64::consts::TAU + 0.5;
    ((turn * SECTORS as f64) as usize).min(SECTORS - 1)
}

/// Side of a pixel of the height map, grain diameters.
const PIXEL: f64 = 0.25;

/// Slope of the flank as a depth camera from above sees it: the mean surface height of every one-diameter ring in each
/// sector, a least-squares line through the rings between 20 % and 80 % of the apex height, and the mean slope of the
/// sectors as an angle, degrees.
fn cone_deg(x: &[Vector], base_radius: f64) -> f64 {
    let rings = base_radius.ceil() as usize;
    let mut profile = vec![Ring::default(); SECTORS * rings];
    let mut apex = 0.0f64;
    for (at, height) in surface(x, base_radius) {
        let r = at[0].hypot(at[1]);
        if (r as usize) < rings {
            let ring = &mut profile[sector(at) * rings + r as usize];
            *ring = Ring { pixels: ring.pixels + 1.0, radius: ring.radius + r, height: ring.height + height };
        }
        apex = apex.max(height);
    }
    let flank = 0.2 * apex..=0.8 * apex;
    let means = |sector: &[Ring]| -> Vec<[f64; 2]> {
        let seen = sector.iter().filter(|ring| ring.pixels > 0.0);
        let points = seen.map(|ring| [ring.radius / ring.pixels, ring.height / ring.pixels]);
        points.filter(|point| flank.contains(&point[1])).collect()
    };
    let slopes: Vec<f64> = profile.chunks(rings).filter_map(|sector| slope(&means(sector))).collect();
    let mean = slopes.iter().sum::<f64>() / slopes.len().max(1) as f64;
    (-mean).atan().to_degrees()
}

/// Sums over the pixels of one ring in one sector.
#[derive(Debug, Clone, Copy, Default)]
struct Ring {
    pixels: f64,
    radius: f64,
    height: f64,
}

/// Position and height of every pixel of the height map that shows a grain.
pub(super) fn surface(x: &[Vector], base_radius: f64) -> impl Iterator<Item = ([f64; 2], f64)> {
    let half = (base_radius / PIXEL).ceil() as i64 + 2;
    let side = (2 * half + 1) as usize;
    let mut top = vec![f64::NEG_INFINITY; side * side];
    for p in x {
        let centre = [f64::from(p[0]), f64::from(p[1])];
        let [column, row] = centre.map(|c| (c / PIXEL).round() as i64);
        for (i, j) in (-2..=2).flat_map(|i| (-2..=2).map(move |j| (column + i, row + j))) {
            let apart = (i as f64 * PIXEL - centre[0]).powi(2) + (j as f64 * PIXEL - centre[1]).powi(2);
            if apart < 0.25 && i.abs() <= half && j.abs() <= half {
                let pixel = &mut top[(j + half) as usize * side + (i + half) as usize];
                *pixel = pixel.max(f64::from(p[2]) + (0.25 - apart).sqrt());
            }
        }
    }
    let position = move |k: usize| [(k % side) as i64 - half, (k / side) as i64 - half].map(|c| c as f64 * PIXEL);
    top.into_iter().enumerate().filter(|(_, z)| z.is_finite()).map(move |(k, z)| (position(k), z))
}

/// Least-squares slope of height over radius; `None` below three points or without spread.
fn slope(points: &[[f64; 2]]) -> Option<f64> {
    let n = points.len() as f64;
    if n < 3.0 {
        return None;
    }
    let mean = |k: usize| points.iter().map(|p| p[k]).sum::<f64>() / n;
    let (r, z) = (mean(0), mean(1));
    let spread: f64 = points.iter().map(|p| (p[0] - r) * (p[0] - r)).sum();
    (spread > 1e-9).then(|| points.iter().map(|p| (p[0] - r) * (p[1] - z)).sum::<f64>() / spread)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cone_of_grains_has_its_own_angle() {
        for angle in [25.0f64, 35.0, 45.0] {
            let slope = angle.to_radians().tan();
            let mut x = Vec::new();
            for i in -100..=100 {
                for j in -100..=100 {
                    let (px, py) = (f64::from(i) * 0.1, f64::from(j) * 0.1);
                    let r = (px * px + py * py).sqrt();
                    if r <= 10.0 {
                        x.push(vector(px as f32, py as f32, (slope * (10.0 - r)) as f32 - 0.5));
                    }
                }
            }
            assert!((cone_deg(&x, 10.0) - angle).abs() < 0.5, "{} for {angle}", cone_deg(&x, 10.0));
        }
    }

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
    fn too_few_grains_are_refused_with_what_to_do() {
        let settings = Settings { particles: 20, ..Settings::default() };
        let refusal = repose(&ParameterSet::default(), &settings, 1).unwrap_err();
        assert!(refusal.to_string().contains("pour more particles"), "{refusal}");
    }
}
