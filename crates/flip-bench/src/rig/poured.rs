//! How a dose ended.

use crate::weigh::Weighed;
use flip_core::domain::apparatus::Stroke;
use flip_core::domain::bench::Tick;
use flip_core::domain::weighing::{MeasuredMass, Outcome};

/// How a dose ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Poured {
    /// Outcome.
    pub outcome: Outcome,
    /// True mass in the vial, mg; unknown on devices.
    pub dispensed_mg: Option<f64>,
    /// Final reading, mg; none if the dose was aborted or there was no reading once everything was
    /// at rest.
    pub reading_mg: Option<f64>,
    /// Further measurement data for that reading.
    pub measured: Option<MeasuredMass>,
    /// Number of shakes.
    pub shakes: u32,
    /// Bench time, s.
    pub seconds: f64,
    /// Actions and readings, in order.
    pub ticks: Vec<Tick>,
    /// How the arm strokes; none if it was not opened.
    pub stroke: Option<Stroke>,
    /// Why it ended as it did, if that needs explaining.
    pub error: Option<String>,
    /// Why a person must check the bench before anything moves again.
    pub must_look: Option<String>,
}

impl Poured {
    /// Nothing has moved.
    pub fn not_begun(cause: String) -> Self {
        Self {
            outcome: Outcome::Aborted,
            dispensed_mg: None,
            reading_mg: None,
            measured: None,
            shakes: 0,
            seconds: 0.0,
            ticks: Vec::new(),
            stroke: None,
            error: Some(cause),
            must_look: None,
        }
    }

    pub(super) fn of(weighed: Weighed, dispensed_mg: Option<f64>) -> Self {
        let measured = |net_mg| MeasuredMass {
            tare_mg: weighed.tare_mg,
            gross_mg: weighed.gross_mg,
            zero_mg: weighed.zero_mg,
            net_mg,
            uncertainty_mg: weighed.uncertainty_mg,
            proven: weighed.proven,
            stable_by_balance: weighed.stable_by_flag.unwrap_or(false),
            stable_by_window: weighed.stable_by_window.unwrap_or(false),
            drift_before_mg_min: weighed.drift_before_mg_min,
            drift_after_mg_min: weighed.drift_after_mg_min,
            in_flight_mg: weighed.in_flight_mg,
            ..MeasuredMass::default()
        };
        let must_look = weighed
            .must_look
            .then(|| weighed.cause.clone().unwrap_or_else(|| "a device failed".to_owned()));
        Self {
            outcome: weighed.outcome,
            dispensed_mg,
            reading_mg: weighed.reading_mg,
            measured: weighed.reading_mg.filter(|_| weighed.stable_by_flag.is_some()).map(measured),
            shakes: weighed.shakes,
            seconds: weighed.seconds,
            ticks: weighed.ticks,
            stroke: None,
            error: weighed.cause,
            must_look,
        }
    }

    /// The arm has latched itself: a person must check it, and gets the reason in the arm's own
    /// words.
    pub(super) fn with_latch(self, cause: &str) -> Self {
        let said = format!(
            "the arm is latched: {cause}. Look at spoon, vial and arm, then clear the bench"
        );
        // A latched arm refuses every command: that refusal is not the cause.
        let is_refusal = |error: &String| {
            ["the arm must not do this now", "the arm is latched"]
                .iter()
                .any(|refused| error.contains(refused))
        };
        let error = match self.error.filter(|error| !is_refusal(error)) {
            Some(error) => format!("{said}; before that: {error}"),
            None => said,
        };
        Self { error: Some(error.clone()), must_look: Some(error), ..self }
    }
}
