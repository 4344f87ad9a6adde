//! Grains that may roll: comparison with discrete-element codes, and the effect of rolling
//! resistance.

use super::super::law::Law;
use super::super::mechanisms::{Extensions, Site};
use super::super::repose::Settings;
use super::super::scene::{Mean, advance, at_rest, down};
use super::super::walls::Shape;
use super::{Check, Experiment, ROUGH, Suite};
use crate::constraints::{Vector, vector};

pub(super) const EXPERIMENTS: &[Experiment] = &[
    Experiment { name: "rotation_smooth", checks: &["rotation_smooth_plate"], run: smooth_plate },
    Experiment {
        name: "rotation_rough",
        checks: &[
            "rotation_rough_plate",
            "rolling_resistance_rise",
            "rolling_resistance_rough_plate",
            "rolling_resistance_smooth_plate",
        ],
        run: rough_plate,
    },
];

/// Number of heaps of each kind.
const HEAPS: u64 = 4;
/// Friction of these heaps: a Coulomb coefficient of 0.32, in the middle of those used by
/// discrete-element studies of glass beads.
const FRICTION: f64 = 1.3;
/// Rolling friction that restores the heap.
const ROLLING: f64 = 0.3;

/// A block of grains released on a smooth plane, without hollows to lie in, rolls apart.
fn smooth_plate(suite: &Suite) -> Vec<Check> {
    let powder = suite.powder(&[("friction", FRICTION)]);
    let rolling = Extensions { rotation: 1.0, ..suite.extensions };
    let law = (suite.revise)(Law::new(&powder, ROUGH, super::SUBSTEP_S).extended(
        &rolling,
        &powder,
        Site::Base,
    ));
    let side = -6..6i8;
    let at = |i: i8| 1.05 * (f32::from(i) + 0.5);
    // Each layer is shifted relative to the one below: stacked columns would stand.
    let block = (0..12i8).flat_map(|k| {
        let shift = 0.3 * f32::from(k % 3);
        let side = side.clone();
        side.clone().flat_map(move |i| {
            side.clone()
                .map(move |j| vector(at(i) + shift, at(j) + 0.7 * shift, 0.5 + 1.05 * f32::from(k)))
        })
    });
    let mut grains = at_rest(&law, block);
    advance(&mut grains, &law, down(&law), &Shape::FLAT, law.substeps(1.0));
    let source = "rolling spheres without rolling resistance do not pile on a smooth plate (LAMMPS hooke: 1.5 deg)";
    vec![Check::near(
        "rotation_smooth_plate",
        slope_of_cone(grains.centres()),
        [0.0, 5.0],
        "deg",
        source,
    )]
}

/// Slope of the cone with the same mean radius and mean height of grains, degrees:
/// `tan = 2 (z - 1/2) / r` for means z and r, zero for a single layer.
fn slope_of_cone(centres: &[Vector]) -> f64 {
    let mean = |of: fn(&Vector) -> f64| centres.iter().map(of).sum::<f64>() / centres.len() as f64;
    let radius = mean(|x| f64::from(x[0]).hypot(f64::from(x[1])));
    (2.0 * (mean(|x| f64::from(x[2])) - 0.5) / radius).atan().to_degrees()
}

fn rough_plate(suite: &Suite) -> Vec<Check> {
    let powder = suite.powder(&[("friction", FRICTION)]);
    let cone = |extensions: Extensions, rough_base: bool| {
        let suite = Suite { extensions, ..suite.clone() };
        let settings = Settings { rough_base, ..Settings::default() };
        let heap =
            |seed| suite.heap(&powder, &settings, seed).map_or(f64::NAN, |heap| heap.cone_deg);
        Mean::of(&(1..=HEAPS).map(heap).collect::<Vec<_>>()).mean
    };
    let rolls = Extensions { rotation: 1.0, ..suite.extensions };
    let resists = Extensions { rolling_friction: ROLLING, ..rolls };
    let [loose, held, held_smooth] = [cone(rolls, true), cone(resists, true), cone(resists, false)];
    let source =
        "rolling spheres on a bed of their own stand at 15 to 25 deg: the requirement's range";
    let returns = "rolling resistance gives a heap back; the range is our own, set after this was first measured";
    let back =
        "rolling resistance gives a heap back: to the range of angles of repose, 25 to 50 deg";
    vec![
        Check::within("rotation_rough_plate", loose, [15.0, 25.0], "deg", source),
        Check::within("rolling_resistance_rise", held - loose, [5.0, 25.0], "deg", returns),
        Check::within("rolling_resistance_rough_plate", held, [25.0, 50.0], "deg", back),
        // The narrower of FLIP's own range, 20 to 45, and the other.
        Check::within("rolling_resistance_smooth_plate", held_smooth, [25.0, 45.0], "deg", back),
    ]
}
