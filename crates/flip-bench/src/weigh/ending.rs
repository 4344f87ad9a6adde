//! The end of a dose: level, retract, take the final reading, return the rest.

use super::guard::{Halt, Limits};
use super::{End, Event, Halted, Loop, Phase, result};
use crate::hardware::{Bench, DeviceError};
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::Ordering;

/// Times a motion of the way back is tried if stops end it.
const TRIES: u32 = 3;

impl<B: Bench, F: FnMut(&Event<'_>) -> ControlFlow<()>> Loop<'_, B, F> {
    /// Level the spoon and take it away, whatever happened and even if events cannot be reported.
    pub(super) fn withdraw(&mut self, dosed: End) -> End {
        let told =
            self.careful(|it| it.tell(&Event::Phase(Phase::Settling)).map(|()| End::Course(None)));
        let ended = if matches!(dosed, End::Aborted(_)) { dosed } else { worse(dosed, told) };
        for (what, motion) in [
            ("levelled", B::level as fn(&mut B) -> Result<(), DeviceError>),
            ("taken away", B::retract),
        ] {
            let cause = match catch_unwind(AssertUnwindSafe(|| self.despite_stops(motion))) {
                Ok(Ok(())) => continue,
                Ok(Err(fault)) => fault.to_string(),
                Err(_) => "the driver failed; the log has the details".to_owned(),
            };
            self.must_look = true;
            return End::Aborted(match ended {
                End::Aborted(first) => {
                    format!(
                        "the spoon could not be {what}, look at the bench: {cause}; before that: {first}"
                    )
                }
                _ => format!("the spoon could not be {what}, look at the bench: {cause}"),
            });
        }
        ended
    }

    /// A motion of the way back. A stop reaches the arm over a connection of its own, and may end
    /// the very motion that brings the spoon back from it, as may one that is pressed twice.
    fn despite_stops(
        &mut self,
        motion: fn(&mut B) -> Result<(), DeviceError>,
    ) -> Result<(), DeviceError> {
        for _ in 1..TRIES {
            match motion(self.bench) {
                Err(DeviceError::Faulted { .. }) if self.stop.load(Ordering::SeqCst) => {}
                done => return done,
            }
        }
        motion(self.bench)
    }

    /// Mass in the vial once all is still.
    pub(super) fn read_finally(&mut self, ended: End) -> End {
        if self.settings.stand_s <= 0.0 || self.ticks.is_empty() {
            return ended;
        }
        let last_mg =
            result::last_reading_mg(&self.ticks).map_or(0.0, |last_mg| self.net_mg(last_mg));
        let ran_its_course = matches!(ended, End::Course(_) | End::Blocked(_));
        let looked = self.careful(|it| {
            let mut after = it.bench.stand(it.settings.stand_s)?;
            (it.after, it.watched.last) = (Some(after), Some(after.rest));
            // A reported mass must be one that the balance responds to.
            if ran_its_course && it.unproven().is_some_and(|shakes| shakes > 0) {
                if !it.shows_life()? {
                    it.must_look = true;
                    return Ok(End::of(Halt::Unproven));
                }
                after.reading = it.bench.read()?;
                it.after = Some(after);
            }
            if ran_its_course && after.still && it.looks_closer() {
                it.watched.last = Some(it.rest(Self::is_near_a_limit)?);
                it.bench.is_the_same()?;
            }
            let rest = it.watched.last.unwrap_or(after.rest);
            let fell_mg = last_mg - it.net_mg(rest.mean_mg.min(after.reading.mass_mg));
            Ok(match rest.mean_mg {
                mass_mg if !(mass_mg.is_finite() && after.reading.mass_mg.is_finite()) => {
                    End::of(Halt::NotANumber)
                }
                _ if !after.still || (rest.last_mg - rest.mean_mg).abs() > Limits::FALL_MG_MAX => {
                    End::of(Halt::NotStable)
                }
                _ if fell_mg > Limits::FALL_MG_MAX => End::of(Halt::VialMoved { fell_mg }),
                _ => End::Course(None),
            })
        });
        worse(ended, looked)
    }

    /// The rest goes back to the container if the dose ran its course; after anything else a person
    /// decides.
    pub(super) fn discard(&mut self, ended: End) -> End {
        if !matches!(ended, End::Course(_) | End::Blocked(_)) || self.go_on().is_err() {
            return ended;
        }
        let discarded =
            self.careful(|it| it.bench.discard().map(|()| End::Course(None)).map_err(Halted::from));
        match (ended, discarded) {
            // The mass is known nevertheless.
            (End::Course(_), End::Aborted(fault)) => {
                self.must_look = true;
                End::Course(Some(format!(
                    "what is left in the spoon could not be returned, look at the bench: {fault}"
                )))
            }
            (ended, _) => ended,
        }
    }

    /// The reading that counts as the mass, mg; `None` if there was no reading at rest.
    pub(super) fn reading_mg(&self, ended: &End) -> Option<f64> {
        match ended {
            End::Aborted(_) => None,
            _ if self.settings.stand_s <= 0.0 => result::last_reading_mg(&self.ticks),
            _ => self.watched.last.map(|rest| self.net_mg(rest.mean_mg)),
        }
    }
}

/// The first end, unless it ran its course and the second did not.
fn worse(first: End, second: End) -> End {
    match (&first, &second) {
        (End::Course(_) | End::Blocked(_), End::NotStable(_) | End::Aborted(_)) => second,
        _ => first,
    }
}
