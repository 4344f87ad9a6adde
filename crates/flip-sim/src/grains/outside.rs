//! The memory of contacts, for solvers outside this crate.

use super::super::constraints::Vector;
use super::super::lanes::{Mask, WIDTH};
use super::super::mechanisms::{AGE, Memory};
use super::super::pairs::{NEW, Pairs};
use super::Grains;

impl Grains {
    /// Touching pairs by the grains' present places, each with the position of its first grain
    /// relative to the second where the contact stuck, and the stretch of its rolling and its age in
    /// substeps, which are zero without mechanisms.
    pub(crate) fn stuck(&self) -> Vec<([u32; 2], [f32; 3], [f32; 4])> {
        let pairs = &self.neighbours.pairs;
        let found = |(row, lane, ends): (usize, usize, [u32; 2])| {
            let anchor = [0, 1, 2].map(|k| pairs.anchor[row][k][lane]);
            let of = |memory: &Memory| [0, 1, 2, AGE].map(|k| memory[k][lane]);
            (ends, anchor, pairs.memory.get(row).map_or([0.0; 4], of))
        };
        self.pairs_of(&pairs.touching).map(found).collect()
    }

    /// Pairs that do not touch and that mechanisms link, by the grains' present places.
    pub(crate) fn bridged(&self) -> Vec<[u32; 2]> {
        let Pairs { touching, linked, .. } = &self.neighbours.pairs;
        let apart: Vec<Mask> = linked.iter().zip(touching).map(|(l, t)| l & !t).collect();
        self.pairs_of(&apart).map(|(.., ends)| ends).collect()
    }

    /// Substeps so far.
    pub(crate) fn elapsed(&self) -> u32 {
        self.elapsed
    }

    /// The pairs of these lanes of each row: row, lane and the grains' present places.
    fn pairs_of(&self, lanes: &[Mask]) -> impl Iterator<Item = (usize, usize, [u32; 2])> {
        let listed = self.listed.iter().filter(|place| **place != NEW).max();
        let mut present = vec![NEW; listed.map_or(0, |place| *place as usize + 1)];
        for (now, &place) in self.listed.iter().enumerate().filter(|(_, place)| **place != NEW) {
            present[place as usize] = now as u32;
        }
        let ends = &self.neighbours.pairs.ends;
        lanes.iter().enumerate().flat_map(move |(row, mask)| {
            let of = |lane: usize| {
                let place = |end: usize| ends[end][row * WIDTH + lane] as usize;
                let now = [0, 1].map(|end| present.get(place(end)).copied().unwrap_or(NEW));
                now.iter().all(|place| *place != NEW).then_some((row, lane, now))
            };
            (0..WIDTH).filter(|lane| mask >> lane & 1 == 1).filter_map(of).collect::<Vec<_>>()
        })
    }

    /// Where each grain's contact with the wall stuck, in the order of the centres; the fourth
    /// number is 1 while it touches.
    pub(crate) fn wall_anchors(&self) -> &[Vector] {
        &self.wall_anchor[..self.n]
    }

    /// Each grain's spin and the stretch of its rolling at the wall, in the order of the centres; the
    /// fourth number of the latter is 1 for a grain that clings to spoons.
    pub(crate) fn turning(&self) -> impl Iterator<Item = (&Vector, &Vector)> {
        self.spin[..self.n].iter().zip(&self.wall_stretch[..self.n])
    }
}
