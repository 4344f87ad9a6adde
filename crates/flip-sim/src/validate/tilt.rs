//! Onset of flow in a tilted bed.
//!
//! A bed with a level surface that is tilted slowly stays put until its maximum angle of stability,
//! flows, and comes to rest at a smaller slope, its angle of repose. In sand and glass beads the
//! two differ by 1 to 5 deg (Jaeger, Liu and Nagel 1989, Phys. Rev. Lett. 62, 40; Pouliquen and
//! Forterre 2002, J. Fluid Mech. 453, 133). If a bed starts to flow below its angle of repose, the
//! friction memory was lost; if far above it, the grains are stuck together. The heap of the same
//! powder stands at the angle of repose, so the bed must start between that and a few degrees more.

use super::super::flank::surface;
use super::super::law::Law;
use super::super::repose::Settings;
use super::super::scene::{Mean, advance, leaning, line, rain, settle, top};
use super::super::shapes::Silo;
use super::super::walls::Shape;
use super::heap::angle;
use super::{Check, Experiment, ROUGH, Suite};
use crate::grains::Grains;

pub(super) const EXPERIMENTS: &[Experiment] = &[Experiment {
    name: "tilted_bed",
    checks: &["tilt_onset", "tilt_hysteresis"],
    run: tilted_bed,
}];

/// Radius of the container and depth of the bed, grain diameters.
const RADIUS: f64 = 15.0;
const DEPTH: f64 = 8.0;
/// Radius within which the slope is measured and the flow monitored.
const WATCHED: f64 = 10.0;

fn tilted_bed(suite: &Suite) -> Vec<Check> {
    let law = suite.law(ROUGH);
    let beds: Vec<[f64; 2]> = (1..=3).map(|seed| avalanche(&law, seed)).collect();
    let [starts, rests] =
        [0, 1].map(|k| Mean::of(&beds.iter().map(|bed| bed[k]).collect::<Vec<_>>()).mean);
    let repose = angle(suite, &suite.powder, &Settings::with_particles(4000), 4).mean;
    let source = "Jaeger et al. 1989: the maximum angle of stability is above the angle of repose by up to 5 deg";
    vec![
        Check::within("tilt_onset", starts - repose, [0.0, 5.0], "deg", source),
        Check::within("tilt_hysteresis", starts - rests, [0.0, 5.0], "deg", source),
    ]
}

/// Slope at which the bed starts to flow, and the slope at which it comes to rest again, degrees;
/// NaN if it never flows.
pub(super) fn avalanche(law: &Law, seed: u64) -> [f64; 2] {
    const LOOK: u32 = 100;
    let silo = Silo::closed(RADIUS as f32);
    let mut bed = rain(law, &silo, 0.4, seed, |grains| f64::from(top(grains)) > DEPTH);
    // At this speed the surface moves by a diameter in ten fall times; individual settling grains
    // do not move its mean that far.
    let fastest = 0.1 * f64::from(law.gravity).sqrt();
    let mut tilt = 0.0;
    let mut flows = false;
    while tilt < 60.0 && !flows {
        // Ten degrees per second, four times that while nothing can happen.
        let rate = if tilt < 10.0 { 40.0 } else { 10.0 };
        for _ in 0..LOOK {
            tilt += rate * law.substep_s;
            bed.substep(law, leaning(law, tilt), &Shape::Silo(silo));
        }
        flows = surface_speed(&bed) > fastest;
    }
    if !flows {
        return [f64::NAN; 2];
    }
    let starts = tilt + slope(&bed);
    let steps = law.substeps(0.02);
    advance(&mut bed, law, leaning(law, tilt), &Shape::Silo(silo), steps);
    settle(&mut bed, law, leaning(law, tilt), &Shape::Silo(silo), law.substeps(1.0));
    [starts, tilt + slope(&bed)]
}

/// Mean velocity down the slope of the grains at the surface, diameters per substep.
fn surface_speed(bed: &Grains) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (x, v) in bed.centres().iter().zip(bed.velocities()) {
        if f64::from(x[2]) > DEPTH - 2.0 && f64::from(x[0]).hypot(f64::from(x[1])) < WATCHED {
            sum += f64::from(v[0]);
            count += 1.0;
        }
    }
    sum / f64::max(count, 1.0)
}

/// Slope of the surface down towards +x, in the container's frame, degrees.
fn slope(bed: &Grains) -> f64 {
    let points: Vec<[f64; 2]> = surface(bed.centres(), WATCHED)
        .filter(|(at, _)| at[0].hypot(at[1]) < WATCHED)
        .map(|(at, height)| [at[0], height])
        .collect();
    (-line(&points)[0]).atan().to_degrees()
}
