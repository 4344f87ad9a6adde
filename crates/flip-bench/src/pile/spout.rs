//! The funnel's tip: the lower end of the spout, on its axis.
//!
//! Depth locates the spout to fractions of a millimetre over its many pixels; but stereo fails at
//! its edges, and two pixels make a degree. Colour is sharp there: the edge is where the spout's
//! colour changes to that of the background.

use super::bench::View;
use super::shot::{Shot, median};
use super::{Dimensions, Limits, Refusal};
use crate::hardware::camera::Frame;

/// The tip, in base coordinates.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tip {
    /// On the spout's axis, mm.
    pub at: [f64; 3],
    /// Standard uncertainty of its height, mm.
    pub u_mm: f64,
}

/// The spout in the image.
pub(super) struct Spout {
    /// Axis, mm in base coordinates.
    axis: [f64; 2],
    /// Columns near the axis, each with the lowest pixel at the spout's depth.
    columns: Vec<[usize; 2]>,
    /// Rows, each with the first and last such pixel.
    rows: Vec<[usize; 3]>,
}

/// Range of heights in which the spout is searched for, fraction of D.
const BAND: [f64; 2] = [0.92, 1.25];
/// Minimum number of pixels of a spout.
const PIXELS_MIN: usize = 40;
/// Accepted width of the spout, fraction of its diameter.
const WIDTH: [f64; 2] = [0.5, 1.25];
/// Pixels before the last one with depth where the profile of an edge begins, and pixels after it
/// where the profile ends.
const INSIDE: usize = 8;
const OUTSIDE: usize = 14;
/// Pixels at either end of a profile that define the colours of spout and background.
const ENDS: usize = 4;
/// Minimum difference of the two colours at an edge, out of 255.
const CONTRAST_MIN: f64 = 25.0;
/// Standard uncertainty of an edge position in addition to its scatter: blur and shading, pixels.
const EDGE_U_PIXELS: f64 = 0.2;
/// Neighbouring columns with correlated edge errors.
const COLUMNS_TOGETHER: f64 = 3.0;

pub(super) fn find(shot: &Shot, view: &View, rig: &Dimensions) -> Result<Spout, Refusal> {
    let missing = |cause| Refusal::FunnelNotFound { tip_height_mm: rig.tip_height_mm, cause };
    let in_band = |z: f64| (BAND[0] * rig.tip_height_mm..=BAND[1] * rig.tip_height_mm).contains(&z);
    let places: Vec<Option<[f64; 3]>> = (0..shot.depth_mm.len())
        .map(|k| shot.point(k).map(|p| view.place(p)).filter(|at| in_band(at[2])))
        .collect();
    let mut parts = components(&places, shot.width());
    parts.retain(|part| part.len() >= PIXELS_MIN);
    if parts.is_empty() {
        return Err(missing("nothing is seen at this height"));
    }
    let as_wide = |part: &Vec<usize>| {
        let [left, right] = span(part, &places);
        (WIDTH[0]..=WIDTH[1]).contains(&((right - left) / rig.spout_diameter_mm))
    };
    let part = parts.into_iter().filter(as_wide).max_by_key(Vec::len);
    let part =
        part.ok_or_else(|| missing("what is seen at this height is not as wide as the spout"))?;
    let [left, right] = span(&part, &places);
    let (radius, x0) = (rig.spout_diameter_mm / 2.0, 0.5 * (left + right));
    let near =
        part.iter().filter_map(|k| places[*k]).filter(|at| (at[0] - x0).abs() < 0.6 * radius);
    let mut behind: Vec<f64> =
        near.map(|at| at[1] + (radius * radius - (at[0] - x0).powi(2)).sqrt()).collect();
    let axis = [x0, median(&mut behind)];
    let columns = lowest(&part, shot.width(), |k| {
        places[k].is_some_and(|at| (at[0] - x0).abs() < 0.7 * radius)
    });
    Ok(Spout { axis, columns, rows: ends(&part, shot.width()) })
}

/// Connected components of the pixels that have a position.
fn components(places: &[Option<[f64; 3]>], width: usize) -> Vec<Vec<usize>> {
    let mut open: Vec<bool> = places.iter().map(Option::is_some).collect();
    let mut found = Vec::new();
    for first in 0..places.len() {
        if !std::mem::take(&mut open[first]) {
            continue;
        }
        let mut part = vec![first];
        let mut next = 0;
        while let Some(&k) = part.get(next) {
            next += 1;
            let column = k % width;
            let left = (column > 0).then(|| k - 1);
            let right = (column + 1 < width).then_some(k + 1);
            for to in [left, right, k.checked_sub(width), Some(k + width)].into_iter().flatten() {
                if to < open.len() && std::mem::take(&mut open[to]) {
                    part.push(to);
                }
            }
        }
        found.push(part);
    }
    found
}

/// Left and right side without the outermost fiftieths, mm.
fn span(part: &[usize], places: &[Option<[f64; 3]>]) -> [f64; 2] {
    let mut x: Vec<f64> = part.iter().filter_map(|k| places[*k]).map(|at| at[0]).collect();
    x.sort_unstable_by(f64::total_cmp);
    let trimmed = x.len() / 50;
    [x[trimmed], x[x.len() - 1 - trimmed]]
}

fn lowest(part: &[usize], width: usize, counts: impl Fn(usize) -> bool) -> Vec<[usize; 2]> {
    let mut low = std::collections::BTreeMap::new();
    for &k in part.iter().filter(|k| counts(**k)) {
        let row = low.entry(k % width).or_insert(0);
        *row = (*row).max(k / width);
    }
    low.into_iter().map(|(column, row)| [column, row]).collect()
}

/// First and last pixel of each row in the middle of the part.
fn ends(part: &[usize], width: usize) -> Vec<[usize; 3]> {
    let mut rows = std::collections::BTreeMap::new();
    for &k in part {
        let [first, last] = rows.entry(k / width).or_insert([usize::MAX, 0]);
        (*first, *last) = ((*first).min(k % width), (*last).max(k % width));
    }
    let third = rows.len() / 3;
    rows.into_iter()
        .skip(third)
        .take(third.max(1))
        .map(|(row, [first, last])| [row, first, last])
        .collect()
}

/// Position along a profile where its colour changes from that of its beginning to that of its end,
/// pixels from the border of the first one; `None` without contrast.
fn step(profile: &[[f64; 3]]) -> Option<f64> {
    let mean = |part: &[[f64; 3]]| -> [f64; 3] {
        std::array::from_fn(|c| {
            part.iter().map(|colour| colour[c]).sum::<f64>() / part.len() as f64
        })
    };
    let (inside, outside) = (mean(&profile[..ENDS]), mean(&profile[profile.len() - ENDS..]));
    let across: [f64; 3] = std::array::from_fn(|c| inside[c] - outside[c]);
    let contrast2: f64 = across.iter().map(|c| c * c).sum();
    let share = |colour: &[f64; 3]| {
        let part: f64 = (0..3).map(|c| (colour[c] - outside[c]) * across[c]).sum();
        (part / contrast2).clamp(0.0, 1.0)
    };
    (contrast2 >= CONTRAST_MIN * CONTRAST_MIN).then(|| profile.iter().map(share).sum())
}

impl Spout {
    /// The tip: where the rays through the lower edge meet the near side of the spout.
    pub fn tip(&self, shot: &Shot, view: &View, rig: &Dimensions) -> Result<Tip, Refusal> {
        let colour = |k: usize| shot.colour[k];
        let mut heights: Vec<f64> = Vec::new();
        let mut mm_per_pixel = Vec::new();
        for &[u, row] in &self.columns {
            let Some(v) = bottom(shot, colour, [u, row]) else { continue };
            let height_at = |v: f64| {
                self.meet(view, shot.lens.direction([u as f64, v]), rig.spout_diameter_mm / 2.0)
            };
            if let (Some(here), Some(below)) = (height_at(v), height_at(v + 1.0)) {
                heights.push(here);
                mm_per_pixel.push((here - below).abs());
            }
        }
        if heights.len() < 5 {
            let cause = "its lower edge has no contrast: give it a colour that differs from what is behind it";
            return Err(Refusal::FunnelNotFound { tip_height_mm: rig.tip_height_mm, cause });
        }
        let height = median(&mut heights);
        let mut apart: Vec<f64> = heights.iter().map(|h| (h - height).abs()).collect();
        let scatter = 1.4826 * median(&mut apart);
        // The median of n values is more certain than a single one by sqrt(n), and less certain
        // than their mean by sqrt(pi / 2).
        let mean_u = scatter * (1.57 * COLUMNS_TOGETHER / heights.len() as f64).sqrt();
        let u_mm = mean_u.hypot(EDGE_U_PIXELS * median(&mut mm_per_pixel));
        Ok(Tip { at: [self.axis[0], self.axis[1], height], u_mm })
    }

    /// Height at which a ray meets the near side of the spout, mm.
    fn meet(&self, view: &View, direction: [f64; 2], radius: f64) -> Option<f64> {
        let [from, by] = view.ray(direction);
        let (x, y) = (from[0] - self.axis[0], from[1] - self.axis[1]);
        let (a, b) = (by[0] * by[0] + by[1] * by[1], x * by[0] + y * by[1]);
        let root = b * b - a * (x * x + y * y - radius * radius);
        (root > 0.0).then(|| from[2] + by[2] * (-b - root.sqrt()) / a)
    }

    /// Positions of the spout's edges in one frame, pixels: its middle and its lower end. `NaN`
    /// without contrast.
    pub fn edges(&self, shot: &Shot, frame: &Frame) -> [f64; 2] {
        let colour = |k: usize| frame.colour[k].map(f64::from);
        let mut low: Vec<f64> =
            self.columns.iter().filter_map(|at| bottom(shot, colour, *at)).collect();
        let across = |[row, first, last]: &[usize; 3]| {
            let out = |from: usize, by: isize| {
                let at = |i: usize| {
                    from.checked_add_signed(by * i as isize).filter(|u| *u < shot.width())
                };
                let pixel = |i: usize| at(i).map(|u| colour(row * shot.width() + u));
                (0..ENDS + OUTSIDE)
                    .map(pixel)
                    .collect::<Option<Vec<_>>>()
                    .and_then(|profile| step(&profile))
            };
            let (left, right) = (out(first + ENDS, -1)?, out(last.checked_sub(ENDS)?, 1)?);
            Some(((first + ENDS) as f64 - left + (last - ENDS) as f64 + right) / 2.0)
        };
        let mut middle: Vec<f64> = self.rows.iter().filter_map(across).collect();
        [median(&mut middle), median(&mut low)]
    }
}

/// Row of the lower edge of the spout in a column, in pixels whose centres are integers.
fn bottom(shot: &Shot, colour: impl Fn(usize) -> [f64; 3], [u, row]: [usize; 2]) -> Option<f64> {
    let first = row.checked_sub(INSIDE)?;
    if row + OUTSIDE >= shot.height() {
        return None;
    }
    let profile: Vec<[f64; 3]> =
        (first..=row + OUTSIDE).map(|v| colour(v * shot.width() + u)).collect();
    Some(first as f64 - 0.5 + step(&profile)?)
}

/// Check that the spout and the bench are at the same place in every frame.
///
/// # Errors
/// The first frame in which they are not.
pub(super) fn still(
    shot: &Shot,
    spout: &Spout,
    on_bench: &[usize],
    limits: &Limits,
) -> Result<(), Refusal> {
    let edges: Vec<[f64; 2]> = shot.frames.iter().map(|frame| spout.edges(shot, frame)).collect();
    let usual: [f64; 2] =
        std::array::from_fn(|c| median(&mut edges.iter().map(|edge| edge[c]).collect::<Vec<_>>()));
    for (frame, edge) in edges.iter().enumerate() {
        let pixels = (edge[0] - usual[0]).abs().max((edge[1] - usual[1]).abs());
        let taken = &shot.frames[frame];
        let depth = |k: &usize| f64::from(taken.depth[*k]) * taken.unit_mm();
        let apart =
            on_bench.iter().filter(|k| taken.depth[**k] > 0).map(|k| depth(k) - shot.depth_mm[*k]);
        let mm = median(&mut apart.collect::<Vec<_>>()).abs();
        if pixels > limits.move_max_pixels || mm > limits.move_max_mm {
            return Err(Refusal::CameraMoved { frame, pixels, mm });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_of_colour_is_found_to_a_fraction_of_a_pixel() {
        let profile = |edge: f64| -> Vec<[f64; 3]> {
            let share = |k: usize| (edge - k as f64).clamp(0.0, 1.0);
            (0..20).map(|k| [200.0 - 100.0 * share(k), 80.0, 90.0 + 30.0 * share(k)]).collect()
        };
        for edge in [7.0, 9.25, 12.6] {
            assert!((step(&profile(edge)).unwrap() - edge).abs() < 1e-9);
        }
        assert_eq!(step(&[[100.0; 3]; 20]), None);
    }

    #[test]
    fn pixels_that_touch_are_one_part_also_at_the_borders() {
        let at = Some([0.0; 3]);
        let places = [at, None, at, at, None, at, None, at, None];
        assert_eq!(components(&places, 3), vec![vec![0, 3], vec![2, 5], vec![7]]);
    }
}
