//! Robust least squares of a height field over a plane, for a handful of parameters.

use super::shot::median;
use nalgebra::{SMatrix, SVector};

/// One point of a surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    /// Pixel that saw it.
    pub pixel: usize,
    /// Position in base coordinates, mm.
    pub at: [f64; 3],
    /// Ray through the pixel: origin, and increment per mm of depth.
    pub ray: [[f64; 3]; 2],
    /// Where the surface is expected on that ray; initially where the point was measured.
    pub expected: [f64; 2],
}

/// Newton steps towards the surface along a ray, how far they may lead, mm, and how close they must
/// come, mm.
const NEARING: usize = 6;
const LEAD_MAX_MM: f64 = 6.0;
const NEAR_MM: f64 = 0.01;

impl Point {
    /// The point, with the position where its ray meets a surface of this height; `None` if it
    /// misses. That position has no noise, so selecting or weighting points by it does not prefer
    /// those whose noise has one sign.
    pub fn expecting(self, height: impl Fn([f64; 2]) -> f64) -> Option<Self> {
        let [from, by] = self.ray;
        let along = |t: f64| -> [f64; 3] { std::array::from_fn(|k| from[k] + t * by[k]) };
        let gap = |t: f64| {
            let [x, y, z] = along(t);
            z - height([x, y])
        };
        let seen = (self.at[2] - from[2]) / by[2];
        let mut t = seen;
        for _ in 0..NEARING {
            let slope = (gap(t + 0.01) - gap(t - 0.01)) / 0.02;
            t = (t - gap(t) / slope).clamp(seen - LEAD_MAX_MM, seen + LEAD_MAX_MM);
        }
        let [x, y, _] = along(t);
        (gap(t).abs() < NEAR_MM).then_some(Self { expected: [x, y], ..self })
    }
}

/// Result of a fit.
#[derive(Debug, Clone)]
pub(super) struct Fitted<const N: usize> {
    pub parameters: [f64; N],
    /// As if every point were an independent observation.
    pub covariance: SMatrix<f64, N, N>,
    /// Scale of the residuals, from their median size, mm.
    pub spread_mm: f64,
}

/// Prior on a parameter: its index, value and standard deviation.
pub(super) type Known = (usize, f64, f64);

/// Rounds of reweighting.
const ROUNDS: usize = 25;
/// Residuals beyond this many scales have no weight (Tukey's biweight at 95 % efficiency).
const TUKEY: f64 = 4.685;
/// Lower bound on the scale, mm, for exact pictures.
const SPREAD_MIN_MM: f64 = 0.01;

/// Fit the parameters of `height` to the points, from a start close to the solution.
///
/// ```text
/// minimise  sum_i w(r_i / s) r_i^2 / s^2 + sum_k (p_k - known_k)^2 / sd_k^2       r_i = z_i - height(p, x_i, y_i)
/// ```
///
/// Derivatives are taken where the surface is expected: taken at the point itself they would share
/// its noise, and flatten a cone. Gauss-Newton with Tukey's biweight; s is 1.4826 times the median
/// of |r|. `height` also returns its derivatives; `kept` clamps parameters to their bounds.
pub(super) fn fit<const N: usize>(
    start: [f64; N],
    points: &[Point],
    known: &[Known],
    kept: impl Fn([f64; N]) -> [f64; N],
    height: impl Fn(&[f64; N], [f64; 2]) -> (f64, [f64; N]),
) -> Option<Fitted<N>> {
    let mut p = kept(start);
    let residual = |p: &[f64; N], point: &Point| {
        (point.at[2] - height(p, [point.at[0], point.at[1]]).0, height(p, point.expected).1)
    };
    let mut last = None;
    for _ in 0..ROUNDS {
        let mut sizes: Vec<f64> = points.iter().map(|point| residual(&p, point).0.abs()).collect();
        let spread_mm = (1.4826 * median(&mut sizes)).max(SPREAD_MIN_MM);
        let (mut normal, mut pull) = (SMatrix::<f64, N, N>::zeros(), SVector::<f64, N>::zeros());
        for point in points {
            let (r, slope) = residual(&p, point);
            let u = r / (TUKEY * spread_mm);
            if u.abs() < 1.0 {
                let w = (1.0 - u * u).powi(2) / (spread_mm * spread_mm);
                let j = SVector::from(slope);
                normal += (j * w) * j.transpose();
                pull += j * (w * r);
            }
        }
        for &(k, value, sd) in known {
            normal[(k, k)] += 1.0 / (sd * sd);
            pull[k] += (value - p[k]) / (sd * sd);
        }
        let covariance = normal.try_inverse()?;
        let step = covariance * pull;
        let next = kept(std::array::from_fn(|k| p[k] + step[k]));
        let moved = (0..N).map(|k| (next[k] - p[k]).abs()).fold(0.0, f64::max);
        p = next;
        last = Some(Fitted { parameters: p, covariance, spread_mm });
        if moved < 1e-7 {
            break;
        }
    }
    last.filter(|fitted| fitted.parameters.iter().all(|p| p.is_finite()))
}
