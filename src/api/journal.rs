//! The bench journal for operations staff: a log line for each start, end, latch and clearance, and
//! metrics of each dose.
//!
//! It follows the committed events, like every live view, so no way of starting, ending or latching
//! can be missed here.

use crate::app::{App, BENCH_TOPIC, Event, Topic, Weighing};
use flip_core::domain::weighing::{Outcome, WeighingState};
use futures::StreamExt;
use metrics::{counter, histogram};
use serde_json::Value;
use std::time::Duration;
use tokio_util::sync::CancellationToken;
use tracing::Level;

/// Delay before following the events again after reading them failed.
const AGAIN: Duration = Duration::from_secs(1);

/// Keeps the journal from now on until the service closes.
pub async fn keep(app: App, closing: CancellationToken) {
    let mut last = app.last_event();
    while !closing.is_cancelled() {
        match app.events(Topic::All, last).await {
            Ok(mut events) => {
                while let Some(Ok(event)) = events.next().await {
                    last = event.seq;
                    tell(&event);
                }
            }
            Err(error) => tracing::warn!(%error, "what happens on the bench could not be followed"),
        }
        tokio::select! {
            () = closing.cancelled() => {}
            () = tokio::time::sleep(AGAIN) => {}
        }
    }
}

fn tell(event: &Event) {
    if event.topic == BENCH_TOPIC {
        return bench(&event.kind, &event.data);
    }
    if event.topic.starts_with("weighing:") && event.kind == "state" {
        match serde_json::from_value::<Weighing>(event.data.clone()) {
            Ok(weighing) => dose(&weighing),
            Err(error) => {
                tracing::warn!(%error, topic = event.topic, "a weighing's event cannot be read")
            }
        }
    }
}

/// Logs what happened to the bench.
fn bench(kind: &str, data: &Value) {
    let text = |field: &str| data.get(field).and_then(Value::as_str).unwrap_or_default();
    let (weighing, by) = (text("weighing"), text("by"));
    match kind {
        "latched" => {
            counter!("flip_bench_latches_total").increment(1);
            tracing::warn!(
                weighing,
                reason = text("reason"),
                "the bench is latched until a person has looked"
            );
        }
        "cleared" => tracing::info!(by, note = text("note"), "the bench was cleared"),
        // Logged by the doses that change it.
        "vial" => {}
        other => tracing::info!(by, weighing, reason = text("reason"), "the bench is {other}"),
    }
}

/// Logs how a dose ended; a macro because the level must be known at compile time.
macro_rules! ended {
    ($level:expr, $weighing:expr, $outcome:expr) => {
        tracing::event!(
            $level,
            weighing = $weighing.id,
            powder = $weighing.powder,
            target_mg = $weighing.target_mg,
            reading_mg = $weighing.reading_mg,
            error_mg = $weighing.error_mg,
            shakes = $weighing.shakes,
            seconds = $weighing.seconds,
            cause = $weighing.error.as_deref(),
            "a dose ended: {}",
            word(&$outcome)
        )
    };
}

/// Logs the state of a dose; records metrics of one that ran.
fn dose(weighing: &Weighing) {
    let Weighing { id, powder, target_mg, .. } = weighing;
    let (lot, vial) = (weighing.asked.lot.as_deref(), weighing.asked.vial.as_deref());
    let Some(outcome) = weighing.outcome else {
        let state = word(&weighing.state);
        return match weighing.state {
            WeighingState::Armed => {
                tracing::info!(weighing = id, powder, target_mg, lot, vial, "a dose begins")
            }
            _ => tracing::info!(weighing = id, powder, target_mg, vial, "a dose is {state}"),
        };
    };
    match outcome {
        Outcome::Within
        | Outcome::Under
        | Outcome::Blocked
        | Outcome::Stopped
        | Outcome::Probed => {
            ended!(Level::INFO, weighing, outcome)
        }
        Outcome::Over | Outcome::NotStable | Outcome::Aborted | Outcome::Unknown => {
            ended!(Level::WARN, weighing, outcome)
        }
    }
    measure(weighing, word(&outcome));
}

/// Counts every end; records error, duration and shakes of doses that ran their course.
fn measure(weighing: &Weighing, outcome: String) {
    let bench = weighing.bench.map_or_else(|| "none".to_owned(), |bench| word(&bench));
    let labels = [("bench", bench), ("outcome", outcome)];
    counter!("flip_doses_total", &labels).increment(1);
    if weighing.state != WeighingState::Done {
        return;
    }
    if let Some(error_mg) = weighing.error_mg {
        histogram!("flip_dose_error_mg", &labels).record(error_mg.abs());
    }
    if let Some(seconds) = weighing.seconds {
        histogram!("flip_dose_seconds", &labels).record(seconds);
    }
    if let Some(shakes) = weighing.shakes {
        histogram!("flip_dose_shakes", &labels).record(f64::from(shakes));
    }
}

/// An enum's variant as written elsewhere in the API.
pub(super) fn word(variant: &impl serde::Serialize) -> String {
    serde_json::to_value(variant)
        .ok()
        .and_then(|json| json.as_str().map(str::to_owned))
        .unwrap_or_default()
}
