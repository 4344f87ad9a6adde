//! Where everything lies in the card's memory, in words of 32 bits: the Rust side of
//! `cuda/state.cuh`.

use crate::Fault;
use flip_sim::batch::heaps::Ground;
use flip_sim::dispense::outside::{Departed, Grain, Mechanisms, Spoon, State, Strengths, Turning};

/// Room for grains of a spoon.
pub(crate) const GRAINS: usize = 2560;
/// Room for touching pairs, and for others.
const CONTACTS: usize = 16384;
const PAIRS: usize = 16384;
/// Room for cells of the search grid.
const CELLS: usize = 4096;
/// Words of a spoon's head, its law, a part of a plan, a job, an outcome.
pub(crate) const HEAD: usize = 32;
const LAW: usize = 38;
const MECHANISMS: usize = 19;
pub(crate) const PART: usize = 5;
pub(crate) const JOB: usize = 7;
pub(crate) const OUTCOME: usize = 10;
/// In the second word of a base simulator's anchor: the pair touches now.
const TOUCHES: u32 = 1 << 31;
/// In the fourth place of an extended anchor: the pair touches, or only a liquid bridge is left.
const TOUCHING: f32 = 1.0;
const BRIDGED: f32 = 2.0;
/// Bytes of shared memory of the small kernels.
pub(crate) const SHARED_SMALL: usize = (4 + 3) * 4 * GRAINS + PLACES;
const PLACES: usize = (2 * (2 * GRAINS + CELLS + 1)).next_multiple_of(16);

/// What a kernel computes; its state has a layout of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kernel {
    /// The base simulator.
    Base,
    /// Grains that turn, with the mechanisms of [`Mechanisms`].
    Extended,
}

impl Kernel {
    /// The one for this spoon.
    pub(crate) fn of(spoon: &Spoon) -> Self {
        if spoon.mechanisms.is_some() { Self::Extended } else { Self::Base }
    }

    /// The one for this heap.
    pub(crate) fn of_heap(ground: &Ground) -> Self {
        if ground.mechanisms.is_some() { Self::Extended } else { Self::Base }
    }

    const fn either(self, base: usize, extended: usize) -> usize {
        match self {
            Self::Base => base,
            Self::Extended => extended,
        }
    }

    /// Words of a law.
    pub(crate) const fn law(self) -> usize {
        LAW + self.either(0, MECHANISMS)
    }

    /// Words of a spoon before its memories: head, centres, velocities, and spins and radii.
    pub(crate) const fn motion(self) -> usize {
        HEAD + self.either(8, 13) * GRAINS
    }

    /// Words of a departed grain.
    pub(crate) const fn departed(self) -> usize {
        self.either(9, 10)
    }

    /// Words of a grain that is poured.
    pub(crate) const fn added(self) -> usize {
        self.either(7, 8)
    }

    const fn radii(self) -> usize {
        HEAD + 12 * GRAINS
    }

    // Where they begin in a memory, which itself begins with anchors and stretches at the spoon.
    const fn ids(self) -> usize {
        self.either(4, 8) * GRAINS
    }
    const fn touching(self) -> usize {
        self.ids() + 2 * GRAINS
    }
    const fn anchors(self) -> usize {
        self.touching() + CONTACTS
    }
    const fn rolls(self) -> usize {
        self.anchors() + self.either(2, 4) * CONTACTS
    }

    /// Words of what a spoon's grains remember.
    const fn memory(self) -> usize {
        self.rolls() + self.either(0, 4) * CONTACTS + PAIRS
    }

    /// Words of a spoon.
    pub(crate) const fn spoon(self) -> usize {
        self.motion() + 2 * self.memory() + 3 * GRAINS
    }

    /// Words of a spoon that were filled by the CPU: without the second memory.
    pub(crate) const fn image(self) -> usize {
        self.motion() + self.memory()
    }

    /// Bytes of a small kernel's room in the card's memory, which a large one has in shared memory.
    pub(crate) const fn room(self) -> usize {
        self.either(4 + 3, 4 + 3 + 3 + 3) * 4 * GRAINS
    }

    /// Bytes of shared memory of the large kernel.
    pub(crate) const fn shared(self) -> usize {
        SHARED_SMALL + self.room()
    }
}

/// Side of a grid cell, grain diameters: the search reaches at least this far. Larger grains have larger
/// cells.
const CELL: f32 = 2.0;
/// Grains higher than this above the rim share the grid's top cells, grain diameters.
const HEADROOM: f32 = 10.0;
/// Kept between the wall's reach and the shapes in which no wall is looked for, grain diameters.
const CLEARANCE: f32 = 0.02;
/// Fixed point of pairs' anchors, as in `cuda/law.cuh`.
const ANCHOR_SCALE: f32 = 524_288.0;
const ANCHOR_ZERO: f32 = 9_437_184.0;
const ANCHOR_BITS: u32 = 0x1f_ffff;

/// The law's numbers as the kernel reads them.
pub(crate) fn law(spoon: &Spoon) -> Vec<u32> {
    let [a, b, c] = spoon.semi_axes;
    let mut words = contacts(&spoon.grain, &spoon.wall, spoon.drag, spoon.mechanisms.is_some());
    let mut tell = |numbers: &[f32]| words.extend(numbers.iter().map(|x| x.to_bits()));
    let reach = spoon.mechanisms.map_or(0.0, |it| it.charge_reach).max(spoon.wall.reach);
    let widest = widest(spoon.mechanisms.as_ref());
    let within = |axis: f32| (1.0 - (widest + reach + CLEARANCE) / axis).max(0.0).powi(2);
    tell(&[spoon.drag, 1.0 / (a * a), 1.0 / (b * b), 1.0 / (c * c), c]);
    tell(&[within(a.min(b).min(c)), within(a.min(b)), spoon.rest_speed * spoon.rest_speed]);
    words.extend([spoon.quiet, spoon.slice]);
    words.extend(grid(widest, [-a - 3.0, -b - 3.0, -c - 1.5], [a + 3.0, b + 3.0, HEADROOM]));
    words.push(0.0f32.to_bits());
    words.extend(spoon.mechanisms.iter().flat_map(mechanisms));
    words
}

fn widest(of: Option<&Mechanisms>) -> f32 {
    of.map_or(0.5, |it| it.widest)
}

/// The mechanisms' numbers as the kernel reads them.
fn mechanisms(of: &Mechanisms) -> [u32; MECHANISMS] {
    let numbers = [
        // The moment of inertia of a solid sphere is 2/5 m r^2, and r is 1/2.
        2.5 * of.freedom / 0.25,
        of.rolling_friction,
        of.rolling_stiffness,
        of.rolling_damping,
        of.film,
        of.cling,
        1.0 / of.film_reach,
        of.charge,
        of.charge_reach,
        of.ageing,
        of.ageing_half_life,
        of.bridge,
        of.bridge_rupture,
        of.bridge_inverse_length,
        of.air,
        of.air_inertia,
        of.vibration,
        of.widest,
    ];
    std::array::from_fn(|k| {
        numbers.get(k).map_or_else(|| turns(of.vibration_pace), |x| x.to_bits())
    })
}

/// An angle a substep as a share of a turn, in 2^-32.
fn turns(radians: f64) -> u32 {
    (radians / std::f64::consts::TAU * 4_294_967_296.0).round() as u32
}

/// The same of a heap on its base.
pub(crate) fn ground(of: &Ground) -> Vec<u32> {
    let mut words = contacts(&of.grain, &of.wall, of.drag, of.mechanisms.is_some());
    words.push(of.drag.to_bits());
    // No bowl, and no speed at which it rests by itself.
    words.extend([0; 7]);
    words.extend([i32::MAX as u32, of.slice]);
    let wide = of.radius + 3.0;
    let widest = widest(of.mechanisms.as_ref());
    words.extend(grid(widest, [-wide, -wide, -2.0], [wide, wide, 1.3 * of.radius + HEADROOM]));
    words.push(of.radius.to_bits());
    words.extend(of.mechanisms.iter().flat_map(mechanisms));
    words
}

/// Between grains, and at walls. Pairs are given velocities before this drag, those of grains that turn
/// after it.
fn contacts(grain: &Strengths, wall: &Strengths, drag: f32, turns: bool) -> Vec<u32> {
    let drag = if turns { 1.0 } else { drag };
    let grain = Strengths {
        normal_damping: grain.normal_damping * drag,
        tangential_damping: grain.tangential_damping * drag,
        ..*grain
    };
    let both = [strengths(&grain), strengths(wall)];
    both.iter().flatten().map(|x| x.to_bits()).collect()
}

/// A grid from corner to corner for grains of up to this radius, with no more cells than there is room
/// for.
fn grid(widest: f32, low: [f32; 3], high: [f32; 3]) -> [u32; 7] {
    let mut cell = CELL + 2.0 * widest - 1.0;
    let size = loop {
        let size = [0, 1, 2].map(|k| ((high[k] - low[k]) / cell).ceil() as u32);
        if size.iter().product::<u32>() as usize <= CELLS {
            break size;
        }
        cell *= 1.05;
    };
    let [x, y, z] = low.map(f32::to_bits);
    [x, y, z, cell.to_bits(), size[0], size[1], size[2]]
}

fn strengths(of: &Strengths) -> [f32; 10] {
    [
        of.normal,
        of.normal_damping,
        of.tangential,
        1.0 / of.tangential,
        of.tangential_damping,
        of.friction,
        of.attraction,
        1.0 / (of.reach - of.onset),
        of.onset,
        of.reach,
    ]
}

/// A spoon's state as the kernel reads it; none if it has too many grains or contacts.
pub(crate) fn image(kernel: Kernel, state: &State) -> Option<Vec<u32>> {
    let n = state.grains.len();
    let contacts = state.stuck.len() + state.bridged.len();
    if n > GRAINS || contacts > CONTACTS {
        return None;
    }
    let mut words = vec![0; kernel.image()];
    let memory = kernel.motion();
    words[0] = n as u32;
    words[7] = contacts as u32;
    words[8] = state.elapsed;
    for (i, grain) in state.grains.iter().enumerate() {
        let share = 1.0 / grain.contacts.max(1.0).sqrt();
        set(&mut words, HEAD + 4 * i, [grain.x[0], grain.x[1], grain.x[2], share]);
        set(&mut words, HEAD + 4 * (GRAINS + i), [grain.v[0], grain.v[1], grain.v[2], 0.0]);
        let [x, y, z] = grain.wall_anchor.unwrap_or_default();
        set(&mut words, memory + 4 * i, [x, y, z, 0.0]);
        words[memory + kernel.ids() + i] = grain.id;
        words[memory + kernel.ids() + GRAINS + i] = u32::from(grain.wall_anchor.is_some());
    }
    for (k, ([a, b], anchor)) in state.stuck.iter().enumerate() {
        words[memory + kernel.touching() + k] = a | b << 16;
        let at = memory + kernel.anchors();
        match kernel {
            Kernel::Base => {
                let [low, high] = pack(*anchor);
                words[at + 2 * k] = low;
                words[at + 2 * k + 1] = high | TOUCHES;
            }
            Kernel::Extended => set(&mut words, at + 4 * k, with(*anchor, TOUCHING)),
        }
    }
    if kernel == Kernel::Extended {
        for (i, grain) in state.grains.iter().enumerate() {
            words[kernel.radii() + i] = grain.radius.to_bits();
        }
        for (i, it) in state.turning.iter().enumerate() {
            set(&mut words, HEAD + 4 * (2 * GRAINS + i), with(it.spin, 0.0));
            let clings = f32::from(u8::from(it.clings));
            set(&mut words, memory + 4 * (GRAINS + i), with(it.wall_stretch, clings));
        }
        for (k, (stretch, age)) in state.rolls.iter().zip(&state.ages).enumerate() {
            set(&mut words, memory + kernel.rolls() + 4 * k, with(*stretch, *age));
        }
        for (k, [a, b]) in (state.stuck.len()..).zip(&state.bridged) {
            words[memory + kernel.touching() + k] = a | b << 16;
            set(&mut words, memory + kernel.anchors() + 4 * k, with([0.0; 3], BRIDGED));
        }
    }
    Some(words)
}

fn with([x, y, z]: [f32; 3], w: f32) -> [f32; 4] {
    [x, y, z, w]
}

fn set(words: &mut [u32], at: usize, numbers: [f32; 4]) {
    for (word, number) in words[at..at + 4].iter_mut().zip(numbers) {
        *word = number.to_bits();
    }
}

fn pack(anchor: [f32; 3]) -> [u32; 2] {
    let [x, y, z] = anchor.map(|a| (a * ANCHOR_SCALE + ANCHOR_ZERO).to_bits() & ANCHOR_BITS);
    [x | y << 21, y >> 11 | z << 10]
}

fn unpack([low, high]: [u32; 2]) -> [f32; 3] {
    [low, low >> 21 | high << 11, high >> 10].map(|bits| {
        (f32::from_bits(0x4b00_0000 | (bits & ANCHOR_BITS)) - ANCHOR_ZERO) / ANCHOR_SCALE
    })
}

/// Which of the two memories of a spoon is the present one: where it lies among its words.
pub(crate) fn present_memory(kernel: Kernel, head: &[u32]) -> std::ops::Range<usize> {
    let start = kernel.motion() + head[2] as usize % 2 * kernel.memory();
    start..start + kernel.memory()
}

/// The state of a spoon from its words up to the end of its first memory, which must be the present
/// one; grains that left are not in it.
pub(crate) fn state(kernel: Kernel, words: &[u32]) -> State {
    let n = (words[0] as usize).min(GRAINS);
    let memory = kernel.motion();
    let four = |at: usize| [0, 1, 2, 3].map(|k| f32::from_bits(words[at + k]));
    let three = |at: usize| [0, 1, 2].map(|k| f32::from_bits(words[at + k]));
    let mut places = vec![None; n];
    let elapsed = match kernel {
        Kernel::Base => 0,
        Kernel::Extended => words[8] + words[5],
    };
    let mut state = State { elapsed, ..State::default() };
    for (i, place) in places.iter_mut().enumerate() {
        let [x, y, z, share] = four(HEAD + 4 * i);
        if x > 5e5 {
            continue;
        }
        let [vx, vy, vz, _] = four(HEAD + 4 * (GRAINS + i));
        let [wx, wy, wz, _] = four(memory + 4 * i);
        let touches = words[memory + kernel.ids() + GRAINS + i] != 0;
        *place = Some(state.grains.len() as u32);
        state.grains.push(Grain {
            id: words[memory + kernel.ids() + i],
            radius: match kernel {
                Kernel::Base => 0.5,
                Kernel::Extended => f32::from_bits(words[kernel.radii() + i]),
            },
            x: [x, y, z],
            v: [vx, vy, vz],
            // A grain without contacts has the share of one with a single contact.
            contacts: (1.0 / (share * share)).round(),
            wall_anchor: touches.then_some([wx, wy, wz]),
        });
        if kernel == Kernel::Extended {
            let [sx, sy, sz, clings] = four(memory + 4 * (GRAINS + i));
            state.turning.push(Turning {
                spin: three(HEAD + 4 * (2 * GRAINS + i)),
                wall_stretch: if touches { [sx, sy, sz] } else { [0.0; 3] },
                clings: clings > 0.0,
            });
        }
    }
    let mut stuck = Vec::new();
    for k in 0..(words[7] as usize).min(CONTACTS) {
        let pair = words[memory + kernel.touching() + k];
        let here = [pair & 0xffff, pair >> 16];
        let here = here.map(|end| places.get(end as usize).copied().flatten());
        let at = memory + kernel.anchors();
        let (anchor, holds) = match kernel {
            Kernel::Base => {
                let [low, high] = [words[at + 2 * k], words[at + 2 * k + 1]];
                (unpack([low, high]), if high & TOUCHES != 0 { TOUCHING } else { 0.0 })
            }
            Kernel::Extended => {
                let [x, y, z, holds] = four(at + 4 * k);
                ([x, y, z], holds)
            }
        };
        let rolls = match kernel {
            Kernel::Base => [0.0; 4],
            Kernel::Extended => four(memory + kernel.rolls() + 4 * k),
        };
        let [Some(a), Some(b)] = here else { continue };
        if holds == TOUCHING {
            stuck.push(([a, b], anchor, rolls));
        } else if holds == BRIDGED {
            state.bridged.push([a, b]);
        }
    }
    // Contacts that began at the same time are listed in any order.
    stuck.sort_unstable_by_key(|(ends, ..)| *ends);
    state.bridged.sort_unstable();
    for (ends, anchor, [x, y, z, age]) in stuck {
        state.stuck.push((ends, anchor));
        state.rolls.extend((kernel == Kernel::Extended).then_some([x, y, z]));
        state.ages.extend((kernel == Kernel::Extended).then_some(age));
    }
    state
}

/// What became of a job.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Outcome {
    pub fault: Option<Fault>,
    pub substeps: u32,
    pub rebuilds: u32,
    pub kept: u32,
    pub crowded: u32,
    /// Places in use, with grains that left since the last list.
    pub places: u32,
    /// Height of the highest grain that touches two others or more, diameters.
    pub apex: f32,
    /// Sum of the squared speeds, diameters per substep squared.
    pub speeds2: f64,
}

pub(crate) fn outcome(words: &[u32]) -> Outcome {
    let fault = match words[1] {
        0 => None,
        2 => Some(Fault::Overfull),
        _ => Some(Fault::TooFast),
    };
    let [low, high] = [words[8], words[9]].map(f64::from);
    Outcome {
        fault,
        substeps: words[2],
        rebuilds: words[3],
        kept: words[4],
        crowded: words[5],
        places: words[6],
        apex: f32::from_bits(words[7]),
        speeds2: (high * 1_048_576.0 + low) / 1_099_511_627_776.0,
    }
}

/// A grain that left, with the place of its job.
pub(crate) fn departed(kernel: Kernel, words: &[u32]) -> (usize, Departed) {
    let three = |at: usize| [0, 1, 2].map(|k| f32::from_bits(words[at + k]));
    let substep = (words[2] != u32::MAX).then_some(words[2]);
    let id = match kernel {
        Kernel::Base => 0,
        Kernel::Extended => words[9],
    };
    (words[0] as usize, Departed { part: words[1], substep, id, x: three(3), v: three(6) })
}

#[cfg(test)]
#[path = "layout_tests.rs"]
mod tests;
