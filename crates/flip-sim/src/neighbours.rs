//! The list of grains that may touch before the next rebuild. Lengths in grain diameters, time in
//! substeps.

use super::constraints::{V3, Vector, dot, inner, splat, sub};
use super::grid::{Grid, Lines, held};
use super::lanes::{Lanes, WIDTH, block};
use super::pairs::Pairs;

/// How far any grain may stray from its path before the list is rebuilt.
const SKIN: f32 = 0.14;
/// Additional allowance of a moving grain, as a share of its path.
const SKIN_PER_PATH: f32 = 0.7;
/// Largest allowance.
const SKIN_MAX: f32 = 0.6;
/// Number of substeps covered by the paths.
const HORIZON: f32 = 6.0;
/// A grain faster than this searches by itself over a wide range, so that the others need not look
/// out for it.
const FAST: f32 = 0.05;
/// Squared distance within which a pair is listed as near: it touches now or soon.
const HOT2: f32 = 1.1;
/// Maximum number of later neighbours of a grain; grains with as many have collapsed into each
/// other: a dense powder at full allowance has a quarter of it.
const NEIGHBOURS_MAX: usize = 112;
/// Coordinate of padding, far from everything.
pub(super) const FAR: f32 = 1e6;
/// Finds the pairs of grains that may touch before the next rebuild.
///
/// A grain's path starts at its position when the list was built, and follows its velocity at that
/// time. Every pair that can come closer than the reach of a contact is listed as long as no grain
/// has strayed from its path by more than its allowance, `SKIN + SKIN_PER_PATH * path`. Grains that
/// move together, as in a falling stream, have parallel paths and are not listed with each other
/// merely for being fast.
#[derive(Debug, Clone, Default)]
pub(super) struct Neighbours {
    /// The pairs found.
    pub pairs: Pairs,
    /// Whether some grain ever had more neighbours than the list can hold, so that contacts were
    /// missing.
    pub overfull: bool,
    /// Number of lists built.
    pub builds: u64,
    /// Start of each grain's path; the fourth number is the square of its allowance.
    start: Vec<Vector>,
    /// Velocity along the path.
    pace: Vec<Vector>,
    /// Substeps since the list was built.
    age: f32,
    /// Excess of the largest radius over the mean.
    widest: f32,
    grid: Grid,
    sorted: Sorted,
    fast: Vec<u32>,
    /// Pairs that include a fast grain.
    wide: Vec<(u32, u32)>,
}

/// Near pairs, and pairs that may come near, with room to write whole lanes.
type Found = [[u32; NEIGHBOURS_MAX + WIDTH]; 2];

/// Positions, velocities and allowances by component, with a block of padding at the end.
#[derive(Debug, Clone, Default)]
struct Sorted {
    x: [Vec<f32>; 3],
    /// The first component again, with fast grains moved far away.
    slow: Vec<f32>,
    v: [Vec<f32>; 3],
    allowance: Vec<f32>,
}

impl Neighbours {
    /// The order in which grains at `x` lie in memory close to their neighbours; call before
    /// [`Neighbours::build`].
    pub(super) fn order(&mut self, x: &[Vector]) -> &[u32] {
        self.grid.fill(x);
        &self.grid.grain
    }

    /// How far beyond its allowance any grain of block `b` at `p` has strayed from its path, as a
    /// difference of squares: the list is valid where this is below zero.
    #[inline(always)]
    pub(super) fn strayed<L: Lanes>(&self, b: usize, p: V3<L>) -> L {
        let [x, y, z, allowance2] = L::rows(block(&self.start, b));
        let [u, v, w, _] = L::rows(block(&self.pace, b));
        let t = L::splat((self.age + 1.0).min(HORIZON));
        let off = sub(p, [x + u * t, y + v * t, z + w * t]);
        inner(off, off) - allowance2
    }

    /// Registers that a substep has passed.
    pub(super) fn grow_older(&mut self) {
        self.age += 1.0;
    }

    /// Builds the list for grains at `x` with velocities `v`, in the order returned by
    /// [`Neighbours::order`]; contacts closer than `reach` from centre to centre matter. `was` is
    /// each grain's place in the previous list, [`NEW`] if it had none; anchors follow their pair.
    #[inline(always)]
    pub(super) fn build<L: Lanes, const EXTENDED: bool>(
        &mut self,
        x: &[Vector],
        v: &[Vector],
        was: &[u32],
        reach: f32,
    ) {
        let n = x.len();
        self.pairs.keep::<EXTENDED>();
        self.set_out(x, v);
        let mut found: Found = [[0; NEIGHBOURS_MAX + WIDTH]; 2];
        self.search_wide::<L>(x, v, reach, &mut found);
        let mut next_wide = 0;
        for i in 0..n {
            let mut counts = [0; 2];
            if self.sorted.slow[i] < FAR {
                counts = self.search::<L>(i, x, v, reach, &mut found);
            }
            while let Some((_, j)) = self.wide.get(next_wide).filter(|pair| pair.0 as usize == i) {
                if counts[1] < NEIGHBOURS_MAX {
                    found[1][counts[1]] = *j;
                    counts[1] += 1;
                }
                next_wide += 1;
            }
            self.overfull |= counts[0] == NEIGHBOURS_MAX || counts[1] == NEIGHBOURS_MAX;
            self.pairs.push(&found[0][..counts[0]], &found[1][..counts[1]]);
        }
        self.pairs.finish::<EXTENDED>(was);
        self.age = 0.0;
        self.builds += 1;
    }

    /// Memory held, bytes. Lists every field, so that none is forgotten.
    pub(super) fn bytes(&self) -> usize {
        let Self {
            pairs,
            overfull: _,
            builds: _,
            start,
            pace,
            age: _,
            widest: _,
            grid,
            sorted,
            fast,
            wide,
        } = self;
        let Sorted { x, slow, v, allowance } = sorted;
        pairs.bytes()
            + held(start)
            + held(pace)
            + grid.bytes()
            + x.iter().chain(v).chain([slow, allowance]).map(held).sum::<usize>()
            + held(fast)
            + held(wide)
    }

    /// Starts every grain's path.
    fn set_out(&mut self, x: &[Vector], v: &[Vector]) {
        let n = x.len();
        let padded = n.div_ceil(WIDTH) * WIDTH;
        self.widest = 0.0;
        self.start.clear();
        self.pace.clear();
        self.fast.clear();
        let Sorted { x: sx, slow, v: sv, allowance } = &mut self.sorted;
        for column in sx.iter_mut().chain(sv.iter_mut()).chain([&mut *slow, &mut *allowance]) {
            column.clear();
            column.resize(n + WIDTH, 0.0);
        }
        for i in 0..n {
            let speed = dot(v[i], v[i]).sqrt();
            let a = (SKIN + SKIN_PER_PATH * speed * HORIZON).min(SKIN_MAX);
            self.start.push([x[i][0], x[i][1], x[i][2], a * a]);
            self.pace.push([v[i][0], v[i][1], v[i][2], 0.0]);
            // The search assumes grains of the mean size: a larger one searches further by its
            // excess radius.
            allowance[i] = a + (x[i][3] - 0.5);
            self.widest = self.widest.max(x[i][3] - 0.5);
            let is_fast = speed > FAST;
            if is_fast {
                self.fast.push(i as u32);
            }
            slow[i] = if is_fast { FAR } else { x[i][0] };
            for k in 0..3 {
                sx[k][i] = x[i][k];
                sv[k][i] = v[i][k];
            }
        }
        self.start.resize(padded, [FAR, FAR, FAR, 1.0]);
        self.pace.resize(padded, [0.0; 4]);
    }

    /// Finds the pairs that include a fast grain.
    #[inline(always)]
    fn search_wide<L: Lanes>(&mut self, x: &[Vector], v: &[Vector], reach: f32, found: &mut Found) {
        self.wide.clear();
        for k in 0..self.fast.len() {
            let i = self.fast[k] as usize;
            // Faster grains find this one.
            let speed = dot(v[i], v[i]).sqrt();
            let range =
                reach + self.sorted.allowance[i] + self.widest + SKIN_MAX + 2.0 * speed * HORIZON;
            let lines = self.grid.near(x[i], range);
            let counts = self.scan::<L, true>(i, x, v, reach, lines, found);
            self.overfull |= counts[0] == NEIGHBOURS_MAX || counts[1] == NEIGHBOURS_MAX;
            for (found, count) in found.iter().zip(counts) {
                for &j in &found[..count] {
                    let theirs = dot(v[j as usize], v[j as usize]).sqrt();
                    if theirs < speed || (theirs == speed && j as usize > i) {
                        self.wide.push((j.min(i as u32), j.max(i as u32)));
                    }
                }
            }
        }
        self.wide.sort_unstable();
    }

    /// Finds the later neighbours of grain `i` that are not fast: those near now, and those that
    /// may come near; returns how many.
    #[inline(always)]
    fn search<L: Lanes>(
        &self,
        i: usize,
        x: &[Vector],
        v: &[Vector],
        reach: f32,
        found: &mut Found,
    ) -> [usize; 2] {
        let others = SKIN + SKIN_PER_PATH * FAST * HORIZON + self.widest;
        let range =
            reach + self.sorted.allowance[i] + others + (dot(v[i], v[i]).sqrt() + FAST) * HORIZON;
        self.scan::<L, false>(i, x, v, reach, self.grid.after(x[i], range), found)
    }

    /// Finds the grains on these lines of cells whose paths come near that of grain `i`: either all
    /// of them, including itself, or only later ones that are not fast. In the latter case the
    /// first line is its own.
    #[inline(always)]
    fn scan<L: Lanes, const ALL: bool>(
        &self,
        i: usize,
        x: &[Vector],
        v: &[Vector],
        reach: f32,
        mut lines: Lines,
        found: &mut Found,
    ) -> [usize; 2] {
        let Sorted { x: sx, slow, v: sv, allowance } = &self.sorted;
        let (first, earliest) = if ALL { (&sx[0], 0) } else { (slow, i + 1) };
        let (at, pace): (V3<L>, V3<L>) = (splat(x[i]), splat(v[i]));
        let (zero, horizon, hot2) = (L::splat(0.0), L::splat(HORIZON), L::splat(HOT2));
        let near = L::splat(reach + allowance[i]);
        let [mut hot_count, mut late_count] = [0, 0];
        while let Some(places) = lines.next(&self.grid) {
            let mut j = places.start.max(earliest);
            while j < places.end {
                let r = sub(at, [sixteen(first, j), sixteen(&sx[1], j), sixteen(&sx[2], j)]);
                let u = sub(pace, [sixteen(&sv[0], j), sixteen(&sv[1], j), sixteen(&sv[2], j)]);
                let near: L = near + sixteen(allowance, j);
                let (near2, rr, ru, uu) = (near * near, inner(r, r), inner(r, u), inner(u, u));
                // Closest at the start, at the end, or in between, where the squared distance is
                // `(rr uu - ru^2) / uu`.
                let end = rr + horizon * (ru + ru + horizon * uu);
                let approach = zero - ru;
                let between = zero.below(approach) & approach.below(uu * horizon);
                let mut hits =
                    rr.min(end).below(near2) | (between & (rr * uu - ru * ru).below(near2 * uu));
                let left = places.end - j;
                if left < WIDTH {
                    hits &= (1 << left) - 1;
                }
                let hot = rr.below(hot2);
                hot_count =
                    L::append(hits & hot, j as u32, &mut found[0], hot_count).min(NEIGHBOURS_MAX);
                late_count =
                    L::append(hits & !hot, j as u32, &mut found[1], late_count).min(NEIGHBOURS_MAX);
                j += WIDTH;
            }
        }
        [hot_count, late_count]
    }
}

/// Sixteen numbers of a column from place `j`; every grain is followed by at least sixteen.
#[inline(always)]
fn sixteen<L: Lanes>(column: &[f32], j: usize) -> L {
    L::load(column[j..j + WIDTH].try_into().expect("sixteen places follow every grain"))
}

#[cfg(test)]
mod tests {
    use super::super::lanes::Portable;
    use super::super::pairs::NEW;
    use super::*;
    use flip_core::domain::seed::derive;

    /// Smallest squared distance of two grains on their paths.
    fn closest2(x: Vector, v: Vector, y: Vector, w: Vector) -> f32 {
        let r: Vector = std::array::from_fn(|k| x[k] - y[k]);
        let u: Vector = std::array::from_fn(|k| v[k] - w[k]);
        let t = if dot(u, u) > 0.0 { (-dot(r, u) / dot(u, u)).clamp(0.0, HORIZON) } else { 0.0 };
        let m: Vector = std::array::from_fn(|k| r[k] + u[k] * t);
        dot(m, m)
    }

    /// A grain of the mean size.
    fn grain(x: f32, y: f32, z: f32) -> Vector {
        [x, y, z, 0.5]
    }

    /// A cloud in which every seventh grain moves, some of them fast, sorted as the list requires.
    fn cloud(n: usize, side: f32, seed: u64) -> (Neighbours, Vec<Vector>, Vec<Vector>) {
        let u =
            |i: usize, k: u64| (derive(seed, &[i as u64, k]) >> 40) as f32 / (1u64 << 24) as f32;
        let x: Vec<Vector> =
            (0..n).map(|i| grain(side * u(i, 0), side * u(i, 1), side * u(i, 2))).collect();
        let speed = |i: usize| if i.is_multiple_of(7) { 0.15 } else { 0.01 };
        let v: Vec<Vector> =
            (0..n).map(|i| [speed(i) * u(i, 3), 0.0, -speed(i) * u(i, 4), 0.0]).collect();
        let mut list = Neighbours::default();
        let order = list.order(&x).to_vec();
        let sort = |of: &[Vector]| order.iter().map(|&i| of[i as usize]).collect::<Vec<_>>();
        let (x, v) = (sort(&x), sort(&v));
        (list, x, v)
    }

    fn pairs(list: &Neighbours, n: usize) -> Vec<(u32, u32)> {
        let mut pairs = Vec::new();
        pairs.extend(
            list.pairs.ends[0]
                .iter()
                .copied()
                .zip(list.pairs.ends[1].iter().copied())
                .filter(|(i, _)| (*i as usize) < n),
        );
        pairs.sort_unstable();
        pairs
    }

    #[test]
    fn the_list_holds_exactly_the_pairs_of_the_n_squared_search() {
        for seed in 0..5 {
            let (mut list, x, v) = cloud(300, 9.0, seed);
            list.build::<Portable, false>(&x, &v, &[NEW; 300], 1.05);
            let mut expected = Vec::new();
            for i in 0..x.len() {
                for j in i + 1..x.len() {
                    let near = 1.05 + list.start[i][3].sqrt() + list.start[j][3].sqrt();
                    if closest2(x[i], v[i], x[j], v[j]) < near * near {
                        expected.push((i as u32, j as u32));
                    }
                }
            }
            assert_eq!(pairs(&list, 300), expected);
        }
    }

    #[test]
    fn grains_that_have_fallen_into_each_other_are_too_many_for_the_list_and_it_says_so() {
        for (spacing, overfull) in [(0.01, true), (0.9, false)] {
            let at = |k: usize| spacing * (k % 6) as f32;
            let x: Vec<Vector> = (0..216).map(|k| grain(at(k), at(k / 6), at(k / 36))).collect();
            let mut list = Neighbours::default();
            let order = list.order(&x).to_vec();
            let x: Vec<Vector> = order.iter().map(|&i| x[i as usize]).collect();
            list.build::<Portable, false>(&x, &vec![[0.0; 4]; 216], &[NEW; 216], 1.1);
            assert_eq!(list.overfull, overfull);
        }
    }

    #[test]
    fn a_grain_has_strayed_when_it_leaves_its_path_and_not_along_it() {
        let x = vec![grain(0.0, 0.0, 0.0), grain(5.0, 0.0, 0.0)];
        let v = vec![[0.0; 4], [0.0, 0.0, -0.04, 0.0]];
        let mut list = Neighbours::default();
        list.order(&x);
        list.build::<Portable, false>(&x, &v, &[NEW; 2], 1.05);
        let strays = |list: &Neighbours, p: [Vector; 2]| {
            let lane =
                |k: usize| Portable::load(&std::array::from_fn(|l| p.get(l).map_or(FAR, |p| p[k])));
            Portable::splat(0.0).below(list.strayed::<Portable>(0, [lane(0), lane(1), lane(2)]))
        };
        let after = |t: f32, aside: f32| [x[0], grain(5.0 + aside, 0.0, -0.04 * t)];
        assert_eq!(strays(&list, after(1.0, 0.0)), 0);
        (0..3).for_each(|_| list.grow_older());
        assert_eq!(strays(&list, after(4.0, 0.25)), 0, "0.14 + 0.7 * 0.04 * 6 = 0.308");
        assert_eq!(strays(&list, after(4.0, 0.35)), 0b10);
    }

    #[test]
    fn what_a_pair_remembers_follows_it_when_grains_leave_and_are_reordered() {
        let x = vec![
            grain(0.0, 0.0, 0.0),
            grain(0.9, 0.0, 0.0),
            grain(5.0, 0.0, 0.0),
            grain(5.9, 0.0, 0.0),
        ];
        let v = vec![[0.0; 4]; 4];
        let mut list = Neighbours::default();
        assert_eq!(list.order(&x), [0, 1, 2, 3]);
        list.build::<Portable, true>(&x, &v, &[NEW; 4], 1.05);
        assert_eq!(pairs(&list, 4), [(0, 1), (2, 3)]);
        // Only the pair (2, 3) sticks.
        list.pairs.touching[0] = 0b10;
        list.pairs.anchor[0][0][1] = -0.9;
        list.pairs.linked[0] = 0b10;
        list.pairs.memory[0][0][1] = 0.3;
        list.pairs.memory[0][3][1] = 7.0;
        // Grain 0 leaves, and 2 and 3, which share a cell, come in the opposite order.
        let (mut y, mut was) = (vec![x[3], x[2], x[1]], vec![3, 2, 1]);
        let order = list.order(&y).to_vec();
        assert_eq!(order, [2, 0, 1]);
        y = order.iter().map(|&i| y[i as usize]).collect();
        was = order.iter().map(|&i| was[i as usize]).collect();
        list.build::<Portable, true>(&y, &v[1..], &was, 1.05);
        assert_eq!(pairs(&list, 3), [(1, 2)]);
        // The second grain of the pair has become the first.
        assert_eq!((list.pairs.touching[0], list.pairs.anchor[0][0][0]), (0b1, 0.9));
        let memory = &list.pairs.memory[0];
        assert_eq!((list.pairs.linked[0], memory[0][0], memory[3][0]), (0b1, -0.3, 7.0));
    }
}
