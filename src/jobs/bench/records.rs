//! Stops that are not written down yet: the arm has been told, and the record follows when the database lets it.

use super::condition::Halted;
use flip_store::who::acting_maybe;
use flip_store::{self as store, Store};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::Notify;
use tokio::task::AbortHandle;

/// Pause before a record that could not be written is tried again.
const AGAIN: Duration = Duration::from_millis(500);
/// Stops written in one transaction.
const BATCH: usize = 100;

/// What is to be written down, in order.
#[derive(Default)]
pub(super) struct Records {
    pending: Mutex<VecDeque<Halted>>,
    /// One writes at a time.
    writing: tokio::sync::Mutex<()>,
    wake: Notify,
    task: Mutex<Option<AbortHandle>>,
}

impl Records {
    /// Write this down when it can be.
    pub fn push(&self, halted: Halted) {
        self.pending().push_back(halted);
        self.wake.notify_one();
    }

    /// Write down all that waits.
    ///
    /// # Errors
    /// [`store::Error`]: what was not written still waits.
    pub async fn write_down(&self, store: &Store) -> store::Result<()> {
        let _one = self.writing.lock().await;
        loop {
            let some: Vec<Halted> = self.pending().iter().take(BATCH).cloned().collect();
            if some.is_empty() {
                return Ok(());
            }
            let mut tx = store.write().await?;
            for Halted { weighing, held, who } in &some {
                acting_maybe(who.clone(), tx.audit_person(weighing.as_deref(), "stop", held.at)).await?;
                tx.hold_bench(held).await?;
            }
            tx.commit().await?;
            self.pending().drain(..some.len());
        }
    }

    /// Write down what comes, until this is closed.
    pub fn keep_writing(self: &Arc<Self>, store: &Store) {
        let (records, store) = (self.clone(), store.clone());
        let task = tokio::spawn(async move {
            loop {
                records.wake.notified().await;
                while let Err(error) = records.write_down(&store).await {
                    tracing::warn!(%error, "a stop is not written down yet");
                    tokio::time::sleep(AGAIN).await;
                }
            }
        });
        *self.task() = Some(task.abort_handle());
    }

    /// Write down what waits a last time.
    pub async fn close(&self, store: &Store) {
        {
            // Not between what is stored and what is forgotten here.
            let _one = self.writing.lock().await;
            self.abandon();
        }
        if let Err(error) = self.write_down(store).await
            && !error.is_closed()
        {
            tracing::error!(%error, "a stop was not written down");
        }
    }

    /// Nobody writes any more.
    pub fn abandon(&self) {
        if let Some(task) = self.task().take() {
            task.abort();
        }
    }

    fn task(&self) -> MutexGuard<'_, Option<AbortHandle>> {
        self.task.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn pending(&self) -> MutexGuard<'_, VecDeque<Halted>> {
        self.pending.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
