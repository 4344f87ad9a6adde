//! A PID rule on the missing mass: the baseline of the prior work.
//!
//! ```text
//! e_k = target - reading          s_k = e_0 + ... + e_k          d_k = e_k - e_(k-1),   e_(-1) = 0
//! share = P e_k + I s_k + D d_k   once for the incline, cut to -1..1 of 8 deg a step, once for the shake, cut to 0..1 of 16 mm
//! ```
//!
//! Below e = 0 it does nothing. There is no anti-windup, and the first difference is the whole
//! error, as in the original.
//!
//! Source: `simulation/test_pid.py` of github.com/omron-sinicx/robotic-powder-weighing, the program
//! published with Kadokawa et al., "Learning robotic powder weighing from simulation for laboratory
//! automation", IROS 2023. Its two outputs are shares of that robot's largest incline change and
//! shake; here they are shares of this robot's. There the mass is the one on the spoon, whose
//! excess equals the vial's shortfall here, so the errors are the same. Its gains are in a file
//! that was not published, so these differ ([`Pid::CHOSEN`]).

use super::controller::Done;
use super::observation::Observation;
use flip_core::domain::bench::{Action, INCLINE_CHANGE_DEG_MAX, SHAKE_MM_MAX};
use flip_core::domain::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// Gains: shares of the largest action per mg of error.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gains {
    /// Gain on the error, 1/mg; -10 to 10.
    pub p: f64,
    /// Gain on the sum of the errors so far, 1/mg; -10 to 10.
    pub i: f64,
    /// Gain on the change of the error since the last step, 1/mg; -10 to 10.
    pub d: f64,
}

/// The PID rule.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pid {
    /// Gains for the change of the pitch.
    pub incline: Gains,
    /// Gains for the shake.
    pub shake: Gains,
}

impl Pid {
    /// Set by hand: 15 mg missing tilts by 5 deg and shakes by 7 mm, and the last fall holds the
    /// next tilt back. `cargo experiment tune_schedule -- sets.json 12 1 pid` searches
    /// for them.
    pub const CHOSEN: Self = Self {
        incline: Gains { p: 0.04, i: 0.0, d: 0.05 },
        shake: Gains { p: 0.03, i: 0.0, d: 0.0 },
    };

    /// Validates the rule: its gains must be within their bounds.
    ///
    /// # Errors
    /// The first gain that is out of bounds, by its path.
    pub fn checked(self) -> Result<Self, FieldError> {
        for (output, gains) in [("incline", self.incline), ("shake", self.shake)] {
            for (name, gain) in [("p", gains.p), ("i", gains.i), ("d", gains.d)] {
                bounded(&format!("{output}.{name}"), gain, -10.0, 10.0, "1/mg")?;
            }
        }
        Ok(self)
    }

    /// Returns the action after these steps.
    pub(super) fn propose(&self, done: &[Done], seen: &Observation) -> Action {
        let error = seen.missing_mg();
        if error < 0.0 {
            return Action::default();
        }
        let before = |step: &Done| step.before.missing_mg();
        let sum = done.iter().map(before).sum::<f64>() + error;
        let change = error - done.last().map_or(0.0, before);
        let share = |gains: &Gains| gains.p * error + gains.i * sum + gains.d * change;
        Action::once(
            share(&self.incline).clamp(-1.0, 1.0) * INCLINE_CHANGE_DEG_MAX,
            share(&self.shake).clamp(0.0, 1.0) * SHAKE_MM_MAX,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Controller, Rules};
    use proptest::prelude::*;

    const NONE: Gains = Gains { p: 0.0, i: 0.0, d: 0.0 };

    fn seen(reading_mg: f64) -> Observation {
        Observation { reading_mg, target_mg: 10.0, pitch_deg: 20.0 }
    }

    #[test]
    fn proportional_action_on_a_linear_plant_closes_the_same_share_of_the_error_with_every_shake() {
        // A plant that releases 0.25 mg per mm, and a shake of 16 mm * 0.05 / mg * e = 0.8 mm /
        // mg * e: e shrinks by a factor of 0.8.
        let pid = Pid { incline: NONE, shake: Gains { p: 0.05, ..NONE } };
        let controller = Controller::Pid(pid);
        let mut dosing = controller.begin(&Rules::FLIP, 1.0);
        let mut reading_mg = 0.0;
        for k in 0..12 {
            assert!(
                (10.0 - reading_mg - 10.0 * 0.8f64.powi(k)).abs() < 1e-9,
                "after {k} shakes {reading_mg} mg"
            );
            let action = dosing.propose(&seen(reading_mg));
            assert_eq!(action.incline_change_deg, 0.0);
            reading_mg += 0.25 * action.shake_mm;
        }
    }

    #[test]
    fn sum_and_change_count_from_the_first_step_and_nothing_is_done_beyond_the_target() {
        let pid = Pid { incline: Gains { i: 0.01, ..NONE }, shake: Gains { d: 0.02, ..NONE } };
        let controller = Controller::Pid(pid);
        let mut dosing = controller.begin(&Rules::FLIP, 1.0);
        // Errors 10, 7, 7.5: sums 10, 17, 24.5; changes 10, -3, 0.5.
        let actions = [0.0, 3.0, 2.5].map(|reading| dosing.propose(&seen(reading)));
        let expected = [(0.1 * 8.0, 0.2 * 16.0), (0.17 * 8.0, 0.0), (0.245 * 8.0, 0.01 * 16.0)];
        for (action, (incline, shake)) in actions.iter().zip(expected) {
            assert!(
                (action.incline_change_deg - incline).abs() < 1e-12
                    && (action.shake_mm - shake).abs() < 1e-12
            );
        }
        assert_eq!(dosing.propose(&seen(10.5)), Action::default());
    }

    #[test]
    fn a_gain_out_of_its_bounds_is_named() {
        let bad = Pid { shake: Gains { i: f64::NAN, ..NONE }, ..Pid::CHOSEN };
        assert_eq!(bad.checked().unwrap_err().field, "shake.i");
        assert_eq!(Pid::CHOSEN.checked(), Ok(Pid::CHOSEN));
    }

    proptest! {
        #[test]
        fn whatever_it_has_seen_its_actions_are_in_range(
            gains in proptest::collection::vec(-10.0..10.0f64, 6),
            readings in proptest::collection::vec(-50.0..50.0f64, 1..12),
        ) {
            let of = |k: usize| Gains { p: gains[k], i: gains[k + 1], d: gains[k + 2] };
            let controller = Controller::Pid(Pid { incline: of(0), shake: of(3) });
            let mut dosing = controller.begin(&Rules::FLIP, 1.0);
            for reading in readings {
                let action = dosing.propose(&seen(reading));
                prop_assert!(action.incline_change_deg.abs() <= 8.0 && (0.0..=16.0).contains(&action.shake_mm));
            }
        }
    }
}
