//! The guard: the policy proposes, the guard disposes.
//!
//! Only what [`guard`] returns reaches a device. It is a pure function of what has been read and done, so every rule can
//! be tested as a table.

use crate::domain::bench::{Action, INCLINE_CHANGE_DEG_MAX, PitchLimits, Reading, SHAKE_MM_MAX};

/// What a weighing may do at most.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Range of the spoon's pitch.
    pub pitch: PitchLimits,
    /// Steps before the weighing ends.
    pub steps_max: u32,
    /// A reading may fall by this much between two steps before the vial counts as moved, mg. Default 3: three steps of
    /// a 1 mg balance.
    pub fall_mg_max: f64,
}

impl Limits {
    /// Limits of a weighing within this frame.
    pub fn new(pitch: PitchLimits, steps_max: u32) -> Self {
        Self { pitch, steps_max, fall_mg_max: 3.0 }
    }
}

/// What is known before a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Situation {
    /// Target, mg.
    pub target_mg: f64,
    /// Steps carried out.
    pub steps: u32,
    /// Pitch now, degrees.
    pub pitch_deg: f64,
    /// Reading before the last step.
    pub before: Reading,
    /// Reading now.
    pub now: Reading,
}

/// Why no further action may reach a device.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Halt {
    /// The balance shows the target or more: nothing may be added.
    #[error("the balance shows the target")]
    TargetReached,
    /// Every step is spent.
    #[error("every step is spent")]
    StepsSpent,
    /// The reading is not a stable number.
    #[error("the balance gives no stable reading: keep draughts and vibration away and tare again")]
    NotStable,
    /// The reading fell.
    #[error("the reading fell by {fell_mg} mg: the vial was moved or lifted")]
    VialMoved {
        /// By how much, mg.
        fell_mg: f64,
    },
    /// The proposal is not a number.
    #[error("the policy proposed an action that is not a number")]
    NotAnAction,
}

impl Halt {
    /// The weighing has run its course; nothing is wrong.
    pub fn is_expected(&self) -> bool {
        matches!(self, Self::TargetReached | Self::StepsSpent)
    }
}

/// The action that may be carried out: the proposal within its bounds and the spoon's.
///
/// # Errors
/// [`Halt`] when nothing may be carried out; the first rule that applies, in the order of the variants' severity:
/// unusable reading, moved vial, target reached, steps spent, unusable proposal.
pub fn guard(limits: &Limits, seen: &Situation, proposed: Action) -> Result<Action, Halt> {
    if !seen.now.stable || !seen.now.mass_mg.is_finite() || !seen.pitch_deg.is_finite() {
        return Err(Halt::NotStable);
    }
    let fell_mg = seen.before.mass_mg - seen.now.mass_mg;
    if fell_mg > limits.fall_mg_max {
        return Err(Halt::VialMoved { fell_mg });
    }
    if seen.now.mass_mg >= seen.target_mg {
        return Err(Halt::TargetReached);
    }
    if seen.steps >= limits.steps_max {
        return Err(Halt::StepsSpent);
    }
    if !proposed.incline_change_deg.is_finite() || !proposed.shake_mm.is_finite() {
        return Err(Halt::NotAnAction);
    }
    let change = proposed.incline_change_deg.clamp(-INCLINE_CHANGE_DEG_MAX, INCLINE_CHANGE_DEG_MAX);
    let pitch = (seen.pitch_deg + change).clamp(limits.pitch.lower_deg, limits.pitch.upper_deg);
    Ok(Action { incline_change_deg: pitch - seen.pitch_deg, shake_mm: proposed.shake_mm.clamp(0.0, SHAKE_MM_MAX) })
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { pitch: PitchLimits::PAPER, steps_max: 10, fall_mg_max: 3.0 };

    fn seen() -> Situation {
        let reading = |mass_mg| Reading { mass_mg, stable: true };
        Situation { target_mg: 15.0, steps: 3, pitch_deg: 30.0, before: reading(4.0), now: reading(6.0) }
    }

    fn action(incline_change_deg: f64, shake_mm: f64) -> Action {
        Action { incline_change_deg, shake_mm }
    }

    #[test]
    fn a_proposal_is_cut_to_the_bounds_of_action_and_spoon() {
        for (proposed, allowed) in [
            (action(4.0, 8.0), action(4.0, 8.0)),
            (action(90.0, 8.0), action(6.0, 8.0)),
            (action(-90.0, -5.0), action(-8.0, 0.0)),
            (action(0.0, 1e9), action(0.0, 16.0)),
        ] {
            assert_eq!(guard(&LIMITS, &seen(), proposed), Ok(allowed));
        }
    }

    #[test]
    fn nothing_moves_when_something_is_wrong_or_enough_is_in_the_vial() {
        let at = |change: fn(&mut Situation)| {
            let mut situation = seen();
            change(&mut situation);
            guard(&LIMITS, &situation, action(1.0, 5.0)).unwrap_err()
        };
        assert_eq!(at(|s| s.now.mass_mg = 15.0), Halt::TargetReached);
        assert_eq!(at(|s| s.now.mass_mg = 40.0), Halt::TargetReached);
        assert_eq!(at(|s| s.steps = 10), Halt::StepsSpent);
        assert_eq!(at(|s| s.now.stable = false), Halt::NotStable);
        assert_eq!(at(|s| s.now.mass_mg = f64::NAN), Halt::NotStable);
        assert_eq!(at(|s| s.now.mass_mg = 0.0), Halt::VialMoved { fell_mg: 4.0 });
        assert_eq!(guard(&LIMITS, &seen(), action(f64::NAN, 5.0)), Err(Halt::NotAnAction));
        assert_eq!(guard(&LIMITS, &seen(), action(1.0, f64::INFINITY)), Err(Halt::NotAnAction));
    }

    #[test]
    fn a_lifted_vial_counts_before_a_target_that_is_reached() {
        let mut situation = seen();
        (situation.before.mass_mg, situation.now.mass_mg) = (50.0, 20.0);
        assert_eq!(guard(&LIMITS, &situation, action(1.0, 5.0)), Err(Halt::VialMoved { fell_mg: 30.0 }));
    }
}
