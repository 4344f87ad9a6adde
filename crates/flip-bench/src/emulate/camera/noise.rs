//! The effect of passive stereo on an exact picture.

use super::Optics;
use super::render::Picture;
use super::surface::bump;
use flip_core::domain::seed::derive;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Noise of the depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Standard deviation of depth from frame to frame at 200 mm, mm; it grows with the square of
    /// depth. Default 0.5.
    pub frame_mm: f64,
    /// Standard deviation of depth errors common to all frames at 200 mm, mm: patches as wide as
    /// the matching window. Default 0.15.
    pub fixed_mm: f64,
    /// Fraction of the pixels missing at random in each frame. Default 0.02.
    pub missing: f64,
    /// Fraction of the powder without texture, where nothing matches in any frame. Default 0.05.
    pub textureless: f64,
    /// Pixels on either side of a depth step where depth is missing or in between. Default 2.
    pub edge_pixels: usize,
    /// Standard deviation of each colour channel, out of 255. Default 3.
    pub colour: f64,
}

impl Default for Noise {
    fn default() -> Self {
        Self {
            frame_mm: 0.5,
            fixed_mm: 0.15,
            missing: 0.02,
            textureless: 0.05,
            edge_pixels: 2,
            colour: 3.0,
        }
    }
}

impl Noise {
    /// No noise.
    pub const NONE: Self = Self {
        frame_mm: 0.0,
        fixed_mm: 0.0,
        missing: 0.0,
        textureless: 0.0,
        edge_pixels: 0,
        colour: 0.0,
    };
}

/// Side of a patch of fixed errors, and of one without texture, pixels.
const PATCH_PIXELS: f64 = 8.0;
const BLANK_PIXELS: f64 = 14.0;
/// A depth step between neighbours that counts as an edge, mm.
const EDGE_MM: f64 = 3.0;
/// Standard deviation of bilinear interpolation between uniform nodes in -0.5..0.5: sqrt(1/12) *
/// 2/3.
const BUMP_SD: f64 = 0.192;

/// Flaws common to all frames of a series.
pub(super) struct Flaws {
    /// Fixed error in standard deviations, per pixel.
    error: Vec<f64>,
    blank: Vec<bool>,
    /// Pixels near an edge, and the depth on its other side, mm.
    edge: Vec<Option<f64>>,
}

impl Noise {
    pub(super) fn flaws(&self, picture: &Picture, seed: u64) -> Flaws {
        let offset = |k: u64| f64::from(derive(seed, &[k]) as u16) * 100.0;
        let (fixed, blank) = ([offset(0), offset(1)], [offset(2), offset(3)]);
        let at = |k: usize| [(k % picture.width) as f64, (k / picture.width) as f64];
        let field = |k: usize, [a, b]: [f64; 2], side: f64| {
            bump([at(k)[0] / side + a, at(k)[1] / side + b]) / BUMP_SD
        };
        // The threshold exceeded by a given fraction of a nearly normal field.
        let level = match self.textureless > 0.0 {
            true => flip_core::stats::normal::quantile(1.0 - self.textureless.min(0.999)),
            false => f64::INFINITY,
        };
        let pixels = 0..picture.depth_mm.len();
        Flaws {
            error: pixels.clone().map(|k| field(k, fixed, PATCH_PIXELS)).collect(),
            blank: pixels
                .map(|k| picture.powder[k] && field(k, blank, BLANK_PIXELS) > level)
                .collect(),
            edge: edges(picture, self.edge_pixels),
        }
    }

    pub(super) fn expose(
        &self,
        picture: &Picture,
        flaws: &Flaws,
        optics: &Optics,
        seed: u64,
    ) -> (Vec<u16>, Vec<[u8; 3]>) {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut spare = None;
        let mut depth = Vec::with_capacity(picture.depth_mm.len());
        for (k, &exact) in picture.depth_mm.iter().enumerate() {
            let missing = rng.random::<f64>() < self.missing;
            let true_mm = match flaws.edge[k].map(|other| (other, rng.random::<f64>())) {
                Some((_, luck)) if luck < 0.5 => 0.0,
                Some((other, luck)) if luck < 0.75 => exact + (other - exact) * rng.random::<f64>(),
                _ => exact,
            };
            let grown = (true_mm / 200.0).powi(2);
            let error = grown
                * (self.frame_mm * normal(&mut rng, &mut spare) + self.fixed_mm * flaws.error[k]);
            let seen = (true_mm + error) / (1.0 + optics.scale_error);
            let valid = true_mm > 0.0 && !missing && !flaws.blank[k];
            depth.push(if valid {
                (seen / optics.unit_mm).round().clamp(0.0, 65535.0) as u16
            } else {
                0
            });
        }
        let mut shade = |c: f64| {
            (c + self.colour * normal(&mut rng, &mut spare)).round().clamp(0.0, 255.0) as u8
        };
        (depth, picture.colour.iter().map(|colour| colour.map(&mut shade)).collect())
    }
}

/// A standard normal deviate; they come in pairs (Box and Muller 1958).
fn normal(rng: &mut Pcg64Mcg, spare: &mut Option<f64>) -> f64 {
    if let Some(kept) = spare.take() {
        return kept;
    }
    let r = (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt();
    let (sin, cos) = (std::f64::consts::TAU * rng.random::<f64>()).sin_cos();
    *spare = Some(r * sin);
    r * cos
}

fn edges(picture: &Picture, reach: usize) -> Vec<Option<f64>> {
    let (width, height) = (picture.width as i64, picture.height as i64);
    let reach = reach as i64;
    let depth = |u: i64, v: i64| {
        let inside = (0..width).contains(&u) && (0..height).contains(&v);
        if inside { picture.depth_mm[(v * width + u) as usize] } else { 0.0 }
    };
    let around: Vec<(i64, i64)> =
        (1..=reach).flat_map(|n| [(n, 0), (-n, 0), (0, n), (0, -n)]).collect();
    (0..width * height)
        .map(|k| {
            let (u, v) = (k % width, k / width);
            let here = depth(u, v);
            let step = |d: f64| d > 0.0 && (d - here).abs() > EDGE_MM;
            around.iter().map(|(i, j)| depth(u + i, v + j)).find(|d| step(*d))
        })
        .collect()
}
