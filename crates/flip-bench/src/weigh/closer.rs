//! Closer readings: the display wanders, so its mean while nothing moves is used, over as long as
//! the wander requires.
//!
//! The display is averaged this way three times per dose: after the tare, where the mean is the
//! zero of all readings; before the dose ends, because stopping at the first number that is high
//! enough stops short; and at the end.

use super::guard::{Halt, Limits};
use super::{ASK_EVERY_S, Event, Halted, Loop, uncertainty};
use crate::hardware::Bench;
use flip_core::domain::bench::{Moment, Reading};
use flip_core::domain::rest::Rest;
use flip_policy::Rules;
use std::ops::ControlFlow;

/// The mean of a watch is certain enough at this fraction of the display step,
const SURE_STEPS: f64 = 0.25;
/// or of the band between the tolerances.
const SURE_BAND: f64 = 0.05;
/// A tare below this is not a vial, mg: such a mass could have fallen from a spoon.
const TARE_MG_MIN: f64 = 500.0;
/// Number of parts of a display step to which means are rounded.
const PARTS: f64 = 100.0;

impl<B: Bench, F: FnMut(&Event<'_>) -> ControlFlow<()>> Loop<'_, B, F> {
    /// Watch the display with nothing moving until its mean is certain enough or the time for it is
    /// up, and for as long again if what it decides is open; returns early on a stop.
    pub(super) fn rest(&mut self, is_open: impl Fn(&Self, f64) -> bool) -> Result<Rest, Halted> {
        let mut seen = Vec::new();
        let rest = self.watch(&mut seen)?;
        if self.is_certain(&rest) || !is_open(self, self.net_mg(rest.mean_mg)) {
            return Ok(rest);
        }
        self.watch(&mut seen)
    }

    /// Go on watching after these readings.
    fn watch(&mut self, seen: &mut Vec<Moment>) -> Result<Rest, Halted> {
        let mut found = None;
        let until_s = self.bench.elapsed_s() + self.settings.rest_max_s.max(self.settings.rest_s);
        loop {
            self.go_on()?;
            seen.extend(self.bench.readings(ASK_EVERY_S)?);
            found = Rest::of(seen).or(found);
            let is_spent = self.bench.elapsed_s() >= until_s;
            match found {
                Some(rest) if is_spent || self.is_certain(&rest) => return Ok(rest),
                None if is_spent => return Err(Halted::Guard(Halt::NotANumber)),
                _ => {}
            }
        }
    }

    /// Whether this watch was long enough for its mean to be certain.
    fn is_certain(&self, rest: &Rest) -> bool {
        let order = self.order;
        let band_mg = order.tolerance_lower_mg + order.tolerance_upper_mg;
        let sure_mg = (SURE_STEPS * order.readability_mg).max(SURE_BAND * band_mg);
        rest.seconds >= self.settings.rest_s
            && uncertainty::of_mean_mg(rest, &self.watched).is_some_and(|u_mg| u_mg <= sure_mg)
    }

    /// Find the mean of the tared display, the zero of all readings.
    pub(super) fn find_zero(&mut self) -> Result<(), Halted> {
        if !self.looks_closer() {
            return Ok(());
        }
        let rest = self.rest(|_, _| false)?;
        let shown = self.bench.read()?;
        let furthest_mg =
            if shown.mass_mg.abs() > rest.mean_mg.abs() { shown.mass_mg } else { rest.mean_mg };
        let halt = match furthest_mg {
            _ if !shown.stable => Halt::NotStable,
            mg if !(mg.is_finite() && shown.mass_mg.is_finite()) => Halt::NotANumber,
            mg if -mg > Limits::FALL_MG_MAX => Halt::VialMoved { fell_mg: -mg },
            mg if mg > Limits::FALL_MG_MAX => Halt::Rose { rose_mg: mg },
            _ => {
                self.watched.zero = Some(rest);
                return Ok(());
            }
        };
        Err(Halted::Guard(halt))
    }

    /// Whether means are taken at all.
    pub(super) fn looks_closer(&self) -> bool {
        self.settings.rest_s > 0.0
    }

    /// Refine a reading by the mean of a longer watch; returns the display itself if it has moved
    /// meanwhile. The reading that led here is one of the higher ones, so a mean that would end the
    /// dose needs the most care.
    pub(super) fn look_closer(&mut self, rules: &Rules, steps: u32) -> Result<Reading, Halted> {
        let rest =
            self.rest(|it, mass_mg| it.would_end(rules, steps, Reading { mass_mg, stable: true }))?;
        let shown = self.bench.read()?;
        let now = self.net(shown);
        let mean_mg = self.net_mg(rest.mean_mg);
        let has_moved = (now.mass_mg - mean_mg).abs() > Limits::FALL_MG_MAX;
        Ok(Reading { mass_mg: if has_moved { now.mass_mg } else { mean_mg }, ..now })
    }

    /// Whether a final reading of this is too near to a tolerance to say on which side it is.
    pub(super) fn is_near_a_limit(&self, reading_mg: f64) -> bool {
        let order = self.order;
        [-order.tolerance_lower_mg, order.tolerance_upper_mg]
            .into_iter()
            .any(|limit_mg| (reading_mg - order.target_mg - limit_mg).abs() < order.readability_mg)
    }

    /// A reading relative to the zero that was found.
    pub(super) fn net(&self, shown: Reading) -> Reading {
        Reading { mass_mg: self.net_mg(shown.mass_mg), ..shown }
    }

    /// Displayed value minus the zero that was found, mg, in hundredths of the display step.
    pub(super) fn net_mg(&self, shown_mg: f64) -> f64 {
        let Some(zero) = self.watched.zero else { return shown_mg };
        let part_mg = self.order.readability_mg / PARTS;
        let parts = ((shown_mg - zero.mean_mg) / part_mg).round();
        // Rounding in decimal keeps 9.7 from being reported as 9.700000000000001.
        (parts * part_mg * 1e9).round() / 1e9
    }

    /// A reading rounded to whole steps of the display, which is all that the frame of a policy
    /// knows.
    pub(super) fn whole_mg(&self, reading_mg: f64) -> f64 {
        let step_mg = self.order.readability_mg;
        if self.watched.zero.is_some() {
            (reading_mg / step_mg).round() * step_mg
        } else {
            reading_mg
        }
    }

    /// Check that the display does not show the vial again, as after a restart or a lost tare.
    pub(super) fn is_tared(&mut self, before: Reading, now: Reading) -> Result<(), Halted> {
        let tare_mg = self.tare.and_then(|tare| tare.tare_mg).unwrap_or(0.0);
        let rose_mg = now.mass_mg - before.mass_mg;
        // Readings that are not numbers are left to the guard.
        let is_lost = tare_mg >= TARE_MG_MIN && rose_mg >= tare_mg / 2.0;
        if !is_lost {
            return Ok(());
        }
        self.must_look = true;
        Err(Halted::Guard(Halt::TareLost { rose_mg }))
    }
}

/// The display went back to zero, by more than its wander: a key was pressed, or the balance
/// restarted.
pub(super) fn is_zeroed(before: Reading, now: Reading, step_mg: f64) -> bool {
    let nothing_mg = step_mg.max(1.0) / 2.0;
    now.mass_mg.abs() <= nothing_mg + 1e-9
        && before.mass_mg - now.mass_mg >= 3.0 * nothing_mg - 1e-9
}
