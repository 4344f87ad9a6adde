//! The memory of contacts, for solvers outside this crate.

use super::super::constraints::Vector;
use super::super::lanes::WIDTH;
use super::super::pairs::NEW;
use super::Grains;

impl Grains {
    /// Touching pairs by the grains' present places, each with the position of its first grain
    /// relative to the second where the contact stuck, and the stretch of its rolling, which is zero
    /// without mechanisms.
    pub(crate) fn stuck(&self) -> Vec<([u32; 2], [f32; 3], [f32; 3])> {
        let pairs = &self.neighbours.pairs;
        let listed = self.listed.iter().filter(|place| **place != NEW).max();
        let mut present = vec![NEW; listed.map_or(0, |place| *place as usize + 1)];
        for (now, &place) in self.listed.iter().enumerate().filter(|(_, place)| **place != NEW) {
            present[place as usize] = now as u32;
        }
        let find = |place: u32| present.get(place as usize).copied().unwrap_or(NEW);
        let mut stuck = Vec::new();
        for (row, touching) in pairs.touching.iter().enumerate() {
            for lane in (0..WIDTH).filter(|lane| touching >> lane & 1 == 1) {
                let ends = [0, 1].map(|end| find(pairs.ends[end][row * WIDTH + lane]));
                if ends.iter().all(|end| *end != NEW) {
                    let of = |numbers: &[[f32; WIDTH]]| [0, 1, 2].map(|k| numbers[k][lane]);
                    let stretch = pairs.memory.get(row).map_or([0.0; 3], |it| of(it));
                    stuck.push((ends, of(&pairs.anchor[row]), stretch));
                }
            }
        }
        stuck
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
