//! The state of a powder and the order of one substep.

use super::constraints::{Grip, V3, Vector, add, attract, choose, dot, inner, scale, separate, splat, stick, sub};
use super::grid::held;
use super::lanes::{Avx2, Avx512, Counting, Lanes, Mask, Path, Portable, WIDTH, block, block_mut};
use super::law::Law;
use super::neighbours::{FAR, NEW, Neighbours};
use super::walls::Wall;

/// Grains at one moment. Lengths in grain diameters, velocities in diameters per substep.
///
/// They lie in memory near their neighbours, so a grain's place changes; arrays are filled up to whole blocks with grains that are far
/// away and never move.
#[derive(Debug, Clone)]
pub(super) struct Grains {
    n: usize,
    /// Centres.
    x: Vec<Vector>,
    /// Velocities; the fourth number counts the grain's contacts.
    v: Vec<Vector>,
    /// Where each grain's wall contact stuck; the fourth number is 1 while it touches a wall.
    wall_anchor: Vec<Vector>,
    /// In the order of pouring.
    id: Vec<u32>,
    /// Each grain's place in the neighbour list.
    listed: Vec<u32>,
    /// Predicted centres and velocities, with one grain more that is nowhere: the neighbour of those who have none.
    p: Vec<Vector>,
    u: Vec<Vector>,
    neighbours: Neighbours,
    /// Grains came or went since the list was built.
    changed: bool,
    poured: u32,
    path: Path,
    scratch: Vec<Vector>,
    numbers: Vec<u32>,
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
/// A grain that fills a block up.
const NOBODY: Vector = [FAR, FAR, FAR, 0.0];
/// Its neighbour: far from it too.
const NOWHERE: Vector = [-FAR, -FAR, -FAR, 0.0];

impl Default for Grains {
    fn default() -> Self {
        Self::on(Path::best())
    }
}

impl Grains {
    /// No grains yet, to be solved on this path.
    pub(super) fn on(path: Path) -> Self {
        Self {
            n: 0,
            x: Vec::new(),
            v: Vec::new(),
            wall_anchor: Vec::new(),
            id: Vec::new(),
            listed: Vec::new(),
            p: Vec::new(),
            u: Vec::new(),
            neighbours: Neighbours::default(),
            changed: true,
            poured: 0,
            path,
            scratch: Vec::new(),
            numbers: Vec::new(),
        }
    }

    /// Centres, in no lasting order.
    pub(super) fn centres(&self) -> &[Vector] {
        &self.x[..self.n]
    }

    /// Velocities, in the order of the centres; the fourth number counts contacts.
    pub(super) fn velocities(&self) -> &[Vector] {
        &self.v[..self.n]
    }

    /// Add a grain.
    pub(super) fn pour(&mut self, x: Vector, v: Vector) {
        for column in [&mut self.x, &mut self.v, &mut self.wall_anchor] {
            column.truncate(self.n);
        }
        self.x.push(x);
        self.v.push([v[0], v[1], v[2], 0.0]);
        self.wall_anchor.push([0.0; 4]);
        self.id.push(self.poured);
        self.listed.push(NEW);
        self.poured += 1;
        self.n += 1;
        self.changed = true;
    }

    /// Advance one substep: predict, project every contact once at the predicted positions, move.
    ///
    /// ```text
    /// u = (v + acceleration) drag           p = x + u
    /// v <- u + sum of corrections(p, u)     x <- x + v
    /// ```
    ///
    /// One relaxed Jacobi iteration: every correction is computed at the same `p` and summed by its own grain in list order, so the
    /// result does not depend on the processor or on threads. Both grains of a pair receive exactly opposite corrections.
    pub(super) fn substep(&mut self, law: &Law, acceleration: Vector, wall: &impl Wall) {
        #[allow(unsafe_code)]
        match self.path {
            Path::Portable => self.advance::<Portable>(law, acceleration, wall),
            // SAFETY: a path is chosen only on a processor that has it.
            Path::Avx2 => unsafe { self.advance_avx2(law, acceleration, wall) },
            // SAFETY: as above.
            Path::Avx512 => unsafe { self.advance_avx512(law, acceleration, wall) },
        }
    }

    /// The same, adding to the thread's [`super::Work`].
    pub(super) fn substep_counted(&mut self, law: &Law, acceleration: Vector, wall: &impl Wall) {
        self.advance::<Counting>(law, acceleration, wall);
    }

    #[target_feature(enable = "avx2")]
    fn advance_avx2(&mut self, law: &Law, acceleration: Vector, wall: &impl Wall) {
        self.advance::<Avx2>(law, acceleration, wall);
    }

    #[target_feature(enable = "avx512f")]
    fn advance_avx512(&mut self, law: &Law, acceleration: Vector, wall: &impl Wall) {
        self.advance::<Avx512>(law, acceleration, wall);
    }

    #[allow(clippy::inline_always)] // See `lanes`.
    #[inline(always)]
    fn advance<L: Lanes>(&mut self, law: &Law, acceleration: Vector, wall: &impl Wall) {
        if self.n == 0 {
            return;
        }
        if self.changed {
            self.list::<L>(law);
        }
        if !self.predict::<L>(law, acceleration) {
            self.list::<L>(law);
            self.predict::<L>(law, acceleration);
        }
        for b in 0..self.x.len() / WIDTH {
            self.project::<L>(b, law, wall);
        }
        self.neighbours.grow_older();
    }

    /// The lanes of block `b` that hold a grain.
    #[allow(clippy::inline_always)] // See `lanes`.
    #[inline(always)]
    fn inhabited(&self, b: usize) -> Mask {
        let left = self.n - b * WIDTH;
        if left >= WIDTH { Mask::MAX } else { (1 << left) - 1 }
    }

    /// Where everything would be without contacts; whether the neighbour list still holds there.
    #[allow(clippy::inline_always)] // See `lanes`.
    #[inline(always)]
    fn predict<L: Lanes>(&mut self, law: &Law, acceleration: Vector) -> bool {
        let pull = splat(acceleration);
        let drag = L::splat(law.drag);
        let mut furthest = L::splat(-1.0);
        for b in 0..self.x.len() / WIDTH {
            let [x, y, z, _] = L::rows(block(&self.x, b));
            let [vx, vy, vz, contacts] = L::rows(block(&self.v, b));
            let u = scale(add([vx, vy, vz], pull), drag);
            let inhabited = self.inhabited(b);
            let p = choose(inhabited, add([x, y, z], u), [x, y, z]);
            let strayed = L::select(inhabited, self.neighbours.strayed(b, p), L::splat(-1.0));
            // A position that is no number has strayed too.
            furthest = L::select(strayed.below(furthest), furthest, strayed);
            L::write_rows([p[0], p[1], p[2], contacts], block_mut(&mut self.p, b));
            L::write_rows([u[0], u[1], u[2], contacts], block_mut(&mut self.u, b));
        }
        furthest.below(L::splat(0.0)) == Mask::MAX
    }

    /// Sort the grains into cells and list their neighbours.
    #[allow(clippy::inline_always)] // See `lanes`.
    #[inline(always)]
    fn list<L: Lanes>(&mut self, law: &Law) {
        let n = self.n;
        let order = self.neighbours.order(&self.x[..n]);
        for column in [&mut self.x, &mut self.v, &mut self.wall_anchor] {
            self.scratch.clear();
            self.scratch.extend(order.iter().map(|&i| column[i as usize]));
            column[..n].copy_from_slice(&self.scratch);
        }
        for column in [&mut self.id, &mut self.listed] {
            self.numbers.clear();
            self.numbers.extend(order.iter().map(|&i| column[i as usize]));
            column.copy_from_slice(&self.numbers);
        }
        self.neighbours.build::<L>(&self.x[..n], &self.v[..n], &self.listed, 1.0 + law.grain.reach);
        self.listed.clear();
        self.listed.extend(0..n as u32);
        let padded = n.div_ceil(WIDTH) * WIDTH;
        self.x.truncate(n);
        self.x.resize(padded, NOBODY);
        for column in [&mut self.v, &mut self.wall_anchor] {
            column.truncate(n);
            column.resize(padded, [0.0; 4]);
        }
        self.p.clear();
        self.p.resize(padded, NOBODY);
        self.p.push(NOWHERE);
        self.u.clear();
        self.u.resize(padded + 1, [0.0; 4]);
        self.changed = false;
    }

    /// Solve every contact of the grains of block `b`, and move them.
    #[allow(clippy::inline_always)] // See `lanes`.
    #[inline(always)]
    fn project<L: Lanes>(&mut self, b: usize, law: &Law, wall: &impl Wall) {
        let [px, py, pz, contacts] = L::rows(block(&self.p, b));
        let [ux, uy, uz, _] = L::rows(block(&self.u, b));
        let (p, u) = ([px, py, pz], [ux, uy, uz]);
        let zero = L::splat(0.0);
        let mut sum = Sum { correction: [zero; 3], contacts: zero };
        self.project_pairs(b, law, p, u, contacts, &mut sum);
        self.project_wall(b, law, wall, p, u, contacts, &mut sum);
        let [x, y, z, _] = L::rows(block(&self.x, b));
        let inhabited = self.inhabited(b);
        let v = choose(inhabited, add(u, sum.correction), [zero; 3]);
        let x = add([x, y, z], v);
        L::write_rows([v[0], v[1], v[2], sum.contacts], block_mut(&mut self.v, b));
        L::write_rows([x[0], x[1], x[2], zero], block_mut(&mut self.x, b));
    }

    #[allow(clippy::inline_always)] // See `lanes`.
    #[inline(always)]
    fn project_pairs<L: Lanes>(&mut self, b: usize, law: &Law, p: V3<L>, u: V3<L>, contacts: L, sum: &mut Sum<L>) {
        let c = &law.grain;
        let (one, zero) = (L::splat(1.0), L::splat(0.0));
        let near2 = L::splat((1.0 + c.reach) * (1.0 + c.reach));
        let (onset, inverse_ramp) = (L::splat(1.0 + c.onset), L::splat(1.0 / (c.reach - c.onset)));
        let Neighbours { first, other, anchor, touching, .. } = &mut self.neighbours;
        for row in first[b] as usize..first[b + 1] as usize {
            let others = &other[row];
            #[allow(unsafe_code)]
            // SAFETY: the list names grains and the one that is nowhere, and `p` has them all; `list` makes both together.
            let [qx, qy, qz, theirs] = unsafe { L::gather(&self.p, others) };
            let offset = sub(p, [qx, qy, qz]);
            let distance2 = inner(offset, offset);
            let near = distance2.below(near2);
            if near == 0 {
                touching[row] = 0;
                continue;
            }
            let distance = distance2.sqrt();
            let normal = scale(offset, one / distance);
            let gap = distance - onset;
            let mut along = zero - attract(gap, L::splat(c.attraction), inverse_ramp);
            let touch = gap.below(zero) & near;
            if touch != 0 {
                #[allow(unsafe_code)]
                // SAFETY: as above; `u` is as long as `p`.
                let [wx, wy, wz, _] = unsafe { L::gather(&self.u, others) };
                let velocity = sub(u, [wx, wy, wz]);
                let opening = inner(velocity, normal);
                // A grain's contacts share its damping: the sum stays stable however many there are.
                let share = one / one.max(contacts * theirs).sqrt();
                let push = separate(gap, opening, L::splat(c.normal), L::splat(c.normal_damping) * share);
                let push = L::select(touch, push, zero);
                along = along + push;
                let memory = &mut anchor[row];
                let stuck = [L::load(&memory[0]), L::load(&memory[1]), L::load(&memory[2])];
                let stuck = choose(touching[row], stuck, offset);
                let grip = Grip {
                    stiffness: L::splat(c.tangential),
                    damping: L::splat(c.tangential_damping) * share,
                    limit: L::splat(c.friction) * push,
                };
                let held = stick(offset, stuck, velocity, normal, opening, grip);
                held.anchor[0].store(&mut memory[0]);
                held.anchor[1].store(&mut memory[1]);
                held.anchor[2].store(&mut memory[2]);
                sum.correction = sub(sum.correction, choose(touch, held.correction, [zero; 3]));
                sum.contacts = sum.contacts + L::select(touch, one, zero);
            }
            touching[row] = touch;
            sum.correction = add(sum.correction, choose(near, scale(normal, along), [zero; 3]));
        }
    }

    #[allow(clippy::inline_always, clippy::too_many_arguments)] // See `lanes`.
    #[inline(always)]
    fn project_wall<L: Lanes>(
        &mut self,
        b: usize,
        law: &Law,
        wall: &impl Wall,
        p: V3<L>,
        u: V3<L>,
        contacts: L,
        sum: &mut Sum<L>,
    ) {
        let c = &law.wall;
        let (one, zero) = (L::splat(1.0), L::splat(0.0));
        let touched = wall.touch(p);
        let near = touched.gap.below(L::splat(c.reach));
        let memory = block_mut(&mut self.wall_anchor, b);
        if near == 0 {
            for memory in memory {
                memory[3] = 0.0;
            }
            return;
        }
        let (normal, gap) = (touched.normal, touched.gap - L::splat(c.onset));
        let touch = gap.below(zero);
        let pull = attract(gap, L::splat(c.attraction), L::splat(1.0 / (c.reach - c.onset)));
        let opening = inner(u, normal);
        let share = one / one.max(contacts).sqrt();
        let push = separate(gap, opening, L::splat(c.normal), L::splat(c.normal_damping) * share);
        let push = L::select(touch, push, zero);
        let [ax, ay, az, was] = L::rows(memory);
        let stuck = choose(zero.below(was), [ax, ay, az], p);
        let grip = Grip {
            stiffness: L::splat(c.tangential),
            damping: L::splat(c.tangential_damping) * share,
            limit: L::splat(c.friction) * push,
        };
        let held = stick(p, stuck, u, normal, opening, grip);
        let touches = L::select(touch, one, zero);
        L::write_rows([held.anchor[0], held.anchor[1], held.anchor[2], touches], memory);
        let along = choose(near, scale(normal, push - pull), [zero; 3]);
        sum.correction = add(sum.correction, sub(along, choose(touch, held.correction, [zero; 3])));
        sum.contacts = sum.contacts + touches;
    }

    /// Take out the grains that have left for good, in the order of pouring.
    pub(super) fn take_departed(&mut self, wall: &impl Wall) -> Vec<Departure> {
        let mut departed = Vec::new();
        let mut kept = 0;
        for i in 0..self.n {
            if wall.has_left(self.x[i]) {
                departed.push((self.id[i], Departure { x: self.x[i], v: self.v[i] }));
                continue;
            }
            for column in [&mut self.x, &mut self.v, &mut self.wall_anchor] {
                column[kept] = column[i];
            }
            for column in [&mut self.id, &mut self.listed] {
                column[kept] = column[i];
            }
            kept += 1;
        }
        self.changed |= kept < self.n;
        self.n = kept;
        self.id.truncate(kept);
        self.listed.truncate(kept);
        departed.sort_unstable_by_key(|(id, _)| *id);
        departed.into_iter().map(|(_, departure)| departure).collect()
    }

    /// Largest and root-mean-square speed, diameters per substep.
    pub(super) fn speeds(&self) -> (f32, f32) {
        let mut largest = 0.0f32;
        let mut sum = 0.0f64;
        for v in self.velocities() {
            let speed2 = dot(*v, *v);
            largest = largest.max(speed2);
            sum += f64::from(speed2);
        }
        (largest.sqrt(), (sum / self.n.max(1) as f64).sqrt() as f32)
    }

    /// Have the next substep build the neighbour list again.
    pub(super) fn outdate(&mut self) {
        self.changed = true;
    }

    /// How often the neighbour list was built.
    pub(super) fn rebuilds(&self) -> u64 {
        self.neighbours.builds
    }

    /// Memory held, bytes. Names every field, so that none is forgotten.
    pub(super) fn bytes(&self) -> usize {
        let Self {
            n: _,
            x,
            v,
            wall_anchor,
            id,
            listed,
            p,
            u,
            neighbours,
            changed: _,
            poured: _,
            path: _,
            scratch,
            numbers,
        } = self;
        [x, v, wall_anchor, p, u, scratch].into_iter().map(held).sum::<usize>()
            + [id, listed, numbers].into_iter().map(held).sum::<usize>()
            + neighbours.bytes()
    }

    /// What makes the state meaningless, if anything does.
    pub(super) fn fault(&self) -> Option<String> {
        if self.neighbours.overfull {
            return Some("grains have fallen into each other".to_owned());
        }
        let mut grains = self.velocities().iter().zip(self.centres()).zip(&self.id);
        grains.find_map(|((v, x), id)| {
            if !dot(*x, *x).is_finite() || !dot(*v, *v).is_finite() {
                return Some(format!("grain {id} has no position"));
            }
            (dot(*v, *v) > SPEED_MAX * SPEED_MAX)
                .then(|| format!("grain {id} moves more than a diameter in one substep"))
        })
    }

    /// Mean and largest overlap of overlapping grains, in diameters.
    pub(super) fn overlaps(&self) -> (f64, f64) {
        let mut along_x = self.centres().to_vec();
        along_x.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
        let (mut sum, mut largest, mut overlapping) = (0.0f64, 0.0f64, 0u32);
        for (i, a) in along_x.iter().enumerate() {
            for b in along_x[i + 1..].iter().take_while(|b| b[0] - a[0] < 1.0) {
                let offset: Vector = std::array::from_fn(|k| a[k] - b[k]);
                let overlap = 1.0 - f64::from(dot(offset, offset).sqrt());
                if overlap > 0.0 {
                    sum += overlap;
                    largest = largest.max(overlap);
                    overlapping += 1;
                }
            }
        }
        (sum / f64::from(overlapping.max(1)), largest)
    }

    /// Centre and velocity of a grain by its number in the order of pouring.
    #[cfg(test)]
    pub(super) fn grain(&self, id: u32) -> (Vector, Vector) {
        let place = self.id.iter().position(|&other| other == id).expect("the grain is still there");
        (self.x[place], self.v[place])
    }
}

/// What the contacts of a block's grains add up to.
struct Sum<L> {
    correction: V3<L>,
    contacts: L,
}
