//! The outcome of a weighing: a result that a chemist can use, and its uncertainty.

use super::Order;
use super::uncertainty::{self, Watched};
pub use flip_core::domain::bench_check::minimum_weight_mg;

use flip_core::domain::bench::{Standing, Tick};
use flip_core::domain::bench_check;
use flip_core::domain::weighing::Outcome;
use serde::{Deserialize, Serialize};

/// USP <41>: maximum ratio of twice the repeatability to the smallest net weight.
const USP_SHARE: f64 = 0.001;
/// Fraction of the display step below which a reading shows nothing: it is rounded to zero.
const NOTHING: f64 = 0.5;

/// Known accuracy of the balance, in addition to its readings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Accuracy {
    /// Standard deviation of ten weighings of one weight, from the bench's last check, mg; `None`:
    /// never checked.
    pub repeatability_mg: Option<f64>,
    /// Maximum ratio of twice the repeatability to the net weight, %: the user's class. Default
    /// 0.1, as in USP <41>.
    pub class_pct: f64,
}

impl Default for Accuracy {
    fn default() -> Self {
        Self { repeatability_mg: None, class_pct: 100.0 * USP_SHARE }
    }
}

/// Result of a weighing.
#[derive(Debug, Clone, PartialEq)]
pub struct Weighed {
    /// Within, under or over by the final reading; or why it ended early.
    pub outcome: Outcome,
    /// Why it ended as it did, if that needs an explanation.
    pub cause: Option<String>,
    /// Target, mg.
    pub target_mg: f64,
    /// Accepted shortfall, mg.
    pub tolerance_lower_mg: f64,
    /// Accepted excess, mg.
    pub tolerance_upper_mg: f64,
    /// Mass of the vial at the tare, mg; `None` if the balance does not report it.
    pub tare_mg: Option<f64>,
    /// Vial and powder, mg; `None` without a tare.
    pub gross_mg: Option<f64>,
    /// Mean display after the tare, mg, the zero of all readings; `None` if it was not watched.
    pub zero_mg: Option<f64>,
    /// Final reading, mg; `None` if the dose was aborted or there was no reading at rest.
    pub reading_mg: Option<f64>,
    /// Its expanded uncertainty, k = 2, mg.
    pub uncertainty_mg: f64,
    /// Whether the outcome holds over the whole uncertainty interval of the reading; `None` for
    /// outcomes to which this does not apply.
    pub proven: Option<bool>,
    /// The net weight is below the minimum weight of the balance by USP <41>, 0.10 %.
    pub below_minimum_weight: bool,
    /// The net weight is below the minimum weight of the balance in the user's class.
    pub below_class_minimum_weight: bool,
    /// The balance's own stable flag at the final reading; `None` without one.
    pub stable_by_flag: Option<bool>,
    /// Our own stability window at the final reading; `None` without one.
    pub stable_by_window: Option<bool>,
    /// Drift before anything moved, mg/min: 0 where the readings prove none; `None` if it was not
    /// watched.
    pub drift_before_mg_min: Option<f64>,
    /// Drift after the spoon was away, mg/min; `None` if it was not watched.
    pub drift_after_mg_min: Option<f64>,
    /// Final reading minus the last one while dosing, mg: powder that was in flight, or fell while
    /// the spoon was levelled.
    pub in_flight_mg: Option<f64>,
    /// Steps with a shake.
    pub shakes: u32,
    /// Bench time from the beginning to the final reading, s.
    pub seconds: f64,
    /// A person must check the bench before it moves again: the spoon may not be level and away, or
    /// a device failed.
    pub must_look: bool,
    /// The reading after the tare, then one tick for each step.
    pub ticks: Vec<Tick>,
}

/// Judge by the reading, as a chemist would: the true mass is not available on a bench. A dose too
/// small to show on the display is never within tolerance.
pub(super) fn judge(order: &Order, reading_mg: f64, shakes: usize) -> Outcome {
    let is_nothing = shakes == 0 || reading_mg < NOTHING * order.readability_mg;
    // Readings are multiples of the readability: a billionth of slack keeps 15.1 - 15 from
    // exceeding 0.1.
    match reading_mg - order.target_mg {
        excess if excess > order.tolerance_upper_mg + 1e-9 => Outcome::Over,
        excess if -excess > order.tolerance_lower_mg + 1e-9 || is_nothing => Outcome::Under,
        _ => Outcome::Within,
    }
}

/// Whether the whole uncertainty interval of the reading is on the outcome's side of the
/// tolerances.
fn proven(order: &Order, outcome: Outcome, reading_mg: f64, uncertainty_mg: f64) -> Option<bool> {
    let (low, high) = (
        reading_mg - uncertainty_mg - order.target_mg,
        reading_mg + uncertainty_mg - order.target_mg,
    );
    match outcome {
        Outcome::Within => {
            Some(-low <= order.tolerance_lower_mg + 1e-9 && high <= order.tolerance_upper_mg + 1e-9)
        }
        Outcome::Under | Outcome::Blocked => Some(-high > order.tolerance_lower_mg),
        Outcome::Over => Some(low > order.tolerance_upper_mg),
        _ => None,
    }
}

/// Repeatability as defined by USP <41>, mg: at least 0.41 steps of the display, also if it was
/// never checked.
pub fn repeatability_mg(accuracy: &Accuracy, readability_mg: f64) -> f64 {
    bench_check::repeatability_mg(accuracy.repeatability_mg.unwrap_or(0.0), readability_mg)
}

/// What is known when the loop ends.
pub(super) struct Known {
    pub(super) outcome: Outcome,
    pub(super) cause: Option<String>,
    pub(super) tare_mg: Option<f64>,
    pub(super) reading_mg: Option<f64>,
    pub(super) last_mg: Option<f64>,
    pub(super) after: Option<Standing>,
    pub(super) watched: Watched,
    pub(super) seconds: f64,
    pub(super) must_look: bool,
    pub(super) ticks: Vec<Tick>,
}

/// The result of this order.
pub(super) fn weighed(order: &Order, accuracy: &Accuracy, known: Known) -> Weighed {
    let Known { outcome, reading_mg, watched, .. } = known;
    let s = repeatability_mg(accuracy, order.readability_mg);
    let uncertainty_mg =
        uncertainty::uncertainty_mg(&watched, accuracy.repeatability_mg, order.readability_mg);
    let drift_mg_min = |rest| uncertainty::proven_mg_min(&rest, &watched, order.readability_mg);
    let is_below = |least_mg: f64| reading_mg.is_some_and(|reading_mg| reading_mg < least_mg);
    Weighed {
        outcome,
        cause: told(outcome, known.cause, &known.ticks),
        target_mg: order.target_mg,
        tolerance_lower_mg: order.tolerance_lower_mg,
        tolerance_upper_mg: order.tolerance_upper_mg,
        tare_mg: known.tare_mg,
        gross_mg: known.tare_mg.zip(reading_mg).map(|(tare_mg, reading_mg)| tare_mg + reading_mg),
        zero_mg: watched.zero.map(|rest| rest.mean_mg),
        reading_mg,
        uncertainty_mg,
        proven: reading_mg
            .and_then(|reading_mg| proven(order, outcome, reading_mg, uncertainty_mg)),
        below_minimum_weight: is_below(minimum_weight_mg(s, USP_SHARE)),
        below_class_minimum_weight: is_below(minimum_weight_mg(s, accuracy.class_pct / 100.0)),
        stable_by_flag: known.after.map(|it| it.reading.stable),
        stable_by_window: known.after.map(|it| it.still),
        drift_before_mg_min: watched.before.map(|(rest, _)| drift_mg_min(rest)),
        drift_after_mg_min: watched.last.map(drift_mg_min),
        in_flight_mg: reading_mg
            .zip(known.last_mg)
            .map(|(reading_mg, last_mg)| reading_mg - last_mg),
        shakes: known.ticks.iter().filter(|tick| tick.action.executed_shake_mm() > 0.0).count()
            as u32,
        seconds: known.seconds,
        must_look: known.must_look,
        ticks: known.ticks,
    }
}

/// The cause; an aborted dose has no reading, so the last displayed value is reported as such.
fn told(outcome: Outcome, cause: Option<String>, ticks: &[Tick]) -> Option<String> {
    match (cause, last_reading_mg(ticks)) {
        (Some(cause), Some(last_mg)) if outcome == Outcome::Aborted => Some(format!(
            "{cause}; the balance last showed {last_mg} mg, which does not say what lies in the vial"
        )),
        (cause, _) => cause,
    }
}

/// The last reading that was a number, mg; `None` if there was none.
pub(super) fn last_reading_mg(ticks: &[Tick]) -> Option<f64> {
    ticks.iter().rev().map(|tick| tick.reading.mass_mg).find(|mass_mg| mass_mg.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tolerances_are_judged_by_the_reading_on_either_side() {
        let order = Order {
            target_mg: 15.0,
            tolerance_lower_mg: 2.0,
            tolerance_upper_mg: 0.1,
            readability_mg: 1.0,
        };
        for (reading, outcome) in [
            (12.9, Outcome::Under),
            (13.0, Outcome::Within),
            (15.1, Outcome::Within),
            (15.2, Outcome::Over),
        ] {
            assert_eq!(judge(&order, reading, 1), outcome, "{reading}");
        }
        let at_least = Order { tolerance_lower_mg: 0.0, tolerance_upper_mg: 1.0, ..order };
        assert_eq!(
            (judge(&at_least, 14.9, 1), judge(&at_least, 15.0, 1)),
            (Outcome::Under, Outcome::Within)
        );
    }

    #[test]
    fn nothing_poured_is_never_within() {
        let order = Order {
            target_mg: 0.4,
            tolerance_lower_mg: 0.4,
            tolerance_upper_mg: 0.4,
            readability_mg: 1.0,
        };
        assert_eq!(
            (judge(&order, 0.0, 9), judge(&order, 0.49, 9)),
            (Outcome::Under, Outcome::Under)
        );
        assert_eq!(
            (judge(&order, 0.5, 9), judge(&order, 0.5, 0)),
            (Outcome::Within, Outcome::Under)
        );
    }

    #[test]
    fn an_outcome_is_proven_where_all_that_is_possible_is_on_its_side() {
        let order = Order {
            target_mg: 10.0,
            tolerance_lower_mg: 2.0,
            tolerance_upper_mg: 1.0,
            readability_mg: 1.0,
        };
        for (reading_mg, u_mg, is) in [
            (10.0, 1.0, Some(true)),
            (10.0, 1.1, Some(false)),
            (9.5, 1.5, Some(true)),
            (8.0, 0.1, Some(false)),
            (7.0, 0.9, Some(true)),
            (7.0, 1.0, Some(false)),
            (12.0, 0.9, Some(true)),
            (12.0, 1.0, Some(false)),
        ] {
            assert_eq!(
                proven(&order, judge(&order, reading_mg, 1), reading_mg, u_mg),
                is,
                "{reading_mg} +- {u_mg}"
            );
        }
        assert_eq!(proven(&order, Outcome::Stopped, 10.0, 0.1), None);
    }

    #[test]
    fn the_minimum_weight_is_that_of_the_pharmacopoeia() {
        let checked = |repeatability_mg| Accuracy { repeatability_mg, class_pct: 1.0 };
        let usp =
            |accuracy: &Accuracy| minimum_weight_mg(repeatability_mg(accuracy, 1.0), USP_SHARE);
        // 2000 s, and never less than 820 steps.
        assert!((usp(&checked(Some(0.6))) - 1200.0).abs() < 1e-9);
        assert!(
            (usp(&checked(Some(0.1))) - 820.0).abs() < 1e-9
                && (usp(&checked(None)) - 820.0).abs() < 1e-9
        );
        assert!((minimum_weight_mg(0.41, 0.01) - 82.0).abs() < 1e-9);
    }
}
