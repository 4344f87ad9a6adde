//! The closed loop: read, observe, propose, guard, act, record. It cannot tell a simulated bench
//! from a real one.
//!
//! ```text
//!  [ARMED]  stand, approach, tare, rest    drift before, spoon filled and level over the vial, zero: the mean of the tared display
//!     |
//!  [DOSING] --> read, propose, lift, guard, record, act: one step --+
//!     |   ^---------------------------------------------------------+     what would end it is looked at closer first
//!     |   ^--- loosen, new spoonful <--- nothing falls (`ladder.rs`)
//!     |  on target, target reached, no room, steps or time spent, blocked, halted, stopped, device failed, panic
//!     v
//!  [SETTLING]  level, retract, stand, rest final reading, drift after      --> within, under, over, not_stable, blocked,
//!     |                                                                         stopped, aborted
//!     +--> discard                         where the dose ran its course
//! ```
//!
//! A probing run takes the place of the steps of a dose (`probe.rs`): it has no target, and ends as
//! `probed`. Every exit levels the spoon and takes it away, including a panic of the controller or of the
//! event listener. A spoon that cannot be levelled is not taken away: it would pour on its way. The
//! listener gets each phase and each decision before the motion that follows, and may forbid it:
//! nothing moves unless it can be recorded.

mod closer;
mod dosing;
pub mod earlier;
mod ending;
mod event;
pub mod forecast;
pub mod guard;
mod ladder;
mod probe;
mod result;
mod settings;
pub mod silence;
mod uncertainty;

pub use event::{Decision, Event, Phase};
pub use result::{Accuracy, Weighed, minimum_weight_mg, repeatability_mg};
pub use settings::{Settings, hangs};

use crate::hardware::{Bench, DeviceError};
use flip_core::domain::bench::{Reach, Reading, Standing, Tare, Tick};
use flip_core::domain::weighing::Outcome;
use flip_policy::{Controller, Episode, Observation, Rules};
use guard::Halt;
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use uncertainty::Watched;

/// A weighing order.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Order {
    /// Target, mg.
    pub target_mg: f64,
    /// Accepted shortfall, mg; 0 for a dose that must not be short.
    pub tolerance_lower_mg: f64,
    /// Accepted excess, mg.
    pub tolerance_upper_mg: f64,
    /// Step of the balance's display, mg.
    pub readability_mg: f64,
}

/// Time from a shake until a load cell has responded to all but a fortieth of the fallen mass, s:
/// 0.05 s of falling and 3.5 time constants of 0.16 s.
const FELT_S: f64 = 0.6;
/// How often the stop flag is polled while waiting, s.
const ASK_EVERY_S: f64 = 1.0;
/// Maximum change of a vial's mass between watching the balance and taring it, mg.
const VIAL_MG_MAX: f64 = 30.0;

/// Why dosing ended.
enum End {
    Course(Option<String>),
    NotStable(String),
    Blocked(String),
    Stopped,
    Aborted(String),
}

impl End {
    fn of(halt: Halt) -> Self {
        let cause = halt.to_string();
        match halt {
            Halt::NoRoom { .. } | Halt::TimeSpent => Self::Course(Some(cause)),
            halt if halt.is_expected() => Self::Course(None),
            Halt::NotStable => Self::NotStable(cause),
            Halt::Blocked { .. } | Halt::Deaf { .. } => Self::Blocked(cause),
            _ => Self::Aborted(cause),
        }
    }
}

/// Why the next operation is not carried out.
enum Halted {
    Stopped,
    Unrecorded,
    Device(DeviceError),
    Guard(Halt),
}

impl From<DeviceError> for Halted {
    fn from(fault: DeviceError) -> Self {
        Self::Device(fault)
    }
}

/// A weighing in progress.
struct Loop<'a, B, F> {
    bench: &'a mut B,
    order: &'a Order,
    settings: &'a Settings,
    on_event: F,
    stop: &'a AtomicBool,
    start_s: f64,
    tare: Option<Tare>,
    after: Option<Standing>,
    watched: Watched,
    ticks: Vec<Tick>,
    /// When each shake was made, bench time, s.
    shaken_s: Vec<f64>,
    must_look: bool,
}

/// Weigh `order` on `bench` with `controller`, within the frame it was made for and the range of
/// the arm; if these do not overlap, nothing moves.
///
/// `on_event` is called with every phase, decision and tick before the motion that follows it; if
/// it fails, the spoon is levelled and taken away and nothing else moves. `stop` is checked before
/// every motion. The spoon is level and away when this returns, unless [`Weighed::must_look`] is
/// set. How to handle an overdose is up to the caller.
pub fn weigh(
    bench: &mut impl Bench,
    controller: &Controller,
    rules: &Rules,
    order: &Order,
    settings: &Settings,
    on_event: impl FnMut(&Event<'_>) -> ControlFlow<()>,
    stop: &AtomicBool,
) -> Weighed {
    let start_s = bench.elapsed_s();
    let reach = bench.reach();
    let mut weighing = Loop {
        bench,
        order,
        settings,
        on_event,
        stop,
        start_s,
        tare: None,
        after: None,
        watched: Watched::default(),
        ticks: Vec::new(),
        shaken_s: Vec::new(),
        must_look: false,
    };
    let ended = match reach.of(rules.pitch) {
        Some(reach) => {
            let dosed = weighing.careful(|it| {
                it.begin()?;
                match settings.probe {
                    Some(probe) => it.probe(probe, rules, &reach),
                    None => it.dose(controller, rules, &reach),
                }
            });
            weighing.withdraw(dosed)
        }
        // Nothing has moved, and nothing needs to.
        None => End::of(out_of_reach(&reach, rules)),
    };
    let ended = weighing.read_finally(ended);
    let seconds = weighing.bench.elapsed_s() - weighing.start_s;
    let ended = weighing.discard(ended);
    let reading_mg = weighing.reading_mg(&ended);
    let shakes = weighing.shaken_s.len();
    let by_reading = |mg| match settings.probe {
        Some(_) => Outcome::Probed,
        None => result::judge(order, mg, shakes),
    };
    let judge = |cause| (reading_mg.map_or(Outcome::Aborted, by_reading), cause);
    let (outcome, cause) = match ended {
        End::Course(cause) => judge(cause),
        // A dose within its tolerance is as ordered, whatever state the spoon is in.
        End::Blocked(cause) => match judge(Some(cause)) {
            (Outcome::Under, cause) => (Outcome::Blocked, cause),
            judged => judged,
        },
        End::NotStable(cause) => (Outcome::NotStable, Some(cause)),
        End::Stopped => (Outcome::Stopped, None),
        End::Aborted(cause) => (Outcome::Aborted, Some(cause)),
    };
    let last_mg = result::last_reading_mg(&weighing.ticks).map(|last_mg| weighing.net_mg(last_mg));
    let Loop { tare, after, watched, ticks, must_look, .. } = weighing;
    let tare_mg = tare.and_then(|tare| tare.tare_mg);
    result::weighed(
        order,
        &settings.accuracy,
        result::Known {
            outcome,
            cause,
            tare_mg,
            reading_mg,
            last_mg,
            after,
            watched,
            seconds,
            must_look,
            ticks,
        },
    )
}

impl<B: Bench, F: FnMut(&Event<'_>) -> ControlFlow<()>> Loop<'_, B, F> {
    /// The result of `work`, whatever happens in it: a controller that panics must not leave the
    /// spoon tilted.
    fn careful(&mut self, work: impl FnOnce(&mut Self) -> Result<End, Halted>) -> End {
        match catch_unwind(AssertUnwindSafe(|| work(self))) {
            Ok(Ok(end)) => end,
            Ok(Err(Halted::Stopped)) => End::Stopped,
            Ok(Err(Halted::Guard(halt))) => End::of(halt),
            Ok(Err(Halted::Unrecorded)) => {
                End::Aborted("the record could not be written, so nothing may move".to_owned())
            }
            // A stop ends the current motion, which the arm reports as an error: nothing is wrong
            // with it.
            Ok(Err(Halted::Device(_))) if self.stop.load(Ordering::SeqCst) => End::Stopped,
            Ok(Err(Halted::Device(fault))) => {
                self.must_look = true;
                End::Aborted(fault.to_string())
            }
            Err(_) => End::Aborted("the weighing loop failed; the log has the details".to_owned()),
        }
    }

    /// Send an event; nothing may move if that fails. Once a stop is requested, the listener no
    /// longer waits for its record.
    fn tell(&mut self, event: &Event<'_>) -> Result<(), Halted> {
        match (self.on_event)(event) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(self.go_on().err().unwrap_or(Halted::Unrecorded)),
        }
    }

    /// Check that no stop is requested.
    fn go_on(&self) -> Result<(), Halted> {
        if self.stop.load(Ordering::SeqCst) { Err(Halted::Stopped) } else { Ok(()) }
    }

    /// From the bench at rest to a filled spoon over a tared vial.
    fn begin(&mut self) -> Result<(), Halted> {
        self.tell(&Event::Phase(Phase::Armed))?;
        self.go_on()?;
        let mut before = None;
        if self.settings.stand_s > 0.0 {
            let standing = self.bench.stand(self.settings.stand_s)?;
            before = Some(standing.rest);
            self.go_on()?;
            if let Some(flaw) = self.settings.pan.flaw(standing.reading.mass_mg) {
                self.tell(&Event::Pan(&flaw))?;
                return Err(Halted::Guard(Halt::Vial(flaw)));
            }
        }
        self.bench.approach()?;
        self.go_on()?;
        let tare = self.bench.tare()?;
        self.tare = Some(tare);
        // Nothing has moved near the balance since it was watched: another load now is another
        // vial, or none.
        let watched_mg = before.map(|rest| rest.last_mg);
        self.watched.before = before.map(|rest| (rest, tare.tare_mg));
        match watched_mg.zip(tare.tare_mg).map(|(watched_mg, tare_mg)| watched_mg - tare_mg) {
            Some(fell_mg) if fell_mg.abs() > VIAL_MG_MAX => {
                Err(Halted::Guard(Halt::VialMoved { fell_mg }))
            }
            _ => self.find_zero(),
        }
    }

    /// The observation for this reading.
    fn seen(&self, now: Reading) -> Observation {
        let (target_mg, pitch_deg) = (self.order.target_mg, self.bench.pitch_deg());
        Observation { reading_mg: now.mass_mg, target_mg, pitch_deg }
    }

    /// Whether this reading would end the dose on target. The frame of a policy knows only whole
    /// steps of a display.
    fn would_end(&self, rules: &Rules, steps: u32, now: Reading) -> bool {
        let whole = Observation { reading_mg: self.whole_mg(now.mass_mg), ..self.seen(now) };
        rules.after(steps, &whole, self.order.readability_mg) == Episode::Terminated
    }

    /// Shakes since the display last changed; `None` if changes are not waited for.
    fn unproven(&self) -> Option<usize> {
        let lived_s = self.bench.lived_s();
        let since = self.shaken_s.iter().rev().take_while(|shaken_s| **shaken_s >= lived_s).count();
        (self.settings.life_s > 0.0).then_some(since)
    }

    /// Whether the display has changed since the load cell responded to the full yield of the last
    /// shake.
    fn is_felt(&self) -> bool {
        let lived_s = self.bench.lived_s();
        self.settings.life_s <= 0.0
            || self.shaken_s.last().is_none_or(|shaken_s| shaken_s + FELT_S <= lived_s)
    }

    /// Wait with nothing moving until the display changes; returns whether it did.
    fn shows_life(&mut self) -> Result<bool, Halted> {
        let until_s = self.bench.elapsed_s() + self.settings.life_s;
        loop {
            self.go_on()?;
            let left_s = until_s - self.bench.elapsed_s();
            if left_s <= 0.0 {
                return Ok(false);
            }
            if self.bench.watch_for_life(left_s.min(ASK_EVERY_S))? {
                return Ok(true);
            }
        }
    }
}

fn out_of_reach(arm: &Reach, rules: &Rules) -> Halt {
    Halt::OutOfReach {
        arm_lower_deg: arm.pitch.lower_deg,
        arm_upper_deg: arm.pitch.upper_deg,
        shake_mm_max: arm.shake_mm_max,
        lower_deg: rules.pitch.lower_deg,
        upper_deg: rules.pitch.upper_deg,
    }
}

#[cfg(test)]
mod tests;
