//! What a weighing leaves behind: a result that a chemist can use, and how sure it is.

use super::Order;
pub use crate::domain::bench_check::minimum_weight_mg;

use crate::domain::bench::{Standing, Tick};
use crate::domain::bench_check;
use crate::domain::weighing::Outcome;

/// USP <41>: twice the repeatability may be this share of the smallest net weight.
const USP_SHARE: f64 = 0.001;
/// Coverage factor of the expanded uncertainty.
const COVERAGE: f64 = 2.0;

/// What is known of the balance beside its readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Accuracy {
    /// Standard deviation of ten weighings of one weight, from the bench's last check, mg; none: never checked.
    pub repeatability_mg: Option<f64>,
    /// Largest share of the net weight that twice the repeatability may be, %: the user's class. Default 0.1, as in USP <41>.
    pub class_pct: f64,
}

impl Default for Accuracy {
    fn default() -> Self {
        Self { repeatability_mg: None, class_pct: 100.0 * USP_SHARE }
    }
}

/// How a weighing went.
#[derive(Debug, Clone, PartialEq)]
pub struct Weighed {
    /// Within, under or over by the final reading; or why it ended early.
    pub outcome: Outcome,
    /// Why it ended as it did, where that needs words.
    pub cause: Option<String>,
    /// Asked for, mg.
    pub target_mg: f64,
    /// Accepted shortfall, mg.
    pub tolerance_lower_mg: f64,
    /// Accepted excess, mg.
    pub tolerance_upper_mg: f64,
    /// What the vial weighed when it was tared, mg; none where the balance does not say.
    pub tare_mg: Option<f64>,
    /// Vial and powder, mg; none without a tare.
    pub gross_mg: Option<f64>,
    /// Final reading, mg; the last number that the balance gave where there is no final one.
    pub reading_mg: f64,
    /// Expanded uncertainty of it, k = 2, mg.
    pub uncertainty_mg: f64,
    /// The net weight is smaller than the balance may weigh by USP <41>, 0.10 %.
    pub below_minimum_weight: bool,
    /// The net weight is smaller than the balance may weigh in the user's class.
    pub below_class_minimum_weight: bool,
    /// The balance's own flag at the final reading; none without one.
    pub stable_by_flag: Option<bool>,
    /// Our own window at the final reading; none without one.
    pub stable_by_window: Option<bool>,
    /// Drift before anything moved, mg/min; none where nobody watched.
    pub drift_before_mg_min: Option<f64>,
    /// Drift after the spoon was away, mg/min; none where nobody watched.
    pub drift_after_mg_min: Option<f64>,
    /// Final reading less the last one while dosing, mg: powder that was in flight, or fell while the spoon was levelled.
    pub in_flight_mg: Option<f64>,
    /// Steps with a shake.
    pub shakes: u32,
    /// Bench time from the beginning to the final reading, s.
    pub seconds: f64,
    /// A person must look before the bench moves again: the spoon may not be level and away, or a device failed.
    pub must_look: bool,
    /// The reading after the tare, then one tick for each step.
    pub ticks: Vec<Tick>,
}

/// By the reading, as a chemist would: the true mass is not to be had on a bench.
pub(super) fn judge(order: &Order, reading_mg: f64) -> Outcome {
    // Readings are multiples of the readability: a billionth keeps 15.1 - 15 from passing 0.1.
    match reading_mg - order.target_mg {
        excess if excess > order.tolerance_upper_mg + 1e-9 => Outcome::Over,
        excess if -excess > order.tolerance_lower_mg + 1e-9 => Outcome::Under,
        _ => Outcome::Within,
    }
}

/// Expanded uncertainty of a net weight, mg.
///
/// ```text
/// U = 2 sqrt(2 (s^2 + d^2 / 12) + (D t)^2 / 3)
/// ```
///
/// | symbol | what | unit |
/// |---|---|---|
/// | s | repeatability; 0.41 d where it was never checked or is smaller | mg |
/// | d | step of the display: each of the two readings, tare and final, is rounded to it (rectangular) | mg |
/// | D | the larger of the drifts before and after: the zero may have moved by as much either way (rectangular) | mg/min |
/// | t | from the tare to the final reading | min |
///
/// It says nothing of buoyancy, nor of a balance that is not adjusted.
pub fn uncertainty_mg(repeatability_mg: f64, readability_mg: f64, drift_mg_min: f64, seconds: f64) -> f64 {
    let readings = 2.0 * (repeatability_mg.powi(2) + readability_mg.powi(2) / 12.0);
    let drift = (drift_mg_min * seconds / 60.0).powi(2) / 3.0;
    COVERAGE * (readings + drift).sqrt()
}

/// Repeatability as USP <41> takes it, mg: at least 0.41 steps of the display, also where it was never checked.
pub fn repeatability_mg(accuracy: &Accuracy, readability_mg: f64) -> f64 {
    bench_check::repeatability_mg(accuracy.repeatability_mg.unwrap_or(0.0), readability_mg)
}

/// What the loop knows at its end.
pub(super) struct Known {
    pub(super) outcome: Outcome,
    pub(super) cause: Option<String>,
    pub(super) tare_mg: Option<f64>,
    pub(super) before: Option<Standing>,
    pub(super) after: Option<Standing>,
    pub(super) seconds: f64,
    pub(super) must_look: bool,
    pub(super) ticks: Vec<Tick>,
}

/// The result of this order.
pub(super) fn weighed(order: &Order, accuracy: &Accuracy, known: Known) -> Weighed {
    let last_mg = last_reading_mg(&known.ticks);
    let final_mg = known.after.map(|it| it.reading.mass_mg).filter(|mass_mg| mass_mg.is_finite());
    let reading_mg = final_mg.unwrap_or(last_mg);
    let s = repeatability_mg(accuracy, order.readability_mg);
    let drifts = [known.before, known.after].map(|it| it.map(|standing| standing.drift_mg_min));
    let drift_mg_min =
        drifts.iter().flatten().filter(|drift| drift.is_finite()).fold(0.0, |most: f64, drift| most.max(drift.abs()));
    Weighed {
        outcome: known.outcome,
        cause: known.cause,
        target_mg: order.target_mg,
        tolerance_lower_mg: order.tolerance_lower_mg,
        tolerance_upper_mg: order.tolerance_upper_mg,
        tare_mg: known.tare_mg,
        gross_mg: known.tare_mg.map(|tare_mg| tare_mg + reading_mg),
        reading_mg,
        uncertainty_mg: uncertainty_mg(s, order.readability_mg, drift_mg_min, known.seconds),
        below_minimum_weight: reading_mg < minimum_weight_mg(s, USP_SHARE),
        below_class_minimum_weight: reading_mg < minimum_weight_mg(s, accuracy.class_pct / 100.0),
        stable_by_flag: known.after.map(|it| it.reading.stable),
        stable_by_window: known.after.map(|it| it.still),
        drift_before_mg_min: drifts[0],
        drift_after_mg_min: drifts[1],
        in_flight_mg: final_mg.map(|final_mg| final_mg - last_mg),
        shakes: known.ticks.iter().filter(|tick| tick.action.executed_shake_mm() > 0.0).count() as u32,
        seconds: known.seconds,
        must_look: known.must_look,
        ticks: known.ticks,
    }
}

/// The last reading that was a number, mg; nothing was weighed without one.
pub(super) fn last_reading_mg(ticks: &[Tick]) -> f64 {
    ticks.iter().rev().map(|tick| tick.reading.mass_mg).find(|mass_mg| mass_mg.is_finite()).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tolerances_are_judged_by_the_reading_on_either_side() {
        let order = Order { target_mg: 15.0, tolerance_lower_mg: 2.0, tolerance_upper_mg: 0.1, readability_mg: 1.0 };
        for (reading, outcome) in
            [(12.9, Outcome::Under), (13.0, Outcome::Within), (15.1, Outcome::Within), (15.2, Outcome::Over)]
        {
            assert_eq!(judge(&order, reading), outcome, "{reading}");
        }
        let at_least = Order { tolerance_lower_mg: 0.0, tolerance_upper_mg: 1.0, ..order };
        assert_eq!((judge(&at_least, 14.9), judge(&at_least, 15.0)), (Outcome::Under, Outcome::Within));
    }

    #[test]
    fn the_uncertainty_of_two_readings_of_a_balance_of_one_milligram() {
        // 2 sqrt(2 (0.41^2 + 1/12)) = 1.4183; a drift of 3 mg/min over 40 s adds 2 mg either way: 2 sqrt(0.50287 + 4/3).
        assert!((uncertainty_mg(0.41, 1.0, 0.0, 40.0) - 1.4183).abs() < 1e-3);
        assert!((uncertainty_mg(0.41, 1.0, -3.0, 40.0) - 2.7101).abs() < 1e-3);
    }

    #[test]
    fn the_minimum_weight_is_that_of_the_pharmacopoeia() {
        let checked = |repeatability_mg| Accuracy { repeatability_mg, class_pct: 1.0 };
        let usp = |accuracy: &Accuracy| minimum_weight_mg(repeatability_mg(accuracy, 1.0), USP_SHARE);
        // 2000 s, and never less than 820 steps.
        assert!((usp(&checked(Some(0.6))) - 1200.0).abs() < 1e-9);
        assert!((usp(&checked(Some(0.1))) - 820.0).abs() < 1e-9 && (usp(&checked(None)) - 820.0).abs() < 1e-9);
        assert!((minimum_weight_mg(0.41, 0.01) - 82.0).abs() < 1e-9);
    }
}
