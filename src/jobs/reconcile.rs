//! Reconciles ledger and queue: the ledger knows what is to be done, and the queue may have lost a
//! delivery.

use super::{Shared, queue};
use flip_store::{self as store, Store, now};
use std::sync::Arc;
use std::time::Duration;

/// How often the two are compared without a request.
const EVERY: Duration = Duration::from_secs(2);

/// Delivers every job that can be claimed now. One that is already on its way has the key of this
/// delivery, and stays.
pub(super) async fn deliver_again(store: &Store) -> store::Result<()> {
    let claimable = store.claimable(now()).await?;
    if claimable.is_empty() {
        return Ok(());
    }
    let mut tx = store.write().await?;
    queue::forget_finished(&mut tx).await?;
    for (kind, lease) in &claimable {
        queue::push(&mut tx, *kind, lease).await?;
    }
    tx.commit().await
}

/// Compares ledger and queue periodically, and whenever a job has left a worker, until the
/// machinery closes.
pub(super) async fn keep_delivering(shared: Arc<Shared>) {
    loop {
        tokio::select! {
            () = shared.closing.cancelled() => return,
            () = shared.reconcile.notified() => {}
            () = tokio::time::sleep(EVERY) => {}
        }
        if let Err(error) = deliver_again(&shared.store).await {
            tracing::warn!(%error, "jobs were not delivered again; the next try may");
        }
    }
}
