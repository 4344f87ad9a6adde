//! A probing run: a few spoonfuls that are shaken to see how a powder flows. No dose is aimed at.
//!
//! ```text
//! spoonful 1, 4, 7   full strokes      from START_DEG
//! spoonful 2, 5, 8   half strokes      from a step below the onset seen
//! spoonful 3, 6, 9   quarter strokes   the same
//! each               two strokes at each pitch, a reading after each, STEP_DEG steeper each time, up to what arm and policy allow;
//!                    then a last row of full strokes at the end of the pitch: what is left then stays in the spoon
//! ```
//!
//! Every step goes through the guard, as in a dose; the target of the order is the most that may
//! fall. A forecast does not know that a spoon is finite: it bounds the steps of those spoonfuls
//! alone that could pass the limit if all of it fell.
//!
//! Shakes that release nothing are data here, and no blocked spoon. A stuck display is found by its
//! signs of life; where a sound display stands for minutes, by a spoonful that shows nothing at all
//! after others did.

use super::dosing::Course;
use super::guard::{Halt, Limits};
use super::ladder::EMPTY;
use super::{End, Event, Halted, Loop, Phase};
use crate::hardware::Bench;
use flip_core::domain::bench::{Action, INCLINE_CHANGE_DEG_MAX, Reach, SHAKE_MM_MIN};
use flip_core::domain::weighing::Probe;
use flip_policy::Rules;
use std::ops::ControlFlow;

/// First pitch of the first spoonful, deg: hardly a powder flows below twice of it.
const START_DEG: f64 = 6.0;
/// From one pitch to the next, deg; half of the largest change in one step.
const STEP_DEG: f64 = 4.0;
/// Readings at each pitch.
const AT_EACH: u32 = 2;
/// Amplitudes of the spoonfuls, as shares of the arm's largest.
const SHARES: [f64; 3] = [1.0, 0.5, 0.25];
/// The last row: readings, and strokes before each.
const LAST_ROW: [u32; 2] = [4, 4];
/// Least mass that counts as flowing, mg, as in the powder's card.
const PIECE_MG: f64 = 0.5;
/// A spoon may hold this many times what is known of it: fillings scatter.
const HEAPED: f64 = 1.25;
/// Longest time of a spoonful, bench s.
const SECONDS_EACH: f64 = 300.0;
/// Probability with which a probed spoonful may stop flowing while powder is left in it; far above
/// that of a stuck display, so that silence alone ends nothing.
const HANGS: f64 = 0.3;

/// What the record says of a new spoonful.
const REFILL: &str = "the next spoonful of the probing run: the spoon is filled anew";
/// Why a run ends whose display shows nothing any more,
const STANDS_STILL: &str = "a spoonful changed nothing on the display, although one before it flowed: the spoon was not filled, or the balance stands still";
/// and what is said of one in which nothing fell.
const NOTHING: &str = "nothing fell, by the display: the powder does not flow within the arm's pitch, the spoon was empty, or the balance stands still";

/// One step of the plan: the pitch to go to, then the stroke there.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Row {
    pitch_deg: f64,
    shake_mm: f64,
    strokes: u32,
}

/// The rows of a spoonful up to the end of the pitch, from `from_deg`.
fn rows(from_deg: f64, reach: &Reach, share: f64) -> Vec<Row> {
    let end_deg = reach.pitch.upper_deg;
    let shake_mm = (share * reach.shake_mm_max).max(SHAKE_MM_MIN);
    let below = (0..)
        .map(|k| from_deg + f64::from(k) * STEP_DEG)
        .take_while(|pitch_deg| *pitch_deg < end_deg - 1e-9);
    let at = |pitch_deg| (0..AT_EACH).map(move |_| Row { pitch_deg, shake_mm, strokes: 1 });
    below.chain([end_deg]).flat_map(at).collect()
}

/// The last row.
fn last_row(limits: &Limits) -> Vec<Row> {
    let [readings, strokes] = LAST_ROW;
    let (pitch_deg, shake_mm) = (limits.pitch.upper_deg, limits.shake_mm_max);
    vec![Row { pitch_deg, shake_mm, strokes }; readings as usize]
}

/// Where a spoonful begins: the first, or one whose powder was never seen to flow, from the start or
/// near the end of the pitch; any other a step below the onset seen.
fn from_deg(spoonful: u32, seen_deg: Option<f64>, reach: &Reach) -> f64 {
    let end_deg = reach.pitch.upper_deg;
    let from_deg = if spoonful == 1 { START_DEG } else { seen_deg.unwrap_or(end_deg) - STEP_DEG };
    from_deg.clamp(START_DEG.min(end_deg), end_deg)
}

impl<B: Bench, F: FnMut(&Event<'_>) -> ControlFlow<()>> Loop<'_, B, F> {
    /// The spoonfuls, from the tare until the last one or until something ends them.
    pub(super) fn probe(
        &mut self,
        probe: Probe,
        rules: &Rules,
        reach: &Reach,
    ) -> Result<End, Halted> {
        let rules = Rules { pitch: reach.pitch, steps_max: u32::MAX, ..*rules };
        let mut limits = self.probe_limits(probe, &rules, reach);
        self.tell(&Event::Phase(Phase::Dosing))?;
        let mut course = self.set_out()?;
        let mut seen_deg = None;
        for (k, share) in SHARES.into_iter().cycle().take(probe.spoonfuls as usize).enumerate() {
            if k > 0 && !self.next_spoonful(&mut limits, &mut course)? {
                break;
            }
            let rows = rows(from_deg(course.spoonful, seen_deg, reach), reach, share);
            if let Some(halt) = self.probe_spoonful(&rules, &limits, &mut course, &rows)? {
                return Ok(self.probed(halt));
            }
            if seen_deg.is_some() && self.stands_still(&limits, &course) {
                self.must_look = true;
                return Ok(End::Aborted(STANDS_STILL.to_owned()));
            }
            seen_deg = seen_deg.or(onset_deg(&limits, &course));
        }
        self.go_on()?;
        Ok(End::Course(seen_deg.is_none().then(|| NOTHING.to_owned())))
    }

    fn probe_limits(&self, probe: Probe, rules: &Rules, reach: &Reach) -> Limits {
        let usual = self.limits(rules, reach);
        Limits {
            seconds_max: usual.seconds_max.min(SECONDS_EACH * f64::from(probe.spoonfuls)),
            blocked_strokes: u32::MAX,
            hangs: usual.hangs.max(HANGS),
            ..usual
        }
    }

    /// Fills the spoon anew, if the bench can; what fell so far informs the forecast.
    fn next_spoonful(&mut self, limits: &mut Limits, course: &mut Course) -> Result<bool, Halted> {
        if !self.bench.can_refill() {
            return Ok(false);
        }
        let fallen = std::slice::from_ref(&course.falls);
        limits.forecast =
            limits.forecast.map(|prior| prior.informed(fallen, limits.readability_mg));
        self.refill(course, REFILL)?;
        Ok(true)
    }

    /// The rows of one spoonful, then the last row; returns why no other may follow, if so.
    fn probe_spoonful(
        &mut self,
        rules: &Rules,
        limits: &Limits,
        course: &mut Course,
        rows: &[Row],
    ) -> Result<Option<Halt>, Halted> {
        let limits = &self.unless_it_fits(limits, course);
        for at in rows.chunks(AT_EACH as usize) {
            for row in at {
                if let Some(halt) = self.shake_at(rules, limits, course, *row)? {
                    return Ok(Some(halt));
                }
            }
            if self.is_spent(limits, course) {
                break;
            }
        }
        for row in last_row(limits) {
            if let Some(halt) = self.shake_at(rules, limits, course, row)? {
                return Ok(Some(halt));
            }
        }
        Ok(None)
    }

    /// The limits without a forecast, if all that this spoonful can hold may fall.
    fn unless_it_fits(&self, limits: &Limits, course: &Course) -> Limits {
        let most_mg = self.settings.spoon_mg.map(|mg| course.from_mg + HEAPED * mg);
        let fits = most_mg.is_some_and(|most_mg| most_mg <= self.order.target_mg);
        Limits { forecast: limits.forecast.filter(|_| !fits), ..*limits }
    }

    /// Whether the spoon has released nearly all, and gave nothing at this pitch.
    fn is_spent(&self, limits: &Limits, course: &Course) -> bool {
        let fallen_mg = course.now.mass_mg - course.from_mg;
        let here_mg: f64 =
            course.falls.iter().rev().take(AT_EACH as usize).map(|fall| fall.mass_mg).sum();
        let is_nearly = |spoon_mg| fallen_mg >= EMPTY * spoon_mg;
        self.settings.spoon_mg.is_some_and(is_nearly) && here_mg < limits.piece_mg - 1e-9
    }

    /// Goes to the row's pitch and strokes there.
    fn shake_at(
        &mut self,
        rules: &Rules,
        limits: &Limits,
        course: &mut Course,
        row: Row,
    ) -> Result<Option<Halt>, Halted> {
        loop {
            let left_deg = row.pitch_deg - self.bench.pitch_deg();
            let is_there = left_deg.abs() <= INCLINE_CHANGE_DEG_MAX + 1e-9;
            let shake_mm = if is_there { row.shake_mm } else { 0.0 };
            let change_deg = left_deg.clamp(-INCLINE_CHANGE_DEG_MAX, INCLINE_CHANGE_DEG_MAX);
            let next = Action { strokes: row.strokes, ..Action::once(change_deg, shake_mm) };
            if let Some(halt) = self.step(rules, limits, course, next)? {
                return Ok(Some(halt));
            }
            if is_there {
                return Ok(None);
            }
        }
    }

    /// One action, as the guard allows it.
    fn step(
        &mut self,
        rules: &Rules,
        limits: &Limits,
        course: &mut Course,
        next: Action,
    ) -> Result<Option<Halt>, Halted> {
        self.go_on()?;
        self.look_if_it_ends(rules, course)?;
        let allowed = self.guard(limits, course, next);
        let allowed = self.proven(limits, course, next, allowed)?;
        self.carry_out(course, next, allowed)
    }

    /// Whether a spoonful after one that flowed did not change a display that shows no life by
    /// itself.
    fn stands_still(&self, limits: &Limits, course: &Course) -> bool {
        let moved = |mass_mg: f64| mass_mg.abs() > limits.readability_mg / 2.0;
        self.unproven().is_none() && !course.falls.iter().any(|fall| moved(fall.mass_mg))
    }

    fn probed(&mut self, halt: Halt) -> End {
        self.must_look |= halt == Halt::Unproven;
        match halt {
            Halt::TargetReached => {
                let limit_mg = self.order.target_mg;
                End::Course(Some(format!("the limit of {limit_mg} mg has fallen")))
            }
            halt => End::of(halt),
        }
    }
}

/// Pitch at which powder began to fall from this spoonful, deg.
fn onset_deg(limits: &Limits, course: &Course) -> Option<f64> {
    let piece_mg = limits.piece_mg.max(PIECE_MG) - 1e-9;
    let mut fallen_mg = 0.0;
    let first = course.falls.iter().find(|fall| {
        fallen_mg += fall.mass_mg;
        fallen_mg >= piece_mg
    });
    first.map(|fall| fall.pitch_deg)
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_core::domain::bench::PitchLimits;

    fn reach(upper_deg: f64) -> Reach {
        Reach { pitch: PitchLimits { lower_deg: -10.0, upper_deg }, shake_mm_max: 12.0 }
    }

    #[test]
    fn each_pitch_is_shaken_twice_up_to_the_end_which_is_part_of_the_plan() {
        let pitches = |from_deg, end_deg| {
            let rows = rows(from_deg, &reach(end_deg), 0.5);
            assert!(rows.iter().all(|row| (row.shake_mm, row.strokes) == (6.0, 1)));
            rows.iter().map(|row| row.pitch_deg).collect::<Vec<_>>()
        };
        assert_eq!(pitches(6.0, 16.0), [6.0, 6.0, 10.0, 10.0, 14.0, 14.0, 16.0, 16.0]);
        assert_eq!(pitches(12.0, 16.0), [12.0, 12.0, 16.0, 16.0]);
        assert_eq!(pitches(16.0, 16.0), [16.0, 16.0]);
        assert_eq!(rows(6.0, &Reach { shake_mm_max: 2.0, ..reach(8.0) }, 0.25)[0].shake_mm, 0.9);
    }

    #[test]
    fn a_later_spoonful_begins_a_step_below_the_onset_seen_and_never_beyond_the_arm() {
        let from = |spoonful, seen_deg, end_deg| from_deg(spoonful, seen_deg, &reach(end_deg));
        assert_eq!((from(1, None, 50.0), from(2, Some(30.0), 50.0)), (6.0, 26.0));
        assert_eq!((from(2, None, 50.0), from(3, Some(8.0), 50.0)), (46.0, 6.0));
        assert_eq!((from(1, None, 4.0), from(2, Some(4.0), 4.0)), (4.0, 4.0));
    }
}
