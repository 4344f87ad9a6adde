//! Tells webhooks of ends, for as long as the service runs.
//!
//! Every webhook has a task of its own, so one that does not answer delays no other. A message is
//! repeated, the longer the rarer, until the address accepts it or a day has passed; then the next
//! one is tried.

use super::wire::Answer;
use crate::app::{App, BENCH_TOPIC, Event, Job, Topic, WebhookRow, Weighing};
use futures::StreamExt;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::time::Duration;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// How often webhooks that were added or removed are looked for.
const LOOK: Duration = Duration::from_secs(1);
/// Waits between the attempts of one message; the last is repeated.
const WAITS_S: [u64; 6] = [1, 5, 30, 120, 600, 3600];
/// How long a message is tried.
const TRIED: Duration = Duration::from_secs(24 * 60 * 60);
/// Events of no interest after which it is noted that they were passed over.
const PASSED_MAX: u32 = 500;

/// Keeps telling until the service closes.
pub async fn keep(app: App, closing: CancellationToken) {
    let mut told: HashMap<String, JoinHandle<()>> = HashMap::new();
    while !closing.is_cancelled() {
        match app.webhook_rows().await {
            Ok(mut rows) => {
                // Of several processes that serve a database, one tells.
                if !app.tells_webhooks().await {
                    rows.clear();
                }
                told.retain(|id, task| {
                    let stays = rows.iter().any(|row| row.webhook.id == *id) && !task.is_finished();
                    if !stays {
                        task.abort();
                    }
                    stays
                });
                for row in rows {
                    let id = row.webhook.id.clone();
                    told.entry(id).or_insert_with(|| tokio::spawn(tell(app.clone(), row)));
                }
            }
            Err(error) => tracing::warn!(%error, "the webhooks could not be read"),
        }
        tokio::select! {
            () = closing.cancelled() => {}
            () = tokio::time::sleep(LOOK) => {}
        }
    }
    told.into_values().for_each(|task| task.abort());
}

/// Tells one webhook; ends when events cannot be read, and is then begun again.
async fn tell(app: App, row: WebhookRow) {
    let Ok(mut events) = app.events(Topic::All, row.seq).await else { return };
    let mut passed = 0;
    while let Some(Ok(event)) = events.next().await {
        let done = match message(&event) {
            Some(body) => {
                passed = 0;
                deliver(&app, &row, event.seq, &body).await
            }
            None => {
                passed += 1;
                match passed % PASSED_MAX {
                    0 => app.skip_for_webhook(&row.webhook.id, event.seq).await.is_ok(),
                    _ => true,
                }
            }
        };
        if !done {
            return;
        }
    }
}

/// Whether a message was accepted, or given up.
async fn deliver(app: &App, row: &WebhookRow, seq: i64, body: &Value) -> bool {
    let begun = tokio::time::Instant::now();
    for k in 0.. {
        match app.send_to_webhook(row, seq, body.to_string()).await {
            Ok(true) => return true,
            Ok(false) => {}
            Err(error) => {
                tracing::warn!(%error, webhook = row.webhook.id, "a message was not noted")
            }
        }
        if begun.elapsed() > TRIED {
            tracing::warn!(webhook = row.webhook.id, seq, "a message was given up after a day");
            return app.skip_for_webhook(&row.webhook.id, seq).await.is_ok();
        }
        let wait = WAITS_S[k.min(WAITS_S.len() - 1)];
        tokio::time::sleep(Duration::from_secs(wait)).await;
    }
    true
}

/// The message of an event that somebody waits for: the end of a weighing or a job, a latch.
fn message(event: &Event) -> Option<Value> {
    let (kind, data) = if event.topic == BENCH_TOPIC && event.kind == "latched" {
        ("bench.latched", event.data.clone())
    } else if event.kind != "state" {
        return None;
    } else if event.topic.starts_with("weighing:") {
        let weighing: Weighing = serde_json::from_value(event.data.clone()).ok()?;
        weighing.outcome?;
        ("weighing.ended", json!(weighing.wire()))
    } else if event.topic.starts_with("job:") {
        let job: Job = serde_json::from_value(event.data.clone()).ok()?;
        if !job.state.is_terminal() {
            return None;
        }
        ("job.ended", json!(job.wire()))
    } else {
        return None;
    };
    Some(json!({ "type": kind, "timestamp": event.at, "seq": event.seq, "data": data }))
}
