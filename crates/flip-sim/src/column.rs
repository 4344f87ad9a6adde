//! Scene for the speed comparison: a settled column of equal spheres, released on a plane.
//!
//! Other simulators run the same scene (`benches/peers`), so its powder is simple: friction 0.5
//! between grains and against the plane, no attraction, no drag. The caller does the timing.

use super::constraints::{Vector, vector};
use super::grains::Grains;
use super::lanes::{Path, Work, counted, peak};
use super::law::{Law, SUBSTEP_S};
use super::shapes::Silo;
use super::walls::Shape;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Grain diameter, m.
pub const DIAMETER_M: f64 = 0.27e-3;
/// Coulomb coefficient of every contact.
pub const FRICTION: f64 = 0.5;
/// Floor on which the column falls.
const FLOOR: Shape = Shape::FLAT;
/// Height of a bed over its radius.
const SLENDERNESS: f64 = 2.0;
/// Assumed packing fraction of a bed, used to choose its radius.
const PACKING: f64 = 0.6;
/// A bed counts as resting below this root-mean-square speed, m/s.
const REST_RMS_M_S: f64 = 0.001;
/// Longest wait for rest, s.
const SETTLE_MAX_S: f64 = 0.6;
/// Mean overlap at which unloading without gravity ends, diameters: a simulator with stiffer grains
/// would burst from more.
const UNLOADED: f64 = 0.000_1;
/// Maximum number of substeps for unloading, and the drag meanwhile.
const UNLOAD_MAX: u32 = 6000;
const UNLOAD_DRAG: f32 = 0.97;

/// Grains on a plane. Clone it to repeat the same run.
#[derive(Debug, Clone)]
pub struct Column {
    law: Law,
    grains: Grains,
    substeps: u64,
}

impl Column {
    /// Grains at rest, centred at these positions, m; z is the height above the plane.
    pub fn new(centres_m: &[[f64; 3]]) -> Self {
        let centres = centres_m.iter().map(|x| {
            let [x, y, z] = x.map(|m| (m / DIAMETER_M) as f32);
            vector(x, y, z)
        });
        Self::of(centres)
    }

    fn of(centres: impl Iterator<Item = Vector>) -> Self {
        let mut law = Law::new(&ParameterSet::default(), FRICTION, SUBSTEP_S);
        law.grain.friction = FRICTION as f32;
        let mut grains = Grains::default();
        centres.for_each(|x| grains.pour(&law, x, [0.0; 4]));
        Self { law, grains, substeps: 0 }
    }

    /// Advances by this many substeps of [`SUBSTEP_S`].
    pub fn advance(&mut self, substeps: u32) {
        self.advance_within(substeps, &FLOOR);
    }

    fn advance_within(&mut self, substeps: u32, wall: &Shape) {
        let down = vector(0.0, 0.0, -self.law.gravity);
        for _ in 0..substeps {
            self.grains.substep(&self.law, down, wall);
        }
        self.substeps += u64::from(substeps);
    }

    /// Advances likewise and counts the work done; slow.
    pub fn count(&mut self, substeps: u32) -> Work {
        let down = vector(0.0, 0.0, -self.law.gravity);
        self.substeps += u64::from(substeps);
        counted(|| (0..substeps).for_each(|_| self.grains.substep_counted(&self.law, down, &FLOOR)))
    }

    /// Makes the next substep rebuild the neighbour list.
    pub fn outdate(&mut self) {
        self.grains.outdate();
    }

    /// Simulated time, s.
    pub fn elapsed_s(&self) -> f64 {
        self.substeps as f64 * self.law.substep_s
    }

    /// Number of grains.
    pub fn particles(&self) -> usize {
        self.grains.centres().len()
    }

    /// Centres, m, in no stable order.
    pub fn centres_m(&self) -> Vec<[f64; 3]> {
        let metres = |x: f32| f64::from(x) * DIAMETER_M;
        self.grains.centres().iter().map(|x| [metres(x[0]), metres(x[1]), metres(x[2])]).collect()
    }

    /// Mean and largest overlap of overlapping grains, in diameters.
    pub fn overlaps(&self) -> (f64, f64) {
        self.grains.overlaps()
    }

    /// Largest and root-mean-square speed, m/s.
    pub fn speeds_m_s(&self) -> (f64, f64) {
        let (largest, rms) = self.grains.speeds();
        (self.law.speed_m_s(largest), self.law.speed_m_s(rms))
    }

    /// Number of neighbour-list builds so far.
    pub fn rebuilds(&self) -> u64 {
        self.grains.rebuilds()
    }

    /// Memory of the grains and their neighbour list, bytes, including spare capacity.
    pub fn bytes(&self) -> usize {
        self.grains.bytes()
    }

    /// The reason why the simulation is no longer meaningful, if any.
    pub fn fault(&self) -> Option<String> {
        self.grains.fault()
    }
}

/// Creates a bed of `particles` grains twice as high as its radius: rained from a loose lattice
/// into an upright beaker and left to rest, without friction, which would let the lattice stand as
/// it is, then unloaded; centres, m. The same number gives the same bed.
///
/// # Errors
/// The reason why the simulation became meaningless.
pub fn bed(particles: u32) -> Result<Vec<[f64; 3]>, String> {
    // n (pi/6) d^3 = PACKING pi R^2 (SLENDERNESS R)
    let radius = libm::cbrt(f64::from(particles) / (6.0 * PACKING * SLENDERNESS));
    let beaker = Shape::Silo(Silo::closed(radius as f32));
    let mut column = Column::of(lattice(particles, radius as f32).into_iter());
    (column.law.grain.friction, column.law.wall.friction) = (0.0, 0.0);
    let limit = column.law.substeps(SETTLE_MAX_S);
    // The rain must have started to fall before rest is checked.
    let slice = column.law.substeps(0.02);
    column.advance_within(slice, &beaker);
    while column.speeds_m_s().1 > REST_RMS_M_S && column.substeps < u64::from(limit) {
        column.advance_within(slice, &beaker);
    }
    (column.law.gravity, column.law.drag) = (0.0, UNLOAD_DRAG);
    let until = column.substeps + u64::from(UNLOAD_MAX);
    while column.overlaps().0 > UNLOADED && column.substeps < until {
        column.advance_within(slice, &beaker);
    }
    column.fault().map_or_else(|| Ok(column.centres_m()), Err)
}

/// A loose cubic lattice within a cylinder of this radius, slightly perturbed.
fn lattice(particles: u32, radius: f32) -> Vec<Vector> {
    const SPACING: f32 = 1.15;
    const SHAKE: f32 = 0.07;
    let mut rng = Pcg64Mcg::seed_from_u64(derive(u64::from(particles), &[0xC01]));
    let inner = (radius - 0.5 - SHAKE).max(0.0);
    let reach = (inner / SPACING) as i32;
    let mut centres = Vec::with_capacity(particles as usize);
    let mut z = 1.0;
    while centres.len() < particles as usize {
        for (i, j) in (-reach..=reach).flat_map(|i| (-reach..=reach).map(move |j| (i, j))) {
            let (x, y) = (i as f32 * SPACING, j as f32 * SPACING);
            if x * x + y * y <= inner * inner && centres.len() < particles as usize {
                let mut shaken = |at: f32| at + rng.random_range(-SHAKE..SHAKE);
                centres.push(vector(shaken(x), shaken(y), shaken(z)));
            }
        }
        z += SPACING;
    }
    centres
}

/// The kernel's code path on this machine: `portable`, `avx2` or `avx512`.
pub fn path() -> &'static str {
    Path::best().name()
}

/// Multiplies and adds in registers, in the kernel's lanes and, like the kernel, without fusing;
/// returns the number of operations.
pub fn multiply_add(rounds: u32) -> u64 {
    peak::multiply_add(Path::best(), rounds)
}

/// Reads numbers in order, `passes` times, in the kernel's lanes; returns the number of bytes read.
pub fn read(numbers: &[[f32; 16]], passes: u32) -> u64 {
    peak::read(Path::best(), numbers, passes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bed_is_settled_dense_and_the_same_twice() {
        let centres = bed(500).unwrap();
        assert_eq!(centres.len(), 500);
        assert_eq!(centres, bed(500).unwrap());
        let column = Column::new(&centres);
        let (mean, largest) = column.overlaps();
        assert!(mean < 0.000_2 && largest < 0.002, "overlaps {mean} {largest}");
        // The grains in the middle of the bed, over the volume there.
        let radius = (500.0f64 / (6.0 * PACKING * SLENDERNESS)).cbrt();
        let (r, low, high) = (radius - 1.0, 1.5, 1.5 * radius);
        let within = |x: &&[f64; 3]| {
            let [x, y, z] = x.map(|m| m / DIAMETER_M);
            x.hypot(y) < r && (low..high).contains(&z)
        };
        let filled = centres.iter().filter(within).count() as f64 / 6.0 / (r * r * (high - low));
        assert!((0.5..0.66).contains(&filled), "packing {filled}");
    }

    #[test]
    fn a_released_column_spreads_falls_and_comes_to_rest_on_the_plane() {
        let mut column = Column::new(&bed(500).unwrap());
        let extent = |column: &Column| {
            let centres = column.centres_m();
            let highest = centres.iter().fold(0.0f64, |top, x| top.max(x[2]));
            let squares: f64 = centres.iter().map(|x| x[0] * x[0] + x[1] * x[1]).sum();
            [highest, (squares / centres.len() as f64).sqrt()]
        };
        let before = extent(&column);
        column.advance(4000);
        let after = extent(&column);
        assert_eq!(column.fault(), None);
        assert!(after[0] < 0.9 * before[0] && after[1] > 1.2 * before[1], "{before:?} {after:?}");
        assert!(column.speeds_m_s().1 < 0.005, "still moving at {:?} m/s", column.speeds_m_s());
        assert!(column.rebuilds() > 1 && (column.elapsed_s() - 0.32).abs() < 1e-9);
    }

    #[test]
    fn counting_changes_no_bit_and_grows_with_the_contacts() {
        let mut column = Column::new(&bed(300).unwrap());
        column.advance(50);
        let mut counted = column.clone();
        let work = counted.count(20);
        column.advance(20);
        assert_eq!(column.centres_m(), counted.centres_m());
        assert!(work.flops > 20 * 300 * 100 && work.slow_flops < work.flops / 4, "{work:?}");
        let mut apart = Column::new(&[[0.0, 0.0, 0.001], [0.001, 0.0, 0.001]]);
        assert_eq!(apart.count(20).gathered_bytes, 0, "nobody is near anybody");
    }

    #[test]
    fn the_peaks_return_what_they_did() {
        assert_eq!(multiply_add(10) % (2 * 10 * 16), 0);
        assert_eq!(read(&[[1.0; 16]; 8], 3), 3 * 8 * 64);
    }
}
