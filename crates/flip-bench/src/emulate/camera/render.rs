//! Ray tracing of one exact picture: for every pixel, the depth along the optical axis and the
//! colour.

use super::surface::bump;
use super::{Funnel, Optics, Pose, Scene};

type Vector = [f64; 3];

/// Extent of spilled powder from the base, mm.
const SKIRT_MM: f64 = 18.0;
/// Height of the spout over its tip, and of the funnel over its spout, mm; radius of the funnel's
/// mouth, mm.
const SPOUT_MM: f64 = 25.0;
const MOUTH_MM: [f64; 2] = [30.0, 32.0];

const BENCH: [f64; 3] = [118.0, 116.0, 112.0];
const BASE: [f64; 3] = [45.0, 45.0, 48.0];
const POWDER: [f64; 3] = [226.0, 221.0, 208.0];
const FUNNEL: [f64; 3] = [52.0, 84.0, 158.0];
const DARK: [f64; 3] = [30.0, 30.0, 32.0];

/// Depth without noise, mm (0: nothing in range), and colour, row by row.
pub(super) struct Picture {
    pub width: usize,
    pub height: usize,
    pub depth_mm: Vec<f64>,
    pub colour: Vec<[f64; 3]>,
    /// Whether a pixel shows powder, which has little texture.
    pub powder: Vec<bool>,
}

/// Right, down and forward vectors of the camera, and its position.
struct Eye {
    at: Vector,
    axes: [Vector; 3],
}

impl Eye {
    fn new(pose: &Pose) -> Self {
        let (se, ce) = pose.elevation_deg.to_radians().sin_cos();
        let (sr, cr) = pose.roll_deg.to_radians().sin_cos();
        let (sy, cy) = pose.yaw_deg.to_radians().sin_cos();
        let turned = |[x, y, z]: Vector| [cy * x - sy * y, sy * x + cy * y, z];
        let forward = turned([0.0, ce, -se]);
        let (right, down) = (turned([1.0, 0.0, 0.0]), turned([0.0, -se, -ce]));
        let mix = |a: f64, b: f64| std::array::from_fn(|k| a * right[k] + b * down[k]);
        let at = [0.0, -pose.distance_mm * ce, pose.aim_height_mm + pose.distance_mm * se];
        Self { at, axes: [mix(cr, sr), mix(-sr, cr), forward] }
    }

    /// The ray in a direction; its parameter is depth, because the forward component has length 1.
    fn ray(&self, [x, y]: [f64; 2]) -> Vector {
        std::array::from_fn(|k| x * self.axes[0][k] + y * self.axes[1][k] + self.axes[2][k])
    }
}

/// Intersection of a ray: distance, colour, whether it is powder.
type Hit = (f64, [f64; 3], bool);

impl Picture {
    pub fn of(scene: &Scene, pose: &Pose, optics: &Optics) -> Self {
        let eye = Eye::new(pose);
        let (width, height) = (optics.intrinsics.width as usize, optics.intrinsics.height as usize);
        let hits: Vec<Option<Hit>> = optics
            .intrinsics
            .directions()
            .into_iter()
            .map(|d| nearest(scene, eye.at, eye.ray(d)))
            .collect();
        let in_range = |hit: &Option<Hit>| hit.filter(|hit| hit.0 <= optics.range_mm);
        let sharp: Vec<[f64; 3]> = hits.iter().map(|hit| hit.map_or(DARK, |hit| hit.1)).collect();
        Self {
            width,
            height,
            depth_mm: hits.iter().map(|hit| in_range(hit).map_or(0.0, |hit| hit.0)).collect(),
            colour: blurred(&sharp, width),
            powder: hits.iter().map(|hit| hit.is_some_and(|hit| hit.2)).collect(),
        }
    }
}

/// Lens blur: the mean of three by three pixels.
fn blurred(sharp: &[[f64; 3]], width: usize) -> Vec<[f64; 3]> {
    let pass = |from: &[[f64; 3]], step: usize| -> Vec<[f64; 3]> {
        let at = |k: usize| {
            [from[k.saturating_sub(step)], from[k], from[(k + step).min(from.len() - 1)]]
        };
        (0..from.len())
            .map(at)
            .map(|[a, b, c]| std::array::from_fn(|i| (a[i] + b[i] + c[i]) / 3.0))
            .collect()
    };
    pass(&pass(sharp, 1), width)
}

fn nearest(scene: &Scene, eye: Vector, ray: Vector) -> Option<Hit> {
    let hits =
        [ground(scene, eye, ray), scene.funnel.and_then(|funnel| funnel_hit(&funnel, eye, ray))];
    hits.into_iter().flatten().min_by(|a, b| a.0.total_cmp(&b.0))
}

fn along(eye: Vector, ray: Vector, t: f64) -> Vector {
    std::array::from_fn(|k| eye[k] + t * ray[k])
}

/// Pile, base, spilled powder and the bench, as one height field.
fn ground(scene: &Scene, eye: Vector, ray: Vector) -> Option<Hit> {
    if ray[2] >= -1e-6 {
        return None;
    }
    let radius = scene.base_diameter_mm / 2.0;
    let bench = -scene.base_height_mm;
    let reach = radius + SKIRT_MM;
    let floor_t = (bench - eye[2]) / ray[2];
    let ceiling = scene.surface.ceiling_mm(radius).max(0.0) + 0.1;
    let (mut t, end) = match circle([eye[0], eye[1]], [ray[0], ray[1]], reach) {
        Some([enter, leave]) => (enter.max((ceiling - eye[2]) / ray[2]), leave.min(floor_t)),
        None => (f64::INFINITY, 0.0),
    };
    let gap = |t: f64| {
        let at = along(eye, ray, t);
        at[2] - height(scene, radius, [at[0], at[1]])
    };
    let (mut above, speed) = (t, ray.iter().map(|c| c * c).sum::<f64>().sqrt());
    while t < end {
        let g = gap(t);
        if g <= 0.0 {
            return Some(struck(scene, radius, eye, ray, meet(gap, above, t)));
        }
        above = t;
        t += (0.4 * g).max(0.15) / speed;
    }
    let at = along(eye, ray, floor_t);
    (at[1] < 600.0).then_some((floor_t, shaded(BENCH, [at[0] / 3.0, at[1] / 3.0], 10.0), false))
}

/// Height of the scene at a point, relative to the base's top.
fn height(scene: &Scene, radius: f64, at: [f64; 2]) -> f64 {
    let r = at[0].hypot(at[1]);
    if r < radius {
        return scene.surface.height_at(at, radius);
    }
    let near = 1.0 - (r - radius) / SKIRT_MM;
    -scene.base_height_mm + scene.overflow_mm * near.max(0.0).powi(2)
}

/// Where the gap changes its sign between two parameters.
fn meet(gap: impl Fn(f64) -> f64, mut above: f64, mut below: f64) -> f64 {
    for _ in 0..30 {
        let middle = 0.5 * (above + below);
        if gap(middle) > 0.0 { above = middle } else { below = middle }
    }
    0.5 * (above + below)
}

fn struck(scene: &Scene, radius: f64, eye: Vector, ray: Vector, t: f64) -> Hit {
    let at = along(eye, ray, t);
    let (place, r) = ([at[0], at[1]], at[0].hypot(at[1]));
    let top = height(scene, radius, place);
    // Below the surface at this point: the side of the base.
    let is_side = (r - radius).abs() < 0.05
        && at[2] < -0.05
        && at[2] > -scene.base_height_mm + scene.overflow_mm;
    let is_powder =
        !is_side && if r < radius { top > 0.02 } else { top > 0.3 - scene.base_height_mm };
    let light = 12.0 * (at[0] / radius);
    match (is_side, is_powder) {
        (true, _) => (t, shaded(BASE, [at[0], at[2]], 4.0), false),
        (false, true) => {
            (t, shaded(POWDER.map(|c| c + light), [at[0] * 2.0, at[1] * 2.0], 14.0), true)
        }
        (false, false) if r < radius => (t, shaded(BASE, place, 6.0), false),
        _ => (t, shaded(BENCH, [at[0] / 3.0, at[1] / 3.0], 10.0), false),
    }
}

fn shaded(colour: [f64; 3], at: [f64; 2], texture: f64) -> [f64; 3] {
    let shade = texture * bump(at);
    colour.map(|c| c + shade)
}

/// Parameters between which a line is inside a circle about the origin.
fn circle(from: [f64; 2], by: [f64; 2], radius: f64) -> Option<[f64; 2]> {
    let a = by[0] * by[0] + by[1] * by[1];
    let b = from[0] * by[0] + from[1] * by[1];
    let c = from[0] * from[0] + from[1] * from[1] - radius * radius;
    let root = (b * b - a * c).sqrt();
    (a > 1e-12 && root.is_finite()).then(|| [(-b - root) / a, (-b + root) / a])
}

fn funnel_hit(funnel: &Funnel, eye: Vector, ray: Vector) -> Option<Hit> {
    let r = funnel.spout_diameter_mm / 2.0;
    let (tip, shoulder) = (funnel.tip_height_mm, funnel.tip_height_mm + SPOUT_MM);
    let local = [eye[0] - funnel.off_centre_mm[0], eye[1] - funnel.off_centre_mm[1], eye[2]];
    let parts = [[tip, shoulder, r, r], [shoulder, shoulder + MOUTH_MM[0], r, MOUTH_MM[1]]];
    let t =
        parts.into_iter().filter_map(|part| frustum(part, local, ray)).min_by(f64::total_cmp)?;
    let at = along(local, ray, t);
    let light = 25.0 * at[0] / at[0].hypot(at[1]).max(1e-6);
    Some((t, shaded(FUNNEL.map(|c| c + light), [at[0], at[2]], 8.0), false))
}

/// Nearest intersection with the side of a frustum about the z axis: from, to, radius at either
/// end.
fn frustum([low, high, r_low, r_high]: [f64; 4], eye: Vector, ray: Vector) -> Option<f64> {
    let widen = (r_high - r_low) / (high - low);
    // x^2 + y^2 = (r_low + widen (z - low))^2 along the ray.
    let (r0, dr) = (r_low + widen * (eye[2] - low), widen * ray[2]);
    let a = ray[0] * ray[0] + ray[1] * ray[1] - dr * dr;
    let b = eye[0] * ray[0] + eye[1] * ray[1] - r0 * dr;
    let c = eye[0] * eye[0] + eye[1] * eye[1] - r0 * r0;
    let root = (b * b - a * c).sqrt();
    let on_side = |t: &f64| {
        let z = eye[2] + t * ray[2];
        *t > 0.0 && (low..=high).contains(&z)
    };
    [(-b - root) / a, (-b + root) / a].into_iter().filter(on_side).min_by(f64::total_cmp)
}
