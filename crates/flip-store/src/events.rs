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

/// An event of a transaction that is not committed yet.
#[derive(Debug)]
pub(super) struct Told {
    topic: String,
    kind: String,
    data: String,
    at: Timestamp,
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
        let (topic, kind) = (topic.to_owned(), kind.to_owned());
        self.events.push(Told { topic, kind, data: json(data)?, at: now() });
        Ok(())
    }

    /// Store the events, one writer at a time, and return the number of the last.
    pub(super) async fn tell_events(&mut self) -> Result<Option<i64>> {
        let events = std::mem::take(&mut self.events);
        if !events.is_empty() && self.store.is_postgres() {
            super::postgres::lock_events(&mut self.inner).await?;
        }
        let mut newest = None;
        for Told { topic, kind, data, at } in events {
            let sql =
                "INSERT INTO event (topic, kind, data, at) VALUES ($1, $2, $3, $4) RETURNING seq";
            let row = sqlx::query_scalar(sql).bind(topic).bind(kind).bind(data).bind(at.unix_ms());
            newest = Some(row.fetch_one(&mut *self.inner).await?);
        }
        Ok(newest)
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
        self.events.retain(|told| told.topic != topic || told.kind != kind);
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
