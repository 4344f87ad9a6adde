//! Helps with the jobs of other workers: carries out portions of them, one on each thread.
//!
//! A worker takes portions before whole jobs that wait. What runs ends sooner so, and then all work at the
//! next; a job that waits does so no longer than those before it take. While a job has no portions,
//! because its next batch is not known yet, the worker takes a whole job.

use super::lanes::{Place, TURNS};
use super::lease::lease_end;
use super::worker::panic_message;
use super::{Shared, portion, priority};
use flip_store::portions::Portion;
use flip_store::{self as store, now};
use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::runtime::Handle;

/// How often a worker looks whether what it helps with is still wanted.
const LOOK: Duration = Duration::from_secs(1);
/// How often it renews the leases of portions.
const RENEW: Duration = Duration::from_secs(9);
/// How often writing the outcome of a portion is tried; then it is another worker's.
const TRIES: u32 = 3;

/// Begins to help if a portion waits and this worker has nothing else to do.
pub(super) async fn help(shared: &Arc<Shared>) -> store::Result<()> {
    if !shared.store.is_shared() || shared.closing.is_cancelled() {
        return Ok(());
    }
    let kinds = shared.lanes.kinds_among(&TURNS);
    let Some(place) = kinds.first().and_then(|kind| shared.lanes.take(*kind)) else {
        return Ok(());
    };
    if !shared.store.has_portion(&shared.worker.id, &kinds, now()).await? {
        return Ok(());
    }
    let (shared, runtime) = (shared.clone(), Handle::current());
    let helping = move || on_help_thread(&shared, runtime, place);
    if let Err(error) = std::thread::Builder::new().name("help".into()).spawn(helping) {
        tracing::error!(%error, "no thread to help with");
    }
    Ok(())
}

fn on_help_thread(shared: &Shared, runtime: Handle, place: Place) {
    let helper =
        Helper { shared, runtime, held: Mutex::default(), at_work: AtomicUsize::default() };
    let (done, wait) = channel::<()>();
    std::thread::scope(|scope| {
        // Before the priority is lowered: threads inherit it.
        let keeper = &helper;
        scope.spawn(move || {
            keeper.keep(|| wait.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout));
        });
        if shared.gives_way {
            priority::give_way();
        }
        let hands: Vec<_> =
            (0..shared.worker.threads).map(|_| scope.spawn(|| helper.lend_a_hand())).collect();
        for hand in hands {
            if hand.join().is_err() {
                tracing::error!("a thread that helps panicked");
            }
        }
        drop(done);
    });
    drop(place);
    shared.wake.notify_one();
}

/// A worker that helps.
struct Helper<'a> {
    shared: &'a Shared,
    runtime: Handle,
    /// The portions that it computes, each with the flag that it is not wanted any more.
    held: Mutex<HashMap<String, (Portion, Arc<AtomicBool>)>>,
    /// Hands that compute.
    at_work: AtomicUsize,
}

impl Helper<'_> {
    /// Carries out one portion after another, until none waits and no other hand is at work: of that job
    /// more may come.
    fn lend_a_hand(&self) {
        let mut changes = self.shared.store.watch_portions();
        while !self.shared.closing.is_cancelled() {
            changes.borrow_and_update();
            self.at_work.fetch_add(1, Ordering::SeqCst);
            let claimed = self.runtime.block_on(self.claim());
            match claimed {
                Ok(Some(ref portion)) => self.carry_out(portion),
                Ok(None) => {}
                Err(ref error) => {
                    tracing::warn!(%error, "no portion was claimed; the next try may")
                }
            }
            let others = self.at_work.fetch_sub(1, Ordering::SeqCst) - 1;
            if matches!(claimed, Ok(Some(_))) {
                continue;
            }
            if others == 0 {
                return;
            }
            // A timer is made where there is a runtime.
            let _ = self
                .runtime
                .block_on(async { tokio::time::timeout(LOOK, changes.changed()).await });
        }
    }

    async fn claim(&self) -> store::Result<Option<Portion>> {
        let (store, worker) = (&self.shared.store, &self.shared.worker.id);
        let (kinds, at) = (self.shared.lanes.kinds_among(&TURNS), now());
        // Most looks find none: those need not wait for other writers.
        if !store.has_portion(worker, &kinds, at).await? {
            return Ok(None);
        }
        let mut tx = store.write().await?;
        let claimed = tx.claim_portion(worker, &kinds, at, lease_end(at)).await?;
        tx.commit().await?;
        Ok(claimed)
    }

    fn carry_out(&self, portion: &Portion) {
        let unwanted = Arc::new(AtomicBool::new(false));
        self.held().insert(portion.id.clone(), (portion.clone(), unwanted.clone()));
        let goes_on = || !unwanted.load(Ordering::SeqCst) && !self.shared.closing.is_cancelled();
        let ended = catch_unwind(AssertUnwindSafe(|| {
            let Portion { kind, experiments, .. } = portion;
            portion::carry_out(&self.shared.functions, kind, experiments, &goes_on)
        }))
        .unwrap_or_else(|panic| Err(format!("it panicked: {}", panic_message(&*panic))));
        if let Err(why) = &ended {
            tracing::warn!(
                job = portion.job,
                why,
                "a portion was not carried out; another worker may"
            );
        }
        self.settle(portion, ended.ok().flatten());
        self.held().remove(&portion.id);
    }

    /// Writes what a portion gave, or gives it back.
    fn settle(&self, portion: &Portion, outcomes: Option<Vec<u8>>) {
        let worker = &self.shared.worker.id;
        let written = async || {
            let mut tx = self.shared.store.write().await?;
            match &outcomes {
                Some(outcomes) => {
                    tx.finish_portion(portion, worker, outcomes, now()).await?;
                }
                None => tx.release_portion(portion, worker).await?,
            }
            tx.commit().await
        };
        for _ in 0..TRIES {
            let Err(error) = self.runtime.block_on(written()) else { return };
            tracing::warn!(job = portion.job, %error, "the end of a portion was not recorded yet");
            std::thread::sleep(LOOK);
        }
    }

    /// Renews the leases of the portions, and flags those that are not wanted any more, while `goes_on`
    /// says so.
    fn keep(&self, mut goes_on: impl FnMut() -> bool) {
        let mut renewed = Instant::now();
        while goes_on() {
            let kept = self.runtime.block_on(self.look(&mut renewed));
            if let Err(error) = kept {
                tracing::warn!(%error, "leases of portions were not looked after; the next try may");
            }
        }
    }

    async fn look(&self, renewed: &mut Instant) -> store::Result<()> {
        let (store, worker) = (&self.shared.store, &self.shared.worker.id);
        // Before asking: what is claimed meanwhile is not missing from the answer.
        let held: Vec<(Portion, Arc<AtomicBool>)> = self.held().values().cloned().collect();
        let wanted = store.portions_of(worker, now()).await?;
        for (portion, unwanted) in &held {
            if !wanted.iter().any(|(id, fence)| (id, *fence) == (&portion.id, portion.fence)) {
                unwanted.store(true, Ordering::SeqCst);
            }
        }
        if renewed.elapsed() < RENEW || held.is_empty() {
            return Ok(());
        }
        let mut tx = store.write().await?;
        for (portion, _) in &held {
            tx.renew_portion(portion, worker, lease_end(now())).await?;
        }
        tx.commit().await?;
        *renewed = Instant::now();
        Ok(())
    }

    fn held(&self) -> std::sync::MutexGuard<'_, HashMap<String, (Portion, Arc<AtomicBool>)>> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
