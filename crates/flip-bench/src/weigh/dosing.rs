//! The steps of a dose: observe, propose, guard, record, act, read; one spoonful after the other.

use super::forecast::Fall;
use super::guard::{Allowed, Halt, Limits, Situation, guard};
use super::{Decision, End, Event, Halted, Loop, Phase, closer, ladder};
use crate::hardware::Bench;
use flip_core::domain::bench::{Action, Reach, Reading, Tick};
use flip_policy::{Controller, Dosing, Observation, Rules};
use std::ops::ControlFlow;

/// Standard deviations of the difference of two readings at rest below which it is noise.
const NOISE_SDS: f64 = 3.0;

/// A dose between two steps.
#[derive(Debug, Clone)]
pub(super) struct Course {
    /// Bench time of the tare, s.
    tared_s: f64,
    /// When the last motion ended, s.
    moved_s: f64,
    /// Reading before the last step.
    before: Reading,
    /// Reading now.
    pub(super) now: Reading,
    /// Whether the last step was a shake.
    shaken: bool,
    /// Steps recorded so far.
    pub(super) ticks: u32,
    /// Which filling of the spoon, from 1.
    pub(super) spoonful: u32,
    /// Steps of this spoonful.
    pub(super) steps: u32,
    /// Reading when it began, mg.
    pub(super) from_mg: f64,
    /// Its shakes.
    pub(super) falls: Vec<Fall>,
    /// Whether it was levelled and shaken to loosen the powder.
    pub(super) loosened: bool,
    /// Its shakes when it was last lowered to where there is room.
    pub(super) lowered_after: Option<usize>,
    /// How often its steps began anew.
    pub(super) rounds: u32,
}

impl<B: Bench, F: FnMut(&Event<'_>) -> ControlFlow<()>> Loop<'_, B, F> {
    /// The steps from the tare until something ends them.
    pub(super) fn dose(
        &mut self,
        controller: &Controller,
        rules: &Rules,
        reach: &Reach,
    ) -> Result<End, Halted> {
        // The narrower of the policy's frame and the arm's range.
        let rules = &Rules { pitch: reach.pitch, ..*rules };
        let mut limits = self.limits(rules, reach);
        self.tell(&Event::Phase(Phase::Dosing))?;
        let mut course = self.set_out()?;
        loop {
            let Some(halt) = self.spoonful(controller, rules, &limits, &mut course)? else {
                return Ok(End::Course(None));
            };
            if self.goes_on(&halt, &limits, &course) {
                self.begin_again(&mut course)?;
                continue;
            }
            if !self.takes_another(&halt, &course) {
                self.must_look |= halt == Halt::Unproven;
                return Ok(self.ended(halt, &course));
            }
            let said = std::slice::from_ref(&course.falls);
            limits.forecast =
                limits.forecast.map(|prior| prior.informed(said, limits.readability_mg));
            self.refill_after(&halt, &mut course)?;
        }
    }

    pub(super) fn limits(&self, rules: &Rules, reach: &Reach) -> Limits {
        let usual = Limits::new(rules.pitch, rules.steps_max);
        let usual = if self.settings.strict { usual } else { usual.lenient() };
        let readability_mg = self.order.readability_mg;
        let noise_mg = self.watched.zero.map_or(0.0, |rest| rest.sd_mg());
        Limits {
            seconds_max: self.settings.seconds_max,
            readability_mg,
            piece_mg: readability_mg.max(NOISE_SDS * std::f64::consts::SQRT_2 * noise_mg),
            forecast: self.settings.forecast,
            hangs: self.settings.hangs,
            silent_share: self.settings.silent_share,
            shake_mm_max: reach.shake_mm_max,
            ..usual
        }
    }

    /// The reading after the tare.
    pub(super) fn set_out(&mut self) -> Result<Course, Halted> {
        let tared_s = self.bench.elapsed_s();
        let first = self.bench.read()?;
        let now = self.net(first);
        // The tare stands in for the reading before the first: a vial lifted since then shows at
        // once.
        let before = Reading { mass_mg: 0.0, stable: true };
        let course = Course {
            tared_s,
            moved_s: tared_s,
            before,
            now,
            shaken: false,
            ticks: 0,
            spoonful: 1,
            steps: 0,
            from_mg: 0.0,
            falls: Vec::new(),
            loosened: false,
            lowered_after: None,
            rounds: 0,
        };
        self.record(&course, Action::default(), first)?;
        self.is_tared(before, now)?;
        Ok(course)
    }

    /// The steps of one spoonful; returns why no other may follow, or `None` on target.
    fn spoonful(
        &mut self,
        controller: &Controller,
        rules: &Rules,
        limits: &Limits,
        course: &mut Course,
    ) -> Result<Option<Halt>, Halted> {
        let begin = || controller.begin(rules, limits.readability_mg);
        let mut dosing = match course.falls.is_empty() {
            true => begin().expecting(self.settings.onset_deg),
            false => begin(),
        };
        loop {
            self.go_on()?;
            let is_sure = self.look_if_it_ends(rules, course)?;
            let (proposed, is_lifted) = self.proposal(&mut dosing, limits, course);
            let steps = course.steps;
            let mut allowed = self.guard(limits, course, proposed);
            if !is_sure && matches!(allowed, Err(Halt::NoRoom { .. } | Halt::TargetReached)) {
                course.now = self.look_closer(rules, course.steps)?;
                allowed = self.guard(limits, course, proposed);
            }
            let is_done = self.would_end(rules, course.steps, course.now);
            if is_done && allowed.as_ref().map_or_else(Halt::is_of_the_spoon, |_| true) {
                return Ok(None);
            }
            allowed = self.proven(limits, course, proposed, allowed)?;
            if self.settings.strict && allowed.is_ok() && self.is_empty(limits, course) {
                let pitch_deg = limits.pitch.upper_deg;
                allowed = Err(Halt::Blocked { strokes: 1, pitch_deg });
            }
            if self.settings.strict && self.may_be_lowered(&allowed, limits, course) {
                if let Some(halt) = self.lower(limits, course)? {
                    return Ok(Some(halt));
                }
                // It would be led back to where the powder is expected to flow.
                dosing = begin();
                continue;
            }
            if self.may_be_loosened(&allowed, limits, course) {
                match self.loosen(limits, course)? {
                    None => continue,
                    halt => return Ok(halt),
                }
            }
            if let Some(halt) = self.carry_out(course, proposed, allowed)? {
                return Ok(Some(halt));
            }
            if is_lifted {
                // What the ladder adds is not the policy's step.
                course.steps = steps;
            }
        }
    }

    /// Looks closer at a reading that would end the dose, or that went back to zero; returns
    /// whether the reading needs no closer look.
    pub(super) fn look_if_it_ends(
        &mut self,
        rules: &Rules,
        course: &mut Course,
    ) -> Result<bool, Halted> {
        let readability_mg = self.order.readability_mg;
        let is_sure = !self.looks_closer() || !course.now.stable;
        let is_zeroed = closer::is_zeroed(course.before, course.now, readability_mg);
        if is_sure || !(is_zeroed || self.would_end(rules, course.steps, course.now)) {
            return Ok(is_sure);
        }
        course.now = self.look_closer(rules, course.steps)?;
        if is_zeroed && closer::is_zeroed(course.before, course.now, readability_mg) {
            self.must_look = true;
            let fell_mg = course.before.mass_mg - course.now.mass_mg;
            return Err(Halted::Guard(Halt::Zeroed { fell_mg }));
        }
        Ok(true)
    }

    /// What the policy proposes, lifted where the powder hardly flows, and whether it was. Each
    /// spoonful is a dose of what is missing.
    fn proposal(
        &self,
        dosing: &mut Dosing<'_>,
        limits: &Limits,
        course: &Course,
    ) -> (Action, bool) {
        let seen = self.seen(course.now);
        let proposed = dosing.propose(&Observation {
            reading_mg: seen.reading_mg - course.from_mg,
            target_mg: self.portion_mg(course),
            ..seen
        });
        if !self.settings.strict {
            return (proposed, false);
        }
        let left = limits.steps_max.saturating_sub(course.steps).max(1);
        let needed = (seen.missing_mg(), left);
        let lifted = ladder::lift(limits, &course.falls, seen.pitch_deg, proposed, needed);
        (lifted, lifted != proposed)
    }

    pub(super) fn situation<'c>(&self, course: &'c Course) -> Situation<'c> {
        let read_s = self.bench.elapsed_s();
        Situation {
            target_mg: self.order.target_mg,
            tolerance_upper_mg: self.order.tolerance_upper_mg,
            steps: course.steps,
            seconds: read_s - course.tared_s,
            moved_s: course.moved_s,
            read_s,
            pitch_deg: self.bench.pitch_deg(),
            before: course.before,
            now: course.now,
            shaken: course.shaken,
            falls: &course.falls,
            unproven: self.unproven(),
            is_felt: self.is_felt(),
        }
    }

    pub(super) fn guard(
        &self,
        limits: &Limits,
        course: &Course,
        proposed: Action,
    ) -> Result<Allowed, Halt> {
        guard(limits, &self.situation(course), proposed)
    }

    /// The guard's decision, after a wait for a sign of life from a display that it doubts.
    pub(super) fn proven(
        &mut self,
        limits: &Limits,
        course: &mut Course,
        proposed: Action,
        allowed: Result<Allowed, Halt>,
    ) -> Result<Result<Allowed, Halt>, Halted> {
        if !matches!(allowed, Err(Halt::Unproven)) || !self.shows_life()? {
            return Ok(allowed);
        }
        self.believe(course)?;
        let now = self.situation(course);
        Ok(guard(limits, &Situation { unproven: Some(0), is_felt: true, ..now }, proposed))
    }

    /// The display is known to be alive, and no shake is in doubt any more: what it shows now is
    /// what the last shake released.
    fn believe(&mut self, course: &mut Course) -> Result<(), Halted> {
        let shown = self.bench.read()?;
        let shown = self.net(shown);
        // The step since the last shake may have been an incline.
        if let Some(last) = course.falls.last_mut() {
            last.mass_mg += shown.mass_mg - course.now.mass_mg;
        }
        course.now = shown;
        Ok(())
    }

    /// Records the guard's decision, then carries out the action, if there is one.
    pub(super) fn carry_out(
        &mut self,
        course: &mut Course,
        proposed: Action,
        allowed: Result<Allowed, Halt>,
    ) -> Result<Option<Halt>, Halted> {
        self.tell(&Event::Decision(&Decision::new(course.ticks + 1, proposed, &allowed)))?;
        let action = match allowed {
            Ok(allowed) => allowed.action,
            Err(halt) => return Ok(Some(halt)),
        };
        // Sending the event may have taken time.
        self.go_on()?;
        self.bench.act(action)?;
        self.read_on(course, action, action.executed_shake_mm() > 0.0)?;
        Ok(None)
    }

    /// Reads after a motion, and records it.
    pub(super) fn read_on(
        &mut self,
        course: &mut Course,
        action: Action,
        shaken: bool,
    ) -> Result<(), Halted> {
        course.moved_s = self.bench.elapsed_s();
        course.before = course.now;
        let shown = self.bench.read()?;
        course.now = self.net(shown);
        self.is_tared(course.before, course.now)?;
        course.shaken = shaken;
        if action.executed_shake_mm() > 0.0 {
            course.falls.push(Fall {
                pitch_deg: self.bench.pitch_deg(),
                shake_mm: action.shake_mm,
                strokes: action.strokes,
                mass_mg: course.now.mass_mg - course.before.mass_mg,
            });
            self.shaken_s.push(course.moved_s);
        }
        course.ticks += 1;
        course.steps += 1;
        self.record(course, action, shown)
    }

    fn record(&mut self, course: &Course, action: Action, reading: Reading) -> Result<(), Halted> {
        let tick = Tick {
            step: course.ticks,
            t_s: self.bench.elapsed_s() - course.tared_s,
            pitch_deg: self.bench.pitch_deg(),
            action,
            reading,
            spoonful: course.spoonful,
        };
        self.ticks.push(tick);
        self.tell(&Event::Tick(&tick))
    }

    /// The end of a dose by a halt, with what a blocked spoon still holds.
    fn ended(&self, halt: Halt, course: &Course) -> End {
        match End::of(halt) {
            End::Blocked(cause) => {
                let fallen_mg = course.now.mass_mg - course.from_mg;
                End::Blocked(ladder::left_in_it(cause, self.settings.spoon_mg, fallen_mg))
            }
            end => end,
        }
    }
}
