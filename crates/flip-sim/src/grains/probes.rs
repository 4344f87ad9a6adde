//! Measurements of all grains at once, and of one grain for tests.

use super::super::constraints::{Vector, dot};
use super::Grains;

impl Grains {
    /// Mean and largest overlap of overlapping grains, in diameters.
    pub(crate) fn overlaps(&self) -> (f64, f64) {
        let mut along_x = self.centres().to_vec();
        let widest = along_x.iter().fold(0.0, |widest: f32, x| widest.max(x[3]));
        along_x.sort_unstable_by(|a, b| a[0].total_cmp(&b[0]));
        let (mut sum, mut largest, mut overlapping) = (0.0f64, 0.0f64, 0u32);
        for (i, a) in along_x.iter().enumerate() {
            for b in along_x[i + 1..].iter().take_while(|b| b[0] - a[0] < a[3] + widest) {
                let offset: Vector = std::array::from_fn(|k| a[k] - b[k]);
                let overlap = f64::from(a[3] + b[3] - dot(offset, offset).sqrt());
                if overlap > 0.0 {
                    sum += overlap;
                    largest = largest.max(overlap);
                    overlapping += 1;
                }
            }
        }
        (sum / f64::from(overlapping.max(1)), largest)
    }

    /// Spin of a grain by id, radians per substep.
    #[cfg(test)]
    pub(crate) fn spin(&self, id: u32) -> Vector {
        self.spin[self.id.iter().position(|&other| other == id).expect("the grain is still there")]
    }

    /// Centre and velocity of a grain by id.
    #[cfg(test)]
    pub(crate) fn grain(&self, id: u32) -> (Vector, Vector) {
        let place =
            self.id.iter().position(|&other| other == id).expect("the grain is still there");
        (self.x[place], self.v[place])
    }
}
