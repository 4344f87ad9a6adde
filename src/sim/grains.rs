//! The state of a powder and the order of one substep.

use super::constraints::{Vector, add, attract, dot, scale, separate, stick, sub};
use super::law::Law;
use super::neighbours::{OPEN, Pairs};
use super::walls::Wall;

/// Grains at one moment. Lengths in grain diameters, velocities in diameters per substep.
#[derive(Debug, Clone, Default)]
pub(super) struct Grains {
    /// Centres.
    pub x: Vec<Vector>,
    /// Velocities.
    pub v: Vec<Vector>,
    /// Where each grain's wall contact stuck; the first lane is NaN while it touches no wall.
    wall_anchor: Vec<Vector>,
    pairs: Pairs,
    predicted: Vec<Vector>,
    correction: Vec<Vector>,
    /// Index of each grain at the last build of the pair list, `u32::MAX` for a grain poured since.
    survivors: Vec<u32>,
}

/// A grain that left the scene.
#[derive(Debug, Clone, Copy)]
pub(super) struct Departure {
    /// Centre when it was taken out.
    pub x: Vector,
    /// Velocity then.
    pub v: Vector,
}

/// What the state means nothing beyond: more than this many diameters per substep is an explosion, not a powder.
const SPEED_MAX: f32 = 1.0;

impl Grains {
    /// Add a grain.
    pub(super) fn pour(&mut self, x: Vector, v: Vector) {
        self.x.push(x);
        self.v.push(v);
        self.wall_anchor.push(OPEN);
        self.survivors.push(u32::MAX);
    }

    /// Advance one substep: predict, project every contact once at the predicted positions, move.
    ///
    /// ```text
    /// v <- (v + acceleration) drag          p = x + v
    /// v <- v + sum of corrections(p)        x <- x + v
    /// ```
    ///
    /// One relaxed Jacobi iteration: every correction is computed at the same `p`, in list order, by one thread, so the
    /// sums are the same on every machine. Both grains of a pair receive exactly opposite corrections.
    pub(super) fn substep(&mut self, law: &Law, acceleration: Vector, wall: &impl Wall) {
        self.predict(law, acceleration);
        self.project_pairs(law);
        self.project_wall(law, wall);
        for ((x, v), correction) in self.x.iter_mut().zip(&mut self.v).zip(&self.correction) {
            *v = add(*v, *correction);
            *x = add(*x, *v);
        }
    }

    fn predict(&mut self, law: &Law, acceleration: Vector) {
        let n = self.x.len();
        self.predicted.resize(n, [0.0; 4]);
        self.correction.clear();
        self.correction.resize(n, [0.0; 4]);
        let mut covered = self.pairs.built_at.len() == n && self.survivors.len() == n;
        for (v, (x, p)) in self.v.iter_mut().zip(self.x.iter().zip(&mut self.predicted)) {
            *v = scale(add(*v, acceleration), law.drag);
            *p = add(*x, *v);
        }
        covered = covered && self.survivors.iter().enumerate().all(|(now, &was)| now as u32 == was);
        covered = covered && self.predicted.iter().enumerate().all(|(i, p)| self.pairs.covers(i, *p));
        if !covered {
            self.pairs.build(&self.predicted, &self.v, law.grain.reach, &self.survivors);
            self.survivors.clear();
            self.survivors.extend(0..n as u32);
        }
    }

    fn project_pairs(&mut self, law: &Law) {
        let contact = &law.grain;
        let near = 1.0 + contact.reach;
        let near2 = near * near;
        let (p, correction) = (self.predicted.as_slice(), self.correction.as_mut_slice());
        let Pairs { first, other, anchor, .. } = &mut self.pairs;
        for i in 0..p.len() {
            let row = first[i] as usize..first[i + 1] as usize;
            let pi = p[i];
            let mut mine = [0.0f32; 4];
            for (&j, anchor) in other[row.clone()].iter().zip(&mut anchor[row]) {
                let j = j as usize;
                let offset = sub(pi, p[j]);
                let distance2 = dot(offset, offset);
                if distance2 >= near2 {
                    *anchor = OPEN;
                    continue;
                }
                let distance = distance2.sqrt().max(1e-6);
                let normal = scale(offset, 1.0 / distance);
                let gap = distance - 1.0;
                let push = separate(gap, contact.normal);
                let mut both = scale(normal, push - attract(gap, contact));
                if gap < 0.0 {
                    let held_at = if anchor[0].is_nan() { offset } else { *anchor };
                    let (held, moved) = stick(offset, held_at, normal, push, contact);
                    *anchor = moved;
                    both = add(both, held);
                } else {
                    *anchor = OPEN;
                }
                mine = add(mine, both);
                correction[j] = sub(correction[j], both);
            }
            correction[i] = add(correction[i], mine);
        }
    }

    fn project_wall(&mut self, law: &Law, wall: &impl Wall) {
        let contact = &law.wall;
        for ((p, anchor), correction) in self.predicted.iter().zip(&mut self.wall_anchor).zip(&mut self.correction) {
            let touch = wall.touch(*p);
            if touch.gap >= contact.reach {
                *anchor = OPEN;
                continue;
            }
            let push = separate(touch.gap, contact.normal);
            let mut all = scale(touch.normal, push - attract(touch.gap, contact));
            if touch.gap < 0.0 {
                let held_at = if anchor[0].is_nan() { *p } else { *anchor };
                let (held, moved) = stick(*p, held_at, touch.normal, push, contact);
                *anchor = moved;
                all = add(all, held);
            } else {
                *anchor = OPEN;
            }
            *correction = add(*correction, all);
        }
    }

    /// Take out the grains that have left for good, in rising order.
    pub(super) fn take_departed(&mut self, wall: &impl Wall) -> Vec<Departure> {
        let mut departed = Vec::new();
        let mut kept = 0;
        for i in 0..self.x.len() {
            if wall.has_left(self.x[i]) {
                departed.push(Departure { x: self.x[i], v: self.v[i] });
                continue;
            }
            self.x[kept] = self.x[i];
            self.v[kept] = self.v[i];
            self.wall_anchor[kept] = self.wall_anchor[i];
            self.survivors[kept] = self.survivors[i];
            kept += 1;
        }
        self.x.truncate(kept);
        self.v.truncate(kept);
        self.wall_anchor.truncate(kept);
        self.survivors.truncate(kept);
        departed
    }

    /// Largest and root-mean-square speed, diameters per substep.
    pub(super) fn speeds(&self) -> (f32, f32) {
        let mut largest = 0.0f32;
        let mut sum = 0.0f64;
        for v in &self.v {
            let speed2 = dot(*v, *v);
            largest = largest.max(speed2);
            sum += f64::from(speed2);
        }
        (largest.sqrt(), (sum / self.v.len().max(1) as f64).sqrt() as f32)
    }

    /// What makes the state meaningless, if anything does.
    pub(super) fn fault(&self) -> Option<String> {
        self.v.iter().zip(&self.x).enumerate().find_map(|(i, (v, x))| {
            if !dot(*x, *x).is_finite() || !dot(*v, *v).is_finite() {
                return Some(format!("grain {i} has no position"));
            }
            (dot(*v, *v) > SPEED_MAX * SPEED_MAX)
                .then(|| format!("grain {i} moves more than a diameter in one substep"))
        })
    }

    /// Mean and largest overlap of touching grains, in diameters.
    pub(super) fn overlaps(&self) -> (f64, f64) {
        let (mut sum, mut largest, mut touching) = (0.0f64, 0.0f64, 0u32);
        for i in 0..self.x.len() {
            let row = match (self.pairs.first.get(i), self.pairs.first.get(i + 1)) {
                (Some(&a), Some(&b)) => a as usize..b as usize,
                _ => continue,
            };
            for &j in &self.pairs.other[row] {
                let Some(xj) = self.x.get(j as usize) else { continue };
                let offset = sub(self.x[i], *xj);
                let overlap = 1.0 - f64::from(dot(offset, offset).sqrt());
                if overlap > 0.0 {
                    sum += overlap;
                    largest = largest.max(overlap);
                    touching += 1;
                }
            }
        }
        (sum / f64::from(touching.max(1)), largest)
    }
}
