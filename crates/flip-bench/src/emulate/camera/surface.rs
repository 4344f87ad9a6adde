//! The imaged surfaces, as height fields over the base.

use flip_core::domain::seed::derive;

/// A pile on the base.
#[derive(Debug, Clone, PartialEq)]
pub enum Surface {
    /// No powder.
    Bare,
    /// A cone of known angle.
    Cone(Cone),
    /// Grains, as left by a simulation.
    Heap(Heap),
}

/// A cone that covers its base, or part of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cone {
    /// atan(2 h / d) of its height and the diameter of the area it covers, degrees.
    pub tip_deg: f64,
    /// Rounding of the apex, fraction of the radius: 0 is a point.
    pub rounding: f64,
    /// Position of the apex, mm from the axis: a skewed cone that still ends at the rim.
    pub off_centre_mm: [f64; 2],
    /// Diameter of the grains that roughen it, mm; 0 is smooth.
    pub grain_mm: f64,
    /// Radius that it covers, fraction of the base's.
    pub cover: f64,
}

impl Cone {
    /// Smooth, pointed, centred, covering its base.
    pub fn of_deg(tip_deg: f64) -> Self {
        Self { tip_deg, rounding: 0.0, off_centre_mm: [0.0; 2], grain_mm: 0.0, cover: 1.0 }
    }

    /// Height on a base of this radius, mm.
    pub fn height_mm(&self, base_radius_mm: f64) -> f64 {
        base_radius_mm * self.cover * self.tip_deg.to_radians().tan()
    }

    /// Fraction of the height lost at this fraction of the way from apex to rim.
    ///
    /// ```text
    /// g(q) = (sqrt(q^2 + k^2) - k) / (sqrt(1 + k^2) - k)
    /// ```
    fn lost(&self, q: f64) -> f64 {
        let k = self.rounding;
        (q.hypot(k) - k) / (1.0_f64.hypot(k) - k)
    }

    /// Slope of a line through the flank between 20 % and 80 % of the height, averaged by area over
    /// all directions, degrees: the result of a cone fit to a perfect picture.
    pub fn cone_deg(&self) -> f64 {
        let flank = (0..2000)
            .map(|k| (f64::from(k) + 0.5) / 2000.0)
            .filter(|q| (0.2..=0.8).contains(&self.lost(*q)));
        let [mut w, mut sq, mut sz, mut sqq, mut sqz] = [0.0; 5];
        for q in flank {
            let z = 1.0 - self.lost(q);
            (w, sq, sz, sqq, sqz) =
                (w + q, sq + q * q, sz + q * z, sqq + q * q * q, sqz + q * q * z);
        }
        let slope = (sq * sz - w * sqz) / (w * sqq - sq * sq);
        (slope * self.tip_deg.to_radians().tan()).atan().to_degrees()
    }

    fn height_at(&self, [x, y]: [f64; 2], base_radius: f64) -> f64 {
        let radius = base_radius * self.cover;
        if x.hypot(y) >= radius {
            return 0.0;
        }
        let [ex, ey] = self.off_centre_mm;
        let (dx, dy) = (x - ex, y - ey);
        let far = dx.hypot(dy).max(1e-9);
        // From the apex through this point to the rim.
        let along = (ex * dx + ey * dy) / far;
        let rim = (along * along + radius * radius - ex * ex - ey * ey).sqrt() - along;
        let smooth = self.height_mm(base_radius) * (1.0 - self.lost(far / rim));
        match self.grain_mm > 0.0 {
            true => (smooth + 0.5 * self.grain_mm * bump([x / self.grain_mm, y / self.grain_mm]))
                .max(0.0),
            false => smooth,
        }
    }
}

/// A number from -0.5 to 0.5 at each node of the unit grid, bilinear in between.
pub(super) fn bump([x, y]: [f64; 2]) -> f64 {
    let node =
        |i: f64, j: f64| derive(i as i64 as u64, &[j as i64 as u64]) as f64 / u64::MAX as f64 - 0.5;
    let (i, j) = (x.floor(), y.floor());
    let (a, b) = (x - i, y - j);
    let row = |j: f64| node(i, j) * (1.0 - a) + node(i + 1.0, j) * a;
    row(j) * (1.0 - b) + row(j + 1.0) * b
}

/// The top of a heap of grains.
#[derive(Debug, Clone, PartialEq)]
pub struct Heap {
    top_mm: Vec<f64>,
    ceiling_mm: f64,
    side: usize,
    cell_mm: f64,
}

impl Heap {
    /// A heap of grains with these centres (x, y from the axis of the base, z over its top) and one
    /// diameter, mm.
    pub fn of_grains(centres_mm: &[[f64; 3]], diameter_mm: f64) -> Self {
        let cell_mm = diameter_mm / 12.0;
        let reach =
            centres_mm.iter().fold(0.0_f64, |reach, c| reach.max(c[0].abs()).max(c[1].abs()))
                + diameter_mm;
        let half = (reach / cell_mm).ceil() as i64;
        let side = (2 * half + 1) as usize;
        let mut top_mm = vec![0.0_f64; side * side];
        for c in centres_mm {
            let [column, row] = [c[0], c[1]].map(|x| (x / cell_mm).round() as i64);
            for (i, j) in (-6..=6).flat_map(|i| (-6..=6).map(move |j| (column + i, row + j))) {
                let apart =
                    (i as f64 * cell_mm - c[0]).powi(2) + (j as f64 * cell_mm - c[1]).powi(2);
                let rise = (0.25 * diameter_mm * diameter_mm - apart).max(0.0).sqrt();
                if rise > 0.0 && i.abs() <= half && j.abs() <= half {
                    let top = &mut top_mm[(j + half) as usize * side + (i + half) as usize];
                    *top = top.max(c[2] + rise);
                }
            }
        }
        let ceiling_mm = top_mm.iter().copied().fold(0.0, f64::max);
        Self { top_mm, ceiling_mm, side, cell_mm }
    }

    fn height_at(&self, at: [f64; 2]) -> f64 {
        let half = (self.side / 2) as i64;
        let [i, j] = at.map(|x| (x / self.cell_mm).round() as i64 + half);
        let inside = |k: i64| (0..self.side as i64).contains(&k);
        if inside(i) && inside(j) { self.top_mm[j as usize * self.side + i as usize] } else { 0.0 }
    }
}

impl Surface {
    /// Height over the base's top at a point on a base of this radius, mm.
    pub fn height_at(&self, at: [f64; 2], base_radius_mm: f64) -> f64 {
        match self {
            Self::Bare => 0.0,
            Self::Cone(cone) => cone.height_at(at, base_radius_mm),
            Self::Heap(heap) => heap.height_at(at),
        }
    }

    /// Upper bound on the height of the surface, mm.
    pub(super) fn ceiling_mm(&self, base_radius_mm: f64) -> f64 {
        match self {
            Self::Bare => 0.0,
            Self::Cone(cone) => cone.height_mm(base_radius_mm) + cone.grain_mm,
            Self::Heap(heap) => heap.ceiling_mm,
        }
    }
}
