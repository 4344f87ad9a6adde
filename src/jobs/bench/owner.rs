//! Keeps the bench of a server's database, on a thread of its own: renews the lease, stops what moves
//! when the bench is lost, and latches the benches of processes that nobody hears of any more.

use super::condition::Condition;
use flip_bench::rig::Rig;
use flip_core::domain::weighing::{Outcome, WeighingState};
use flip_store::bench::Latch;
use flip_store::weighings::Ending;
use flip_store::{self as store, Store, now};
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::Duration;
use tokio::runtime::Handle;

/// Renewal interval: four renewals may fail before the lease ends.
const RENEW: Duration = Duration::from_secs(3);
/// How long one renewal may take.
const PATIENCE: Duration = Duration::from_secs(10);

/// Keeps a bench until it is dropped.
pub(super) struct Keeper {
    _end: Sender<()>,
}

/// What the thread works with.
pub(super) struct Keeping {
    pub store: Store,
    pub rig: Arc<dyn Rig>,
    pub condition: Condition,
    pub runtime: Handle,
    /// Owners found silent at the last look: only who is silent twice is lost, because after an
    /// outage of the database everybody's lease has ended.
    pub silent: HashMap<String, String>,
}

impl Keeper {
    /// Starts keeping it.
    ///
    /// # Errors
    /// The system cannot spawn a thread.
    pub fn start(mut keeping: Keeping) -> std::io::Result<Self> {
        let (end, ended) = channel();
        let keep = move || {
            loop {
                let (runtime, keeping) = (keeping.runtime.clone(), &mut keeping);
                runtime.block_on(keeping.once());
                if ended.recv_timeout(RENEW) != Err(RecvTimeoutError::Timeout) {
                    return;
                }
            }
        };
        std::thread::Builder::new().name("owner".into()).spawn(keep)?;
        Ok(Self { _end: end })
    }
}

impl Keeping {
    async fn once(&mut self) {
        let renewed = tokio::time::timeout(PATIENCE, self.store.renew_bench(self.rig.kind())).await;
        match renewed {
            Ok(Ok(())) => {}
            Ok(Err(error @ store::Error::Disowned(_))) => return self.lose(&error).await,
            Ok(Err(error)) if error.is_closed() => return,
            Ok(Err(error)) => {
                tracing::warn!(%error, "the bench's lease was not renewed; the next try may");
                return;
            }
            Err(_) => {
                tracing::warn!("the bench's lease was not renewed: the database does not answer");
                return;
            }
        }
        if let Err(error) = self.look_after_others().await {
            tracing::warn!(%error, "could not look for benches whose process was lost");
        }
    }

    /// The bench is another process's, or was taken for lost: what moves is stopped, and nothing
    /// starts until a person has looked.
    async fn lose(&self, error: &store::Error) {
        tracing::error!(%error, "the bench is not this process's any more");
        if self.condition.stop_moving()
            && let Err(error) = self.rig.halt()
        {
            tracing::error!(%error, "the arm could not be told to stop: its dead-man acts");
        }
        let bench = Some(self.rig.kind());
        let stored = self.store.latch().await.ok().flatten();
        let reason = error.remedy();
        let latch = stored.unwrap_or(Latch { at: now(), reason, weighing: None, bench });
        self.condition.latch(latch);
    }

    async fn look_after_others(&mut self) -> store::Result<()> {
        let mut silent = HashMap::new();
        for row in self.store.benches().await? {
            let Some(owner) = row.owner.filter(|_| !row.served) else { continue };
            if self.silent.get(&row.name) == Some(&owner)
                && let Some(there) = self.store.at_bench(&row.name).await?
            {
                latch_lost(&there, row.machine.as_deref(), row.kind).await?;
            }
            silent.insert(row.name, owner);
        }
        self.silent = silent;
        Ok(())
    }
}

/// Takes a bench from a process that was lost: what moved there has an unknown end, and nobody may
/// use it until a person has looked.
async fn latch_lost(
    there: &Store,
    machine: Option<&str>,
    bench: Option<flip_core::domain::bench::BenchKind>,
) -> store::Result<()> {
    let mut tx = there.write().await?;
    if !tx.take_from_lost_owner(now()).await? {
        return Ok(());
    }
    let machine = machine.unwrap_or("another machine");
    let reason = format!(
        "the process on {machine} that had this bench is not heard of any more: look at spoon, vial and balance, start it again there, then clear the bench"
    );
    let moving = there.interrupted_weighings().await?;
    for (id, _) in &moving {
        let ending = Ending::bare(WeighingState::Unknown, Outcome::Unknown, reason.clone());
        tx.end_weighing(id, &ending, now()).await?;
    }
    let weighing = moving.into_iter().next().map(|(id, _)| id);
    tx.latch_bench(&Latch { at: now(), reason, weighing, bench }).await?;
    tx.commit().await?;
    tracing::error!(bench = there.bench_name(), "its process was lost; it is latched");
    Ok(())
}
