//! What is tried before a spoon counts as empty or blocked.
//!
//! At the end of the pitch only shakes are left. Rung by rung, as long as nothing falls:
//!
//! ```text
//! 1  full strokes                               after two shakes that released nothing
//! 2  two, four, eight strokes before a reading  each after a silent one; and as many as the missing mass needs
//! 3  loosen                                     level, eight full strokes there, back to the end, once for each spoonful
//! 4  a new spoonful                             where the arm fills its spoon
//! ```
//!
//! A last spoonful whose steps are spent while powder still falls gets them once more; else it is filled
//! anew.
//!
//! A spoon whose gentlest shake might release more than there is room for is lowered without a shake to
//! where it would not, and filled anew where there is no such pitch: level, a full spoon releases less.
//!
//! Every stroke of it is forecast and bounded by the guard like any other. A spoon known to be
//! almost empty goes to rung 4 at once; so does a powder that comes in pieces
//! ([`Forecast::in_pieces`](super::forecast::Forecast::in_pieces)) and is silent at the end of the
//! pitch: what its next piece may weigh leaves only gentle shakes, and a new spoonful flows at less.

use super::dosing::Course;
use super::forecast::Fall;
use super::guard::{
    AT_THE_END_DEG, Allowed, FULL, Halt, Limits, Situation, guard, silent_at_the_end,
};
use super::{Decision, Event, Halted, Loop};
use crate::hardware::Bench;
use flip_core::domain::bench::{Action, INCLINE_CHANGE_DEG_MAX, SHAKE_MM_MIN, STROKES_MAX};
use std::ops::ControlFlow;

/// Silent shakes at the end of the pitch after which the next is a full one.
const SILENT: usize = 2;
/// A spoon that has released this fraction of what it holds is empty once it is silent.
pub(super) const EMPTY: f64 = 0.85;
/// The fraction of what the spoon holds that a spoonful of a larger target is to release.
const PORTION: f64 = 0.8;
/// Full strokes at the end of the pitch that release nothing after which such a spoonful is spent.
const SPENT_STROKES: u32 = 3;
/// Silent shakes at the end of the pitch after which a powder that comes in pieces gets a new spoonful.
const SILENT_PIECES: usize = 6;
/// Shakes of which at least one released something while a spoon is alive.
const ALIVE_SHAKES: usize = 10;
/// Most of what is missing that one step may be expected to release.
const AT_ONCE: f64 = 0.5;

/// The proposal as it suits a powder that hardly flows: at the end of the pitch, full shakes after
/// silent ones, and as many strokes as it takes to release the missing mass in the steps left.
///
/// `missing_mg`: up to the target; `steps_left`: at least 1.
pub(super) fn lift(
    limits: &Limits,
    falls: &[Fall],
    pitch_deg: f64,
    proposed: Action,
    (missing_mg, steps_left): (f64, u32),
) -> Action {
    let end_deg = limits.pitch.upper_deg - AT_THE_END_DEG;
    if proposed.incline_change_deg < 0.0 || pitch_deg + proposed.incline_change_deg < end_deg {
        return proposed;
    }
    let there: Vec<&Fall> =
        falls.iter().rev().take_while(|fall| fall.pitch_deg > end_deg).collect();
    let fell_mg: f64 = there.iter().take(SILENT).map(|fall| fall.mass_mg).sum();
    let is_silent = there.len() >= SILENT && fell_mg < limits.piece_mg - 1e-9;
    let full_mm = FULL * limits.shake_mm_max;
    let shake_mm = if is_silent { limits.shake_mm_max } else { proposed.shake_mm };
    if shake_mm < full_mm {
        return proposed;
    }
    let full: Vec<&Fall> = there.into_iter().take_while(|fall| fall.shake_mm >= full_mm).collect();
    let strokes = strokes(limits, &full, missing_mg, steps_left);
    Action { shake_mm, strokes, ..proposed }
}

/// Strokes of the next step, after these full ones at the end of the pitch, the latest first.
fn strokes(limits: &Limits, full: &[&Fall], missing_mg: f64, steps_left: u32) -> u32 {
    let Some(last) = full.first() else { return 1 };
    if last.mass_mg < limits.piece_mg - 1e-9 {
        return (2 * last.strokes).min(STROKES_MAX);
    }
    let made: u32 = full.iter().map(|fall| fall.strokes).sum();
    let each_mg = full.iter().map(|fall| fall.mass_mg).sum::<f64>() / f64::from(made);
    let needed = missing_mg / f64::from(steps_left.max(1)) / each_mg;
    let most = (AT_ONCE * missing_mg / each_mg).max(1.0);
    // Casting saturates, and not a number becomes 0.
    (needed.ceil().min(most) as u32).clamp(1, STROKES_MAX)
}

/// What the record says of a loosening,
const LOOSEN: &str = "nothing falls: the spoon is levelled and shaken to loosen the powder";
/// of a spoon that is lowered,
const LOWER: &str = "here even the gentlest shake might let too much fall: the spoon is lowered, without a shake, to where it would not";
/// of steps that begin anew,
const GO_ON: &str = "every step is spent, and powder still falls: the steps begin anew";
/// of a new spoonful,
const REFILL: &str = "the spoon gives no more: it is filled anew";
/// and of one that is to begin gently.
const REFILL_GENTLY: &str =
    "the spoon gives too much at once for what is missing: it is filled anew, and begins gently";

impl<B: Bench, F: FnMut(&Event<'_>) -> ControlFlow<()>> Loop<'_, B, F> {
    /// What this spoonful is to release, mg: what is missing, or a portion of a larger target that a
    /// spoon surely holds.
    pub(super) fn portion_mg(&self, course: &Course) -> f64 {
        let missing_mg = self.order.target_mg - course.from_mg;
        match self.settings.spoon_mg {
            Some(spoon_mg) if missing_mg > spoon_mg => PORTION * spoon_mg,
            _ => missing_mg,
        }
    }

    /// Whether the spoon may be lowered after this halt: it was not yet, or was shaken since, and at
    /// the lowest pitch the gentlest shake would leave room.
    pub(super) fn may_be_lowered(
        &self,
        allowed: &Result<Allowed, Halt>,
        limits: &Limits,
        course: &Course,
    ) -> bool {
        let lowest_deg = limits.pitch.lower_deg;
        matches!(allowed, Err(Halt::NoRoom { .. }))
            && course.lowered_after != Some(course.falls.len())
            && self.bench.pitch_deg() > lowest_deg + AT_THE_END_DEG
            && self.has_room_at(lowest_deg, limits, course)
    }

    /// Whether the gentlest shake at this pitch, or lower within a step's reach, would leave room.
    fn has_room_at(&self, pitch_deg: f64, limits: &Limits, course: &Course) -> bool {
        let there = Situation { pitch_deg, ..self.situation(course) };
        guard(limits, &there, Action::once(0.0, SHAKE_MM_MIN)).is_ok()
    }

    /// Lower the spoon without a shake until there is room for the gentlest. These steps are not the
    /// policy's, and do not count as such. Returns why it was not finished, if so.
    pub(super) fn lower(
        &mut self,
        limits: &Limits,
        course: &mut Course,
    ) -> Result<Option<Halt>, Halted> {
        let steps = course.steps;
        course.lowered_after = Some(course.falls.len());
        self.decide(course, LOWER)?;
        loop {
            let left_deg = limits.pitch.lower_deg - self.bench.pitch_deg();
            let next = Action::once(left_deg.max(-INCLINE_CHANGE_DEG_MAX), 0.0);
            let allowed = self.guard(limits, course, next);
            if let Some(halt) = self.carry_out(course, next, allowed)? {
                return Ok(Some(halt));
            }
            course.steps = steps;
            let pitch_deg = self.bench.pitch_deg();
            let is_lowest = pitch_deg < limits.pitch.lower_deg + AT_THE_END_DEG;
            if is_lowest || self.has_room_at(pitch_deg, limits, course) {
                return Ok(None);
            }
        }
    }

    /// Whether the next spoonful may follow: this one has released its portion of a larger target,
    /// or nearly all that the spoon holds and full shakes at the end of the pitch release nothing.
    /// A few such shakes suffice where more spoonfuls have to follow anyway.
    pub(super) fn is_empty(&self, limits: &Limits, course: &Course) -> bool {
        if self.has_stuck(limits, course) {
            return true;
        }
        let Some(spoon_mg) = self.settings.spoon_mg else { return false };
        let fallen_mg = course.now.mass_mg - course.from_mg;
        let silent = silent_at_the_end(limits, &course.falls).unwrap_or(0);
        match self.is_last(course) {
            true => fallen_mg >= EMPTY * spoon_mg && silent > 0,
            false => fallen_mg >= self.portion_mg(course) - 1.0 || silent >= SPENT_STROKES,
        }
    }

    /// Whether a powder that comes in pieces no longer does, and another spoonful can be had.
    fn has_stuck(&self, limits: &Limits, course: &Course) -> bool {
        let end_deg = limits.pitch.upper_deg - AT_THE_END_DEG;
        let is_silent =
            |fall: &&Fall| fall.pitch_deg > end_deg && fall.mass_mg < limits.piece_mg - 1e-9;
        let silent = course.falls.iter().rev().take_while(is_silent).count();
        limits.forecast.is_some_and(|forecast| forecast.in_pieces)
            && silent >= SILENT_PIECES
            && course.spoonful < self.settings.spoonfuls_max
            && self.bench.can_refill()
    }

    fn is_last(&self, course: &Course) -> bool {
        self.portion_mg(course) >= self.order.target_mg - course.from_mg
    }

    /// Whether a spoon that releases nothing may still hold powder that shakes would loosen.
    pub(super) fn may_be_loosened(
        &self,
        allowed: &Result<Allowed, Halt>,
        limits: &Limits,
        course: &Course,
    ) -> bool {
        matches!(allowed, Err(Halt::Blocked { .. }))
            && !course.loosened
            && self.is_last(course)
            && !self.is_empty(limits, course)
    }

    /// Whether this spoonful goes on although its steps are spent: it is the last, the dose is
    /// short, and its latest shakes released something.
    pub(super) fn goes_on(&self, halt: &Halt, limits: &Limits, course: &Course) -> bool {
        let latest = course.falls.iter().rev().take(ALIVE_SHAKES);
        self.settings.strict
            && *halt == Halt::StepsSpent
            && self.is_last(course)
            && self.is_short(course)
            && course.rounds + 1 < self.settings.spoonfuls_max
            && latest.map(|fall| fall.mass_mg).sum::<f64>() > limits.piece_mg - 1e-9
    }

    /// Give this spoonful its steps once more.
    pub(super) fn begin_again(&mut self, course: &mut Course) -> Result<(), Halted> {
        self.decide(course, GO_ON)?;
        (course.steps, course.rounds) = (0, course.rounds + 1);
        Ok(())
    }

    /// Whether the dose may be short of its tolerance: a mean this near to the limit may as well be
    /// on its other side.
    fn is_short(&self, course: &Course) -> bool {
        let least_mg = self.order.tolerance_lower_mg - self.order.readability_mg / 2.0;
        self.order.target_mg - course.now.mass_mg > least_mg
    }

    /// Whether a new spoonful may bring the dose to its target.
    pub(super) fn takes_another(&self, halt: &Halt, course: &Course) -> bool {
        let is_spent = match halt {
            Halt::Blocked { .. } => true,
            // The steps were made for one spoonful.
            Halt::StepsSpent => self.settings.strict || !self.is_last(course),
            // A full spoon is gentle while it is level; one that may not be shaken even once never is.
            Halt::NoRoom { .. } => !course.falls.is_empty(),
            _ => false,
        };
        is_spent
            && course.spoonful < self.settings.spoonfuls_max
            && self.is_short(course)
            && self.bench.can_refill()
    }

    /// Shake the level spoon, then return to the end of the pitch. These steps are not the
    /// policy's, and do not count as such. Returns why it was not finished, if so.
    pub(super) fn loosen(
        &mut self,
        limits: &Limits,
        course: &mut Course,
    ) -> Result<Option<Halt>, Halted> {
        let steps = course.steps;
        course.loosened = true;
        self.decide(course, LOOSEN)?;
        let back = Action::once(-self.bench.pitch_deg(), 0.0);
        self.bench.level()?;
        self.read_on(course, back, true)?;
        let mut next = Action { strokes: STROKES_MAX, ..Action::once(0.0, limits.shake_mm_max) };
        loop {
            course.steps = steps;
            let allowed = self.guard(limits, course, next);
            let allowed = self.proven(limits, course, next, allowed)?;
            if let Some(halt) = self.carry_out(course, next, allowed)? {
                return Ok(Some(halt));
            }
            course.steps = steps;
            let left_deg = limits.pitch.upper_deg - self.bench.pitch_deg();
            if left_deg < AT_THE_END_DEG {
                return Ok(None);
            }
            next = Action::once(left_deg.min(INCLINE_CHANGE_DEG_MAX), 0.0);
        }
    }

    /// Fill the spoon anew after this halt.
    pub(super) fn refill_after(&mut self, halt: &Halt, course: &mut Course) -> Result<(), Halted> {
        let is_lively = matches!(halt, Halt::NoRoom { .. });
        self.refill(course, if is_lively { REFILL_GENTLY } else { REFILL })
    }

    /// Fill the spoon anew, for this reason; the rest of the dose is a dose of its own.
    pub(super) fn refill(&mut self, course: &mut Course, why: &str) -> Result<(), Halted> {
        self.decide(course, why)?;
        self.bench.refill()?;
        course.spoonful += 1;
        (course.loosened, course.rounds) = (false, 0);
        course.lowered_after = None;
        course.falls.clear();
        // Levelling a steep spoon may have released some.
        self.read_on(course, Action::default(), true)?;
        (course.steps, course.from_mg) = (0, course.now.mass_mg);
        Ok(())
    }

    /// Record what is about to be done that no policy proposed.
    fn decide(&mut self, course: &Course, why: &str) -> Result<(), Halted> {
        let allowed = Ok(Allowed { action: Action::default(), cut: None });
        let decision = Decision::new(course.ticks + 1, Action::default(), &allowed);
        self.tell(&Event::Decision(&Decision { reason: Some(why.to_owned()), ..decision }))?;
        self.go_on()
    }
}

/// The cause of a blocked spoon, with what is still in it.
pub(super) fn left_in_it(cause: String, spoon_mg: Option<f64>, fallen_mg: f64) -> String {
    match spoon_mg.map(|spoon_mg| spoon_mg - fallen_mg) {
        Some(left_mg) if left_mg >= 1.0 => {
            format!("{cause}; of a full spoon, about {left_mg:.0} mg are still in it")
        }
        _ => cause,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_core::domain::bench::PitchLimits;

    fn limits() -> Limits {
        Limits::new(PitchLimits { lower_deg: -10.0, upper_deg: 60.0 }, 30)
    }

    fn fall(pitch_deg: f64, shake_mm: f64, strokes: u32, mass_mg: f64) -> Fall {
        Fall { pitch_deg, shake_mm, strokes, mass_mg }
    }

    fn lifted(falls: &[Fall], proposed: Action) -> Action {
        lift(&limits(), falls, 60.0, proposed, (10.0, 10))
    }

    #[test]
    fn below_the_end_of_the_pitch_and_on_the_way_back_a_proposal_stays_as_it_is() {
        let silent = [fall(50.0, 16.0, 1, 0.0); 4];
        let proposed = Action::once(4.0, 3.0);
        assert_eq!(lift(&limits(), &silent, 50.0, proposed, (10.0, 10)), proposed);
        let back = Action::once(-4.0, 16.0);
        assert_eq!(lift(&limits(), &[fall(60.0, 16.0, 1, 0.0); 4], 60.0, back, (9.0, 9)), back);
    }

    #[test]
    fn silent_shakes_at_the_end_are_followed_by_full_ones_and_those_by_ever_more_strokes() {
        let gentle = Action::once(0.0, 3.0);
        let mut falls = vec![fall(60.0, 3.0, 1, 0.0)];
        assert_eq!(lifted(&falls, gentle), gentle);
        falls.push(fall(60.0, 3.0, 1, 0.4));
        let made: Vec<u32> = (0..6)
            .map(|_| {
                let next = lifted(&falls, gentle);
                assert_eq!(next.shake_mm, 16.0);
                falls.push(fall(60.0, 16.0, next.strokes, 0.0));
                next.strokes
            })
            .collect();
        assert_eq!(made, [1, 2, 4, 8, 8, 8]);
    }

    #[test]
    fn strokes_are_as_many_as_the_missing_mass_needs() {
        let full = Action::once(0.0, 16.0);
        let strokes = |falls: &[Fall], missing_mg, steps| {
            lift(&limits(), falls, 60.0, full, (missing_mg, steps)).strokes
        };
        // 0.5 mg a stroke; 1.5 mg for each of ten steps.
        let slow = [fall(60.0, 16.0, 4, 2.0)];
        assert_eq!(strokes(&slow, 15.0, 10), 3);
        assert_eq!(strokes(&slow, 15.0, 1), 8);
        assert_eq!(strokes(&slow, 2.0, 1), 2, "at most half of it at once");
        assert_eq!(strokes(&[fall(60.0, 16.0, 1, 4.0)], 15.0, 10), 1, "it flows");
        assert_eq!(strokes(&[], 15.0, 10), 1);
    }

    #[test]
    fn what_is_left_in_a_blocked_spoon_is_said_where_it_is_known() {
        let said = |spoon_mg, fallen_mg| left_in_it("blocked".to_owned(), spoon_mg, fallen_mg);
        assert_eq!(said(Some(37.0), 2.5), "blocked; of a full spoon, about 34 mg are still in it");
        assert_eq!(said(Some(37.0), 36.8), "blocked");
        assert_eq!(said(None, 2.5), "blocked");
    }
}
