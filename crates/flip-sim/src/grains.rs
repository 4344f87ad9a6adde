//! The state of a powder, and the sequence of one substep.

mod outside;
mod probes;

use super::constraints::{Vector, add, choose, dot, scale, splat};
use super::contacts::{self, Predicted, Sums, Turn};
use super::grid::held;
use super::lanes::{Computation, Counting, Lanes, Mask, Path, WIDTH, block, block_mut};
use super::law::Law;
use super::neighbours::{FAR, Neighbours};
use super::pairs::NEW;
use super::walls::{Shape, Wall};

/// Grains at one moment. Lengths in grain diameters, velocities in diameters per substep.
///
/// Grains lie in memory near their neighbours, so a grain's index changes; arrays are padded to
/// whole blocks with grains that are far away and never move.
#[derive(Debug, Clone)]
pub(super) struct Grains {
    n: usize,
    /// Centres; the fourth number is the grain's radius.
    x: Vec<Vector>,
    /// Velocities; the fourth number counts the grain's contacts.
    v: Vec<Vector>,
    /// Where each grain's wall contact stuck; the fourth number is 1 while it touches a wall.
    wall_anchor: Vec<Vector>,
    /// Spins, radians per substep; the fourth number is 1 for a grain that can move.
    spin: Vec<Vector>,
    /// Each grain's rolling stretch at the wall; the fourth number is 1 for a grain that clings to
    /// spoons.
    wall_stretch: Vec<Vector>,
    /// Ids, in the order of pouring.
    id: Vec<u32>,
    /// Each grain's place in the neighbour list.
    listed: Vec<u32>,
    /// As in [`Predicted`], plus two grains that are nowhere: the pairs that fill up a row.
    p: Vec<Vector>,
    u: Vec<Vector>,
    turning: Vec<Vector>,
    /// As in [`Sums`]; zero between substeps.
    impulse: Vec<Vector>,
    torque: Vec<Vector>,
    neighbours: Neighbours,
    /// Whether grains were added or removed since the list was built.
    changed: bool,
    poured: u32,
    elapsed: u32,
    path: Path,
    scratch: Vec<Vector>,
    numbers: Vec<u32>,
}

/// One substep, on any path.
struct Substep<'a> {
    grains: &'a mut Grains,
    law: &'a Law,
    acceleration: Vector,
    wall: &'a Shape,
}

impl Computation for Substep<'_> {
    type Output = ();
    #[allow(clippy::inline_always)] // See `lanes`.
    #[inline(always)]
    fn with<L: Lanes>(self) {
        let Self { grains, law, acceleration, wall } = self;
        match law.extended {
            false => grains.advance::<L, false>(law, acceleration, wall),
            true => grains.advance::<L, true>(law, acceleration, wall),
        }
    }
}

/// A grain that left the scene.
#[derive(Debug, Clone, Copy)]
pub(super) struct Departure {
    /// Id.
    pub id: u32,
    /// Centre when it was removed.
    pub x: Vector,
    /// Velocity when it was removed.
    pub v: Vector,
}

/// Mass of a grain centred at `x`, relative to a mean grain.
fn mass(x: &Vector) -> f64 {
    (2.0 * f64::from(x[3])).powi(3)
}

impl Departure {
    /// Mass relative to a mean grain.
    pub(super) fn mass(&self) -> f64 {
        mass(&self.x)
    }
}

/// Speed limit of a meaningful state: more diameters per substep is an explosion, not a powder.
const SPEED_MAX: f32 = 1.0;
/// A padding grain.
const NOBODY: Vector = [FAR, FAR, FAR, 0.5];
/// The two grains of a padding pair: far from each other.
const NOWHERE: [Vector; 2] = [[-FAR, -FAR, -FAR, 0.5], [-FAR, -FAR, FAR, 0.5]];

impl Default for Grains {
    fn default() -> Self {
        Self::on(Path::best())
    }
}

impl Grains {
    /// Creates an empty state, to be solved on this path.
    pub(super) fn on(path: Path) -> Self {
        Self {
            n: 0,
            x: Vec::new(),
            v: Vec::new(),
            wall_anchor: Vec::new(),
            spin: Vec::new(),
            wall_stretch: Vec::new(),
            id: Vec::new(),
            listed: Vec::new(),
            p: Vec::new(),
            u: Vec::new(),
            turning: Vec::new(),
            impulse: Vec::new(),
            torque: Vec::new(),
            neighbours: Neighbours::default(),
            changed: true,
            poured: 0,
            elapsed: 0,
            path,
            scratch: Vec::new(),
            numbers: Vec::new(),
        }
    }

    /// Centres, in no stable order; the fourth number is the radius.
    pub(super) fn centres(&self) -> &[Vector] {
        &self.x[..self.n]
    }

    /// Ids (numbers in the order of pouring), in the order of the centres.
    pub(super) fn ids(&self) -> &[u32] {
        &self.id
    }

    /// Velocities, in the order of the centres; the fourth number counts contacts.
    pub(super) fn velocities(&self) -> &[Vector] {
        &self.v[..self.n]
    }

    /// Adds a grain; the law determines its radius from its id.
    pub(super) fn pour(&mut self, law: &Law, x: Vector, v: Vector) {
        let radius = law.mechanisms.sizes.radius(self.poured);
        let clings = law.mechanisms.film.clings(self.poured);
        self.add([x[0], x[1], x[2], radius], v, [1.0, clings]);
    }

    /// Adds a grain of the mean size that never moves. Only a law with mechanisms supports such
    /// grains.
    pub(super) fn fix(&mut self, x: Vector) {
        self.add([x[0], x[1], x[2], 0.5], [0.0; 4], [0.0, 0.0]);
    }

    fn add(&mut self, x: Vector, v: Vector, [mobile, clings]: [f32; 2]) {
        let n = self.n;
        for column in self.columns() {
            column.truncate(n);
        }
        self.x.push(x);
        self.v.push([v[0], v[1], v[2], 0.0]);
        self.wall_anchor.push([0.0; 4]);
        self.spin.push([0.0, 0.0, 0.0, mobile]);
        self.wall_stretch.push([0.0, 0.0, 0.0, clings]);
        self.id.push(self.poured);
        self.listed.push(NEW);
        self.poured += 1;
        self.n += 1;
        self.changed = true;
    }

    /// The columns that move with a grain when its index changes.
    fn columns(&mut self) -> [&mut Vec<Vector>; 5] {
        [&mut self.x, &mut self.v, &mut self.wall_anchor, &mut self.spin, &mut self.wall_stretch]
    }

    /// Advances one substep: predict, project every contact once at the predicted positions, move.
    ///
    /// ```text
    /// u = (v + acceleration) drag           p = x + u
    /// v <- u + sum of corrections(p, u)     x <- x + v
    /// ```
    ///
    /// One relaxed Jacobi iteration: every correction is computed at the same `p` and summed per
    /// grain in list order, so the result does not depend on the processor or on threads. Both
    /// grains of a pair receive exactly opposite corrections.
    pub(super) fn substep(&mut self, law: &Law, acceleration: Vector, wall: &Shape) {
        self.path.run(Substep { grains: self, law, acceleration, wall });
    }

    /// Like [`Self::substep`], adding to the thread's [`super::Work`].
    pub(super) fn substep_counted(&mut self, law: &Law, acceleration: Vector, wall: &Shape) {
        self.advance::<Counting, false>(law, acceleration, wall);
    }

    #[allow(clippy::inline_always)] // See `lanes`.
    #[inline(always)]
    fn advance<L: Lanes, const EXTENDED: bool>(
        &mut self,
        law: &Law,
        acceleration: Vector,
        wall: &Shape,
    ) {
        if self.n == 0 {
            return;
        }
        let acceleration =
            if EXTENDED { law.mechanisms.step(acceleration, self.elapsed) } else { acceleration };
        if self.changed {
            self.list::<L, EXTENDED>(law);
        }
        if !self.predict::<L, EXTENDED>(law, acceleration) {
            self.list::<L, EXTENDED>(law);
            self.predict::<L, EXTENDED>(law, acceleration);
        }
        let at = Predicted { p: &self.p, u: &self.u, spin: &self.turning };
        let mut sums = Sums { impulse: &mut self.impulse, torque: &mut self.torque };
        contacts::pairs::<L, EXTENDED>(&mut self.neighbours.pairs, law, at, &mut sums);
        for b in 0..self.x.len() / WIDTH {
            self.advance_block::<L, EXTENDED>(b, law, wall);
        }
        self.neighbours.grow_older();
        self.elapsed += 1;
    }

    /// Mask of the lanes of block `b` that hold a grain.
    #[allow(clippy::inline_always)] // See `lanes`.
    #[inline(always)]
    fn inhabited(&self, b: usize) -> Mask {
        let left = self.n - b * WIDTH;
        if left >= WIDTH { Mask::MAX } else { (1 << left) - 1 }
    }

    /// Predicts the state without contacts; returns whether the neighbour list is still valid
    /// there.
    #[allow(clippy::inline_always)] // See `lanes`.
    #[inline(always)]
    fn predict<L: Lanes, const EXTENDED: bool>(&mut self, law: &Law, acceleration: Vector) -> bool {
        let pull = splat(acceleration);
        let drag = L::splat(law.drag);
        let mut furthest = L::splat(-1.0);
        for b in 0..self.x.len() / WIDTH {
            let [x, y, z, radius] = L::rows(block(&self.x, b));
            let [vx, vy, vz, contacts] = L::rows(block(&self.v, b));
            let mut u = scale(add([vx, vy, vz], pull), drag);
            let mut inhabited = self.inhabited(b);
            if EXTENDED {
                let [sx, sy, sz, mobile] = L::rows(block(&self.spin, b));
                inhabited &= L::splat(0.0).below(mobile);
                u = choose(inhabited, law.mechanisms.grain(u, radius), [L::splat(0.0); 3]);
                L::write_rows([sx, sy, sz, mobile], block_mut(&mut self.turning, b));
            }
            let p = choose(inhabited, add([x, y, z], u), [x, y, z]);
            let strayed = L::select(inhabited, self.neighbours.strayed(b, p), L::splat(-1.0));
            // A position that is NaN counts as strayed too.
            furthest = L::select(strayed.below(furthest), furthest, strayed);
            L::write_rows([p[0], p[1], p[2], radius], block_mut(&mut self.p, b));
            let share = L::splat(1.0) / L::splat(1.0).max(contacts).sqrt();
            L::write_rows([u[0], u[1], u[2], share], block_mut(&mut self.u, b));
        }
        furthest.below(L::splat(0.0)) == Mask::MAX
    }

    /// Sorts the grains into cells and lists their neighbours.
    #[allow(clippy::inline_always)] // See `lanes`.
    #[inline(always)]
    fn list<L: Lanes, const EXTENDED: bool>(&mut self, law: &Law) {
        let n = self.n;
        let Self {
            x,
            v,
            wall_anchor,
            spin,
            wall_stretch,
            id,
            listed,
            neighbours,
            scratch,
            numbers,
            ..
        } = self;
        let order = neighbours.order(&x[..n]);
        for column in [x, v, wall_anchor, spin, wall_stretch] {
            scratch.clear();
            scratch.extend(order.iter().map(|&i| column[i as usize]));
            column[..n].copy_from_slice(scratch);
        }
        for column in [id, listed] {
            numbers.clear();
            numbers.extend(order.iter().map(|&i| column[i as usize]));
            column.copy_from_slice(numbers);
        }
        let reach = if EXTENDED {
            law.grain.reach.max(law.mechanisms.pair_reach())
        } else {
            law.grain.reach
        };
        self.neighbours.build::<L, EXTENDED>(&self.x[..n], &self.v[..n], &self.listed, 1.0 + reach);
        self.listed.clear();
        self.listed.extend(0..n as u32);
        let padded = n.div_ceil(WIDTH) * WIDTH;
        for column in self.columns() {
            column.truncate(n);
            column.resize(padded, [0.0; 4]);
        }
        self.x[n..].fill(NOBODY);
        self.p.clear();
        self.p.resize(padded, NOBODY);
        self.p.extend(NOWHERE);
        for column in [&mut self.u, &mut self.impulse] {
            column.clear();
            column.resize(padded + 2, [0.0; 4]);
        }
        for column in [&mut self.turning, &mut self.torque] {
            column.clear();
            column.resize(if EXTENDED { padded + 2 } else { 0 }, [0.0; 4]);
        }
        self.changed = false;
    }

    /// Adds the walls to the sums over pairs for the grains of block `b`, and moves them.
    #[allow(clippy::inline_always)] // See `lanes`.
    #[inline(always)]
    fn advance_block<L: Lanes, const EXTENDED: bool>(&mut self, b: usize, law: &Law, wall: &Shape) {
        let [px, py, pz, radius] = L::rows(block(&self.p, b));
        let [ux, uy, uz, share] = L::rows(block(&self.u, b));
        let zero = L::splat(0.0);
        let [ix, iy, iz, contacts] = L::rows(block(&self.impulse, b));
        block_mut(&mut self.impulse, b).fill([0.0; 4]);
        let (p, u, still) = ([px, py, pz], [ux, uy, uz], [zero; 3]);
        let mut turn = Turn {
            p,
            u,
            radius,
            share,
            spin: still,
            correction: [ix, iy, iz],
            torque: still,
            contacts,
        };
        let mut free = self.inhabited(b);
        let mut mobile = zero;
        if EXTENDED {
            let lightness = L::splat(1.0) / contacts::mass(radius);
            turn.correction = scale(turn.correction, lightness);
            let [tx, ty, tz, _] = L::rows(block(&self.torque, b));
            block_mut(&mut self.torque, b).fill([0.0; 4]);
            turn.torque = scale([tx, ty, tz], lightness);
            let [sx, sy, sz, flag] = L::rows(block(&self.turning, b));
            turn.spin = [sx, sy, sz];
            mobile = flag;
            free &= zero.below(flag);
        }
        let stretches = if EXTENDED { Some(block_mut(&mut self.wall_stretch, b)) } else { None };
        contacts::wall::<L, EXTENDED>(
            law,
            wall,
            block_mut(&mut self.wall_anchor, b),
            stretches,
            &mut turn,
        );
        let [x, y, z, radius] = L::rows(block(&self.x, b));
        let v = choose(free, add(turn.u, turn.correction), [zero; 3]);
        let x = add([x, y, z], v);
        L::write_rows([v[0], v[1], v[2], turn.contacts], block_mut(&mut self.v, b));
        L::write_rows([x[0], x[1], x[2], radius], block_mut(&mut self.x, b));
        if EXTENDED {
            // The moment of inertia of a solid sphere is 2/5 m r^2.
            let ease = L::splat(2.5 * law.mechanisms.freedom) / (radius * radius);
            let spin = choose(free, add(turn.spin, scale(turn.torque, ease)), [zero; 3]);
            L::write_rows([spin[0], spin[1], spin[2], mobile], block_mut(&mut self.spin, b));
        }
    }

    /// Removes the grains that have left for good, in the order of pouring.
    pub(super) fn take_departed(&mut self, wall: &Shape) -> Vec<Departure> {
        let mut departed = Vec::new();
        let mut kept = 0;
        for i in 0..self.n {
            if wall.has_left(self.x[i]) {
                departed.push(Departure { id: self.id[i], x: self.x[i], v: self.v[i] });
                continue;
            }
            for column in self.columns() {
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
        departed.sort_unstable_by_key(|departure| departure.id);
        departed
    }

    /// Mass of all grains, relative to a mean grain.
    pub(super) fn mass(&self) -> f64 {
        self.centres().iter().map(mass).sum()
    }

    /// Centres of the grains that can move.
    pub(super) fn free(&self) -> impl Iterator<Item = &Vector> {
        self.centres().iter().zip(&self.spin).filter(|(_, spin)| spin[3] > 0.0).map(|(x, _)| x)
    }

    /// Largest and root-mean-square speed of the grains that can move, diameters per substep.
    pub(super) fn speeds(&self) -> (f32, f32) {
        let (mut largest, mut sum, mut mobile) = (0.0f32, 0.0f64, 0u32);
        for (v, _) in self.velocities().iter().zip(&self.spin).filter(|(_, spin)| spin[3] > 0.0) {
            mobile += 1;
            let speed2 = dot(*v, *v);
            largest = largest.max(speed2);
            sum += f64::from(speed2);
        }
        (largest.sqrt(), (sum / f64::from(mobile.max(1))).sqrt() as f32)
    }

    /// Makes the next substep rebuild the neighbour list.
    pub(super) fn outdate(&mut self) {
        self.changed = true;
    }

    /// Number of neighbour-list builds so far.
    pub(super) fn rebuilds(&self) -> u64 {
        self.neighbours.builds
    }

    /// Memory held, bytes. Lists every field, so that none is forgotten.
    pub(super) fn bytes(&self) -> usize {
        let Self {
            n: _,
            x,
            v,
            wall_anchor,
            spin,
            wall_stretch,
            id,
            listed,
            p,
            u,
            turning,
            impulse,
            torque,
            neighbours,
            changed: _,
            poured: _,
            elapsed: _,
            path: _,
            scratch,
            numbers,
        } = self;
        [x, v, wall_anchor, spin, wall_stretch, p, u, turning, impulse, torque, scratch]
            .into_iter()
            .map(held)
            .sum::<usize>()
            + [id, listed, numbers].into_iter().map(held).sum::<usize>()
            + neighbours.bytes()
    }

    /// The reason why the state is meaningless, if any.
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
}
