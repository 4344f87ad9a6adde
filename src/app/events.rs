//! Live views: events as they happen, resumable by sequence number.

use super::keyring::Keyring;
use super::{App, Error, Result, Who};
use flip_store::Store;
use flip_store::events::Event;
use flip_store::jobs::job_topic;
use flip_store::weighings::weighing_topic;
use futures::StreamExt;
use futures::stream::{self, BoxStream};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

/// Number of events read at once.
const BATCH: u32 = 200;
/// How often a follower polls by itself: events written by another process are not announced here.
const LOOK: Duration = Duration::from_secs(1);

/// Which events to follow.
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
    /// Events of a topic after `after_seq` (0 is from the beginning), then new ones as they happen,
    /// in order and each once. The stream of a job or weighing ends after the event that ends it;
    /// every stream ends at shutdown, and with [`Error::TokenEnded`] when the token it was
    /// requested with ends.
    ///
    /// An `after_seq` beyond the last event stems from another data folder, or from one that was
    /// restored: it is taken as the beginning, or with [`Topic::All`] as now.
    pub async fn events(
        &self,
        topic: Topic,
        after_seq: i64,
    ) -> Result<BoxStream<'static, Result<Event>>> {
        match &topic {
            Topic::Job(id) => drop(self.job(id).await?),
            Topic::Weighing(id) => {
                self.store().weighing(id).await?.ok_or_else(|| Error::not_found("weighing", id))?;
            }
            Topic::All => {}
        }
        let newest = self.store().newest_event().await?;
        let after = match &topic {
            _ if after_seq <= newest => after_seq,
            Topic::All => newest,
            Topic::Job(_) | Topic::Weighing(_) => 0,
        };
        let follower = Follower {
            store: self.store().clone(),
            topic,
            after,
            ready: VecDeque::new(),
            newest: self.store().watch_events(),
            closing: self.inner.jobs.as_ref().map(|jobs| jobs.closing()).unwrap_or_default(),
            token: Who::now().and_then(|who| who.token),
            keyring: self.inner.keyring.clone(),
            over: false,
        };
        let next =
            async |mut follower: Follower| follower.next().await.map(|event| (event, follower));
        Ok(stream::unfold(follower, next).boxed())
    }

    /// Waits until a job or weighing has ended, at most `patience`; or until the service shuts down
    /// or the token of the request ends.
    ///
    /// # Errors
    /// `NotFound`
    pub async fn wait_for(&self, topic: Topic, patience: Duration) -> Result<()> {
        let mut events = self.events(topic, self.last_event()).await?;
        let ended = async { while let Some(Ok(_)) = events.next().await {} };
        let _patience_is_over = tokio::time::timeout(patience, ended).await;
        Ok(())
    }

    /// Sequence number of the newest event: pass it to [`App::events`] to get only new ones.
    pub fn last_event(&self) -> i64 {
        *self.store().watch_events().borrow()
    }
}

struct Follower {
    store: Store,
    topic: Topic,
    after: i64,
    ready: VecDeque<Event>,
    newest: watch::Receiver<i64>,
    closing: CancellationToken,
    /// The token it was requested with, if any.
    token: Option<String>,
    keyring: Arc<Keyring>,
    /// Nothing follows an error.
    over: bool,
}

impl Follower {
    /// The next event; `None` when there will be no more.
    async fn next(&mut self) -> Option<Result<Event>> {
        if self.over {
            return None;
        }
        let next = self.look_and_wait().await.transpose();
        self.over = !matches!(next, Some(Ok(_)));
        next
    }

    async fn look_and_wait(&mut self) -> Result<Option<Event>> {
        loop {
            if self.token.as_deref().is_some_and(|id| !self.keyring.is_good(id)) {
                return Err(Error::TokenEnded);
            }
            if let Some(event) = self.ready.pop_front() {
                self.after = event.seq;
                return Ok(Some(event));
            }
            // Before the query, so that nothing that arrives between query and wait is missed.
            self.newest.mark_unchanged();
            let ended = self.closing.is_cancelled() || self.has_ended().await?;
            self.ready = self.read().await?.into();
            if self.ready.is_empty() {
                if ended {
                    return Ok(None);
                }
                self.wait().await;
            }
        }
    }

    async fn wait(&mut self) {
        let token_ended = async {
            match &self.token {
                Some(id) => self.keyring.ended(id).await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            () = token_ended => {}
            _ = self.newest.changed() => {}
            () = tokio::time::sleep(LOOK) => {}
            () = self.closing.cancelled() => {}
        }
    }

    async fn read(&self) -> Result<Vec<Event>> {
        let topic = match &self.topic {
            Topic::Job(id) => Some(job_topic(id)),
            Topic::Weighing(id) => Some(weighing_topic(id)),
            Topic::All => None,
        };
        Ok(self.store.events_after(topic.as_deref(), self.after, BATCH).await?)
    }

    /// Whether the last event of the topic is already stored.
    async fn has_ended(&self) -> Result<bool> {
        Ok(match &self.topic {
            Topic::Job(id) => {
                self.store.job(id).await?.is_none_or(|row| row.job.state.is_terminal())
            }
            Topic::Weighing(id) => {
                self.store.weighing(id).await?.is_none_or(|row| row.weighing.outcome.is_some())
            }
            Topic::All => false,
        })
    }
}
