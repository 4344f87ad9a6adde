//! Fuzzy rules adapted to the number of steps and the target: gentle when there is time.
//!
//! The mass released depends on the pitch: a spoon releases the powder above its slope of rest, and
//! the harder it is shaken, the larger the first piece (`docs/dispenser.md`). The gentlest shake
//! that suffices is therefore the best, and the number of steps available determines which one that
//! is. With n steps for a target m:
//!
//! ```text
//! s      = max(1, m / n / pace)                     how much faster than gently
//! fall   peaks of some and much, times s
//! missing  peak of large, divided by s
//! on     = gentle on * s, at most 6 deg
//! far    = max(climb / n, gentle far / gentle on * on), at most 8 deg
//! ```
//!
//! The rules are those of [`Fuzzy`] with these numbers. Until the first piece has fallen, no shake
//! is larger than s times `first_mm`. If the spoon cannot be raised further and the last shake
//! released less than each remaining step has to, the next shake is harder, up to the limit set by
//! the missing mass; if it released up to three times as much, the next shake is the same.

use super::controller::Done;
use super::episode::Rules;
use super::fuzzy::Fuzzy;
use super::observation::Observation;
use flip_core::domain::bench::{Action, INCLINE_CHANGE_DEG_MAX, SHAKE_MM_MAX};
use flip_core::domain::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// Largest change of the pitch once powder falls, degrees.
const ON_DEG_MAX: f64 = 6.0;

/// Within this distance of its upper limit the pitch counts as being there, degrees.
const AT_THE_END_DEG: f64 = 0.5;

/// How far below the pitch at which a powder flowed before the first shake is made, degrees: from
/// dose to dose, that pitch differs by up to 3.5, and the guard learns from shakes that release
/// nothing.
const BEFORE_ONSET_DEG: f64 = 10.0;

/// A smaller fall is dust, not a piece, mg.
const PIECE_MG: f64 = 0.5;

/// A fall is sufficient up to this multiple of the mass each step has to release.
const ENOUGH: f64 = 3.0;

/// The rules of an unhurried weighing, and their adaptation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Paced {
    /// The rules for a pace of at most `pace_mg`.
    pub gentle: Fuzzy,
    /// Largest target per step that counts as unhurried, mg; 0.01 to 1000.
    pub pace_mg: f64,
    /// Pitch covered over all steps if nothing falls, degrees; 1 to 1000.
    pub climb_deg: f64,
    /// Largest shake before the first piece has fallen, mm; 1 to 16.
    pub first_mm: f64,
    /// Factor on the last shake for the next one if too little falls at the upper pitch limit; 1
    /// to 10.
    pub harder: f64,
    /// Amplitude limit of such a shake, mm per missing mg, in addition to the rules' own; 0 to 100.
    pub stuck_mm_per_mg: f64,
}

impl Paced {
    /// The shipped values: found by `cargo experiment tune_schedule` for `paced` on sand, sugar and salt
    /// (`docs/dispenser.md`).
    pub const CHOSEN: Self = Self {
        gentle: Fuzzy {
            missing_mg: [0.5, 4.5, 27.0],
            fall_mg: [0.0, 0.15, 2.0],
            tilt_deg: [-7.8, 0.0, 2.4, 4.0],
            shake_mm: [1.0, 1.01, 15.7],
        },
        pace_mg: 0.6,
        climb_deg: 120.0,
        first_mm: 3.0,
        harder: 1.6,
        stuck_mm_per_mg: 5.0,
    };

    /// Validates the controller: its numbers must be within their bounds.
    ///
    /// # Errors
    /// The first field that is out of bounds.
    pub fn checked(self) -> Result<Self, FieldError> {
        self.gentle
            .checked()
            .map_err(|e| FieldError::new(format!("gentle.{}", e.field), e.message))?;
        bounded("gentle.tilt_deg", self.gentle.tilt_deg[2], 0.1, ON_DEG_MAX, "deg")?;
        bounded("pace_mg", self.pace_mg, 0.01, 1000.0, "mg")?;
        bounded("climb_deg", self.climb_deg, 1.0, 1000.0, "deg")?;
        bounded("first_mm", self.first_mm, 1.0, SHAKE_MM_MAX, "mm")?;
        bounded("harder", self.harder, 1.0, 10.0, "")?;
        bounded("stuck_mm_per_mg", self.stuck_mm_per_mg, 0.0, 100.0, "mm/mg")?;
        Ok(self)
    }

    /// Returns the action after these steps.
    pub(super) fn propose(&self, done: &[Done], seen: &Observation, frame: &Rules) -> Action {
        let rules = self.rules(seen.target_mg, frame.steps_max);
        let mut action = rules.propose(done, seen);
        if seen.reading_mg < PIECE_MG && !is_at_the_end(seen, frame) {
            action.shake_mm =
                action.shake_mm.min(self.first_mm * self.faster(seen.target_mg, frame.steps_max));
        }
        let Some(last) = done.iter().rfind(|step| step.action.executed_shake_mm() > 0.0) else {
            return action;
        };
        let fell_mg = last.after.reading_mg - last.before.reading_mg;
        let missing_mg = seen.missing_mg().max(0.0);
        let needed_mg =
            missing_mg / f64::from(frame.steps_max.saturating_sub(done.len() as u32).max(1));
        let factor = match fell_mg {
            _ if action.incline_change_deg < 0.0 || !is_at_the_end(seen, frame) => return action,
            fell if fell < needed_mg => self.harder,
            fell if fell < ENOUGH * needed_mg => 1.0,
            _ => return action,
        };
        let allowed_mm = (rules.shake_mm[0] + self.stuck_mm_per_mg * missing_mg).min(SHAKE_MM_MAX);
        let shake_mm = (factor * last.action.shake_mm).min(allowed_mm);
        Action { shake_mm: action.shake_mm.max(shake_mm), ..action }
    }

    /// Speed-up factor relative to the gentle rules.
    fn faster(&self, target_mg: f64, steps_max: u32) -> f64 {
        (target_mg / f64::from(steps_max.max(1)) / self.pace_mg).max(1.0)
    }

    /// The rules for a weighing of this target in this many steps.
    fn rules(&self, target_mg: f64, steps_max: u32) -> Fuzzy {
        let (n, gentle) = (f64::from(steps_max.max(1)), &self.gentle);
        let faster = self.faster(target_mg, steps_max);
        let [none, some, much] = gentle.fall_mg;
        let [small, medium, large] = gentle.missing_mg;
        let [back, hold, on, far] = gentle.tilt_deg;
        let quick_on = (on * faster).min(ON_DEG_MAX);
        let quick_far = (self.climb_deg / n).max(far / on * quick_on).min(INCLINE_CHANGE_DEG_MAX);
        Fuzzy {
            // The peaks must rise, whatever the speed-up.
            missing_mg: [small, medium, (large / faster).max(1.01 * medium)],
            fall_mg: [none, some * faster, much * faster],
            tilt_deg: [back, hold, quick_on, quick_far.max(quick_on)],
            shake_mm: gentle.shake_mm,
        }
    }
}

/// The way to where a known powder is about to flow, unshaken: [`BEFORE_ONSET_DEG`] below the
/// pitch at which it began to flow before. `None` once there, or once something has fallen.
pub(super) fn lead_in(onset_deg: Option<f64>, seen: &Observation) -> Option<Action> {
    let left_deg = onset_deg? - BEFORE_ONSET_DEG - seen.pitch_deg;
    let is_on_the_way = seen.reading_mg < PIECE_MG && left_deg > AT_THE_END_DEG;
    is_on_the_way.then(|| Action::once(left_deg.min(INCLINE_CHANGE_DEG_MAX), 0.0))
}

/// Whether the spoon cannot be raised further.
fn is_at_the_end(seen: &Observation, frame: &Rules) -> bool {
    seen.pitch_deg > frame.pitch.upper_deg - AT_THE_END_DEG
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn where_there_is_time_the_rules_are_the_gentle_ones() {
        let paced = Paced::CHOSEN.checked().unwrap();
        assert_eq!(paced.rules(5.0, 30), paced.gentle);
        assert_eq!(paced.rules(18.0, 30), paced.gentle);
    }

    #[test]
    fn where_there_is_none_they_are_as_written_above() {
        // 12 mg in 10 steps is twice the pace.
        let rules = Paced::CHOSEN.rules(12.0, 10);
        assert_eq!(rules.missing_mg, [0.5, 4.5, 13.5]);
        assert_eq!(rules.fall_mg, [0.0, 0.3, 4.0]);
        assert_eq!(rules.tilt_deg, [-7.8, 0.0, 4.8, 8.0]);
        assert_eq!(rules.shake_mm, Paced::CHOSEN.gentle.shake_mm);
        // A small dose in few steps still has to climb.
        assert_eq!(Paced::CHOSEN.rules(5.0, 20).tilt_deg, [-7.8, 0.0, 2.4, 6.0]);
    }

    #[test]
    fn until_the_first_piece_has_fallen_shakes_are_gentle() {
        let shake_mm = |reading_mg, pitch_deg, steps_max| {
            let seen = Observation { reading_mg, target_mg: 18.0, pitch_deg };
            Paced::CHOSEN.propose(&[], &seen, &Rules { steps_max, ..Rules::FLIP }).shake_mm
        };
        assert_eq!(shake_mm(0.4, 20.0, 30), 3.0);
        assert!(shake_mm(0.6, 20.0, 30) > 8.0, "a piece has fallen and much is missing");
        assert!(shake_mm(0.0, 50.0, 30) > 8.0, "nothing else is left to try");
        // Twice as fast.
        assert_eq!(shake_mm(0.0, 20.0, 15), 6.0);
    }

    #[test]
    fn a_powder_that_flowed_before_is_brought_near_that_pitch_without_a_shake() {
        let way = |onset_deg, reading_mg, pitch_deg| {
            lead_in(onset_deg, &Observation { reading_mg, target_mg: 15.0, pitch_deg })
        };
        assert_eq!(way(Some(46.0), 0.0, 0.0), Some(Action::once(8.0, 0.0)));
        assert_eq!(way(Some(46.0), 0.0, 33.0), Some(Action::once(3.0, 0.0)));
        assert_eq!(way(Some(46.0), 0.0, 36.0), None, "there");
        assert_eq!(way(Some(46.0), 1.0, 20.0), None, "it has begun to fall");
        assert_eq!(way(None, 0.0, 0.0), None);
    }

    #[test]
    fn at_the_end_of_the_pitch_shakes_grow_until_something_falls_or_little_is_missing() {
        let frame = Rules { steps_max: 30, ..Rules::FLIP };
        let seen = |reading_mg, pitch_deg| Observation { reading_mg, target_mg: 20.0, pitch_deg };
        let next = |shake_mm, before_mg, now_mg, pitch_deg| {
            let action = Action::once(0.0, shake_mm);
            let step =
                Done { before: seen(before_mg, pitch_deg), action, after: seen(now_mg, pitch_deg) };
            Paced::CHOSEN.propose(&[step], &seen(now_mg, pitch_deg), &frame).shake_mm
        };
        let usual = next(2.0, 17.0, 17.0, 40.0);
        assert!(usual < 2.0, "{usual}");
        assert_eq!(next(2.0, 17.0, 17.0, 50.0), 3.2);
        assert_eq!(next(16.0, 17.0, 17.0, 50.0), 16.0);
        // 3 mg in 29 steps: 0.1 mg each.
        assert_eq!(next(2.0, 16.8, 17.0, 50.0), 2.0, "enough fell");
        assert_eq!(next(2.0, 16.7, 17.0, 50.0), 2.0, "2.9 times as much is enough");
        assert_eq!(next(2.0, 16.68, 17.0, 50.0), usual, "3.1 times as much is more");
        assert_eq!(next(2.0, 16.0, 17.0, 50.0), usual, "more fell");
        // 0.2 mg is missing: 1 mm, plus 5 mm per mg.
        assert!((next(8.0, 19.8, 19.8, 50.0) - 2.0).abs() < 1e-9);
    }

    #[test]
    fn numbers_out_of_bounds_are_named() {
        let named = |bad: Paced| bad.checked().unwrap_err().field;
        assert_eq!(named(Paced { pace_mg: 0.0, ..Paced::CHOSEN }), "pace_mg");
        assert_eq!(named(Paced { climb_deg: f64::NAN, ..Paced::CHOSEN }), "climb_deg");
        let gentle = Fuzzy { fall_mg: [0.0, 3.0, 2.0], ..Paced::CHOSEN.gentle };
        assert_eq!(named(Paced { gentle, ..Paced::CHOSEN }), "gentle.fall_mg");
    }

    proptest! {
        #[test]
        fn the_rules_of_any_weighing_are_within_their_bounds_and_more_haste_never_slows(
            target_mg in 0.1..5000.0f64, more in 1.0..10.0f64, steps in 1..100u32,
        ) {
            let slow = Paced::CHOSEN.rules(target_mg, steps);
            let fast = Paced::CHOSEN.rules(target_mg * more, steps);
            // *Far* and *on* may coincide where nothing faster is allowed.
            let rising = |f: Fuzzy| f.tilt_deg[2] <= f.tilt_deg[3] && f.tilt_deg[3] <= INCLINE_CHANGE_DEG_MAX
                && f.missing_mg.windows(2).all(|w| w[0] < w[1]) && f.fall_mg.windows(2).all(|w| w[0] < w[1]);
            prop_assert!(rising(slow) && rising(fast));
            prop_assert!(fast.tilt_deg[2] >= slow.tilt_deg[2] && fast.tilt_deg[3] >= slow.tilt_deg[3]);
            prop_assert!(fast.missing_mg[2] <= slow.missing_mg[2] && fast.fall_mg[2] >= slow.fall_mg[2]);
        }
    }
}
