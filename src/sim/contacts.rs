//! Every contact of sixteen grains: what the constraints and the mechanisms add up to.
#![allow(clippy::inline_always)] // See `lanes`.

use super::constraints::{Grip, V3, Vector, add, attract, choose, cross, inner, scale, separate, stick, sub};
use super::lanes::{Lanes, Mask, WIDTH};
use super::law::Law;
use super::mechanisms::{AtWall, Pair};
use super::neighbours::Neighbours;
use super::walls::{Shape, Wall};

/// Where everything would be without contacts: centre and radius, velocity and number of contacts, spin (radians per substep).
#[derive(Clone, Copy)]
pub(super) struct Predicted<'a> {
    pub p: &'a [Vector],
    pub u: &'a [Vector],
    /// As long as the others, or empty where grains do not rotate.
    pub spin: &'a [Vector],
}

/// The grains of a block, and what their contacts add up to.
pub(super) struct Turn<L> {
    pub p: V3<L>,
    pub u: V3<L>,
    pub radius: L,
    pub contacts: L,
    pub spin: V3<L>,
    pub sum: Sum<L>,
}

/// What contacts add up to: change of velocity, torque over mass, number.
pub(super) struct Sum<L> {
    pub correction: V3<L>,
    pub torque: V3<L>,
    pub contacts: L,
}

/// Mass over that of a grain of the mean size.
#[inline(always)]
fn mass<L: Lanes>(radius: L) -> L {
    let diameter = radius + radius;
    diameter * diameter * diameter
}

/// Surfaces that turn with `spins` (spin times radius, summed over both) carry their contact along: the slip velocity and the anchor
/// then. Each difference leaves every bit alone where nothing spins; a sum would turn minus zero into zero.
#[inline(always)]
fn carry<L: Lanes>(velocity: V3<L>, anchor: V3<L>, spins: V3<L>, normal: V3<L>) -> [V3<L>; 2] {
    let still = [L::splat(0.0); 3];
    let moved = sub(still, cross(normal, spins));
    [sub(velocity, moved), sub(anchor, sub(still, moved))]
}

/// Contacts with the listed neighbours of block `b`.
#[inline(always)]
pub(super) fn pairs<L: Lanes, const EXTENDED: bool>(
    list: &mut Neighbours,
    b: usize,
    law: &Law,
    at: Predicted,
    turn: &mut Turn<L>,
) {
    let c = &law.grain;
    let (one, zero) = (L::splat(1.0), L::splat(0.0));
    let reach = if EXTENDED { c.reach.max(law.mechanisms.pair_reach()) } else { c.reach };
    let near2 = L::splat((1.0 + reach) * (1.0 + reach));
    let (onset, inverse_ramp) = (L::splat(1.0 + c.onset), L::splat(1.0 / (c.reach - c.onset)));
    let my_mass = mass(turn.radius);
    let Neighbours { first, other, anchor, touching, linked, memory, .. } = list;
    for row in first[b] as usize..first[b + 1] as usize {
        let others = &other[row];
        #[allow(unsafe_code)]
        // SAFETY: the list names grains and the one that is nowhere, and `p` has them all; `Grains::list` makes both together.
        let [qx, qy, qz, their_radius] = unsafe { L::gather(at.p, others) };
        let offset = sub(turn.p, [qx, qy, qz]);
        let distance2 = inner(offset, offset);
        let radii = turn.radius + their_radius;
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
        let normal = scale(offset, one / distance);
        let gap = if EXTENDED { distance - (radii + L::splat(c.onset)) } else { distance - onset };
        let mut along = zero - attract(gap, L::splat(c.attraction), inverse_ramp);
        let touch = gap.below(zero) & near;
        // Of unequal grains the lighter one gives way: shares of a correction are as the other's mass to both.
        let (mut side, mut lightness) = (one, one);
        if EXTENDED {
            let their_mass = mass(their_radius);
            side = (their_mass + their_mass) / (my_mass + their_mass);
            // Attraction grows with the effective radius.
            let effective = L::splat(4.0) * turn.radius * their_radius / radii;
            lightness = effective / my_mass;
            along = along * lightness;
        }
        // The levers of both add up to the distance, overlap or not, so that friction keeps angular momentum.
        let lever = distance * turn.radius / radii;
        let mut push = zero;
        let mut turning = [zero; 3];
        if touch != 0 {
            #[allow(unsafe_code)]
            // SAFETY: as above; `u` and `spin` are as long as `p`.
            let [wx, wy, wz, theirs] = unsafe { L::gather(at.u, others) };
            let mut velocity = sub(turn.u, [wx, wy, wz]);
            let opening = inner(velocity, normal);
            // A grain's contacts share its damping: the sum stays stable however many there are.
            let share = one / one.max(turn.contacts * theirs).sqrt();
            let taken = if EXTENDED { share * side } else { share };
            let stiffness = if EXTENDED { L::splat(c.normal) * side } else { L::splat(c.normal) };
            push = separate(gap, opening, stiffness, L::splat(c.normal_damping) * taken);
            push = L::select(touch, push, zero);
            along = along + push;
            let kept = &mut anchor[row];
            let mut stuck = choose(touching[row], [L::load(&kept[0]), L::load(&kept[1]), L::load(&kept[2])], offset);
            if EXTENDED {
                #[allow(unsafe_code)]
                // SAFETY: as above.
                let [sx, sy, sz, _] = unsafe { L::gather(at.spin, others) };
                let spin = [sx, sy, sz];
                // Surfaces that turn carry the contact's two points along.
                let spins = add(scale(turn.spin, lever), scale(spin, distance - lever));
                [velocity, stuck] = carry(velocity, stuck, spins, normal);
                turning = sub(turn.spin, spin);
            }
            let grip = Grip {
                stiffness: if EXTENDED { L::splat(c.tangential) * side } else { L::splat(c.tangential) },
                damping: L::splat(c.tangential_damping) * taken,
                limit: L::splat(c.friction) * push,
            };
            let held = stick(offset, stuck, velocity, normal, opening, grip);
            held.anchor[0].store(&mut kept[0]);
            held.anchor[1].store(&mut kept[1]);
            held.anchor[2].store(&mut kept[2]);
            let held = choose(touch, held.correction, [zero; 3]);
            turn.sum.correction = sub(turn.sum.correction, held);
            turn.sum.contacts = turn.sum.contacts + L::select(touch, one, zero);
            if EXTENDED {
                turn.sum.torque = add(turn.sum.torque, scale(cross(normal, held), lever));
            }
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
                normal,
                radii: [turn.radius, their_radius],
                lightness,
                side,
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
            turn.sum.torque = add(turn.sum.torque, choose(near, pair.torque, [zero; 3]));
        }
        touching[row] = touch;
        turn.sum.correction = add(turn.sum.correction, choose(near, scale(normal, along), [zero; 3]));
    }
}

/// Contact of block grains with a wall. `anchors` are where each contact stuck, with 1 in the fourth place while it touches; `stretches`
/// are the rolling stretches, with 1 in the fourth place for a grain that clings to spoons.
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
    let share = one / one.max(turn.contacts).sqrt();
    let push = separate(gap, opening, L::splat(c.normal), L::splat(c.normal_damping) * share);
    let push = L::select(touch, push, zero);
    let [ax, ay, az, was] = L::rows(anchors);
    let was = zero.below(was);
    let mut stuck = choose(was, [ax, ay, az], turn.p);
    // An anchor goes with its wall.
    stuck = sub(stuck, sub([zero; 3], touched.velocity));
    if EXTENDED {
        [velocity, stuck] = carry(velocity, stuck, scale(turn.spin, turn.radius), normal);
    }
    let grip = Grip {
        stiffness: L::splat(c.tangential),
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
        // A wall's effective radius is the grain's own.
        let lightness = (turn.radius + turn.radius) / mass(turn.radius);
        pull = pull * lightness;
        let mut contact = AtWall {
            gap,
            normal,
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
        turn.sum.torque = add(turn.sum.torque, add(scale(cross(normal, held), turn.radius), contact.torque));
        L::write_rows([stretch[0], stretch[1], stretch[2], clings], stretches);
    }
    let along = choose(near, scale(normal, push - pull), [zero; 3]);
    turn.sum.correction = add(turn.sum.correction, sub(along, held));
    turn.sum.contacts = turn.sum.contacts + touches;
}
