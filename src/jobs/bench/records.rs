//! Stops that are not recorded yet: the arm has been notified, and the record follows when the
//! database allows.

use super::condition::Halted;
use flip_store::who::acting_maybe;
use flip_store::{self as store, Store};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::Notify;
use tokio::task::AbortHandle;

/// Delay before retrying a record that could not be written.
const AGAIN: Duration = Duration::from_millis(500);
/// Stops written in one transaction.
const BATCH: usize = 100;

/// Records to be written, in order.
#[derive(Default)]
pub(super) struct Records {
    pending: Mutex<VecDeque<Halted>>,
    /// Serializes writing.
    writing: tokio::sync::Mutex<()>,
    wake: Notify,
    task: Mutex<Option<AbortHandle>>,
}

impl Records {
    /// Queues a record to be written when possible.
    pub fn push(&self, halted: Halted) {
        self.pending().push_back(halted);
        self.wake.notify_one();
    }

    /// Writes all pending records.
    ///
    /// # Errors
    /// [`store::Error`]: unwritten records stay pending.
    pub async fn write_down(&self, store: &Store) -> store::Result<()> {
        let _one = self.writing.lock().await;
        loop {
            let some: Vec<Halted> = self.pending().iter().take(BATCH).cloned().collect();
            if some.is_empty() {
                return Ok(());
            }
            let mut tx = store.write_for_bench().await?;
            for Halted { weighing, held, who } in &some {
                acting_maybe(who.clone(), tx.audit_person(weighing.as_deref(), "stop", held.at))
                    .await?;
                tx.hold_bench(held).await?;
            }
            tx.commit().await?;
            self.pending().drain(..some.len());
        }
    }

    /// Writes records as they come, until this is closed.
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

    /// Writes pending records one last time.
    pub async fn close(&self, store: &Store) {
        {
            // Not between storing records and removing them here.
            let _one = self.writing.lock().await;
            self.abandon();
        }
        if let Err(error) = self.write_down(store).await
            && !error.is_closed()
        {
            tracing::error!(%error, "a stop was not written down");
        }
    }

    /// Marks that nothing more is written.
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
