//! From a delivery to a settled row.

use super::host::{JobError, JobHost};
use super::lanes::Place;
use super::lease::{Renewer, lease_end};
use super::leased::LeasedJob;
use super::queue::{self, Delivery};
use super::spec::JobSpec;
use super::stop::{Stop, StopFlag};
use super::{
    Functions, Running, Shared, calibrate, evaluate, investigate, priority, repose, train,
};
use flip_core::domain::job::{JobKind, JobState};
use flip_store::ledger::{Claim, Claimed, Lease};
use flip_store::{self as store, now};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Handle;

/// Delay before restarting a worker that failed, and the maximum after repeated failures.
const RESTART: Duration = Duration::from_millis(500);
const RESTART_MAX: Duration = Duration::from_secs(30);

/// How long a computation may continue after it was asked to stop: one heap on a busy machine takes
/// longer than a shutdown may wait.
const GRACE: Duration = Duration::from_secs(8);

/// How often, and with what delay, writing the end of an attempt is retried when the database
/// refuses.
const SETTLE_TRIES: u32 = 30;
const SETTLE_PAUSE: Duration = Duration::from_secs(1);

/// Keeps a queue worker running until the machinery closes: the library ends one on the first
/// statement that fails.
pub(super) async fn supervise(shared: Arc<Shared>) {
    let mut pause = RESTART;
    while !shared.closing.is_cancelled() {
        // A new name for every start: the library's fence is the name.
        let name = format!("flip-{}", store::new_id());
        let handling = shared.clone();
        let owner = name.clone();
        let handle = move |delivery: Delivery| {
            let (shared, owner) = (handling.clone(), owner.clone());
            async move { handle(shared, owner, delivery).await }
        };
        let ended = match queue::run(&shared.store, &name, handle, shared.closing.clone()) {
            Ok(running) => tokio::select! {
                ended = running => ended.map_err(|error| error.to_string()),
                () = queue::silence(&shared.store, &name) => Err("it was not heard of any more".to_owned()),
            },
            Err(error) => Err(error.to_string()),
        };
        match ended {
            Ok(()) => pause = RESTART,
            Err(error) => {
                tracing::error!(%error, "the queue worker ended; another starts in {pause:?}");
                tokio::select! {
                    () = tokio::time::sleep(pause) => {}
                    () = shared.closing.cancelled() => {}
                }
                pause = (pause * 2).min(RESTART_MAX);
            }
        }
    }
    // A running computation holds a slot until the row is settled.
    if tokio::time::timeout(GRACE, shared.lanes.all_free()).await.is_err() {
        leave_behind(&shared).await;
    }
}

/// Abandons computations that do not notice the shutdown in time: what they saved counts, they
/// write nothing more, and their jobs wait for the next start.
async fn leave_behind(shared: &Shared) {
    let late: Vec<Running> = shared.running().drain().map(|(_, running)| running).collect();
    for Running { lease, stop } in late {
        stop.set(Stop::Fenced);
        tracing::info!(
            job = lease.job,
            "does not stop in time; it goes on at the next start from what it has saved"
        );
        let released = async {
            let mut tx = shared.store.write().await?;
            tx.release(&lease).await?;
            tx.commit().await
        };
        match released.await {
            Ok(()) | Err(store::Error::Fenced) => {}
            Err(error) => {
                tracing::warn!(job = lease.job, %error, "was not given back; the next start takes it")
            }
        }
    }
}

/// Handles one delivery: starts the job that has waited longest for such a slot, or leaves it to
/// the reconciler, which redelivers jobs that can be claimed. Which job was delivered does not
/// matter: deliveries overtake one another.
async fn handle(shared: Arc<Shared>, owner: String, delivery: Delivery) {
    // The next job to free a slot wakes the reconciler.
    let Some(place) = shared.lanes.take(delivery.kind) else { return };
    match claim_oldest(&shared, &owner, delivery.kind).await {
        Ok(Some(claimed)) => compute(shared, claimed, place),
        Ok(None) => {}
        // The row is unchanged.
        Err(error) => tracing::error!(job = delivery.job, %error, "could not claim a job"),
    }
}

/// Claims the oldest job that waits for a slot of this kind. `None`: there is none.
async fn claim_oldest(
    shared: &Shared,
    owner: &str,
    kind: JobKind,
) -> store::Result<Option<Claimed>> {
    let waiting = shared.store.claimable(now()).await?;
    for (_, lease) in waiting.iter().filter(|(waits, _)| shared.lanes.share(*waits, kind)) {
        if let Some(claimed) = claim(shared, owner, &lease.job).await? {
            return Ok(Some(claimed));
        }
    }
    Ok(None)
}

/// Claims a job. `None`: there is nothing to do, or another lease is still valid.
async fn claim(shared: &Shared, owner: &str, job: &str) -> store::Result<Option<Claimed>> {
    if shared.closing.is_cancelled() {
        return Ok(None);
    }
    let at = now();
    let mut tx = shared.store.write().await?;
    let claim = tx.claim(job, owner, at, lease_end(at)).await?;
    tx.commit().await?;
    match claim {
        Claim::Granted(claimed) => Ok(Some(claimed)),
        Claim::Ended | Claim::Held(_) => Ok(None),
    }
}

/// Computes on a separate thread. Nothing waits for it: the lease shows that the job is running,
/// and its slot when it has ended.
fn compute(shared: Arc<Shared>, claimed: Claimed, place: Place) {
    let stop = Arc::new(StopFlag::default());
    shared.running().insert(
        claimed.lease.job.clone(),
        Running { lease: claimed.lease.clone(), stop: stop.clone() },
    );
    // A shutdown between the claim and the line above has not seen the flag.
    if shared.closing.is_cancelled() {
        stop.set(Stop::Shutdown);
    }
    let (runtime, job) = (Handle::current(), claimed.lease.job.clone());
    let compute = move || on_compute_thread(&shared, claimed, &stop, runtime, place);
    if let Err(error) = std::thread::Builder::new().name("compute".into()).spawn(compute) {
        tracing::error!(job, %error, "no thread for a job; it goes on when its lease has ended");
    }
}

fn on_compute_thread(
    shared: &Shared,
    claimed: Claimed,
    stop: &Arc<StopFlag>,
    runtime: Handle,
    place: Place,
) {
    let lease = claimed.lease.clone();
    let renewer =
        Renewer::start(shared.store.clone(), lease.clone(), stop.clone(), runtime.clone());
    if let Err(error) = &renewer {
        tracing::error!(job = lease.job, %error, "no thread to renew a lease");
    }
    // After spawning the thread that renews: it would inherit the priority.
    if shared.gives_way {
        priority::give_way();
    }
    let host = LeasedJob::new(shared.store.clone(), &claimed, stop.clone(), runtime.clone());
    let ended = catch_unwind(AssertUnwindSafe(|| perform(&host, &shared.functions, &claimed)))
        .unwrap_or_else(|panic| {
            Err(JobError::Retry(format!("it panicked: {}", panic_message(&*panic))))
        });
    runtime.block_on(settle_surely(shared, &lease, stop, ended));
    shared.running().remove(&lease.job);
    drop(place);
    shared.reconcile.notify_one();
}

fn perform(host: &dyn JobHost, functions: &Functions, claimed: &Claimed) -> Result<(), JobError> {
    let spec = serde_json::from_str(&claimed.spec).map_err(|error| {
        JobError::Fail(format!("the specification is of another version: {error}"))
    })?;
    tracing::info!(job = host.id(), kind = ?claimed.kind, "computes");
    match spec {
        JobSpec::Calibration(spec) => calibrate::perform(host, functions, &spec),
        JobSpec::Training(spec) => train::perform(host, functions, &spec),
        JobSpec::Evaluation(spec) => evaluate::perform(host, functions, &spec),
        JobSpec::Investigation(spec) => investigate::perform(host, functions, &spec),
        JobSpec::Repose(spec) => repose::perform(host, functions, &spec),
    }
}

/// Records how an attempt ended, however long the database is busy: the lease is renewed meanwhile.
async fn settle_surely(
    shared: &Shared,
    lease: &Lease,
    stop: &StopFlag,
    ended: Result<(), JobError>,
) {
    for _ in 0..SETTLE_TRIES {
        match settle(shared, lease, stop.get(), &ended).await {
            Ok(()) => return,
            Err(error) => {
                tracing::warn!(job = lease.job, %error, "a job's end was not recorded yet")
            }
        }
        tokio::time::sleep(SETTLE_PAUSE).await;
    }
    tracing::error!(
        job = lease.job,
        "a job's end was not recorded; it is tried again when its lease has ended"
    );
}

/// Records how an attempt ended. Success was already recorded by the body, together with its
/// results.
async fn settle(
    shared: &Shared,
    lease: &Lease,
    stop: Option<Stop>,
    ended: &Result<(), JobError>,
) -> store::Result<()> {
    let Err(error) = ended else { return Ok(()) };
    let mut tx = shared.store.write().await?;
    let written = match (error, stop) {
        (_, Some(Stop::Fenced)) => return Ok(()),
        (JobError::Stopped, Some(Stop::Cancelled)) => {
            tx.end(lease, JobState::Cancelled, None, now()).await
        }
        (JobError::Stopped, _) => tx.release(lease).await,
        (JobError::Fail(cause), _) => tx.end(lease, JobState::Failed, Some(cause), now()).await,
        (JobError::Retry(cause), _) => tx.retry(lease, cause, now()).await,
    };
    match written {
        Ok(()) => tx.commit().await?,
        Err(store::Error::Fenced) => {}
        Err(error) => return Err(error),
    }
    if !matches!(error, JobError::Stopped) {
        tracing::warn!(job = lease.job, %error, "an attempt did not succeed");
    }
    Ok(())
}

pub(super) fn panic_message(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("without a message")
}
