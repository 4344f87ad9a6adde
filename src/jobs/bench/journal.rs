//! Events of a dose as the lane receives them, kept in memory in order until they are recorded.
//!
//! A motion that may release powder waits until the event before it is committed. The way back
//! waits for nothing: after a stop the spoon is levelled at once, and the events are written as
//! soon as the database allows, at the latest before the end of the dose.

use super::condition::Condition;
use flip_bench::hardware::wire::{Direction, Exchange};
use flip_bench::weigh::{Decision, Event, Phase};
use flip_core::domain::bench::Tick;
use flip_core::domain::timestamp::Timestamp;
use flip_core::domain::vial::VialFlaw;
use flip_core::domain::weighing::WeighingState;
use flip_store::audit::About;
use flip_store::{self as store, Store, Tx, now};
use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Entries written in one transaction.
const BATCH: usize = 100;

/// Entries still to be written, in order.
#[derive(Default)]
pub(super) struct Journal {
    pending: Mutex<VecDeque<Entry>>,
    /// Serializes writing.
    writing: tokio::sync::Mutex<()>,
}

/// One event, with the wire traffic up to then.
#[derive(Clone)]
struct Entry {
    weighing: String,
    at: Timestamp,
    exchanges: Vec<Exchange>,
    said: Option<Said>,
}

#[derive(Clone)]
enum Said {
    State(WeighingState),
    Pan(VialFlaw),
    Decision(Decision),
    Tick(Tick),
}

impl Said {
    fn of(event: &Event<'_>) -> Option<Self> {
        Some(match event {
            // Committed before the bench was opened.
            Event::Phase(Phase::Armed) => return None,
            Event::Phase(Phase::Dosing) => Self::State(WeighingState::Dosing),
            Event::Phase(Phase::Settling) => Self::State(WeighingState::Settling),
            Event::Pan(flaw) => Self::Pan(**flaw),
            Event::Decision(decision) => Self::Decision((*decision).clone()),
            Event::Tick(tick) => Self::Tick(**tick),
        })
    }
}

impl Journal {
    /// Adds an event and the wire traffic before it.
    pub fn hear(&self, weighing: &str, exchanges: Vec<Exchange>, event: Option<&Event<'_>>) {
        let said = event.and_then(Said::of);
        if said.is_some() || !exchanges.is_empty() {
            let entry = Entry { weighing: weighing.to_owned(), at: now(), exchanges, said };
            self.pending().push_back(entry);
        }
    }

    /// Writes all pending entries, after any writer at work now.
    ///
    /// # Errors
    /// [`store::Error`]: unwritten entries stay pending.
    pub async fn write_down(&self, store: &Store, condition: &Condition) -> store::Result<()> {
        let _one = self.writing.lock().await;
        self.write(store, condition).await
    }

    /// The same, unless a write is in progress: that writer picks up new entries, or the next one
    /// does.
    ///
    /// # Errors
    /// As [`Self::write_down`].
    pub async fn write_if_nobody_does(
        &self,
        store: &Store,
        condition: &Condition,
    ) -> store::Result<()> {
        match self.writing.try_lock() {
            Ok(_one) => self.write(store, condition).await,
            Err(_) => Ok(()),
        }
    }

    async fn write(&self, store: &Store, condition: &Condition) -> store::Result<()> {
        loop {
            let some: Vec<Entry> = self.pending().iter().take(BATCH).cloned().collect();
            if some.is_empty() {
                return Ok(());
            }
            let mut tx = store.write_record().await?;
            for entry in &some {
                entry.write(&mut tx).await?;
            }
            tx.commit().await?;
            self.pending().drain(..some.len());
            some.iter().for_each(|entry| entry.tell(condition));
        }
    }

    fn pending(&self) -> MutexGuard<'_, VecDeque<Entry>> {
        self.pending.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Entry {
    async fn write(&self, tx: &mut Tx) -> store::Result<()> {
        let (id, at) = (&*self.weighing, self.at);
        audit_exchanges(tx, Some(id), &self.exchanges, at).await?;
        let decision = About { weighing: Some(id), kind: "decision" };
        match &self.said {
            None => Ok(()),
            Some(Said::State(state)) => tx.advance_weighing(id, *state, at).await,
            Some(Said::Pan(flaw)) => tx.audit(decision, flaw, at).await,
            Some(Said::Decision(made)) => tx.audit(decision, made, at).await,
            Some(Said::Tick(tick)) => {
                tx.insert_tick(id, tick).await?;
                tx.audit(About { weighing: Some(id), kind: "reading" }, tick, at).await
            }
        }
    }

    fn tell(&self, condition: &Condition) {
        if let Some(Said::State(state)) = &self.said {
            condition.advance(*state);
        }
    }
}

/// Records wire traffic in the audit trail.
pub(in crate::jobs) async fn audit_exchanges(
    tx: &mut Tx,
    weighing: Option<&str>,
    exchanges: &[Exchange],
    at: Timestamp,
) -> store::Result<()> {
    for exchange in exchanges {
        let kind = match exchange.direction {
            Direction::Sent => "sent",
            Direction::Received => "received",
        };
        let said = serde_json::json!({ "device": exchange.device, "text": exchange.text });
        tx.audit(About { weighing, kind }, &said, at).await?;
    }
    Ok(())
}
