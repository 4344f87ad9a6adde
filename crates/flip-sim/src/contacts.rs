//! All contacts, sixteen at a time: the sum of the constraints and the mechanisms.
#![allow(clippy::inline_always)] // See `lanes`.

use super::constraints::{
    Grip, V3, Vector, add, attract, choose, cross, inner, scale, separate, stick, sub,
};
use super::lanes::{Lanes, Mask, WIDTH};
use super::law::Law;
use super::mechanisms::{AtWall, Pair};
use super::pairs::Pairs;
use super::walls::{Shape, Wall};

/// Predicted state without contacts: centre and radius, velocity and share of damping, spin
/// (radians per substep).
#[derive(Clone, Copy)]
pub(super) struct Predicted<'a> {
    pub p: &'a [Vector],
    pub u: &'a [Vector],
    /// As long as the others, or empty if grains do not rotate.
    pub spin: &'a [Vector],
}

/// The grains of a block and the sums over their contacts.
pub(super) struct Turn<L> {
    pub p: V3<L>,
    pub u: V3<L>,
    pub radius: L,
    /// `1 / sqrt(contacts)`: a grain's contacts share its damping, so that the sum stays stable for
    /// any number of them.
    pub share: L,
    pub spin: V3<L>,
    /// Change of velocity.
    pub correction: V3<L>,
    /// Torque over mass.
    pub torque: V3<L>,
    /// Number of contacts.
    pub contacts: L,
}

/// Sums of the pairs' impulses by grain: change of velocity times mass, with the number of contacts
/// in the fourth place; and torque, empty if grains do not rotate.
pub(super) struct Sums<'a> {
    pub impulse: &'a mut [Vector],
    pub torque: &'a mut [Vector],
}

/// Mass relative to a grain of the mean size.
#[inline(always)]
pub(super) fn mass<L: Lanes>(radius: L) -> L {
    let diameter = radius + radius;
    diameter * diameter * diameter
}

/// Slip velocity and anchor of a contact carried along by surfaces that turn with `spins` (spin
/// times radius, summed over both). Differences preserve every bit where nothing spins; a sum would
/// turn minus zero into zero.
#[inline(always)]
fn carry<L: Lanes>(velocity: V3<L>, anchor: V3<L>, spins: V3<L>, normal: V3<L>) -> [V3<L>; 2] {
    let still = [L::splat(0.0); 3];
    let moved = sub(still, cross(normal, spins));
    [sub(velocity, moved), sub(anchor, sub(still, moved))]
}

/// Solves the contacts of all listed pairs. Impulses on the two grains of a pair are exactly
/// opposite.
#[inline(always)]
pub(super) fn pairs<L: Lanes, const EXTENDED: bool>(
    list: &mut Pairs,
    law: &Law,
    at: Predicted,
    sums: &mut Sums,
) {
    let c = &law.grain;
    let (one, zero) = (L::splat(1.0), L::splat(0.0));
    let reach = if EXTENDED { c.reach.max(law.mechanisms.pair_reach()) } else { c.reach };
    let near2 = L::splat((1.0 + reach) * (1.0 + reach));
    let (onset, inverse_ramp) = (L::splat(1.0 + c.onset), L::splat(1.0 / (c.reach - c.onset)));
    let (stiffness, looseness) = (L::splat(c.tangential), L::splat(1.0 / c.tangential));
    let Pairs { ends, anchor, touching, linked, memory, .. } = list;
    let [firsts, seconds] = [ends[0].as_chunks::<WIDTH>().0, ends[1].as_chunks::<WIDTH>().0];
    for row in 0..firsts.len() {
        let (first, second) = (&firsts[row], &seconds[row]);
        #[allow(unsafe_code)]
        // SAFETY: the list contains indices of grains and the two places after the last, and `p`
        // has them all; `Grains::list` builds both together.
        let ([ax, ay, az, radius], [bx, by, bz, their_radius]) =
            unsafe { (L::gather(at.p, first), L::gather(at.p, second)) };
        let offset = sub([ax, ay, az], [bx, by, bz]);
        let distance2 = inner(offset, offset);
        let radii = radius + their_radius;
        let near = if EXTENDED {
            let far = radii + L::splat(reach);
            distance2.below(far * far)
        } else {
            distance2.below(near2)
        };
        if near == 0 {
            touching[row] = 0;
            if EXTENDED {
                linked[row] = 0;
            }
            continue;
        }
        let distance = distance2.sqrt();
        // A square root and a division that do not depend on each other compute the inverse.
        let normal = scale(offset, distance * (one / distance2));
        let gap = if EXTENDED { distance - (radii + L::splat(c.onset)) } else { distance - onset };
        let mut along = zero - attract(gap, L::splat(c.attraction), inverse_ramp);
        let touch = gap.below(zero) & near;
        let (mut reduced_mass, mut effective) = (one, one);
        if EXTENDED {
            // Of unequal grains the lighter one yields: a correction for equal grains is an impulse
            // of their reduced mass.
            let (mine, theirs) = (mass(radius), mass(their_radius));
            reduced_mass = (mine + mine) * theirs / (mine + theirs);
            // Attraction grows with the effective radius.
            effective = L::splat(4.0) * radius * their_radius / radii;
            along = along * effective;
        }
        let mut push = zero;
        let mut held = [zero; 3];
        let mut turning = [zero; 3];
        if touch != 0 {
            #[allow(unsafe_code)]
            // SAFETY: as above; `u` and `spin` are as long as `p`.
            let ([ux, uy, uz, mine], [wx, wy, wz, theirs]) =
                unsafe { (L::gather(at.u, first), L::gather(at.u, second)) };
            let mut velocity = sub([ux, uy, uz], [wx, wy, wz]);
            let opening = inner(velocity, normal);
            let share = mine * theirs;
            push = separate(gap, opening, L::splat(c.normal), L::splat(c.normal_damping) * share);
            push = L::select(touch, push, zero);
            let kept = &mut anchor[row];
            let mut stuck = choose(
                touching[row],
                [L::load(&kept[0]), L::load(&kept[1]), L::load(&kept[2])],
                offset,
            );
            if EXTENDED {
                #[allow(unsafe_code)]
                // SAFETY: as above.
                let ([sx, sy, sz, _], [tx, ty, tz, _]) =
                    unsafe { (L::gather(at.spin, first), L::gather(at.spin, second)) };
                let (spin, their_spin) = ([sx, sy, sz], [tx, ty, tz]);
                let [lever, their_lever] = levers(distance, radius, radii);
                // Rotating surfaces carry the contact's two points along.
                let spins = add(scale(spin, lever), scale(their_spin, their_lever));
                [velocity, stuck] = carry(velocity, stuck, spins, normal);
                turning = sub(spin, their_spin);
            }
            let damping = L::splat(c.tangential_damping) * share;
            let grip = Grip { stiffness, looseness, damping, limit: L::splat(c.friction) * push };
            let stick = stick(offset, stuck, velocity, normal, opening, grip);
            stick.anchor[0].store(&mut kept[0]);
            stick.anchor[1].store(&mut kept[1]);
            stick.anchor[2].store(&mut kept[2]);
            held = choose(touch, stick.correction, [zero; 3]);
            if EXTENDED {
                push = push * reduced_mass;
                held = scale(held, reduced_mass);
            }
            along = along + push;
        }
        if EXTENDED {
            let met: Mask = touching[row] | linked[row];
            let memory = &mut memory[row];
            if met != Mask::MAX {
                for slot in memory.iter_mut() {
                    L::select(met, L::load(slot), zero).store(slot);
                }
            }
            linked[row] = touch;
            let mut pair = Pair {
                gap,
                radii: [radius, their_radius],
                effective,
                reduced_mass,
                touch,
                push,
                turning,
                memory,
                linked: &mut linked[row],
                pull: zero,
                torque: [zero; 3],
            };
            law.mechanisms.pair(&mut pair);
            along = along - pair.pull;
            let torque = choose(near, pair.torque, [zero; 3]);
            let [lever, their_lever] = levers(distance, radius, radii);
            let arm = cross(normal, held);
            let [x, y, z] = add(scale(arm, lever), torque);
            let [tx, ty, tz] = sub(scale(arm, their_lever), torque);
            #[allow(unsafe_code)]
            // SAFETY: as above; `torque` is as long as `p`.
            unsafe {
                L::scatter([x, y, z, zero], sums.torque, first);
                L::scatter([tx, ty, tz, zero], sums.torque, second);
            }
        }
        touching[row] = touch;
        let [x, y, z] = sub(choose(near, scale(normal, along), [zero; 3]), held);
        #[allow(unsafe_code)]
        // SAFETY: as above; `impulse` is as long as `p`.
        unsafe {
            L::exchange([x, y, z, L::select(touch, one, zero)], sums.impulse, first, second);
        }
    }
}

/// The levers of both grains add up to the distance, overlap or not, so that friction conserves
/// angular momentum.
#[inline(always)]
fn levers<L: Lanes>(distance: L, radius: L, radii: L) -> [L; 2] {
    let lever = distance * radius / radii;
    [lever, distance - lever]
}

/// Solves the contacts of block grains with a wall. `anchors` are where each contact stuck, with 1
/// in the fourth place while it touches; `stretches` are the rolling stretches, with 1 in the
/// fourth place for a grain that clings to spoons.
#[inline(always)]
pub(super) fn wall<L: Lanes, const EXTENDED: bool>(
    law: &Law,
    wall: &Shape,
    anchors: &mut [Vector; WIDTH],
    stretches: Option<&mut [Vector; WIDTH]>,
    turn: &mut Turn<L>,
) {
    let c = &law.wall;
    let (one, zero) = (L::splat(1.0), L::splat(0.0));
    let touched = wall.touch(turn.p);
    let surface = if EXTENDED { touched.gap + (L::splat(0.5) - turn.radius) } else { touched.gap };
    let reach = if EXTENDED { c.reach.max(law.mechanisms.wall_reach()) } else { c.reach };
    let near = surface.below(L::splat(reach));
    if near == 0 {
        for anchor in anchors {
            anchor[3] = 0.0;
        }
        return;
    }
    let (normal, gap) = (touched.normal, surface - L::splat(c.onset));
    let touch = gap.below(zero);
    let mut pull = attract(gap, L::splat(c.attraction), L::splat(1.0 / (c.reach - c.onset)));
    let mut velocity = sub(turn.u, touched.velocity);
    let opening = inner(velocity, normal);
    let share = turn.share;
    let push = separate(gap, opening, L::splat(c.normal), L::splat(c.normal_damping) * share);
    let push = L::select(touch, push, zero);
    let [ax, ay, az, was] = L::rows(anchors);
    let was = zero.below(was);
    let mut stuck = choose(was, [ax, ay, az], turn.p);
    // An anchor moves with its wall.
    stuck = sub(stuck, sub([zero; 3], touched.velocity));
    if EXTENDED {
        [velocity, stuck] = carry(velocity, stuck, scale(turn.spin, turn.radius), normal);
    }
    let grip = Grip {
        stiffness: L::splat(c.tangential),
        looseness: L::splat(1.0 / c.tangential),
        damping: L::splat(c.tangential_damping) * share,
        limit: L::splat(c.friction) * push,
    };
    let held = stick(turn.p, stuck, velocity, normal, opening, grip);
    let touches = L::select(touch, one, zero);
    L::write_rows([held.anchor[0], held.anchor[1], held.anchor[2], touches], anchors);
    let held = choose(touch, held.correction, [zero; 3]);
    if EXTENDED {
        let stretches = stretches.expect("grains with mechanisms have stretches");
        let [sx, sy, sz, clings] = L::rows(stretches);
        let mut stretch = choose(was, [sx, sy, sz], [zero; 3]);
        // At a wall, the effective radius is the grain's own.
        let lightness = (turn.radius + turn.radius) / mass(turn.radius);
        pull = pull * lightness;
        let mut contact = AtWall {
            gap,
            radius: turn.radius,
            lightness,
            touch,
            push,
            spin: turn.spin,
            stretch: &mut stretch,
            clings,
            pull: zero,
            torque: [zero; 3],
        };
        law.mechanisms.wall(&mut contact);
        pull = pull + contact.pull;
        turn.torque =
            add(turn.torque, add(scale(cross(normal, held), turn.radius), contact.torque));
        L::write_rows([stretch[0], stretch[1], stretch[2], clings], stretches);
    }
    let along = choose(near, scale(normal, push - pull), [zero; 3]);
    turn.correction = add(turn.correction, sub(along, held));
    turn.contacts = turn.contacts + touches;
}
