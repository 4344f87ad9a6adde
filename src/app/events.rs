//! Live views: events as they happen, resumable by their sequence number.

use super::{App, Result};
use crate::store::events::Event;
use futures::stream::BoxStream;

/// Whose events to follow.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Topic {
    /// Of one job, by id.
    Job(String),
    /// Of one weighing, by id.
    Weighing(String),
    /// All.
    All,
}

impl App {
    /// Events of a topic after `after_seq` (0 is from the beginning), then new ones as they happen, in order and
    /// each once. The stream of a job or weighing ends after the event that ends it; every stream ends at shutdown.
    pub async fn events(&self, _topic: Topic, _after_seq: i64) -> Result<BoxStream<'static, Result<Event>>> {
        self.stub()
    }

    /// Sequence number of the newest event: pass it to [`App::events`] to hear only what is new.
    pub fn last_event(&self) -> i64 {
        0
    }
}
