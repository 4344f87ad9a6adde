//! The pile itself: the height of its apex and the slope of its flank, each from a surface fitted
//! to many pixels.

use super::fit::{Fitted, Known, Point, fit};
use super::{Dimensions, Refusal};
use nalgebra::SVector;
use std::f64::consts::TAU;

/// The top of the pile: a cone with a rounded apex.
///
/// ```text
/// z = z_0 - s sqrt((x - x_c)^2 + (y - y_c)^2 + q)        z_apex = z_0 - s sqrt(q)
/// ```
///
/// Parameters z_0, s, x_c, y_c, q. The highest pixel is biased by its noise, and stereo fails where
/// the apex stands against a distant background; the fitted surface averages the noise of hundreds
/// of pixels and bridges the gap. Written with q rather than its root, so that a pointed apex is
/// not a singular case.
pub(super) type Apex = Fitted<5>;

/// The flank between 20 % and 80 % of the height: `z = z_0 - t sqrt((x - x_c)^2 + (y - y_c)^2)`;
/// parameters z_0, t, x_c, y_c.
pub(super) type Flank = Fitted<4>;

/// Fraction of the base's radius whose points determine the apex, and within which enough points
/// must be visible.
const TOP: f64 = 0.5;
const NEAR: f64 = 0.22;
const NEAR_PIXELS_MIN: usize = 12;
/// Standard deviation of the offset between the axes of spout and pile, fraction of the base's
/// radius.
const CENTRE_SD: f64 = 0.05;
/// Prior mean and standard deviation of the rounding q, fraction of the square of the base's
/// radius: where little of the top is visible, height and rounding could otherwise grow together
/// without limit.
const ROUNDING: [f64; 2] = [0.01, 0.015];
/// Relative standard deviation between the slope far from the apex and that of the flank's cone.
const SLOPE_SD: f64 = 0.03;
/// Minimum slope of a pile, degrees.
const STEEP_MIN_DEG: f64 = 8.0;
/// Minimum number of pixels of a flank.
const FLANK_PIXELS_MIN: usize = 150;
/// Maximum RMS distance of a flank from its cone, fraction of the pile's height.
const FLANK_RMS_MAX: f64 = 0.12;
/// Number of sectors around the axis.
pub(super) const SECTORS: usize = 12;
/// Pixels needed for a sector to count as visible.
const SECTOR_PIXELS_MIN: usize = 20;
/// Radii at which the rim is checked, fraction of the base's radius, and fraction of the height of
/// a cone to the rim that must be found there.
const RIM: [f64; 2] = [0.84, 0.95];
const RIM_HEIGHT_MIN: f64 = 0.4;

fn away(at: [f64; 3], centre: [f64; 2]) -> f64 {
    (at[0] - centre[0]).hypot(at[1] - centre[1])
}

/// Height of the pile, mm, before any fit: the level that nine tenths of the points near the axis
/// do not exceed.
pub(super) fn height(points: &[Point], axis: [f64; 2], rig: &Dimensions) -> Result<f64, Refusal> {
    let radius = rig.base_diameter_mm / 2.0;
    let mut near: Vec<f64> =
        points.iter().filter(|p| away(p.at, axis) < NEAR * radius).map(|p| p.at[2]).collect();
    if near.len() < NEAR_PIXELS_MIN {
        return Err(Refusal::ApexNotFound { pixels: near.len(), wanted: NEAR_PIXELS_MIN });
    }
    near.sort_unstable_by(f64::total_cmp);
    let height_mm = near[near.len() * 9 / 10];
    match height_mm < radius * STEEP_MIN_DEG.to_radians().tan() {
        true => Err(Refusal::PileNotFound { height_mm }),
        false => Ok(height_mm),
    }
}

/// Locate the apex, over a flank of this slope.
pub(super) fn apex(
    points: &[Point],
    axis: [f64; 2],
    height_mm: f64,
    slope: f64,
    rig: &Dimensions,
) -> Result<Apex, Refusal> {
    let q = ROUNDING[0] * (rig.base_diameter_mm / 2.0).powi(2);
    let start = [height_mm + slope * q.sqrt(), slope, axis[0], axis[1], q];
    let rough = top(points, axis, start, slope, rig)?;
    let expected: Vec<Point> =
        points.iter().map(|p| p.expecting(|at| rough.height(at)).unwrap_or(*p)).collect();
    top(&expected, axis, rough.parameters, slope, rig)
}

/// How far from the apex valid depth begins, mm: the distance of the fifth nearest point.
pub(super) fn gap(points: &[Point], apex: [f64; 2]) -> f64 {
    let mut apart: Vec<f64> = points.iter().map(|p| away(p.at, apex)).collect();
    apart.sort_unstable_by(f64::total_cmp);
    apart.get(4).copied().unwrap_or(f64::INFINITY)
}

/// One fit of the top, from a start close to the solution.
pub(super) fn top(
    points: &[Point],
    axis: [f64; 2],
    start: [f64; 5],
    slope: f64,
    rig: &Dimensions,
) -> Result<Apex, Refusal> {
    let radius = rig.base_diameter_mm / 2.0;
    let inside =
        |p: &Point| (p.expected[0] - axis[0]).hypot(p.expected[1] - axis[1]) < TOP * radius;
    let top: Vec<Point> = points.iter().copied().filter(inside).collect();
    let [x, y] = centred(axis, radius, 2);
    let rounding = (4, ROUNDING[0] * radius * radius, ROUNDING[1] * radius * radius);
    let known = [x, y, rounding, (1, slope, SLOPE_SD * slope)];
    let kept = |p: [f64; 5]| {
        [p[0], p[1].clamp(0.05, 3.0), p[2], p[3], p[4].clamp(0.0, 0.3 * radius * radius)]
    };
    let unseen = Refusal::ApexNotFound { pixels: top.len(), wanted: NEAR_PIXELS_MIN };
    fit(start, &top, &known, kept, rounded).ok_or(unseen)
}

/// The points whose rays meet a surface, each with the position where they do.
fn expecting(points: &[Point], height: impl Fn([f64; 2]) -> f64) -> Vec<Point> {
    points.iter().filter_map(|point| point.expecting(&height)).collect()
}

impl Flank {
    /// Height of the cone at a position.
    fn height(&self, at: [f64; 2]) -> f64 {
        pointed(&self.parameters, at).0
    }
}

impl Apex {
    /// Height of the top at a position.
    fn height(&self, at: [f64; 2]) -> f64 {
        rounded(&self.parameters, at).0
    }

    /// Position of the apex, mm.
    pub fn at(&self) -> [f64; 3] {
        let [z0, s, x, y, q] = self.parameters;
        [x, y, z0 - s * q.sqrt()]
    }

    /// Radius of the rounding, mm.
    pub fn rounding_mm(&self) -> f64 {
        self.parameters[4].sqrt()
    }

    /// Variance of its height as if all pixels were independent, mm^2.
    pub fn height_variance(&self) -> f64 {
        let [_, s, _, _, q] = self.parameters;
        // The root of q is not linear near zero: its slope is taken one standard deviation above.
        let above = (q + self.covariance[(4, 4)].sqrt()).sqrt().max(1e-6);
        let by = SVector::from([1.0, -q.sqrt(), 0.0, 0.0, -0.5 * s / above]);
        (by.transpose() * self.covariance * by)[(0, 0)]
    }
}

fn centred(axis: [f64; 2], radius: f64, first: usize) -> [Known; 2] {
    [(first, axis[0], CENTRE_SD * radius), (first + 1, axis[1], CENTRE_SD * radius)]
}

fn rounded(p: &[f64; 5], [x, y]: [f64; 2]) -> (f64, [f64; 5]) {
    let [z0, s, xc, yc, q] = *p;
    let (dx, dy) = (x - xc, y - yc);
    let root = (dx * dx + dy * dy + q).sqrt().max(1e-9);
    (z0 - s * root, [1.0, -root, s * dx / root, s * dy / root, -0.5 * s / root])
}

fn pointed(p: &[f64; 4], [x, y]: [f64; 2]) -> (f64, [f64; 4]) {
    let [z0, t, xc, yc] = *p;
    let (dx, dy) = (x - xc, y - yc);
    let r = dx.hypot(dy).max(1e-9);
    (z0 - t * r, [1.0, -r, t * dx / r, t * dy / r])
}

/// The flank and the cone through it. Points are selected by their own heights first, then by where
/// their rays meet that first cone.
pub(super) fn flank(
    points: &[Point],
    axis: [f64; 2],
    height_mm: f64,
    rig: &Dimensions,
) -> Result<(Vec<Point>, Flank), Refusal> {
    let range = 0.2 * height_mm..=0.8 * height_mm;
    let inside = |p: &Point| away(p.at, axis) < 0.5 * rig.base_diameter_mm;
    let seen: Vec<Point> =
        points.iter().copied().filter(|p| inside(p) && range.contains(&p.at[2])).collect();
    let rough = cone(&seen, axis, height_mm, rig)?;
    let chosen = expecting(points, |at| rough.height(at)).into_iter();
    let chosen: Vec<Point> = chosen.filter(|p| range.contains(&rough.height(p.expected))).collect();
    let cone = cone(&chosen, axis, height_mm, rig)?;
    Ok((chosen, cone))
}

/// Fit the cone through points of a flank.
pub(super) fn cone(
    flank: &[Point],
    axis: [f64; 2],
    height_mm: f64,
    rig: &Dimensions,
) -> Result<Flank, Refusal> {
    let radius = rig.base_diameter_mm / 2.0;
    let none = |rms_mm| Refusal::NoCone { pixels: flank.len(), rms_mm };
    if flank.len() < FLANK_PIXELS_MIN {
        return Err(none(0.0));
    }
    let known = centred(axis, radius, 2);
    let kept = |p: [f64; 4]| [p[0], p[1].clamp(0.05, 3.0), p[2], p[3]];
    let start = [height_mm, height_mm / radius, axis[0], axis[1]];
    let fitted = fit(start, flank, &known, kept, pointed).ok_or_else(|| none(f64::NAN))?;
    match fitted.spread_mm <= FLANK_RMS_MAX * height_mm {
        true => Ok(fitted),
        false => Err(none(fitted.spread_mm)),
    }
}

/// The sector of a position around a centre.
fn sector(at: [f64; 3], centre: [f64; 2]) -> usize {
    let turn = (at[1] - centre[1]).atan2(at[0] - centre[0]) / TAU + 0.5;
    ((turn * SECTORS as f64) as usize).min(SECTORS - 1)
}

/// How a flank deviates from its cone.
pub(super) struct Departure {
    /// Correlation of neighbouring residuals: variance of a sum over that of independent ones.
    pub together: f64,
    /// Standard deviation of the slope over the visible sectors.
    pub slope_sd: f64,
}

/// Side of the blocks of pixels whose residuals are summed.
const BLOCK_PIXELS: usize = 24;

pub(super) fn departure(flank: &[Point], cone: &Flank, width: usize) -> Departure {
    let [_, _, xc, yc] = cone.parameters;
    let mut blocks = std::collections::BTreeMap::<[usize; 2], [f64; 2]>::new();
    let mut sectors = vec![Vec::new(); SECTORS];
    for point in flank {
        let r = point.at[2] - pointed(&cone.parameters, [point.at[0], point.at[1]]).0;
        if r.abs() > 5.0 * cone.spread_mm {
            continue;
        }
        let block = blocks
            .entry([point.pixel % width / BLOCK_PIXELS, point.pixel / width / BLOCK_PIXELS])
            .or_default();
        (block[0], block[1]) = (block[0] + r, block[1] + r * r);
        sectors[sector(point.at, [xc, yc])].push([away(point.at, [xc, yc]), r]);
    }
    let [sums, squares] =
        blocks.values().fold([0.0; 2], |[a, b], block| [a + block[0] * block[0], b + block[1]]);
    let slopes: Vec<f64> =
        sectors.iter().filter(|s| s.len() >= SECTOR_PIXELS_MIN).map(|s| slope(s)).collect();
    let together = if squares > 0.0 { (sums / squares).max(1.0) } else { 1.0 };
    Departure { together, slope_sd: flip_core::stats::summary::sd(&slopes).unwrap_or(0.0) }
}

/// Slope error, as a line through the cone's apex, implied by residuals versus distance: in a
/// sector that is steeper they fall with distance.
fn slope(points: &[[f64; 2]]) -> f64 {
    let n = points.len() as f64;
    let mean = |c: usize| points.iter().map(|p| p[c]).sum::<f64>() / n;
    let (r, z) = (mean(0), mean(1));
    let spread: f64 = points.iter().map(|p| (p[0] - r).powi(2)).sum();
    points.iter().map(|p| (p[0] - r) * (p[1] - z)).sum::<f64>() / spread.max(1e-9)
}

/// Whether the pile reaches the rim wherever the rim is visible.
pub(super) fn covers(
    points: &[Point],
    cone: &Flank,
    axis: [f64; 2],
    rig: &Dimensions,
) -> Result<(), Refusal> {
    let radius = rig.base_diameter_mm / 2.0;
    let mut sectors = [(0, 0.0); SECTORS];
    let rim =
        points.iter().filter(|p| (RIM[0] * radius..=RIM[1] * radius).contains(&away(p.at, axis)));
    for point in rim {
        let (pixels, height) = &mut sectors[sector(point.at, axis)];
        (*pixels, *height) = (*pixels + 1, *height + point.at[2]);
    }
    let wanted = RIM_HEIGHT_MIN * (1.0 - 0.5 * (RIM[0] + RIM[1])) * radius * cone.parameters[1];
    let seen: Vec<f64> = sectors
        .iter()
        .filter(|s| s.0 >= SECTOR_PIXELS_MIN)
        .map(|s| s.1 / f64::from(s.0 as u32))
        .collect();
    let covered = seen.iter().filter(|height| **height >= wanted).count();
    match covered == seen.len() && covered > 0 {
        true => Ok(()),
        false => Err(Refusal::BaseNotCovered { covered, sectors: seen.len() }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a rounded cone, on the near side only.
    fn near_side(za: f64, s: f64, centre: [f64; 2], rho: f64) -> Vec<Point> {
        let grid = (-60..=60)
            .flat_map(|i| (-60..=10).map(move |j| [f64::from(i) * 0.5, f64::from(j) * 0.5]));
        let p = [za + s * rho, s, centre[0], centre[1], rho * rho];
        let point = |(pixel, at): (usize, [f64; 2])| {
            let seen = [at[0], at[1], rounded(&p, at).0];
            let ray = [[seen[0], seen[1] - 173.0, seen[2] + 100.0], [0.0, 0.865, -0.5]];
            Point { pixel, at: seen, ray, expected: at }
        };
        grid.filter(|at| at[0].hypot(at[1]) < 30.0).enumerate().map(point).collect()
    }

    #[test]
    fn an_exact_surface_gives_its_own_apex_and_slope() {
        let rig = Dimensions::default();
        let points = near_side(21.0, 0.75, [0.6, -0.4], 2.0);
        let apex = apex(&points, [0.0; 2], 20.0, 0.73, &rig).unwrap();
        for (found, true_value) in apex.at().into_iter().zip([0.6, -0.4, 21.0]) {
            assert!((found - true_value).abs() < 0.03, "{apex:?}");
        }
        let points = near_side(21.0, 0.7, [0.3, 0.2], 0.0);
        let (flank, cone) = flank(&points, [0.0; 2], 21.0, &rig).unwrap();
        assert!((cone.parameters[1] - 0.7).abs() < 1e-3, "{cone:?}");
        assert!(departure(&flank, &cone, 121).slope_sd < 1e-3);
        assert_eq!(covers(&points, &cone, [0.0; 2], &rig), Ok(()));
    }

    #[test]
    fn wild_points_do_not_move_the_cone() {
        let mut points = near_side(21.0, 0.7, [0.0; 2], 0.0);
        points.iter_mut().step_by(7).for_each(|p| p.at[2] += 4.0);
        let (_, cone) = flank(&points, [0.0; 2], 21.0, &Dimensions::default()).unwrap();
        assert!((cone.parameters[1] - 0.7).abs() < 3e-3, "{}", cone.parameters[1]);
    }

    #[test]
    fn nothing_and_little_on_the_base_are_refused() {
        let flat = near_side(0.5, 0.0, [0.0; 2], 0.1);
        let height = |points: &[Point]| height(points, [0.0; 2], &Dimensions::default());
        assert!(matches!(height(&flat), Err(Refusal::PileNotFound { .. })));
        assert_eq!(height(&[]), Err(Refusal::ApexNotFound { pixels: 0, wanted: 12 }));
    }
}
