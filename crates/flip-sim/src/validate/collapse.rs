//! Axisymmetric column collapse: a cylinder of grains is released on a plane.
//!
//! With r0 and h0 the column's radius and height and a = h0 / r0, sand, rice and sugar come to rest
//! at (Lube et al. 2004, J. Fluid Mech. 508, 175)
//!
//! ```text
//! (r_inf - r0) / r0 = 1.24 a        a < 1.7
//!                   = 1.6 a^(1/2)   a > 1.7
//! ```
//!
//! and glass beads at `1.35 a` up to a = 3, `2.0 a^(1/2)` above, and `h_inf / r0 = 0.74` above a =
//! 0.74 (Lajeunesse et al. 2004, Phys. Fluids 16, 2371). The run-outs agree within the tolerances
//! used here, and the former are taken. The heights differ: angular grains end up higher the taller
//! the column was, `0.88 a^(1/6)`, while beads, the spheres of a laboratory, do not. Both are
//! checked.
//!
//! Columns have r0 = 20 d, above which the run-out no longer depends on it (Warnett et al. 2014,
//! Granular Matter 16, 115). All columns of one experiment are cut from one bed that was rained
//! into a container without wall friction, and stand on a plane roughened with a layer of the same
//! grains, like the beds in a laboratory.

use super::super::engine::{LAYER, close_packed};
use super::super::flank::surface;
use super::super::law::Law;
use super::super::scene::{advance, down, fall_time, power_law, rain, settle, top};
use super::super::shapes::Silo;
use super::super::walls::Shape;
use super::{Check, Experiment, ROUGH, Suite};
use crate::constraints::{Vector, vector};
use crate::grains::Grains;

pub(super) const EXPERIMENTS: &[Experiment] = &[
    Experiment {
        name: "collapse_tall",
        checks: &[
            "collapse_tall_runout_exponent",
            "collapse_tall_runout_prefactor",
            "collapse_height_exponent",
            "collapse_height_prefactor",
            "collapse_height_beads_exponent",
            "collapse_height_beads_prefactor",
        ],
        run: tall,
    },
    Experiment {
        name: "collapse_low",
        checks: &["collapse_low_runout_exponent", "collapse_low_runout_prefactor"],
        run: low,
    },
];

/// Radius of every column, grain diameters.
const RADIUS: f64 = 20.0;
/// Aspect ratios of low columns: a column of fewer than fourteen grains loses a tenth of its
/// run-out to the one-grain uncertainty of its front.
const LOW: [f64; 3] = [0.7, 1.1, 1.6];
/// Aspect ratios of tall columns: beyond the transition of either source's law, because the
/// exponent falls gradually.
const TALL: [f64; 3] = [3.2, 4.5, 6.3];
/// Extent of the rough layer beyond the column, relative to the expected run-out (both in column
/// radii).
const MARGIN: f64 = 1.4;
/// Initial height of the column above the rough layer, grain diameters, chosen so that its grains
/// do not overlap the layer's.
const LIFT: f32 = 0.95;
/// The front is where the grains' cross-sections cover this share of a ring.
const COVERED: f64 = 0.5;

/// The deposit of a column, in column radii.
struct Deposit {
    aspect: f64,
    /// (r_inf - r0) / r0.
    runout: f64,
    /// h_inf / r0.
    height: f64,
}

fn tall(suite: &Suite) -> Vec<Check> {
    let deposits = collapse(suite, &TALL);
    let [exponent, prefactor] = law_of(&deposits, |deposit| deposit.runout);
    let [height_exponent, height_prefactor] = law_of(&deposits, |deposit| deposit.height);
    let runout = "Lube et al. 2004: (r_inf - r0) / r0 = 1.6 a^(1/2), a > 1.7";
    let beads = "Lajeunesse et al. 2004, glass beads: h_inf / r0 = 0.74 whatever a > 0.74";
    let sand = "Lube et al. 2004, sand: h_inf / r0 = 0.88 a^(1/6), a > 1.7";
    vec![
        Check::near("collapse_tall_runout_exponent", exponent, [0.5, 0.1], "", runout),
        Check::near("collapse_tall_runout_prefactor", prefactor, [1.6, 0.4], "", runout),
        Check::near("collapse_height_exponent", height_exponent, [1.0 / 6.0, 0.1], "", sand),
        Check::near("collapse_height_prefactor", height_prefactor, [0.88, 0.22], "", sand),
        Check::near("collapse_height_beads_exponent", height_exponent, [0.0, 0.1], "", beads),
        Check::near("collapse_height_beads_prefactor", height_prefactor, [0.74, 0.185], "", beads),
    ]
}

fn low(suite: &Suite) -> Vec<Check> {
    let [exponent, prefactor] = law_of(&collapse(suite, &LOW), |deposit| deposit.runout);
    let source = "Lube et al. 2004: (r_inf - r0) / r0 = 1.24 a, a < 1.7";
    vec![
        Check::near("collapse_low_runout_exponent", exponent, [1.0, 0.1], "", source),
        Check::near("collapse_low_runout_prefactor", prefactor, [1.24, 0.31], "", source),
    ]
}

/// Exponent and prefactor of a length of the deposit over the aspect ratio.
fn law_of(deposits: &[Deposit], length: fn(&Deposit) -> f64) -> [f64; 2] {
    power_law(&deposits.iter().map(|deposit| [deposit.aspect, length(deposit)]).collect::<Vec<_>>())
}

fn collapse(suite: &Suite, aspects: &[f64]) -> Vec<Deposit> {
    let law = suite.law_of_deep_bed(ROUGH);
    let mut smooth_sided = law;
    smooth_sided.wall.friction = 0.0;
    let silo = Silo::closed(RADIUS as f32);
    let tallest = aspects.iter().fold(0.0f64, |tallest, a| tallest.max(*a)) * RADIUS;
    let bed = rain(&smooth_sided, &silo, 1.0, 1, |grains| f64::from(top(grains)) > tallest + 1.0);
    // Only a law with mechanisms supports fixed grains.
    let (law, contained) = (Law { extended: true, ..law }, Law { extended: true, ..smooth_sided });
    let release = |aspect: f64| {
        let mut grains = Grains::default();
        let reach = RADIUS * (1.0 + MARGIN * (1.24 * aspect).min(1.6 * aspect.sqrt()));
        close_packed(reach as f32).into_iter().for_each(|x| grains.fix(x));
        for x in bed.centres().iter().filter(|x| f64::from(x[2]) + 0.5 <= aspect * RADIUS) {
            grains.pour(&law, vector(x[0], x[1], x[2] + LIFT), [0.0; 4]);
        }
        advance(&mut grains, &contained, down(&law), &Shape::Silo(silo), 200);
        // The front takes about three free falls from the column's height; it gets twice that to
        // come to rest.
        let time = 6.0 * (aspect * RADIUS).sqrt() * fall_time(&law);
        settle(&mut grains, &law, down(&law), &Shape::FLAT, time as u32);
        let lying: Vec<Vector> = grains.free().map(|x| [x[0], x[1], x[2] - LAYER, x[3]]).collect();
        Deposit { aspect, runout: front(&lying) / RADIUS - 1.0, height: height(&lying) / RADIUS }
    };
    aspects.iter().map(|aspect| release(*aspect)).collect()
}

/// Radius up to which the deposit covers the plane, grain diameters.
pub(super) fn front(centres: &[Vector]) -> f64 {
    let mut counts: Vec<f64> = Vec::new();
    for x in centres {
        let ring = f64::from(x[0]).hypot(f64::from(x[1])) as usize;
        if ring >= counts.len() {
            counts.resize(ring + 1, 0.0);
        }
        counts[ring] += 1.0;
    }
    // A grain covers pi / 4, ring k has the area pi (2 k + 1).
    let coverage =
        |ring: usize| counts.get(ring).map_or(0.0, |count| count / 4.0 / (2 * ring + 1) as f64);
    let bare = (1..=counts.len()).find(|&ring| coverage(ring) < COVERED).unwrap_or(0);
    let (within, beyond) = (coverage(bare.saturating_sub(1)), coverage(bare));
    bare as f64 - 0.5 + ((within - COVERED) / (within - beyond)).clamp(0.0, 1.0)
}

/// Mean height of the surface around the axis, grain diameters.
fn height(centres: &[Vector]) -> f64 {
    let near: Vec<f64> =
        surface(centres, 3.0).filter(|(at, _)| at[0].hypot(at[1]) < 3.0).map(|(_, z)| z).collect();
    near.iter().sum::<f64>() / near.len() as f64
}
