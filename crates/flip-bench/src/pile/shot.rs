//! Averages many frames of a scene at rest.

use super::{Limits, Refusal};
use crate::hardware::camera::{Frame, Intrinsics};

/// The mean of the frames.
#[derive(Debug)]
pub(super) struct Shot<'a> {
    pub frames: &'a [Frame],
    pub lens: Intrinsics,
    /// Direction through each pixel.
    pub directions: Vec<[f64; 2]>,
    /// Depth, mm; 0 where fewer than half of the frames have a value.
    pub depth_mm: Vec<f64>,
    /// Standard deviation from frame to frame, mm; 0 where there is no depth.
    pub sd_mm: Vec<f64>,
    pub colour: Vec<[f64; 3]>,
    /// Pixels near a depth step, where stereo mixes foreground and background.
    pub edge: Vec<bool>,
}

/// Pixels on either side of a step that are not trusted, and the size of a step, mm.
const EDGE_PIXELS: usize = 2;
const STEP_MM: f64 = 4.0;

impl<'a> Shot<'a> {
    pub fn of(frames: &'a [Frame], limits: &Limits) -> Result<Self, Refusal> {
        let wanted = limits.frames_min as usize;
        let first = frames.first().filter(|_| frames.len() >= wanted);
        let first = first.ok_or(Refusal::TooFewFrames { got: frames.len(), wanted })?;
        let pixels = first.intrinsics.pixels();
        let alike = |frame: &Frame| {
            frame.intrinsics == first.intrinsics
                && frame.depth_unit_m.to_bits() == first.depth_unit_m.to_bits()
                && frame.depth.len() == pixels
                && frame.colour.len() == pixels
        };
        if let Some(frame) = frames.iter().position(|frame| !alike(frame)) {
            return Err(Refusal::UnlikeFrames { frame });
        }
        let repeats =
            |k: &usize| frames[..*k].iter().any(|earlier| earlier.depth == frames[*k].depth);
        if let Some(frame) = (1..frames.len()).find(repeats) {
            return Err(Refusal::Frozen { frame });
        }
        let (depth_mm, sd_mm): (Vec<f64>, Vec<f64>) =
            (0..pixels).map(|k| mean_depth(frames, k)).unzip();
        let invalid =
            depth_mm.iter().filter(|depth| **depth == 0.0).count() as f64 / pixels.max(1) as f64;
        if invalid > limits.frame_invalid_max {
            let (invalid_percent, allowed_percent) =
                (100.0 * invalid, 100.0 * limits.frame_invalid_max);
            return Err(Refusal::TooManyInvalid {
                part: "frame",
                invalid_percent,
                allowed_percent,
            });
        }
        let colour = (0..pixels).map(|k| mean_colour(frames, k)).collect();
        let lens = first.intrinsics;
        let edge = edges(&depth_mm, lens.width as usize);
        Ok(Self { frames, lens, directions: lens.directions(), depth_mm, sd_mm, colour, edge })
    }

    pub fn width(&self) -> usize {
        self.lens.width as usize
    }

    pub fn height(&self) -> usize {
        self.lens.height as usize
    }

    /// The point at a pixel, mm from the camera; `None` without depth.
    pub fn point(&self, k: usize) -> Option<[f64; 3]> {
        at_depth(self.directions[k], self.depth_mm[k])
    }

    /// The same in a single frame.
    pub fn point_in(&self, frame: &Frame, k: usize) -> Option<[f64; 3]> {
        at_depth(self.directions[k], f64::from(frame.depth[k]) * frame.unit_mm())
    }
}

fn at_depth([x, y]: [f64; 2], z: f64) -> Option<[f64; 3]> {
    (z > 0.0).then_some([x * z, y * z, z])
}

/// Interquartile mean of the depths, which is robust against outliers and resolves fractions of a
/// depth step, and their standard deviation from the interquartile range.
fn mean_depth(frames: &[Frame], k: usize) -> (f64, f64) {
    let mut seen: Vec<u16> =
        frames.iter().map(|frame| frame.depth[k]).filter(|depth| *depth > 0).collect();
    if 2 * seen.len() < frames.len() || seen.len() < 2 {
        return (0.0, 0.0);
    }
    seen.sort_unstable();
    let middle = &seen[seen.len() / 4..seen.len() - seen.len() / 4];
    let unit = frames[0].unit_mm();
    let mean = middle.iter().map(|depth| f64::from(*depth)).sum::<f64>() / middle.len() as f64;
    // Half of a normal distribution lies within 0.6745 standard deviations of its centre.
    let half_width = f64::from(middle[middle.len() - 1] - middle[0]) / 2.0;
    (mean * unit, half_width / 0.6745 * unit)
}

fn edges(depth_mm: &[f64], width: usize) -> Vec<bool> {
    let mut edge = vec![false; depth_mm.len()];
    for (k, &here) in depth_mm.iter().enumerate().filter(|(_, depth)| **depth > 0.0) {
        let right = (1..=EDGE_PIXELS).filter(|n| k % width + n < width).map(|n| k + n);
        let below = (1..=EDGE_PIXELS).map(|n| k + n * width);
        for to in right.chain(below) {
            let is_step = depth_mm
                .get(to)
                .is_some_and(|there| *there > 0.0 && (there - here).abs() > STEP_MM);
            if is_step {
                (edge[k], edge[to]) = (true, true);
            }
        }
    }
    edge
}

fn mean_colour(frames: &[Frame], k: usize) -> [f64; 3] {
    let mean = |c: usize| {
        frames.iter().map(|frame| f64::from(frame.colour[k][c])).sum::<f64>() / frames.len() as f64
    };
    std::array::from_fn(mean)
}

/// Median; `NaN` for an empty slice.
pub(super) fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
