//! Packing fraction of poured grains.

use super::super::scene::{packing_fraction, rain, top};
use super::super::shapes::Silo;
use super::{Check, Experiment, SMOOTH, Suite};

pub(super) const EXPERIMENTS: &[Experiment] = &[
    Experiment { name: "packing_poured", checks: &["packing_poured"], run: poured },
    Experiment {
        name: "packing_frictionless",
        checks: &["packing_frictionless"],
        run: frictionless,
    },
];

/// Radius of the container and height of the filling, grain diameters.
const RADIUS: f64 = 13.0;
const HEIGHT: f64 = 15.0;

fn poured(suite: &Suite) -> Vec<Check> {
    let source = "random loose 0.55 (Jerkins et al. 2008) to random close 0.64";
    vec![Check::within("packing_poured", fraction(suite, true), [0.55, 0.64], "", source)]
}

fn frictionless(suite: &Suite) -> Vec<Check> {
    let source = "random close 0.64 (Silbert 2010)";
    vec![Check::within("packing_frictionless", fraction(suite, false), [0.60, 0.66], "", source)]
}

/// Packing fraction in the bulk, away from walls and surface, after rain.
fn fraction(suite: &Suite, with_friction: bool) -> f64 {
    let mut law = suite.law_of_deep_bed(SMOOTH);
    if !with_friction {
        law.grain.friction = 0.0;
        law.wall.friction = 0.0;
    }
    let bed =
        rain(&law, &Silo::closed(RADIUS as f32), 0.4, 1, |grains| f64::from(top(grains)) > HEIGHT);
    packing_fraction(&bed, RADIUS - 5.0, [4.0, HEIGHT - 4.0])
}
