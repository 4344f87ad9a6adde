//! The flank of a heap as seen by a depth camera from above.

use super::constraints::Vector;

/// Number of sectors around the axis for the cone fit and for the coverage of the rim.
pub(super) const SECTORS: usize = 12;

/// The sector of a position.
pub(super) fn sector(at: [f64; 2]) -> usize {
    let turn = libm::atan2(at[1], at[0]) / std::f64::consts::TAU + 0.5;
    ((turn * SECTORS as f64) as usize).min(SECTORS - 1)
}

/// Side of a pixel of the height map, grain diameters.
const PIXEL: f64 = 0.25;

/// The cone through the flank of a heap.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Cone {
    /// Its slope, degrees.
    pub deg: f64,
    /// Height of its point, grain diameters.
    pub height: f64,
    /// What it was fitted to: sector, mean radius and mean height of a ring, grain diameters.
    pub rings: Vec<(usize, [f64; 2])>,
}

/// [`cone`]'s slope alone.
pub(super) fn cone_deg(x: &[Vector], base_radius: f64) -> f64 {
    cone(x, base_radius).deg
}

/// The flank as seen by a depth camera from above: the mean surface height of every one-diameter
/// ring in each sector, a least-squares line through the rings between 20 % and 80 % of the apex
/// height, and the mean line of the sectors.
pub(super) fn cone(x: &[Vector], base_radius: f64) -> Cone {
    let rings = base_radius.ceil() as usize;
    let mut profile = vec![Ring::default(); SECTORS * rings];
    let mut apex = 0.0f64;
    for (at, height) in surface(x, base_radius) {
        let r = libm::hypot(at[0], at[1]);
        if (r as usize) < rings {
            let ring = &mut profile[sector(at) * rings + r as usize];
            *ring = Ring {
                pixels: ring.pixels + 1.0,
                radius: ring.radius + r,
                height: ring.height + height,
            };
        }
        apex = apex.max(height);
    }
    let flank = 0.2 * apex..=0.8 * apex;
    let means = |sector: &[Ring]| -> Vec<[f64; 2]> {
        let seen = sector.iter().filter(|ring| ring.pixels > 0.0);
        let points = seen.map(|ring| [ring.radius / ring.pixels, ring.height / ring.pixels]);
        points.filter(|point| flank.contains(&point[1])).collect()
    };
    let sectors: Vec<Vec<[f64; 2]>> = profile.chunks(rings).map(means).collect();
    let lines: Vec<[f64; 2]> = sectors.iter().filter_map(|points| line(points)).collect();
    let mean = |k: usize| lines.iter().map(|l| l[k]).sum::<f64>() / lines.len().max(1) as f64;
    let used = sectors.into_iter().enumerate().filter(|(_, points)| line(points).is_some());
    Cone {
        deg: libm::atan(-mean(0)).to_degrees(),
        height: mean(1),
        rings: used.flat_map(|(k, points)| points.into_iter().map(move |p| (k, p))).collect(),
    }
}

/// Sums over the pixels of one ring in one sector.
#[derive(Debug, Clone, Copy, Default)]
struct Ring {
    pixels: f64,
    radius: f64,
    height: f64,
}

/// Position and height of every pixel of the height map that shows a grain.
pub(super) fn surface(x: &[Vector], base_radius: f64) -> impl Iterator<Item = ([f64; 2], f64)> {
    let half = (base_radius / PIXEL).ceil() as i64 + 2;
    let side = (2 * half + 1) as usize;
    let mut top = vec![f64::NEG_INFINITY; side * side];
    for p in x {
        let (centre, r2) = ([f64::from(p[0]), f64::from(p[1])], f64::from(p[3] * p[3]));
        let [column, row] = centre.map(|c| (c / PIXEL).round() as i64);
        let wide = (f64::from(p[3]) / PIXEL).ceil() as i64;
        for (i, j) in
            (-wide..=wide).flat_map(|i| (-wide..=wide).map(move |j| (column + i, row + j)))
        {
            let apart =
                (i as f64 * PIXEL - centre[0]).powi(2) + (j as f64 * PIXEL - centre[1]).powi(2);
            if apart < r2 && i.abs() <= half && j.abs() <= half {
                let pixel = &mut top[(j + half) as usize * side + (i + half) as usize];
                *pixel = pixel.max(f64::from(p[2]) + (r2 - apart).sqrt());
            }
        }
    }
    let position = move |k: usize| {
        [(k % side) as i64 - half, (k / side) as i64 - half].map(|c| c as f64 * PIXEL)
    };
    top.into_iter().enumerate().filter(|(_, z)| z.is_finite()).map(move |(k, z)| (position(k), z))
}

/// Least-squares slope of height over radius, and the height at the axis; `None` for fewer than three
/// points or without spread.
fn line(points: &[[f64; 2]]) -> Option<[f64; 2]> {
    let n = points.len() as f64;
    if n < 3.0 {
        return None;
    }
    let mean = |k: usize| points.iter().map(|p| p[k]).sum::<f64>() / n;
    let (r, z) = (mean(0), mean(1));
    let spread: f64 = points.iter().map(|p| (p[0] - r) * (p[0] - r)).sum();
    let slope = points.iter().map(|p| (p[0] - r) * (p[1] - z)).sum::<f64>() / spread;
    (spread > 1e-9).then_some([slope, z - slope * r])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cone_of_grains_has_its_own_angle() {
        for angle in [25.0f64, 35.0, 45.0] {
            let slope = angle.to_radians().tan();
            let mut x = Vec::new();
            for i in -100..=100 {
                for j in -100..=100 {
                    let (px, py) = (f64::from(i) * 0.1, f64::from(j) * 0.1);
                    let r = (px * px + py * py).sqrt();
                    if r <= 10.0 {
                        x.push([px as f32, py as f32, (slope * (10.0 - r)) as f32 - 0.5, 0.5]);
                    }
                }
            }
            let cone = cone(&x, 10.0);
            assert!((cone.deg - angle).abs() < 0.5, "{} for {angle}", cone.deg);
            // Its point is where that of the grains' cone is.
            assert!((cone.height - 10.0 * slope).abs() < 0.7, "{} for {angle}", cone.height);
            assert!(cone.rings.len() >= 3 * SECTORS, "{}", cone.rings.len());
        }
    }
}
