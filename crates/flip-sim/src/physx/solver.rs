//! The state of a powder under the published engine's semantics, and one frame of its solver.

use super::law::Law;
use crate::constraints::{Vector, dot};
use crate::grid::Grid;
use crate::lanes::{Lanes, Portable, WIDTH};
use crate::walls::Wall;

/// Shortest slip with a defined direction, diameters.
const SLIP_MIN: f32 = 1e-16;

/// Grains at one moment, in the order of pouring. Lengths in grain diameters, velocities in
/// diameters per frame.
///
/// Plain scalar code in one fixed order on one thread: the same bits on every machine.
#[derive(Debug, Clone, Default)]
pub(crate) struct Solver {
    /// Centres.
    x: Vec<Vector>,
    /// Velocities; the fourth number counts the contacts of the last iteration.
    v: Vec<Vector>,
    /// Displacement since the frame began.
    moved: Vec<Vector>,
    /// Sum of the corrections of one iteration; the fourth number counts them.
    sum: Vec<Vector>,
    pairs: Vec<Pair>,
    contacts: Vec<WallContact>,
    grid: Grid,
    projected: Vec<Vector>,
}

/// Two grains that may touch in this frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pair {
    i: u32,
    j: u32,
    /// Sum of normal corrections in this frame, zero or negative: minus the repulsion.
    normal: f32,
    /// Sum of friction corrections in this frame.
    pub tangential: f32,
}

/// A grain near a wall, which is a plane for one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WallContact {
    grain: u32,
    /// Unit vector from the wall to the grain.
    normal: Vector,
    /// Distance between the surfaces when the frame began.
    gap: f32,
    /// Sum of normal corrections in this frame, zero or positive.
    pub pressed: f32,
    /// Sum of friction corrections in this frame.
    pub held: f32,
}

#[inline]
fn plus(a: Vector, b: Vector, times: f32) -> Vector {
    [a[0] + b[0] * times, a[1] + b[1] * times, a[2] + b[2] * times, a[3]]
}

#[inline]
fn minus(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2], 0.0]
}

/// The part of `a` that is perpendicular to the unit vector `normal`, and its length.
#[inline]
fn tangential(a: Vector, normal: Vector) -> (Vector, f32) {
    let slip = plus(a, normal, -dot(a, normal));
    (slip, dot(slip, slip).sqrt())
}

impl Solver {
    /// Adds a grain at `x` with velocity `v`.
    pub(crate) fn pour(&mut self, x: Vector, v: Vector) {
        self.x.push([x[0], x[1], x[2], 0.0]);
        self.v.push([v[0], v[1], v[2], 0.0]);
    }

    /// Centres.
    pub(crate) fn centres(&self) -> &[Vector] {
        &self.x
    }

    /// Velocities, in the order of the centres; the fourth number counts contacts.
    pub(crate) fn velocities(&self) -> &[Vector] {
        &self.v
    }

    /// The wall contacts of the last frame.
    #[cfg(test)]
    pub(super) fn contacts(&self) -> &[WallContact] {
        &self.contacts
    }

    /// Advances one frame; the equations are in the [module's documentation](super).
    pub(crate) fn frame(&mut self, law: &Law, acceleration: Vector, wall: &impl Wall) {
        for v in &mut self.v {
            *v =
                [0, 1, 2, 3].map(|k| if k < 3 { (v[k] + acceleration[k]) * law.drag } else { 0.0 });
        }
        self.find_pairs(law, 0.5);
        self.find_contacts(law, wall);
        self.moved.clear();
        self.moved.resize(self.x.len(), [0.0; 4]);
        let share = 1.0 / law.iterations as f32;
        for _ in 0..law.iterations {
            self.step(law, share);
            self.solve_pairs(law);
            self.solve_contacts(law);
            self.correct(law.iterations as f32);
        }
        for v in &mut self.v {
            limit(v, law.speed_max);
        }
    }

    /// Finds every pair that is near at the positions `ahead` of a frame from now.
    fn find_pairs(&mut self, law: &Law, ahead: f32) {
        self.projected.clear();
        self.projected.extend(self.x.iter().zip(&self.v).map(|(x, v)| plus(*x, *v, ahead)));
        self.pairs.clear();
        if self.x.is_empty() {
            return;
        }
        self.grid.fill(&self.projected);
        let range = law.pair_range2.sqrt();
        for i in 0..self.x.len() as u32 {
            let here = self.projected[i as usize];
            let mut lines = self.grid.near(here, range);
            while let Some(places) = lines.next(&self.grid) {
                for &j in &self.grid.grain[places] {
                    let offset = minus(here, self.projected[j as usize]);
                    if j > i && dot(offset, offset) <= law.pair_range2 {
                        self.pairs.push(Pair { i, j, normal: 0.0, tangential: 0.0 });
                    }
                }
            }
        }
    }

    /// Finds every grain that is near the wall at its current position. A grain that crosses the
    /// contact offset and the wall within one frame is missed: continuous collision detection is
    /// off in the engine by default.
    fn find_contacts(&mut self, law: &Law, wall: &impl Wall) {
        self.contacts.clear();
        for first in (0..self.x.len()).step_by(WIDTH) {
            let mut at = [[0.0; WIDTH]; 3];
            let grains = &self.x[first..self.x.len().min(first + WIDTH)];
            for (lane, x) in grains.iter().enumerate() {
                (0..3).for_each(|axis| at[axis][lane] = x[axis]);
            }
            let touch = wall.touch([0, 1, 2].map(|axis| Portable::load(&at[axis])));
            let (mut gap, mut normal) = ([0.0; WIDTH], [[0.0; WIDTH]; 3]);
            touch.gap.store(&mut gap);
            (0..3).for_each(|axis| touch.normal[axis].store(&mut normal[axis]));
            for lane in (0..grains.len()).filter(|&lane| gap[lane] <= law.wall_range) {
                self.contacts.push(WallContact {
                    grain: (first + lane) as u32,
                    normal: [normal[0][lane], normal[1][lane], normal[2][lane], 0.0],
                    gap: gap[lane],
                    pressed: 0.0,
                    held: 0.0,
                });
            }
        }
    }

    /// Moves every grain along its velocity for `share` of a frame.
    fn step(&mut self, law: &Law, share: f32) {
        for ((x, v), moved) in self.x.iter_mut().zip(&mut self.v).zip(&mut self.moved) {
            limit(v, law.speed_max);
            *x = plus(*x, *v, share);
            *moved = plus(*moved, *v, share);
        }
    }

    /// Sums the corrections of all pairs and averages them.
    fn solve_pairs(&mut self, law: &Law) {
        let Self { x, moved, sum, pairs, .. } = self;
        sum.clear();
        sum.resize(x.len(), [0.0; 4]);
        let adhesive = law.radius_scale > 1.0 && law.grain_adhesion > 0.0;
        for pair in pairs {
            let (i, j) = (pair.i as usize, pair.j as usize);
            let offset = minus(x[i], x[j]);
            let distance2 = dot(offset, offset);
            // A pair that is apart, does not attract and has not repelled gets no correction below
            // either.
            if distance2 < law.nearest2 || (distance2 >= 1.0 && pair.normal == 0.0 && !adhesive) {
                continue;
            }
            let distance = distance2.sqrt();
            let e = distance - 1.0;
            let m = e.min(law.grain_pull(e).max(-pair.normal)).clamp(-1.0, 1.0);
            let normal_sum = pair.normal + m;
            pair.normal = normal_sum.min(0.0);
            if normal_sum == 0.0 {
                continue;
            }
            let normal = [offset[0] / distance, offset[1] / distance, offset[2] / distance, 0.0];
            let (slip, length) = tangential(minus(moved[i], moved[j]), normal);
            let mut correction = normal.map(|n| 0.5 * m * n);
            if law.friction > 0.0 && length > 0.0 {
                let cap = law.friction * (-normal_sum).max(0.0);
                let grip = cap.min(length + pair.tangential) - pair.tangential;
                pair.tangential += grip;
                correction = plus(correction, slip, 0.5 * grip / length);
            }
            sum[i] = plus(sum[i], correction, -1.0);
            sum[j] = plus(sum[j], correction, 1.0);
            sum[i][3] += 1.0;
            sum[j][3] += 1.0;
        }
        for (sum, v) in sum.iter_mut().zip(&mut self.v) {
            let share = law.relaxation / sum[3].max(1.0);
            v[3] = sum[3];
            *sum = [sum[0] * share, sum[1] * share, sum[2] * share, 0.0];
        }
    }

    /// Adds the corrections of the wall contacts, which are averaged separately from those of the
    /// pairs: with one wall, there is nothing to average.
    fn solve_contacts(&mut self, law: &Law) {
        for contact in &mut self.contacts {
            let i = contact.grain as usize;
            let moved = self.moved[i];
            let sep = contact.gap + dot(contact.normal, moved);
            let m = (-contact.pressed).min(-law.wall_pull(sep)).max(-sep);
            contact.pressed = (contact.pressed + m).max(0.0);
            let (slip, length) = tangential(moved, contact.normal);
            let grip =
                (law.wall_friction * contact.pressed).min(length + contact.held) - contact.held;
            contact.held += grip;
            let sum = plus(self.sum[i], contact.normal, law.wall_relaxation * m);
            let back = if length >= SLIP_MIN { law.wall_relaxation * grip / length } else { 0.0 };
            self.sum[i] = plus(sum, slip, -back);
            self.v[i][3] += if contact.pressed > 0.0 { 1.0 } else { 0.0 };
        }
    }

    /// Applies the corrections: each moves its grain and changes its velocity by the correction
    /// over the `per_frame`-th part of a frame.
    fn correct(&mut self, per_frame: f32) {
        for (((x, v), moved), sum) in
            self.x.iter_mut().zip(&mut self.v).zip(&mut self.moved).zip(&self.sum)
        {
            *x = plus(*x, *sum, 1.0);
            *moved = plus(*moved, *sum, 1.0);
            *v = plus(*v, *sum, per_frame);
        }
    }

    /// Removes the grains that have left for good.
    pub(crate) fn drop_departed(&mut self, wall: &impl Wall) {
        let mut kept = 0;
        for i in 0..self.x.len() {
            if !wall.has_left(self.x[i]) {
                self.x[kept] = self.x[i];
                self.v[kept] = self.v[i];
                kept += 1;
            }
        }
        self.x.truncate(kept);
        self.v.truncate(kept);
    }

    /// Root-mean-square speed, diameters per frame.
    pub(crate) fn speed_rms(&self) -> f32 {
        let sum: f64 = self.v.iter().map(|v| f64::from(dot(*v, *v))).sum();
        (sum / self.v.len().max(1) as f64).sqrt() as f32
    }

    /// The reason why the state is meaningless, if any.
    pub(crate) fn fault(&self) -> Option<String> {
        let lost =
            self.x.iter().zip(&self.v).position(|(x, v)| !(dot(*x, *x) + dot(*v, *v)).is_finite());
        lost.map(|place| format!("grain {place} has no position"))
    }

    /// Mean and largest overlap of overlapping grains, in diameters.
    pub(crate) fn overlaps(&mut self, law: &Law) -> (f64, f64) {
        self.find_pairs(law, 0.0);
        let (mut sum, mut largest, mut overlapping) = (0.0f64, 0.0f64, 0u32);
        for pair in &self.pairs {
            let offset = minus(self.x[pair.i as usize], self.x[pair.j as usize]);
            let overlap = 1.0 - f64::from(dot(offset, offset).sqrt());
            if overlap > 0.0 {
                sum += overlap;
                largest = largest.max(overlap);
                overlapping += 1;
            }
        }
        (sum / f64::from(overlapping.max(1)), largest)
    }
}

/// Limits a velocity to the speed limit.
#[inline]
fn limit(v: &mut Vector, speed_max: f32) {
    let speed2 = dot(*v, *v);
    if speed2 > speed_max * speed_max {
        let shorter = speed_max / speed2.sqrt();
        *v = [v[0] * shorter, v[1] * shorter, v[2] * shorter, v[3]];
    }
}
