//! From a waiting row to a settled one.

use super::host::{JobError, JobHost};
use super::lanes::Place;
use super::lease::{Renewer, lease_end};
use super::leased::LeasedJob;
use super::spec::JobSpec;
use super::stop::{Stop, StopFlag};
use super::{
    Functions, Running, Shared, calibrate, card, episode_film, evaluate, film, help, investigate,
    priority, repose, spread, train,
};
use flip_core::domain::job::JobState;
use flip_store::ledger::{Claim, Claimed, Lease};
use flip_store::workers::Worker;
use flip_store::{self as store, Store, now};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::runtime::Handle;
use tokio::sync::watch;

/// How often an idle worker looks for jobs that nothing has woken it for: those whose lease has
/// expired, and those of another process.
const POLL: Duration = Duration::from_secs(2);

/// How long to wait for more events after one: a hundred trials are one reason to look, not a hundred.
const PAUSE: Duration = Duration::from_millis(50);

/// How often a worker says that it is there.
const BEAT: Duration = Duration::from_secs(5);

/// How long a computation may continue after it was asked to stop: one heap on a busy machine takes
/// longer than a shutdown may wait.
const GRACE: Duration = Duration::from_secs(8);

/// How often, and with what delay, writing the end of an attempt is retried when the database
/// refuses.
const SETTLE_TRIES: u32 = 30;
const SETTLE_PAUSE: Duration = Duration::from_secs(1);

/// Starts waiting jobs until the machinery closes, then waits for those that run.
pub(super) async fn work(shared: Arc<Shared>) {
    let mut events = shared.store.watch_events();
    let mut portions = shared.store.watch_portions();
    let mut heard = Instant::now();
    while !shared.closing.is_cancelled() {
        // Before looking: what comes while it looks is a reason to look again.
        events.borrow_and_update();
        portions.borrow_and_update();
        if let Err(error) = help::help(&shared).await {
            tracing::warn!(%error, "portions were not looked for; the next try may");
        }
        if let Err(error) = start_waiting(&shared).await {
            tracing::warn!(%error, "waiting jobs were not started; the next try may");
        }
        if shared.store.is_shared()
            && let Err(error) = hear_others(&shared, &mut heard).await
        {
            tracing::warn!(%error, "other processes were not heard; the next try may");
        }
        tokio::select! {
            () = shared.closing.cancelled() => {}
            () = shared.wake.notified() => {}
            () = tokio::time::sleep(POLL) => {}
            () = told(&shared, &mut events) => {}
            () = told(&shared, &mut portions) => {}
        }
    }
    // A running computation holds a slot until the row is settled.
    if tokio::time::timeout(GRACE, shared.lanes.all_free()).await.is_err() {
        leave_behind(&shared).await;
    }
}

/// Waits until another process has written an event or changed a portion, and then a moment for more.
async fn told<T>(shared: &Shared, events: &mut watch::Receiver<T>) {
    // Of its own events a process that is alone is woken.
    if !shared.store.is_shared() || events.changed().await.is_err() {
        std::future::pending::<()>().await;
    }
    tokio::time::sleep(PAUSE).await;
}

/// Stops the jobs that another process was asked to cancel, and says that this one is there.
async fn hear_others(shared: &Shared, heard: &mut Instant) -> store::Result<()> {
    for job in shared.store.cancelled_of(&shared.worker.id).await? {
        if let Some(running) = shared.running().get(&job) {
            running.stop.set(Stop::Cancelled);
        }
    }
    if heard.elapsed() < BEAT {
        return Ok(());
    }
    *heard = Instant::now();
    let mut tx = shared.store.write().await?;
    if !tx.worker_heard(&shared.worker.id, now()).await? {
        tx.insert_worker(&Worker { heard_at: now(), ..shared.worker.clone() }).await?;
    }
    tx.commit().await
}

/// Abandons computations that do not notice the shutdown in time: what they saved counts, they
/// write nothing more, and their jobs wait for the next start.
async fn leave_behind(shared: &Shared) {
    if let Err(error) = give_portions_back(shared).await {
        tracing::warn!(%error, "portions were not given back; others take them when their leases end");
    }
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

async fn give_portions_back(shared: &Shared) -> store::Result<()> {
    let mut tx = shared.store.write().await?;
    tx.release_portions(&shared.worker.id).await?;
    tx.commit().await
}

/// Starts jobs, each time the one that has waited longest for a slot that is free, until there is
/// none.
async fn start_waiting(shared: &Arc<Shared>) -> store::Result<()> {
    while !shared.closing.is_cancelled() {
        let mut waiting = shared.store.claimable(now()).await?;
        if waiting.iter().any(|it| !it.device.is_cpu()) && !has_card(shared).await {
            // They wait for a process that has one, and hold up nobody here.
            waiting.retain(|it| it.device.is_cpu());
        }
        let next = waiting.into_iter().find_map(|it| Some((it.job, shared.lanes.take(it.kind)?)));
        let Some((job, place)) = next else { break };
        if let Some(claimed) = claim(&shared.store, &shared.worker.id, &job).await? {
            compute(shared.clone(), claimed, place);
        }
    }
    Ok(())
}

/// Whether jobs for a card may be claimed here.
async fn has_card(shared: &Shared) -> bool {
    card::found(&shared.functions).await.is_ok()
}

/// Claims a job. `None`: there is nothing to do, or another lease is still valid.
async fn claim(store: &Store, owner: &str, job: &str) -> store::Result<Option<Claimed>> {
    let at = now();
    let mut tx = store.write().await?;
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
    let functions = spread::functions(shared, &claimed, stop, &runtime);
    let host = LeasedJob::new(
        shared.store.clone(),
        &claimed,
        shared.held.clone(),
        stop.clone(),
        runtime.clone(),
    );
    let ended = catch_unwind(AssertUnwindSafe(|| perform(&host, &functions, &claimed)))
        .unwrap_or_else(|panic| {
            Err(JobError::Retry(format!("it panicked: {}", panic_message(&*panic))))
        });
    runtime.block_on(settle_surely(shared, &lease, stop, ended));
    shared.running().remove(&lease.job);
    drop(place);
    shared.wake.notify_one();
}

fn perform(host: &dyn JobHost, functions: &Functions, claimed: &Claimed) -> Result<(), JobError> {
    let spec = JobSpec::read(&claimed.spec).map_err(|error| JobError::Fail(error.to_string()))?;
    tracing::info!(job = host.id(), kind = ?claimed.kind, "computes");
    match spec {
        JobSpec::Calibration(spec) => calibrate::perform(host, functions, &spec),
        JobSpec::Training(spec) => train::perform(host, functions, &spec),
        JobSpec::Evaluation(spec) => evaluate::perform(host, functions, &spec),
        JobSpec::Investigation(spec) => investigate::perform(host, functions, &spec),
        JobSpec::Repose(spec) => repose::perform(host, functions, &spec),
        JobSpec::Film(spec) => film::perform(host, &spec),
        JobSpec::HeapFilm(spec) => film::perform_heap(host, &spec),
        JobSpec::EpisodeFilm(spec) => episode_film::perform(host, &spec),
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
        (JobError::Device(cause), _) => tx.fail_keeping_checkpoint(lease, cause, now()).await,
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
