//! Keeps a lease while its job computes, from a thread that nothing else can block.

use super::stop::{Stop, StopFlag};
use flip_core::domain::timestamp::Timestamp;
use flip_store::ledger::Lease;
use flip_store::{self as store, Store, now};
use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::runtime::Handle;

/// How long a claim lasts without renewal.
pub(super) const LEASE: Duration = Duration::from_secs(30);
/// Renewal interval: two renewals may fail before the lease ends.
const RENEW: Duration = Duration::from_secs(9);

/// When a lease taken or renewed at `from` ends.
pub(super) fn lease_end(from: Timestamp) -> Timestamp {
    Timestamp::from_unix_ms(from.unix_ms() + LEASE.as_millis() as i64)
}

/// Renews a lease until it is dropped.
pub(super) struct Renewer {
    done: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Renewer {
    /// Starts renewing; a lost lease or a cancellation sets `stop`.
    pub fn start(
        store: Store,
        lease: Lease,
        stop: Arc<StopFlag>,
        runtime: Handle,
    ) -> std::io::Result<Self> {
        let (done, wait) = channel::<()>();
        let renewing = move || {
            while wait.recv_timeout(RENEW) == Err(RecvTimeoutError::Timeout) {
                runtime.block_on(renew(&store, &lease, &stop));
            }
        };
        let thread = std::thread::Builder::new().name("lease".into()).spawn(renewing)?;
        Ok(Self { done: Some(done), thread: Some(thread) })
    }
}

impl Drop for Renewer {
    fn drop(&mut self) {
        drop(self.done.take());
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread that renews a lease panicked");
        }
    }
}

async fn renew(store: &Store, lease: &Lease, stop: &StopFlag) {
    let renewed = async {
        let mut tx = store.write().await?;
        let cancelled = tx.renew(lease, lease_end(now())).await?;
        tx.commit().await?;
        Ok(cancelled)
    };
    match renewed.await {
        Ok(false) => {}
        Ok(true) => stop.set(Stop::Cancelled),
        Err(store::Error::Fenced) => stop.set(Stop::Fenced),
        Err(error) => {
            tracing::warn!(job = lease.job, %error, "a lease was not renewed; the next try may")
        }
    }
}
