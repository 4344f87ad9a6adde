//! The pairs of nearby grains, in rows of sixteen, and the memory of each.

use super::grid::held;
use super::lanes::{Mask, WIDTH};
use super::mechanisms::{Memory, SLOTS};

/// Marks a grain that was not in the previous list.
pub(super) const NEW: u32 = u32::MAX;
/// Number of leading memory entries that point from one grain of a pair to the other, and flip sign
/// with it.
const POINTING: usize = 3;

/// The pairs, each once, with a memory for each.
///
/// Sixteen pairs form a row, solved at a time. First come the pairs that were near when the list
/// was built, so that most of their rows have all lanes busy, then those that may come near; in
/// both, pairs of the same grain are adjacent.
#[derive(Debug, Clone, Default)]
pub(super) struct Pairs {
    /// The earlier and the later grain of each pair, row after row. Unused places of a row hold the
    /// two places after the last grain.
    pub ends: [Vec<u32>; 2],
    /// By component: position of the first grain relative to the second where the contact stuck.
    /// Only meaningful where `touching` is set.
    pub anchor: Vec<[[f32; WIDTH]; 3]>,
    /// Lanes of a row that touch.
    pub touching: Vec<Mask>,
    /// Lanes of a row with a memory in addition to the anchor, and that memory; used by mechanisms
    /// only.
    pub linked: Vec<Mask>,
    pub memory: Vec<Memory>,
    /// Start of each grain's pairs among the near ones, and among those that may come near.
    begins: [Vec<u32>; 2],
    /// Start of the latter among all pairs.
    middle: usize,
    later: Vec<u32>,
    /// Number of grains in the previous list.
    grains: usize,
    kept: Vec<Kept>,
    /// Their memories, if mechanisms have any.
    kept_memory: Vec<[f32; SLOTS]>,
    renamed: Vec<u32>,
}

/// A pair that carries over from one list to the next.
#[derive(Debug, Clone)]
struct Kept {
    ends: [u32; 2],
    touched: bool,
    linked: bool,
    anchor: [f32; 3],
}

impl Pairs {
    /// Saves the state to carry over from the current list.
    pub(super) fn keep<const EXTENDED: bool>(&mut self) {
        self.kept.clear();
        self.kept_memory.clear();
        for row in 0..self.touching.len() {
            let touching = self.touching[row];
            let linked = if EXTENDED { self.linked[row] } else { 0 };
            let mut left = touching | linked;
            while left != 0 {
                let lane = left.trailing_zeros() as usize;
                left &= left - 1;
                self.kept.push(Kept {
                    ends: [self.ends[0][row * WIDTH + lane], self.ends[1][row * WIDTH + lane]],
                    touched: touching >> lane & 1 == 1,
                    linked: linked >> lane & 1 == 1,
                    anchor: std::array::from_fn(|k| self.anchor[row][k][lane]),
                });
                if EXTENDED {
                    self.kept_memory.push(std::array::from_fn(|k| self.memory[row][k][lane]));
                }
            }
        }
        self.ends.iter_mut().chain(&mut self.begins).chain([&mut self.later]).for_each(Vec::clear);
    }

    /// Adds the pairs of the next grain: the later ends of those that are near, and of those that
    /// may come near.
    pub(super) fn push(&mut self, near: &[u32], later: &[u32]) {
        let [first, second] = &mut self.ends;
        self.begins[0].push(second.len() as u32);
        self.begins[1].push(self.later.len() as u32);
        second.extend_from_slice(near);
        first.resize(second.len(), self.begins[0].len() as u32 - 1);
        self.later.extend_from_slice(later);
    }

    /// Completes the list once every grain's pairs are in. `was` is each grain's place in the
    /// previous list, [`NEW`] if it had none; the memory of a pair follows it.
    pub(super) fn finish<const EXTENDED: bool>(&mut self, was: &[u32]) {
        self.write_rows::<EXTENDED>(was.len());
        self.remember::<EXTENDED>(was);
        self.grains = was.len();
    }

    /// Memory held, bytes. Lists every field, so that none is forgotten.
    pub(super) fn bytes(&self) -> usize {
        let Self {
            ends,
            anchor,
            touching,
            linked,
            memory,
            begins,
            middle: _,
            later,
            grains: _,
            kept,
            kept_memory,
            renamed,
        } = self;
        ends.iter().chain(begins).chain([later, renamed]).map(held).sum::<usize>()
            + held(anchor)
            + held(touching)
            + held(linked)
            + held(memory)
            + held(kept)
            + held(kept_memory)
    }

    /// Moves the pairs that may come near behind the near ones, and allocates the memories.
    fn write_rows<const EXTENDED: bool>(&mut self, n: usize) {
        let padded = (n.div_ceil(WIDTH) * WIDTH) as u32;
        let [first, second] = &mut self.ends;
        let fill_up = |first: &mut Vec<u32>, second: &mut Vec<u32>| {
            first.resize(first.len().next_multiple_of(WIDTH), padded);
            second.resize(second.len().next_multiple_of(WIDTH), padded + 1);
        };
        self.begins[0].push(second.len() as u32);
        self.begins[1].push(self.later.len() as u32);
        fill_up(first, second);
        self.middle = second.len();
        for (i, end) in self.begins[1][1..].iter().enumerate() {
            first.resize(self.middle + *end as usize, i as u32);
        }
        second.extend_from_slice(&self.later);
        fill_up(first, second);
        let rows = second.len() / WIDTH;
        self.touching.clear();
        self.touching.resize(rows, 0);
        self.anchor.resize(rows, [[0.0; WIDTH]; 3]);
        if EXTENDED {
            self.linked.clear();
            self.linked.resize(rows, 0);
            self.memory.clear();
            self.memory.resize(rows, [[0.0; WIDTH]; SLOTS]);
        }
    }

    /// Restores the saved state of pairs that are still listed.
    fn remember<const EXTENDED: bool>(&mut self, was: &[u32]) {
        self.renamed.clear();
        self.renamed.resize(self.grains, NEW);
        for (now, &was) in was.iter().enumerate().filter(|(_, was)| **was != NEW) {
            self.renamed[was as usize] = now as u32;
        }
        for (k, kept) in self.kept.iter().enumerate() {
            let [a, b] = kept.ends.map(|place| self.renamed[place as usize]);
            if a == NEW || b == NEW {
                continue;
            }
            let Some(place) = self.place(a.min(b) as usize, a.max(b)) else { continue };
            let sign = if a < b { 1.0 } else { -1.0 };
            let (row, lane) = (place / WIDTH, place % WIDTH);
            for axis in 0..3 {
                self.anchor[row][axis][lane] = sign * kept.anchor[axis];
            }
            self.touching[row] |= Mask::from(kept.touched) << lane;
            if EXTENDED {
                self.linked[row] |= Mask::from(kept.linked) << lane;
                for (slot, number) in self.kept_memory[k].iter().enumerate() {
                    self.memory[row][slot][lane] =
                        if slot < POINTING { sign * number } else { *number };
                }
            }
        }
    }

    /// Place at which the pair of grains `i` and `j > i` is listed.
    fn place(&self, i: usize, j: u32) -> Option<usize> {
        let among = |begin: usize, begins: &[u32]| {
            let (first, end) = (begin + begins[i] as usize, begin + begins[i + 1] as usize);
            self.ends[1][first..end].iter().position(|&other| other == j).map(|place| first + place)
        };
        among(0, &self.begins[0]).or_else(|| among(self.middle, &self.begins[1]))
    }
}
