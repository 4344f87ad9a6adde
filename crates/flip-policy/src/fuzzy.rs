//! A Mamdani-style fuzzy controller: the rival from the dual-arm dispensing system.
//!
//! ```text
//! inputs      missing mass: small, medium, large          fall, the mass of the last shake: none, some, much
//! strength    of a rule: product of its two memberships
//! outputs     sum over the rules of strength * centroid of the rule's output set, for the tilt and for the shake
//!
//! tilt        missing \ fall   none   some   much         shake      small -> gentle, medium -> usual, large -> strong,
//!             small            on     hold   back                    whatever fell
//!             medium           far    on     hold
//!             large            far    far    on
//! ```
//!
//! Memberships are triangles over three peaks, flat beyond the outer two, and sum to one. So do the
//! strengths, and the sum above is the centroid of the sum of the scaled output sets. With the
//! product, and with this table, more missing mass never tilts or shakes less.
//!
//! Source: Jiang et al., "Autonomous biomimetic solid dispensing using a dual-arm robotic
//! manipulator", Digital Discovery 2023 (d3dd00075c), as far as it can be read from
//! `Code/FLCBalance_client.py` of github.com/fourteenjiang/Solid-dispensing: missing mass and
//! density in, number of shakes out, nine rules in which the missing mass alone decides,
//! strength-weighted centroids. Differences: the output is the amplitude instead of the number,
//! since a step has one shake; the density is not an input here, so the last fall is used instead;
//! and there are rules for the tilt, for which that program only has the range. That program
//! combines memberships by their minimum, and its masses are up to 2 g, so the breakpoints differ
//! ([`Fuzzy::CHOSEN`]).

use super::controller::Done;
use super::observation::Observation;
use flip_core::domain::bench::{Action, INCLINE_CHANGE_DEG_MAX, SHAKE_MM_MAX};
use flip_core::domain::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// Breakpoints of the inputs and centroids of the outputs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fuzzy {
    /// Peaks of a small, medium and large missing mass, mg; rising, 0 to 1000.
    pub missing_mg: [f64; 3],
    /// Peaks of no, some and much fall, mg; rising, 0 to 1000.
    pub fall_mg: [f64; 3],
    /// Change of the pitch for *back*, *hold*, *on* and *far*, degrees; rising, -8 to 8.
    pub tilt_deg: [f64; 4],
    /// Amplitude of a gentle, usual and strong shake, mm; rising, 0 to 16.
    pub shake_mm: [f64; 3],
}

const BACK: usize = 0;
const HOLD: usize = 1;
const ON: usize = 2;
const FAR: usize = 3;

/// Rules for the tilt: by missing mass, then by fall.
const TILT: [[usize; 3]; 3] = [[ON, HOLD, BACK], [FAR, ON, HOLD], [FAR, FAR, ON]];

impl Fuzzy {
    /// Set by hand for doses of about 20 mg. `cargo experiment tune_schedule --
    /// sets.json 12 1 fuzzy` searches for them.
    pub const CHOSEN: Self = Self {
        missing_mg: [1.0, 5.0, 15.0],
        fall_mg: [0.0, 2.0, 6.0],
        tilt_deg: [-4.0, 0.0, 4.0, 8.0],
        shake_mm: [2.0, 6.0, 14.0],
    };

    /// Validates the controller: its numbers must rise within their bounds.
    ///
    /// # Errors
    /// The first field that does not.
    pub fn checked(self) -> Result<Self, FieldError> {
        let rising = |field: &str, values: &[f64], lower: f64, upper: f64, unit: &str| {
            values
                .iter()
                .try_for_each(|value| bounded(field, *value, lower, upper, unit).map(|_| ()))?;
            match values.windows(2).all(|pair| pair[0] < pair[1]) {
                true => Ok(()),
                false => Err(FieldError::new(field, "must rise from each number to the next")),
            }
        };
        rising("missing_mg", &self.missing_mg, 0.0, 1000.0, "mg")?;
        rising("fall_mg", &self.fall_mg, 0.0, 1000.0, "mg")?;
        rising("tilt_deg", &self.tilt_deg, -INCLINE_CHANGE_DEG_MAX, INCLINE_CHANGE_DEG_MAX, "deg")?;
        rising("shake_mm", &self.shake_mm, 0.0, SHAKE_MM_MAX, "mm")?;
        Ok(self)
    }

    /// Returns the action after these steps. Before the first shake nothing has fallen.
    pub(super) fn propose(&self, done: &[Done], seen: &Observation) -> Action {
        let shaken = done.iter().rfind(|step| step.action.executed_shake_mm() > 0.0);
        let fall_mg = shaken.map_or(0.0, |step| step.after.reading_mg - step.before.reading_mg);
        let missing = memberships(&self.missing_mg, seen.missing_mg());
        let fall = memberships(&self.fall_mg, fall_mg);
        let rules = (0..3).flat_map(|m| (0..3).map(move |f| (m, f)));
        // Sums of strengths may slightly exceed one.
        Action::once(
            rules
                .map(|(m, f)| missing[m] * fall[f] * self.tilt_deg[TILT[m][f]])
                .sum::<f64>()
                .clamp(-INCLINE_CHANGE_DEG_MAX, INCLINE_CHANGE_DEG_MAX),
            (0..3).map(|m| missing[m] * self.shake_mm[m]).sum::<f64>().clamp(0.0, SHAKE_MM_MAX),
        )
    }
}

/// Memberships of a number in three sets: triangles over rising peaks, the outer two flat beyond
/// theirs.
fn memberships(peaks: &[f64; 3], x: f64) -> [f64; 3] {
    let share = |from: f64, to: f64| ((x - from) / (to - from)).clamp(0.0, 1.0);
    let (first, second) = (share(peaks[0], peaks[1]), share(peaks[1], peaks[2]));
    [1.0 - first, first - second, second]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Controller, Rules};
    use proptest::prelude::*;

    const PLAIN: Fuzzy = Fuzzy {
        missing_mg: [1.0, 5.0, 15.0],
        fall_mg: [0.0, 2.0, 6.0],
        tilt_deg: [-4.0, 0.0, 4.0, 8.0],
        shake_mm: [2.0, 6.0, 14.0],
    };

    fn seen(missing_mg: f64) -> Observation {
        Observation { reading_mg: 20.0 - missing_mg, target_mg: 20.0, pitch_deg: 25.0 }
    }

    /// The controller's answer for this missing mass and this fall in the last shake.
    fn answer(fuzzy: &Fuzzy, missing_mg: f64, fall_mg: f64) -> Action {
        let action = Action::once(0.0, 5.0);
        fuzzy.propose(
            &[Done { before: seen(missing_mg + fall_mg), action, after: seen(missing_mg) }],
            &seen(missing_mg),
        )
    }

    #[test]
    fn at_the_peaks_each_rule_speaks_alone() {
        for (m, missing_mg) in PLAIN.missing_mg.into_iter().enumerate() {
            for (f, fall_mg) in PLAIN.fall_mg.into_iter().enumerate() {
                let action = answer(&PLAIN, missing_mg, fall_mg);
                assert!((action.incline_change_deg - PLAIN.tilt_deg[TILT[m][f]]).abs() < 1e-12);
                assert!((action.shake_mm - PLAIN.shake_mm[m]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn between_the_peaks_the_rules_are_weighed() {
        // Half small, half medium; three quarters none, one quarter some: 0.375 on, 0.125 hold,
        // 0.375 far, 0.125 on.
        let action = answer(&PLAIN, 3.0, 0.5);
        assert!(
            (action.incline_change_deg - (0.375 * 4.0 + 0.375 * 8.0 + 0.125 * 4.0)).abs() < 1e-12
        );
        assert!((action.shake_mm - 4.0).abs() < 1e-12);
    }

    #[test]
    fn only_a_step_that_shook_says_what_falls() {
        let shook = Done { before: seen(18.0), action: Action::once(0.0, 5.0), after: seen(12.0) };
        let tilted = Done { before: seen(12.0), action: Action::default(), after: seen(12.0) };
        assert_eq!(
            PLAIN.propose(&[shook, tilted], &seen(12.0)),
            PLAIN.propose(&[shook], &seen(12.0))
        );
        assert_ne!(PLAIN.propose(&[tilted], &seen(12.0)), PLAIN.propose(&[shook], &seen(12.0)));
        let first = Controller::Fuzzy(PLAIN).begin(&Rules::FLIP, 1.0).propose(&seen(20.0));
        assert_eq!(first, Action::once(8.0, 14.0));
    }

    #[test]
    fn numbers_that_do_not_rise_are_named() {
        let bad = Fuzzy { fall_mg: [0.0, 2.0, 2.0], ..PLAIN };
        assert_eq!(bad.checked().unwrap_err().field, "fall_mg");
        let bad = Fuzzy { tilt_deg: [-9.0, 0.0, 4.0, 8.0], ..PLAIN };
        assert_eq!(bad.checked().unwrap_err().field, "tilt_deg");
        assert_eq!(Fuzzy::CHOSEN.checked(), Ok(Fuzzy::CHOSEN));
    }

    proptest! {
        #[test]
        fn memberships_lie_within_0_and_1_and_sum_to_one(a in 0.0..10.0f64, b in 0.01..10.0f64, c in 0.01..10.0f64, x in -50.0..50.0f64) {
            let found = memberships(&[a, a + b, a + b + c], x);
            prop_assert!(found.iter().all(|m| (-1e-12..=1.0 + 1e-12).contains(m)));
            prop_assert!((found.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }

        #[test]
        fn more_missing_never_tilts_or_shakes_less_and_more_fall_never_tilts_more(
            missing in -5.0..40.0f64, more in 0.0..10.0f64, fall in -2.0..20.0f64, tuned: bool,
        ) {
            let fuzzy = if tuned { Fuzzy::CHOSEN } else { PLAIN };
            let (less, much) = (answer(&fuzzy, missing, fall), answer(&fuzzy, missing + more, fall));
            prop_assert!(much.incline_change_deg >= less.incline_change_deg - 1e-9 && much.shake_mm >= less.shake_mm - 1e-9);
            prop_assert!(answer(&fuzzy, missing, fall + more).incline_change_deg <= less.incline_change_deg + 1e-9);
            prop_assert!(less.incline_change_deg.abs() <= 8.0 && (0.0..=16.0).contains(&less.shake_mm));
        }
    }
}
