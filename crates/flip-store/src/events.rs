//! The event log, in order: the source of every live view.

use super::row::{Columns, json};
use super::{Result, Store, Tx, now};
use flip_core::domain::timestamp::Timestamp;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;
use tokio::sync::watch;

/// An event of a job or a weighing, or a choice of the current simulator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Event {
    /// Position in the order of all events; the `id:` of a server-sent event.
    pub seq: i64,
    /// `job:<id>`, `weighing:<id>`, `simulator` or `bench`.
    pub topic: String,
    /// `state`, `progress`, `trial`, `episode` or `checkpoint_lost` of a job; `state` or `tick` of
    /// a weighing; `current` of the simulator; `latched` or `cleared` of the bench.
    pub kind: String,
    /// Contents; the fields depend on the kind.
    pub data: serde_json::Value,
    /// When.
    pub at: Timestamp,
}

/// The number of the latest event, 0 if there is none.
pub(super) const NEWEST: &str = "SELECT coalesce(max(seq), 0) FROM event";

/// Tell watchers of an event, unless they know of a later one.
pub(super) fn tell(watchers: &watch::Sender<i64>, seq: i64) {
    watchers.send_if_modified(|newest| std::mem::replace(newest, seq.max(*newest)) < seq);
}

impl Store {
    /// Events after `after`, oldest first, at most `limit`; of one topic if given.
    pub async fn events_after(
        &self,
        topic: Option<&str>,
        after: i64,
        limit: u32,
    ) -> Result<Vec<Event>> {
        let query = match topic {
            Some(topic) => sqlx::query(
                "SELECT * FROM event WHERE topic = $3 AND seq > $1 ORDER BY seq LIMIT $2",
            )
            .bind(after)
            .bind(i64::from(limit))
            .bind(topic),
            None => sqlx::query("SELECT * FROM event WHERE seq > $1 ORDER BY seq LIMIT $2")
                .bind(after)
                .bind(i64::from(limit)),
        };
        query.fetch_all(&self.reader).await?.iter().map(event).collect()
    }

    /// Number of the latest event, whichever process wrote it; 0 if there is none.
    pub async fn newest_event(&self) -> Result<i64> {
        Ok(sqlx::query_scalar(NEWEST).fetch_one(&self.reader).await?)
    }

    /// Watches the number of the latest committed event.
    pub fn watch_events(&self) -> watch::Receiver<i64> {
        self.newest_event.subscribe()
    }
}

impl Tx {
    /// Emit an event; followers are notified once the transaction is committed.
    pub async fn emit(&mut self, topic: &str, kind: &str, data: &impl Serialize) -> Result<()> {
        let sql = "INSERT INTO event (topic, kind, data, at) VALUES ($1, $2, $3, $4) RETURNING seq";
        let seq = sqlx::query_scalar(sql)
            .bind(topic)
            .bind(kind)
            .bind(json(data)?)
            .bind(now().unix_ms())
            .fetch_one(&mut *self.inner)
            .await?;
        self.newest_event = Some(seq);
        Ok(())
    }

    /// Like [`Tx::emit`], but only the latest event of this kind is kept: a client that resumes
    /// does not need old progress.
    pub async fn emit_latest(
        &mut self,
        topic: &str,
        kind: &str,
        data: &impl Serialize,
    ) -> Result<()> {
        let sql = "DELETE FROM event WHERE topic = $1 AND kind = $2";
        sqlx::query(sql).bind(topic).bind(kind).execute(&mut *self.inner).await?;
        self.emit(topic, kind, data).await
    }
}

fn event(row: &AnyRow) -> Result<Event> {
    Ok(Event {
        seq: row.plain("seq")?,
        topic: row.plain("topic")?,
        kind: row.plain("kind")?,
        data: row.json("data")?,
        at: row.time("at")?,
    })
}
