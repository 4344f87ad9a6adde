//! Background work of an arm connection: renewing its lease and keeping its latest state.

use super::proto::RenewResponse;
use super::proto::{RenewRequest, State, StreamStateRequest};
use super::remote::{Remote, forbidden, lost, refusal};
use crate::hardware::DeviceError;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::task::{JoinHandle, JoinSet};
use tokio::time::{MissedTickBehavior, interval, sleep, timeout};
use tonic::Code;

/// A state older than this no longer counts as current.
const STATE_AGE_MAX: Duration = Duration::from_secs(1);
/// How long to wait for the first state after connecting.
const STATE_FIRST: Duration = Duration::from_secs(1);
/// Pause before resubscribing to states.
const RESUBSCRIBE: Duration = Duration::from_millis(100);
/// How long one renewal may take. Later renewals do not wait for it.
const RENEWAL_MAX: Duration = Duration::from_secs(1);
/// Maximum number of renewals in flight.
const RENEWALS_MAX: usize = 8;

/// Reason given when this side gave the lease up.
pub(super) const UNATTENDED: &str =
    "nobody attended to it, so that its lease was given up: acquire it again";

/// A value shared by two threads.
type Shared<T> = Arc<Mutex<T>>;

fn locked<T>(value: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    value.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A task that is aborted when its owner is dropped.
struct Task(JoinHandle<()>);

impl Drop for Task {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// When the arm's owner last called.
#[derive(Clone)]
pub(super) struct Attended {
    last: Shared<Instant>,
    idle: Duration,
}

impl Attended {
    pub(super) fn new(idle: Duration) -> Self {
        Self { last: Arc::new(Mutex::new(Instant::now())), idle }
    }

    /// Record that the owner called.
    pub(super) fn now(&self) {
        *locked(&self.last) = Instant::now();
    }

    /// Record that the owner is waiting for an answer, which may take up to `limit`.
    pub(super) fn for_next(&self, limit: Duration) {
        *locked(&self.last) = Instant::now() + limit;
    }

    fn is_over(&self) -> bool {
        locked(&self.last).elapsed() > self.idle
    }
}

/// Renewals of one lease. They stop when this is dropped.
pub(super) struct Renewals {
    ended: Shared<Option<DeviceError>>,
    _task: Task,
}

impl Renewals {
    pub(super) fn start(
        remote: &Remote,
        lease_id: &str,
        every: Duration,
        attended: &Attended,
    ) -> Self {
        let ended = Shared::default();
        let work =
            renew(remote.clone(), lease_id.to_owned(), every, attended.clone(), ended.clone());
        Self { ended, _task: Task(remote.handle().spawn(work)) }
    }

    /// Why the lease is gone, if it is.
    pub(super) fn ended(&self) -> Option<DeviceError> {
        locked(&self.ended).clone()
    }
}

/// Renew until the driver reports that the lease is gone, or until the arm's owner has been idle
/// for too long. Each renewal is sent on schedule, whether or not the previous one has been
/// answered. Lost ones do not matter: the driver's dead-man decides when the gap was too long.
async fn renew(
    remote: Remote,
    lease_id: String,
    every: Duration,
    attended: Attended,
    ended: Shared<Option<DeviceError>>,
) {
    let mut ticks = interval(every);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut under_way: JoinSet<Renewed> = JoinSet::new();
    loop {
        ticks.tick().await;
        if attended.is_over() {
            *locked(&ended) = Some(forbidden(UNATTENDED));
            return;
        }
        while let Some(renewed) = under_way.try_join_next() {
            if let Ok(Ok(Err(status))) = renewed
                && matches!(status.code(), Code::PermissionDenied | Code::FailedPrecondition)
            {
                *locked(&ended) = Some(refusal(&status));
                return;
            }
        }
        if under_way.len() < RENEWALS_MAX {
            let (mut client, request) =
                (remote.client(), RenewRequest { lease_id: lease_id.clone() });
            under_way.spawn(timeout(RENEWAL_MAX, async move { client.renew(request).await }));
        }
    }
}

/// Outcome of one renewal.
type Renewed =
    Result<Result<tonic::Response<RenewResponse>, tonic::Status>, tokio::time::error::Elapsed>;

/// The latest state of the arm.
pub(super) struct States {
    seen: Shared<Seen>,
    _task: Task,
}

struct Seen {
    since: Instant,
    newest: Option<(State, Instant)>,
    lost: Option<DeviceError>,
}

impl States {
    pub(super) fn watch(remote: &Remote) -> Self {
        let seen = Arc::new(Mutex::new(Seen { since: Instant::now(), newest: None, lost: None }));
        let task = Task(remote.handle().spawn(watch(remote.clone(), seen.clone())));
        Self { seen, _task: task }
    }

    /// The latest state; waits briefly for the first one.
    pub(super) fn newest(&self) -> Result<State, DeviceError> {
        loop {
            let seen = locked(&self.seen);
            if let Some(error) = &seen.lost {
                return Err(error.clone());
            }
            match seen.newest {
                Some((state, at)) if at.elapsed() <= STATE_AGE_MAX => return Ok(state),
                None if seen.since.elapsed() <= STATE_FIRST => {}
                _ => return Err(lost("it no longer says where it is")),
            }
            drop(seen);
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

/// Read states forever; when the stream ends, record that and subscribe again.
async fn watch(remote: Remote, seen: Shared<Seen>) {
    loop {
        let lost = match remote.client().stream_state(StreamStateRequest {}).await {
            Ok(stream) => read(stream.into_inner(), &seen).await,
            Err(status) => refusal(&status),
        };
        locked(&seen).lost = Some(lost);
        sleep(RESUBSCRIBE).await;
    }
}

async fn read(mut stream: tonic::Streaming<State>, seen: &Mutex<Seen>) -> DeviceError {
    loop {
        match stream.message().await {
            Ok(Some(state)) => {
                let mut seen = locked(seen);
                (seen.newest, seen.lost) = (Some((state, Instant::now())), None);
            }
            Ok(None) => return lost("it ended the stream of its states"),
            Err(status) => return refusal(&status),
        }
    }
}
