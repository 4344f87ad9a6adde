//! The cup experiment: grains flow out of a flat-bottomed cylinder through a round hole in the
//! middle of its floor. It measures the flow rate and the slope of the remaining powder.

use super::flank::surface;
use super::grains::Grains;
use super::law::{Law, SUBSTEP_S};
use super::repose::Refusal;
use super::scene::{advance, down, fall_time, line, rain, top};
use super::shapes::Silo;
use super::walls::Shape;
use flip_core::domain::parameters::ParameterSet;

/// Coulomb coefficient of the cup.
const FRICTION: f64 = 0.4;
/// Shares of grains discharged at the start and end of timing: in between, the flow is steady and
/// independent of the fill level.
const TIMED: [f64; 2] = [0.1, 0.4];
/// Time, in units of sqrt(d / g), after which a cup without flow is given up.
const PATIENCE: f64 = 60.0;
/// Substeps between two checks of the hole.
const LOOK: u32 = 8;
/// Hole and cup of the drained angle, radii in grain diameters, and fill depth: a crater of 50 deg
/// ends at the side of the cup.
const DRAIN: [f64; 3] = [4.0, 12.0, 13.0];

/// A filled cup.
struct Cup {
    law: Law,
    silo: Silo,
    grains: Grains,
}

impl Cup {
    /// Fills a cup with the hole closed, then opens it. Lengths in grain diameters.
    fn open(set: &ParameterSet, [hole, radius, depth]: [f64; 3], seed: u64) -> Self {
        let law = Law::new(set, FRICTION, SUBSTEP_S);
        let closed = Silo::closed(radius as f32);
        let grains = rain(&law, &closed, 1.0, seed, |grains| f64::from(top(grains)) > depth);
        Self { law, silo: Silo { orifice: hole as f32, ..closed }, grains }
    }

    fn run(&mut self) -> Result<(), Refusal> {
        let wall = Shape::Silo(self.silo);
        advance(&mut self.grains, &self.law, down(&self.law), &wall, LOOK);
        self.grains.take_departed(&wall);
        match self.grains.fault() {
            Some(cause) => Err(Refusal::Diverged { at_s: 0.0, cause }),
            None => Ok(()),
        }
    }
}

/// Number of grains that leave in the time sqrt(d / g) through a hole of `orifice` grain diameters;
/// 0 for a powder that bridges it.
///
/// The cup is 1.6 times as wide as the hole, at least 16 d, and filled to a depth of 1.2 holes plus
/// 4 d.
///
/// # Errors
/// [`Refusal`] if the solver diverged.
pub(super) fn flow(set: &ParameterSet, orifice: f64, seed: u64) -> Result<f64, Refusal> {
    let mut cup =
        Cup::open(set, [0.5 * orifice, (0.8 * orifice).max(8.0), 1.2 * orifice + 4.0], seed);
    let all = cup.grains.centres().len() as f64;
    let fall = fall_time(&cup.law);
    let patience = (PATIENCE * fall) as u32;
    let (mut substeps, mut begun) = (0, None);
    loop {
        cup.run()?;
        substeps += LOOK;
        let gone = all - cup.grains.centres().len() as f64;
        let (since, before) = match begun {
            None if gone >= TIMED[0] * all => *begun.insert((substeps, gone)),
            None => (0, 0.0),
            Some(begun) => begun,
        };
        if gone >= TIMED[1] * all || substeps >= since + patience {
            return Ok((gone - before) / f64::from(substeps - since) * fall);
        }
    }
}

/// Slope of the powder that remains in a drained cup, degrees; 90 for a powder that bridges the
/// hole or leaves a shaft.
///
/// # Errors
/// [`Refusal`] if the solver diverged.
pub(super) fn drained_deg(set: &ParameterSet, seed: u64) -> Result<f64, Refusal> {
    let [hole, radius, _] = DRAIN;
    let mut cup = Cup::open(set, DRAIN, seed);
    // Drained: at most a thousandth of the grains leaves in the time of ten falls.
    let all = cup.grains.centres().len();
    let window = (10.0 * fall_time(&cup.law)) as u32;
    loop {
        let before = cup.grains.centres().len();
        for _ in 0..window / LOOK {
            cup.run()?;
        }
        if before - cup.grains.centres().len() <= all / 1000 {
            break;
        }
    }
    let crater: Vec<[f64; 2]> = surface(cup.grains.centres(), radius)
        .map(|(at, height)| [libm::hypot(at[0], at[1]), height])
        .filter(|[r, _]| (hole + 0.5..radius - 1.5).contains(r))
        .collect();
    let gone = (all - cup.grains.centres().len()) as f64 / all as f64;
    // A shaft as wide as the hole holds a ninth of the cup: a crater requires more than twice that
    // to leave.
    if gone < 0.25 || crater.len() < 3 {
        return Ok(90.0);
    }
    Ok(libm::atan(line(&crater)[0]).to_degrees())
}
