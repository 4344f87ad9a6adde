//! Pairs of grains that may touch before the list is built again. Lengths in grain diameters, time in substeps.

use super::constraints::{Vector, dot, sub};

/// Side of a cell of the search grid: a slow pair lies in the same or in touching cells.
const CELL: f32 = 1.4;
/// Half of the distance that a grain at rest may move before the list is built again.
const SKIN: f32 = 0.12;
/// Substeps for which a moving grain's path is covered.
const HORIZON: f32 = 12.0;
/// Largest distance covered for one grain; a faster one brings the next build forward.
const ALLOWANCE_MAX: f32 = 3.0;

/// Candidate pairs `i < j`, grouped by `i` in rising order, with one anchor for each.
///
/// Every pair closer than the reach of a contact is in the list as long as no grain has moved further than its own
/// allowance, `SKIN + |v| HORIZON`, from where it was when the list was built.
#[derive(Debug, Clone, Default)]
pub(super) struct Pairs {
    /// `first[i]..first[i + 1]` are the pairs of grain `i`.
    pub first: Vec<u32>,
    /// The other grain of each pair.
    pub other: Vec<u32>,
    /// Relative position where the contact stuck; the first lane is NaN while the pair does not touch.
    pub anchor: Vec<Vector>,
    /// Position of each grain when the list was built, and in the fourth lane the square of its allowance.
    pub built_at: Vec<Vector>,
    grid: Grid,
    found: Vec<(u32, u32)>,
    old: Old,
}

/// The list before a build, for carrying anchors over.
#[derive(Debug, Clone, Default)]
struct Old {
    first: Vec<u32>,
    other: Vec<u32>,
    anchor: Vec<Vector>,
}

/// The anchor of a pair that does not touch.
pub(super) const OPEN: Vector = [f32::NAN, 0.0, 0.0, 0.0];

impl Pairs {
    /// Whether the list still covers grain `i` at `p`.
    #[inline(always)]
    pub(super) fn covers(&self, i: usize, p: Vector) -> bool {
        let built = self.built_at[i];
        let moved = [p[0] - built[0], p[1] - built[1], p[2] - built[2], 0.0];
        dot(moved, moved) <= built[3]
    }

    /// Build the list for positions `p` and velocities `v`; contacts closer than `1 + reach` matter.
    ///
    /// `survivors` gives for each grain its index in the list before, in rising order (grains that left are missing,
    /// new grains carry `u32::MAX`); anchors follow their pair.
    pub(super) fn build(&mut self, p: &[Vector], v: &[Vector], reach: f32, survivors: &[u32]) {
        std::mem::swap(&mut self.old.first, &mut self.first);
        std::mem::swap(&mut self.old.other, &mut self.other);
        std::mem::swap(&mut self.old.anchor, &mut self.anchor);
        self.built_at.clear();
        self.built_at.extend(p.iter().zip(v).map(|(p, v)| {
            let allowance = (SKIN + dot(*v, *v).sqrt() * HORIZON).min(ALLOWANCE_MAX);
            [p[0], p[1], p[2], allowance * allowance]
        }));
        self.grid.fill(p);
        self.search(p, 1.0 + reach);
        self.group(p.len());
        self.carry_anchors(p.len(), survivors);
    }

    /// The pair is found by its faster grain, so that slow grains search only their own surroundings.
    fn search(&mut self, p: &[Vector], contact: f32) {
        self.found.clear();
        for i in 0..p.len() {
            let allowance = self.built_at[i][3].sqrt();
            let range = contact + 2.0 * allowance;
            let pi = p[i];
            let (built_at, found) = (&self.built_at, &mut self.found);
            self.grid.visit(pi, range, |j| {
                let theirs = built_at[j as usize][3].sqrt();
                if theirs > allowance || (theirs == allowance && j as usize <= i) {
                    return;
                }
                let apart = sub(pi, p[j as usize]);
                let near = contact + allowance + theirs;
                if dot(apart, apart) < near * near {
                    found.push(((i as u32).min(j), (i as u32).max(j)));
                }
            });
        }
    }

    /// Counting sort by the first grain: the order depends on the positions alone.
    fn group(&mut self, n: usize) {
        self.first.clear();
        self.first.resize(n + 1, 0);
        for &(i, _) in &self.found {
            self.first[i as usize + 1] += 1;
        }
        for i in 0..n {
            self.first[i + 1] += self.first[i];
        }
        self.other.clear();
        self.other.resize(self.found.len(), 0);
        let mut next = self.first.clone();
        for &(i, j) in &self.found {
            self.other[next[i as usize] as usize] = j;
            next[i as usize] += 1;
        }
    }

    fn carry_anchors(&mut self, n: usize, survivors: &[u32]) {
        self.anchor.clear();
        self.anchor.resize(self.other.len(), OPEN);
        for i in 0..n {
            let was = survivors[i] as usize;
            if was + 1 >= self.old.first.len() {
                continue;
            }
            let row = self.old.first[was] as usize..self.old.first[was + 1] as usize;
            for k in self.first[i] as usize..self.first[i + 1] as usize {
                let partner = survivors[self.other[k] as usize];
                if let Some(at) = self.old.other[row.clone()].iter().position(|&j| j == partner) {
                    self.anchor[k] = self.old.anchor[row.start + at];
                }
            }
        }
    }
}

/// A uniform grid over the grains' bounding box.
#[derive(Debug, Clone, Default)]
struct Grid {
    origin: [f32; 3],
    size: [i32; 3],
    first: Vec<u32>,
    grain: Vec<u32>,
    cell_of: Vec<u32>,
}

/// Most cells along one side: a stray grain far away must not cost memory.
const CELLS_MAX: i32 = 128;

impl Grid {
    fn coordinate(&self, p: Vector, axis: usize) -> i32 {
        (((p[axis] - self.origin[axis]) / CELL) as i32).clamp(0, self.size[axis] - 1)
    }

    fn fill(&mut self, p: &[Vector]) {
        let mut low = [f32::MAX; 3];
        let mut high = [f32::MIN; 3];
        for p in p {
            for axis in 0..3 {
                low[axis] = low[axis].min(p[axis]);
                high[axis] = high[axis].max(p[axis]);
            }
        }
        self.origin = low;
        self.size = std::array::from_fn(|axis| (((high[axis] - low[axis]) / CELL) as i32 + 1).clamp(1, CELLS_MAX));
        let cells = (self.size[0] * self.size[1] * self.size[2]) as usize;
        self.first.clear();
        self.first.resize(cells + 1, 0);
        self.cell_of.clear();
        for p in p {
            let [x, y, z] = std::array::from_fn(|axis| self.coordinate(*p, axis));
            let cell = (z * self.size[1] + y) * self.size[0] + x;
            self.cell_of.push(cell as u32);
            self.first[cell as usize + 1] += 1;
        }
        for cell in 0..cells {
            self.first[cell + 1] += self.first[cell];
        }
        self.grain.clear();
        self.grain.resize(p.len(), 0);
        // Filled from the back so that the counts become the starts again, and grains stand in rising order.
        let mut next = self.first.clone();
        for (grain, &cell) in self.cell_of.iter().enumerate() {
            self.grain[next[cell as usize] as usize] = grain as u32;
            next[cell as usize] += 1;
        }
    }

    /// Call `found` for every grain in the cells within `range` of `p`.
    #[inline(always)]
    fn visit(&self, p: Vector, range: f32, mut found: impl FnMut(u32)) {
        let low: [i32; 3] = std::array::from_fn(|axis| {
            let mut q = p;
            q[axis] -= range;
            self.coordinate(q, axis)
        });
        let high: [i32; 3] = std::array::from_fn(|axis| {
            let mut q = p;
            q[axis] += range;
            self.coordinate(q, axis)
        });
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                let row = (z * self.size[1] + y) * self.size[0];
                let cells = (row + low[0]) as usize..=(row + high[0]) as usize;
                let grains = self.first[*cells.start()] as usize..self.first[*cells.end() + 1] as usize;
                for &grain in &self.grain[grains] {
                    found(grain);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::constraints::vector;
    use super::*;
    use crate::domain::seed::derive;

    fn cloud(n: usize, side: f32, speed: f32, seed: u64) -> (Vec<Vector>, Vec<Vector>) {
        let u = |i: usize, k: u64| (derive(seed, &[i as u64, k]) >> 40) as f32 / (1u64 << 24) as f32;
        let p = (0..n).map(|i| vector(side * u(i, 0), side * u(i, 1), side * u(i, 2))).collect();
        let v = (0..n)
            .map(|i| if i % 7 == 0 { vector(speed * u(i, 3), 0.0, -speed * u(i, 4)) } else { [0.0; 4] })
            .collect();
        (p, v)
    }

    #[test]
    fn the_list_holds_exactly_the_pairs_of_the_n_squared_search() {
        for seed in 0..5 {
            let (p, v) = cloud(300, 9.0, 0.15, seed);
            let mut pairs = Pairs::default();
            pairs.build(&p, &v, 0.05, &vec![u32::MAX; p.len()]);
            let mut listed = Vec::new();
            for i in 0..p.len() {
                for k in pairs.first[i]..pairs.first[i + 1] {
                    listed.push((i as u32, pairs.other[k as usize]));
                }
            }
            listed.sort_unstable();
            let allowance = |i: usize| pairs.built_at[i][3].sqrt();
            let mut expected = Vec::new();
            for i in 0..p.len() {
                for j in i + 1..p.len() {
                    let r = sub(p[i], p[j]);
                    let near = 1.05 + allowance(i) + allowance(j);
                    if dot(r, r) < near * near {
                        expected.push((i as u32, j as u32));
                    }
                }
            }
            assert_eq!(listed, expected);
        }
    }

    #[test]
    fn anchors_follow_their_pair_when_grains_leave() {
        let p = vec![vector(0.0, 0.0, 0.0), vector(5.0, 0.0, 0.0), vector(0.9, 0.0, 0.0), vector(5.9, 0.0, 0.0)];
        let v = vec![[0.0; 4]; 4];
        let mut pairs = Pairs::default();
        pairs.build(&p, &v, 0.0, &[u32::MAX; 4]);
        for k in 0..pairs.anchor.len() {
            pairs.anchor[k] = vector(pairs.other[k] as f32, 7.0, 7.0);
        }
        // Grain 0 leaves; the pair (1, 3) becomes (0, 2).
        pairs.build(&p[1..], &v[1..], 0.0, &[1, 2, 3]);
        assert_eq!((pairs.first.clone(), pairs.other.clone()), (vec![0, 1, 1, 1], vec![2]));
        assert_eq!(pairs.anchor, vec![vector(3.0, 7.0, 7.0)]);
    }
}
