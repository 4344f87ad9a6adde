//! A small discrete-element code: the angle of repose of a heap of soft spheres.
//!
//! A different kind of simulator from the product's, which moves grains by projecting positions:
//! here springs push, and Newton's law is integrated. It uses nothing from the crate, so the two
//! share physics, not code. A heap is poured from a rising opening onto a round plate of glued
//! grains; the excess falls off the rim. The second half is poured in portions; the angle is the
//! mean of those of the flank at rest after each, because a single heap of bonded grains may just
//! have slid.
//!
//! Units: mean diameter d, mean grain's mass m, gravity g; hence times in √(d/g), forces in m g,
//! stiffnesses in m g / d.
//!
//! | Symbol | Meaning | Law | Source |
//! |---|---|---|---|
//! | n, δ | normal from b to a; overlap | δ = Ra + Rb - distance | geometry |
//! | R | radius of a contact | R = min(Ra, Rb), a sphere's own on a plane | chosen here |
//! | k | normal stiffness | k = K 2R, K = [`STIFFNESS`] | chosen here: an elastic modulus times a length |
//! | m* | reduced mass | 1/m* = 1/ma + 1/mb | textbook |
//! | N | push along n | N = k δ - 2 ζ √(k m*) vn | textbook, linear spring and dashpot |
//! | e | restitution of an impact | e = exp(-π ζ / √(1 - ζ²)) | textbook, damped oscillator over half a period |
//! | tc | duration of an impact | tc = π √(m* / (k (1 - ζ²))) | textbook, the same |
//! | u | slip at the contact | du/dt = v of a against b at the contact, across n | Cundall and Strack (1979) |
//! | T | friction | T = -kt u - 2 ζ √(kt m*) du/dt, at most μ max(N, 0); kt = [`TANGENTIAL`] k | Cundall and Strack (1979) |
//! | θ | rolling | dθ/dt = ωa - ωb, about n as well: a grain on one contact stops spinning | after Ai, Chen, Rotter, Ooi (2011), elastic-plastic |
//! | M | resistance to rolling | M = -kr θ - 2 ζ √(kr I*) dθ/dt, at most μr R max(N, 0) | the same |
//! | kr, I* | its stiffness; inertia | kr = kt R²; I* = 2/5 m* R² | derived here: as if rolling by θ slipped by R θ |
//! | Bo | bond | attraction Bo m g along n at gaps -δ up to [`REACH`] | chosen here: constant, the same for all pairs |
//! | σ | spread of sizes | ln of the radius is normal of SD σ, cut at ±2 σ; mean volume that of d | chosen here |

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::f64::consts::{PI, TAU};
use std::iter::repeat_with;
use std::ops::{Add, Mul, Sub};

/// K, m g / d per d: the grain under ten others is pressed in by 1 % of d.
const STIFFNESS: f64 = 1000.0;
/// ζ of every dashpot: restitution 0.37.
const DAMPING: f64 = 0.3;
/// kt / k.
const TANGENTIAL: f64 = 2.0 / 7.0;
/// Gap up to which grains attract, d.
const REACH: f64 = 0.05;
/// Gap beyond contact or attraction up to which pairs are listed, d.
const SKIN: f64 = 0.2;
/// Grains poured over the cube of the plate's radius; a heap of slope s holds about 1.2 s.
const POURED_PER_CUBE: f64 = 4.0;

/// A powder of spheres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grains {
    /// Coulomb's coefficient μ.
    pub friction: f64,
    /// Coefficient of rolling resistance μr: the tangent of the slope on which a sphere stands.
    pub rolling: f64,
    /// SD σ of the logarithm of the radius, 0 to 0.3.
    pub size_spread: f64,
    /// Attraction of a pair over the weight of the mean grain, Bo; at 4, few heaps reach the rim.
    pub bond: f64,
    /// Grains poured; the plate grows with them.
    pub count: usize,
}

/// Angle of repose of one heap, degrees, or None if it does not come to rest, or does not cover its
/// base after most portions.
pub fn repose_deg(grains: &Grains, seed: u64) -> Option<f64> {
    const PORTIONS: usize = 5;
    let mut rng = Pcg64::seed_from_u64(seed);
    let radii = radii(grains, &mut rng);
    let plate = (grains.count as f64 / POURED_PER_CUBE).cbrt();
    let mut world = World::new(grains, plate_of_grains(plate, &mut rng));
    let dt = step_time(radii.iter().copied().fold(0.5, f64::min));
    let (heap, rest) = radii.split_at(radii.len() / 2);
    pour(&mut world, heap, plate, dt, &mut rng);
    let mut read = Vec::new();
    for portion in rest.chunks(rest.len().div_ceil(PORTIONS).max(1)) {
        pour(&mut world, portion, plate, dt, &mut rng);
        settle(&mut world, dt)?;
        read.extend(flank_deg(&world.spheres, plate));
    }
    (2 * read.len() > PORTIONS).then(|| read.iter().sum::<f64>() / read.len() as f64)
}

/// Radii of the cut lognormal distribution, scaled so that the mean volume is that of a sphere of
/// diameter 1.
fn radii(grains: &Grains, rng: &mut Pcg64) -> Vec<f64> {
    // Box-Muller transform of two uniform numbers.
    let normal =
        || (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt() * (TAU * rng.random::<f64>()).cos();
    let cut = repeat_with(normal).filter(|it| it.abs() <= 2.0).take(grains.count);
    let drawn: Vec<f64> = cut.map(|it| (grains.size_spread * it).exp()).collect();
    let mean_cube = drawn.iter().map(|it| it.powi(3)).sum::<f64>() / drawn.len() as f64;
    drawn.iter().map(|it| 0.5 * it / mean_cube.cbrt()).collect()
}

/// Grains of diameter 1 glued in a triangular lattice, uneven in height so that the grains on top
/// find no lattice.
fn plate_of_grains(plate: f64, rng: &mut Pcg64) -> Vec<Sphere> {
    let rows = plate.ceil() as i32 + 2;
    let lattice = (-rows..=rows).flat_map(|row| (-rows..=rows).map(move |column| (row, column)));
    lattice
        .map(|(row, column)| {
            (f64::from(column) + 0.5 * f64::from(row & 1), f64::from(row) * 0.75_f64.sqrt())
        })
        .filter(|(x, y)| x.hypot(*y) <= plate)
        .map(|(x, y)| Sphere::new(V3(x, y, rng.random_range(-0.15..0.15)), 0.5, Role::Glued))
        .collect()
}

/// The time step for grains of this radius and more: a 25th of the impact of the two smallest.
fn step_time(radius_min: f64) -> f64 {
    let reduced_mass = 0.5 * (2.0 * radius_min).powi(3);
    let stiffness = STIFFNESS * 2.0 * radius_min;
    PI * (reduced_mass / (stiffness * (1.0 - DAMPING * DAMPING))).sqrt() / 25.0
}

/// Drops grains of these radii, this many per unit time, from an opening half as wide as the plate
/// and this far above the top of the heap.
fn pour(world: &mut World, radii: &[f64], plate: f64, dt: f64, rng: &mut Pcg64) {
    const RATE: f64 = 12.0;
    const DROP: f64 = 2.5;
    let (width, mut time, mut poured) = (0.5 * plate, 0.0, 0);
    while poured < radii.len() {
        if time * RATE >= poured as f64 {
            let lies = |it: &&Sphere| it.role != Role::Fallen && it.velocity.norm() < 0.5;
            let below =
                world.spheres.iter().filter(lies).filter(|it| it.at.0.hypot(it.at.1) < width);
            let opening = below.map(|it| it.at.2 + it.radius).fold(0.0, f64::max) + DROP;
            let (out, around) = (width * rng.random::<f64>().sqrt(), TAU * rng.random::<f64>());
            let at = V3(out * around.cos(), out * around.sin(), opening + radii[poured]);
            if world.spheres.iter().all(|it| (it.at - at).norm() > it.radius + radii[poured]) {
                world.spheres.push(thrown(at, V3(0.0, 0.0, -1.0), radii[poured]));
                poured += 1;
            }
        }
        world.step(dt);
        time += dt;
    }
}

/// Waits until the mean grain has almost no kinetic energy; None if that takes too long.
fn settle(world: &mut World, dt: f64) -> Option<()> {
    const ENERGY: f64 = 1e-6;
    const TIME_MAX: usize = 100;
    let rests = |_| {
        (0..(1.0 / dt) as usize).for_each(|_| world.step(dt));
        let free = world.spheres.iter().filter(|it| it.role == Role::Free);
        let square =
            |it: &Sphere| it.velocity.dot(it.velocity) + it.gyration() * it.spin.dot(it.spin);
        free.clone().map(|it| 0.5 * square(it) / it.lightness).sum::<f64>()
            <= ENERGY * free.count() as f64
    };
    (0..TIME_MAX).any(rests).then_some(())
}

/// Slope of the least-squares line through the heights of the flank, averaged over rays, against
/// the distance from the axis.
///
/// None if at the outer end fewer than a third of the rays meet a free grain: the heap does not
/// reach the rim, and the line ends on the plate. A covered plate has one loose layer there, on
/// half of the rays or more.
fn flank_deg(spheres: &[Sphere], plate: f64) -> Option<f64> {
    const RAYS: u32 = 36;
    let on_rays = |distance: f64| {
        let rays = (0..RAYS).map(|r| TAU * f64::from(r) / f64::from(RAYS));
        rays.map(move |around| surface(spheres, distance * around.cos(), distance * around.sin()))
    };
    let [from, to] = [0.25 * plate, 0.85 * plate];
    if 3 * on_rays(to).filter(|it| it.1 == Role::Free).count() < RAYS as usize {
        return None;
    }
    let [mut squares, mut products] = [0.0; 2];
    for off_middle in (0..20).map(|p| (to - from) * (f64::from(p) / 19.0 - 0.5)) {
        let height =
            on_rays((from + to) / 2.0 + off_middle).map(|it| it.0).sum::<f64>() / f64::from(RAYS);
        squares += off_middle * off_middle;
        products += off_middle * height;
    }
    Some((-products / squares).atan().to_degrees())
}

/// Height and role of the highest sphere over a point; between grains, the height of the plate.
fn surface(spheres: &[Sphere], x: f64, y: f64) -> (f64, Role) {
    let over = spheres.iter().filter(|it| it.role != Role::Fallen).filter_map(|it| {
        let square = it.radius * it.radius - (it.at.0 - x).powi(2) - (it.at.1 - y).powi(2);
        (square > 0.0).then(|| (it.at.2 + square.sqrt(), it.role))
    });
    over.fold((0.0, Role::Glued), |highest, it| if it.0 > highest.0 { it } else { highest })
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Role {
    Free,
    Glued,
    /// Off the plate, and removed from the simulation.
    Fallen,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Sphere {
    at: V3,
    velocity: V3,
    spin: V3,
    force: V3,
    torque: V3,
    radius: f64,
    /// 1/mass; 0 if it does not move.
    lightness: f64,
    role: Role,
}

/// A free grain without spin.
fn thrown(at: V3, velocity: V3, radius: f64) -> Sphere {
    Sphere { velocity, ..Sphere::new(at, radius, Role::Free) }
}

impl Sphere {
    fn new(at: V3, radius: f64, role: Role) -> Self {
        let lightness = if role == Role::Free { (2.0 * radius).powi(-3) } else { 0.0 };
        Self {
            at,
            velocity: V3::ZERO,
            spin: V3::ZERO,
            force: V3::ZERO,
            torque: V3::ZERO,
            radius,
            lightness,
            role,
        }
    }

    /// 2/5 R², a sphere's inertia over its mass.
    fn gyration(&self) -> f64 {
        0.4 * self.radius * self.radius
    }
}

/// Two spheres near each other, and the memory of their contact.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Pair {
    a: usize,
    b: usize,
    slip: V3,
    roll: V3,
}

struct World {
    grains: Grains,
    gravity: V3,
    spheres: Vec<Sphere>,
    /// In the order of a, then b.
    pairs: Vec<Pair>,
    /// Positions when the pairs were listed.
    listed_at: Vec<V3>,
}

impl World {
    fn new(grains: &Grains, spheres: Vec<Sphere>) -> Self {
        Self {
            grains: *grains,
            gravity: V3(0.0, 0.0, -1.0),
            spheres,
            pairs: Vec::new(),
            listed_at: Vec::new(),
        }
    }

    /// Advances by dt, by semi-implicit Euler: forces, then velocities, then positions.
    fn step(&mut self, dt: f64) {
        let moved = |(it, then): (&Sphere, &V3)| (it.at - *then).norm() > 0.5 * SKIN;
        if self.listed_at.len() < self.spheres.len()
            || self.spheres.iter().zip(&self.listed_at).any(moved)
        {
            self.list_pairs();
        }
        for pair in &mut self.pairs {
            let (a, b) = (self.spheres[pair.a], self.spheres[pair.b]);
            let Some([force, torque_a, torque_b]) = touch(&self.grains, &a, &b, pair, dt) else {
                continue;
            };
            for (i, force, torque) in [(pair.a, force, torque_a), (pair.b, force * -1.0, torque_b)]
            {
                self.spheres[i].force = self.spheres[i].force + force;
                self.spheres[i].torque = self.spheres[i].torque + torque;
            }
        }
        for it in &mut self.spheres {
            if it.role == Role::Free {
                it.velocity = it.velocity + (self.gravity + it.force * it.lightness) * dt;
                it.spin = it.spin + it.torque * (it.lightness / it.gyration() * dt);
                it.at = it.at + it.velocity * dt;
            }
            (it.force, it.torque) = (V3::ZERO, V3::ZERO);
        }
    }

    /// Lists the pairs that may touch or attract before anything moves by half the skin; contacts
    /// keep their memory.
    ///
    /// Slabs along one axis serve as cells: with a thousand grains a slab holds a hundred.
    fn list_pairs(&mut self) {
        for it in self.spheres.iter_mut().filter(|it| it.role == Role::Free && it.at.2 < -2.0) {
            *it = Sphere::new(it.at, it.radius, Role::Fallen);
        }
        let spheres = &self.spheres;
        let mut along: Vec<usize> =
            (0..spheres.len()).filter(|&i| spheres[i].role != Role::Fallen).collect();
        along.sort_by(|&i, &j| spheres[i].at.0.total_cmp(&spheres[j].at.0));
        let widest = spheres.iter().map(|it| it.radius).fold(0.0, f64::max);
        let old = std::mem::take(&mut self.pairs);
        for (k, &i) in along.iter().enumerate() {
            let slab = spheres[i].at.0 + spheres[i].radius + widest + REACH + SKIN;
            for &j in along[k + 1..].iter().take_while(|&&j| spheres[j].at.0 < slab) {
                let near = spheres[i].radius + spheres[j].radius + REACH + SKIN;
                let moves = spheres[i].lightness + spheres[j].lightness > 0.0;
                if moves && (spheres[i].at - spheres[j].at).norm() < near {
                    let (a, b) = (i.min(j), i.max(j));
                    let known =
                        old.binary_search_by_key(&(a, b), |it| (it.a, it.b)).map(|at| old[at]);
                    self.pairs.push(known.unwrap_or(Pair { a, b, slip: V3::ZERO, roll: V3::ZERO }));
                }
            }
        }
        self.pairs.sort_unstable_by_key(|it| (it.a, it.b));
        self.listed_at = self.spheres.iter().map(|it| it.at).collect();
    }
}

/// The contact law of the module's table: force on a, torque on a, torque on b; None beyond the
/// reach of the attraction.
fn touch(grains: &Grains, a: &Sphere, b: &Sphere, pair: &mut Pair, dt: f64) -> Option<[V3; 3]> {
    let apart = a.at - b.at;
    let distance = apart.norm();
    let overlap = a.radius + b.radius - distance;
    if overlap < -REACH {
        return None;
    }
    let normal = apart * (1.0 / distance);
    let attraction = normal * -grains.bond;
    if overlap <= 0.0 {
        (pair.slip, pair.roll) = (V3::ZERO, V3::ZERO);
        return Some([attraction, V3::ZERO, V3::ZERO]);
    }
    let radius = a.radius.min(b.radius);
    let mass = 1.0 / (a.lightness + b.lightness);
    let stiffness = STIFFNESS * 2.0 * radius;
    // Lever arms that meet in the middle of the overlap conserve angular momentum.
    let (arm_a, arm_b) = (a.radius - 0.5 * overlap, b.radius - 0.5 * overlap);
    let velocity = a.velocity - b.velocity - (a.spin * arm_a + b.spin * arm_b).cross(normal);
    let approach = velocity.dot(normal);
    let push = stiffness * overlap - 2.0 * DAMPING * (stiffness * mass).sqrt() * approach;
    let load = push.max(0.0);
    let tangential = TANGENTIAL * stiffness;
    // The plane of slip has turned with the pair since the last step.
    pair.slip = pair.slip - normal * pair.slip.dot(normal);
    let friction = pull(
        &mut pair.slip,
        velocity - normal * approach,
        dt,
        tangential,
        mass,
        grains.friction * load,
    );
    let square = radius * radius;
    let (stiff, inertia, limit) =
        (tangential * square, 0.4 * mass * square, grains.rolling * radius * load);
    let resistance = pull(&mut pair.roll, a.spin - b.spin, dt, stiff, inertia, limit);
    let turning = friction.cross(normal);
    Some([
        normal * push + attraction + friction,
        turning * arm_a + resistance,
        turning * arm_b - resistance,
    ])
}

/// Loads a damped spring, which yields at a limit, by a rate over dt; returns the resulting force
/// or torque.
fn pull(stretch: &mut V3, rate: V3, dt: f64, stiffness: f64, inertia: f64, limit: f64) -> V3 {
    let damping = rate * (2.0 * DAMPING * (stiffness * inertia).sqrt());
    *stretch = *stretch + rate * dt;
    let answer = (*stretch * stiffness + damping) * -1.0;
    let size = answer.norm();
    if size <= limit {
        return answer;
    }
    let answer = answer * (limit / size);
    *stretch = (answer + damping) * (-1.0 / stiffness);
    answer
}

/// A vector in space.
#[derive(Debug, Clone, Copy, PartialEq)]
struct V3(f64, f64, f64);

impl V3 {
    const ZERO: Self = Self(0.0, 0.0, 0.0);

    fn dot(self, other: Self) -> f64 {
        self.0 * other.0 + self.1 * other.1 + self.2 * other.2
    }

    fn cross(self, other: Self) -> Self {
        let (V3(a, b, c), V3(x, y, z)) = (self, other);
        Self(b * z - c * y, c * x - a * z, a * y - b * x)
    }

    fn norm(self) -> f64 {
        self.dot(self).sqrt()
    }
}

impl Add for V3 {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0 + other.0, self.1 + other.1, self.2 + other.2)
    }
}

impl Sub for V3 {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + other * -1.0
    }
}

impl Mul<f64> for V3 {
    type Output = Self;
    fn mul(self, factor: f64) -> Self {
        Self(self.0 * factor, self.1 * factor, self.2 * factor)
    }
}

#[cfg(test)]
mod tests;
