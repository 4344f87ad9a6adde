//! Automated angle of repose: from frames of a pile under a funnel to an angle with its
//! uncertainty.
//!
//! The published procedure finds the funnel's tip and the pile's apex in depth images and derives
//! the height of the apex over the base from their distance. In addition, a cone is fitted to the
//! flank. Both work on the mean of at least ten frames, in coordinates based on the bench that the
//! camera sees around the base, so that the pose of the camera need not be known.
//!
//! | file | answers |
//! |------|---------|
//! | `settings` | what is known of the rig, what frames must show |
//! | `shot` | frames become their mean |
//! | `bench` | where the level surface is, coordinates of the base |
//! | `spout` | where the tip is |
//! | `flank` | where the apex is, how steep the flank |
//! | `fit` | robust least squares |
//! | `outline` | where all that is in the picture |
//! | `repeats` | five measurements become a flowability |
//! | `comparison` | automated beside manual |
//!
//! Pure functions; lengths in mm.

mod bench;
mod comparison;
mod fit;
mod flank;
mod outline;
mod refusal;
mod repeats;
mod settings;
mod shot;
mod spout;

pub use comparison::{Compared, Stored, compare, published};
pub use flip_core::domain::pile::{Angle, Measurement, Outline};
pub use refusal::Refusal;
pub use repeats::{Repeats, repeats};
pub use settings::{Dimensions, Lengths, Limits};

use crate::hardware::camera::Frame;
use bench::View;
use fit::Point;
use flank::{Apex, Departure, Flank};
use shot::{Shot, median};
use spout::Tip;

/// Standard uncertainty of the bench as a level: its fit and its flatness, degrees.
const LEVEL_U_DEG: f64 = 0.1;
/// Standard uncertainty of the mean slope because only the near sides are visible, fraction of the
/// standard deviation of the slope over them.
const UNSEEN_U: f64 = 0.7;
/// Standard uncertainty of the apex's height because no pile is exactly a rounded cone, fraction of
/// the rounding's radius.
const ROUNDING_U: f64 = 0.08;
/// The same because nothing is visible around the apex, fraction of the flank's rise over the gap.
const GAP_U: f64 = 0.25;

/// Measure the pile in these frames.
///
/// ```text
/// h = D - |p_apex - p_tip|        AoR = atan(2 h / d_base)
/// ```
///
/// | symbol | what | from |
/// |--------|------|------|
/// | D | height of the tip over the base | `rig` |
/// | d_base | diameter of the base | `rig` |
/// | p_tip | lower end of the spout, on its axis | depth of the spout, colour at its edge |
/// | p_apex | top of a rounded cone fitted to the inner half | depth |
///
/// The publication prints `2 h / d_base`; its numbers are degrees, so the arctangent is taken.
///
/// Numerics: with [`Lengths::ByTipHeight`] all lengths are scaled so that the tip is D above the
/// base. The slope of the cone does not depend on the scale.
///
/// # Errors
/// [`Refusal`], with what was seen instead.
pub fn measure(
    frames: &[Frame],
    rig: &Dimensions,
    limits: &Limits,
) -> Result<Measurement, Refusal> {
    look(frames, rig, limits).map(|(measured, _)| measured)
}

/// [`measure`], and where in the picture is what was measured.
///
/// # Errors
/// As [`measure`].
pub fn look(
    frames: &[Frame],
    rig: &Dimensions,
    limits: &Limits,
) -> Result<(Measurement, Outline), Refusal> {
    let rig = &rig.checked().map_err(Refusal::Settings)?;
    let limits = &limits.checked().map_err(Refusal::Settings)?;
    let shot = &Shot::of(frames, limits)?;
    let plane = bench::bench(shot, limits)?;
    let on_bench: Vec<usize> = (0..shot.depth_mm.len())
        .step_by(17)
        .filter(|k| shot.point(*k).is_some_and(|p| plane.height(p).abs() < 1.0))
        .collect();
    let stated = View::over(plane, rig.base_height_mm, 1.0);
    let spout = spout::find(shot, &stated, rig)?;
    spout::still(shot, &spout, &on_bench, limits)?;
    let seen = spout.tip(shot, &stated, rig)?;
    let scale = (rig.tip_height_mm + rig.base_height_mm) / (seen.at[2] + rig.base_height_mm);
    if (scale - 1.0).abs() > limits.scale_error_max {
        return Err(Refusal::TipMisplaced { seen_mm: seen.at[2], stated_mm: rig.tip_height_mm });
    }
    let (view, tip) = match rig.lengths {
        Lengths::Stated => (stated, seen.clone()),
        Lengths::ByTipHeight => {
            let view = View::over(plane, rig.base_height_mm, scale);
            (view, spout::find(shot, &view, rig)?.tip(shot, &view, rig)?)
        }
    };
    let [roll_deg, elevation_deg] = plane.roll_and_elevation_deg();
    let pile = Pile { shot, view, tip, rig };
    pile.measured(limits, [seen.at[2], roll_deg, elevation_deg])
}

/// A pile in base coordinates.
struct Pile<'a> {
    shot: &'a Shot<'a>,
    view: View,
    tip: Tip,
    rig: &'a Dimensions,
}

impl Pile<'_> {
    fn measured(&self, limits: &Limits, seen: [f64; 3]) -> Result<(Measurement, Outline), Refusal> {
        let axis = [self.tip.at[0], self.tip.at[1]];
        let points = self.points();
        self.is_quiet(limits)?;
        let rough = flank::height(&points, axis, self.rig)?;
        // A flank without depth is refused as such, not for its shape.
        let no_depth = |none| self.invalid_share(limits, rough).err().unwrap_or(none);
        let slope = flank::flank(&points, axis, rough, self.rig).map_err(no_depth)?.1.parameters[1];
        let apex = flank::apex(&points, axis, rough, slope, self.rig)?;
        let [x, y, top] = apex.at();
        let off_centre_mm = (x - axis[0]).hypot(y - axis[1]);
        let allowed_mm = limits.off_centre_max * self.rig.base_diameter_mm / 2.0;
        if off_centre_mm > allowed_mm {
            return Err(Refusal::NotCentred { offset_mm: off_centre_mm, allowed_mm });
        }
        let pile_invalid = self.invalid_share(limits, top)?;
        let (flank, cone) = flank::flank(&points, axis, top, self.rig)?;
        flank::covers(&points, &cone, axis, self.rig)?;

        let departure = flank::departure(&flank, &cone, self.shot.width());
        let [tips, cones] = self.by_frame(&points, &flank, &apex, slope);
        let tip_to_apex_mm = distance([x, y, top], self.tip.at);
        let height_mm = self.rig.tip_height_mm - tip_to_apex_mm;
        let apex_u = (apex.height_variance() * departure.together)
            .sqrt()
            .hypot(ROUNDING_U * apex.rounding_mm());
        let apex_u = apex_u.hypot(GAP_U * slope * flank::gap(&points, [x, y]));
        let outline = self.outline([x, y, top], &cone, &flank);
        let measured = Measurement {
            tip: self.tip_angle(height_mm, apex_u, frame_u(&tips)),
            cone: cone_angle(&cone, &departure, frame_u(&cones)),
            height_mm,
            tip_to_apex_mm,
            tip_height_seen_mm: seen[0],
            off_centre_mm,
            roll_deg: seen[1],
            elevation_deg: seen[2],
            flank_pixels: flank.len() as u32,
            pile_invalid,
            frames: self.shot.frames.len() as u32,
        };
        Ok((measured, outline))
    }

    /// Points on and over the base, below the spout.
    fn points(&self) -> Vec<Point> {
        let radius = self.rig.base_diameter_mm / 2.0;
        let (low, high) = (-0.1 * radius, self.tip.at[2] - 0.1 * self.rig.tip_height_mm);
        let on_pile = |at: &[f64; 3]| {
            (low..high).contains(&at[2])
                && (at[0] - self.tip.at[0]).hypot(at[1] - self.tip.at[1]) < 1.02 * radius
        };
        let point = |pixel: usize| {
            let at = self.shot.point(pixel).map(|p| self.view.place(p)).filter(on_pile)?;
            Some(Point {
                pixel,
                at,
                ray: self.view.ray(self.shot.directions[pixel]),
                expected: [at[0], at[1]],
            })
        };
        (0..self.shot.depth_mm.len())
            .filter(|pixel| !self.shot.edge[*pixel])
            .filter_map(point)
            .collect()
    }

    /// Pixels whose rays pass this level over the base within half its radius: any pile that covers
    /// the base is hit there or nearby.
    fn pixels_across(&self, level_mm: f64) -> Vec<usize> {
        let radius = self.rig.base_diameter_mm / 2.0;
        let is_across = |direction: &[f64; 2]| {
            let [from, by] = self.view.ray(*direction);
            let t = (level_mm - from[2]) / by[2];
            let (x, y) =
                (from[0] + t * by[0] - self.tip.at[0], from[1] + t * by[1] - self.tip.at[1]);
            t > 0.0 && x.hypot(y) < 0.5 * radius
        };
        let pixels = self.shot.directions.iter().enumerate();
        pixels.filter(|(_, direction)| is_across(direction)).map(|(pixel, _)| pixel).collect()
    }

    /// Check that depth is quiet where half the height of a pile of 35 deg would be.
    fn is_quiet(&self, limits: &Limits) -> Result<(), Refusal> {
        let across = self.pixels_across(0.35 * self.rig.base_diameter_mm / 2.0).into_iter();
        let mut noise: Vec<f64> =
            across.map(|pixel| self.shot.sd_mm[pixel]).filter(|sd| *sd > 0.0).collect();
        let sd_mm = median(&mut noise);
        match sd_mm > limits.noise_max_mm {
            true => Err(Refusal::TooNoisy { sd_mm, allowed_mm: limits.noise_max_mm }),
            false => Ok(()),
        }
    }

    /// Fraction of the pile's pixels without depth.
    fn invalid_share(&self, limits: &Limits, top: f64) -> Result<f64, Refusal> {
        let across = self.pixels_across(0.5 * top);
        let invalid = across.iter().filter(|pixel| self.shot.depth_mm[**pixel] == 0.0).count();
        let share = invalid as f64 / across.len().max(1) as f64;
        let (invalid_percent, allowed_percent) = (100.0 * share, 100.0 * limits.pile_invalid_max);
        match share > limits.pile_invalid_max {
            true => Err(Refusal::TooManyInvalid { part: "pile", invalid_percent, allowed_percent }),
            false => Ok(share),
        }
    }

    /// Both angles of each single frame, degrees, at the pixels of the mean.
    fn by_frame(
        &self,
        points: &[Point],
        flank: &[Point],
        apex: &Apex,
        slope: f64,
    ) -> [Vec<f64>; 2] {
        let axis = [self.tip.at[0], self.tip.at[1]];
        let of = |frame: &Frame, points: &[Point]| -> Vec<Point> {
            let place = |p: &Point| {
                self.shot.point_in(frame, p.pixel).map(|at| Point { at: self.view.place(at), ..*p })
            };
            points.iter().filter_map(place).collect()
        };
        let frames = self.shot.frames.iter();
        let tips = frames.clone().filter_map(|frame| {
            let apex =
                flank::top(&of(frame, points), axis, apex.parameters, slope, self.rig).ok()?;
            Some(self.rig.angle_deg(self.rig.tip_height_mm - distance(apex.at(), self.tip.at)))
        });
        let cones = frames.filter_map(|frame| {
            let cone = flank::cone(&of(frame, flank), axis, apex.at()[2], self.rig).ok()?;
            Some(cone.parameters[1].atan().to_degrees())
        });
        [tips.collect(), cones.collect()]
    }

    /// The angle from a height, with the uncertainty due to the tip, the apex and the rig.
    ///
    /// ```text
    /// stated:    h = D - (z_tip - z_apex)                       q = 1
    /// by tip:    h = (D + b) (z_apex + b) / (z_tip + b) - b     q = (h + b) / (D + b)
    /// u_h^2 = q^2 (u_D^2 + u_tip^2) + (1 - q)^2 u_b^2 + u_apex^2 [ + (u_scale L)^2 if stated ]
    /// ```
    fn tip_angle(&self, height_mm: f64, apex_u: f64, u_frames_deg: f64) -> Angle {
        let rig = self.rig;
        let base = rig.base_height_mm;
        let (q, scale_u) = match rig.lengths {
            Lengths::Stated => (1.0, rig.depth_scale_u * (rig.tip_height_mm - height_mm)),
            Lengths::ByTipHeight => ((height_mm + base) / (rig.tip_height_mm + base), 0.0),
        };
        let parts = [
            q * rig.tip_height_u_mm,
            q * self.tip.u_mm,
            (1.0 - q) * rig.base_height_u_mm,
            apex_u,
            scale_u,
        ];
        let height_u = parts.iter().map(|u| u * u).sum::<f64>().sqrt();
        let t = 2.0 * height_mm / rig.base_diameter_mm;
        let tangent_u = (2.0 * height_u / rig.base_diameter_mm)
            .hypot(t * rig.base_diameter_u_mm / rig.base_diameter_mm);
        let u_deg = (tangent_u / (1.0 + t * t)).to_degrees().hypot(u_frames_deg);
        Angle { deg: rig.angle_deg(height_mm), u_deg, u_frames_deg }
    }
}

impl Dimensions {
    fn angle_deg(&self, height_mm: f64) -> f64 {
        (2.0 * height_mm / self.base_diameter_mm).atan().to_degrees()
    }
}

/// The slope of a cone, with the uncertainty due to the pixels, the level and the hidden sides.
fn cone_angle(cone: &Flank, departure: &Departure, u_frames_deg: f64) -> Angle {
    let t = cone.parameters[1];
    let slope_u =
        (cone.covariance[(1, 1)] * departure.together).sqrt().hypot(UNSEEN_U * departure.slope_sd);
    let u_deg = (slope_u / (1.0 + t * t)).to_degrees().hypot(LEVEL_U_DEG).hypot(u_frames_deg);
    Angle { deg: t.atan().to_degrees(), u_deg, u_frames_deg }
}

/// Standard error of the mean over single frames, from their median deviation: a frame that lost
/// the apex is ignored.
fn frame_u(angles_deg: &[f64]) -> f64 {
    let middle = median(&mut angles_deg.to_vec());
    let mut apart: Vec<f64> = angles_deg.iter().map(|angle| (angle - middle).abs()).collect();
    match angles_deg.len() {
        0 | 1 => 0.0,
        n => 1.4826 * median(&mut apart) / (n as f64).sqrt(),
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests;
