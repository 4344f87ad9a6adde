//! The closed loop: read, observe, propose, guard, act, record. It cannot tell a digital bench from a real one.
//!
//! ```text
//!            tare ok                     on target, target reached, steps spent
//!  [OPEN] ------------> [DOSING] ------------------------------------------------> [level] --> within, under, over
//!    |                     |  ^
//!    | device failed       |  +-- read, propose, guard, act: one step
//!    v                     v
//!  [level] <------------ halted by the guard, stop pressed, device failed          --> stopped, aborted
//! ```
//!
//! Every way out levels the spoon first, a panic of the controller included.

pub mod guard;

use crate::domain::bench::{Action, Reading, Tick};
use crate::domain::weighing::Outcome;
use crate::hardware::{Bench, DeviceError};
use crate::policy::{Controller, Episode, Observation, Rules};
use guard::{Halt, Limits, Situation, guard};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};

/// What to weigh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Order {
    /// Target, mg.
    pub target_mg: f64,
    /// Accepted shortfall, mg.
    pub tolerance_lower_mg: f64,
    /// Accepted excess, mg.
    pub tolerance_upper_mg: f64,
    /// Step of the balance's display, mg.
    pub readability_mg: f64,
}

/// How a weighing went.
#[derive(Debug, Clone, PartialEq)]
pub struct Weighed {
    /// Within, under or over by the last reading; or why it ended early.
    pub outcome: Outcome,
    /// Last reading that was a number, mg.
    pub reading_mg: f64,
    /// Steps with a shake.
    pub shakes: u32,
    /// Bench time from the tare to the last reading, s.
    pub seconds: f64,
    /// The reading after the tare, then one tick for each step.
    pub ticks: Vec<Tick>,
    /// Why it was aborted, if it was.
    pub cause: Option<String>,
}

/// Why dosing ended.
enum End {
    Course,
    Stopped,
    Aborted(String),
}

/// Weigh `order` on `bench` with `controller`, within the frame it was made for.
///
/// `on_tick` hears of every step as soon as its reading is known; `stop` is looked at before every motion. The spoon is
/// level when this returns, unless the arm itself failed, which the cause then says.
pub fn weigh(
    bench: &mut impl Bench,
    controller: &Controller,
    rules: &Rules,
    order: &Order,
    mut on_tick: impl FnMut(&Tick),
    stop: &AtomicBool,
) -> Weighed {
    let start_s = bench.elapsed_s();
    let mut ticks = Vec::new();
    let mut record = |tick: Tick| {
        on_tick(&tick);
        ticks.push(tick);
    };
    // A controller that panics must not leave the spoon tilted.
    let dosed = catch_unwind(AssertUnwindSafe(|| dose(bench, controller, rules, order, start_s, &mut record, stop)));
    let mut end = match dosed {
        Ok(Ok(end)) => end,
        Ok(Err(fault)) => End::Aborted(fault.to_string()),
        Err(_) => End::Aborted("the weighing loop failed; the log has the details".to_owned()),
    };
    if let Err(fault) = bench.level() {
        end = End::Aborted(format!("the spoon could not be levelled, look at the bench: {fault}"));
    }
    let mut readings = ticks.iter().map(|tick| tick.reading.mass_mg);
    let reading_mg = readings.rfind(|mass| mass.is_finite()).unwrap_or(0.0);
    let (outcome, cause) = match end {
        End::Course => (judge(order, reading_mg), None),
        End::Stopped => (Outcome::Stopped, None),
        End::Aborted(cause) => (Outcome::Aborted, Some(cause)),
    };
    let shakes = ticks.iter().filter(|tick| tick.action.executed_shake_mm() > 0.0).count() as u32;
    Weighed { outcome, reading_mg, shakes, seconds: bench.elapsed_s() - start_s, ticks, cause }
}

/// The steps from the tare until something ends them.
fn dose(
    bench: &mut impl Bench,
    controller: &Controller,
    rules: &Rules,
    order: &Order,
    start_s: f64,
    record: &mut impl FnMut(Tick),
    stop: &AtomicBool,
) -> Result<End, DeviceError> {
    bench.tare()?;
    let mut now = bench.read()?;
    record(tick(bench, 0, start_s, Action::default(), now));
    let mut before = now;
    let limits = Limits::new(rules.pitch, rules.steps_max);
    let mut dosing = controller.begin(rules, order.readability_mg);
    for steps in 0.. {
        if stop.load(Ordering::SeqCst) {
            return Ok(End::Stopped);
        }
        let seen = Observation { reading_mg: now.mass_mg, target_mg: order.target_mg, pitch_deg: bench.pitch_deg() };
        let situation = Situation { target_mg: order.target_mg, steps, pitch_deg: seen.pitch_deg, before, now };
        let allowed = guard(&limits, &situation, dosing.propose(&seen));
        let action = match allowed {
            Ok(_) if now.stable && rules.after(steps, &seen, order.readability_mg) == Episode::Terminated => {
                return Ok(End::Course);
            }
            Ok(action) => action,
            Err(halt) if halt.is_expected() => return Ok(End::Course),
            Err(halt) => return Ok(End::Aborted(halt.to_string())),
        };
        bench.act(action)?;
        before = now;
        now = bench.read()?;
        record(tick(bench, steps + 1, start_s, action, now));
    }
    Ok(End::Aborted(Halt::StepsSpent.to_string()))
}

fn tick(bench: &impl Bench, step: u32, start_s: f64, action: Action, reading: Reading) -> Tick {
    Tick { step, t_s: bench.elapsed_s() - start_s, pitch_deg: bench.pitch_deg(), action, reading }
}

/// By the reading, as a chemist would: the true mass is not to be had on a bench.
fn judge(order: &Order, reading_mg: f64) -> Outcome {
    // Readings are multiples of the readability: a billionth keeps 15.1 - 15 from passing 0.1.
    match reading_mg - order.target_mg {
        excess if excess > order.tolerance_upper_mg + 1e-9 => Outcome::Over,
        excess if -excess > order.tolerance_lower_mg + 1e-9 => Outcome::Under,
        _ => Outcome::Within,
    }
}

#[cfg(test)]
mod tests;
