//! Raw calls of the contract, and the states an arm sends: for checks that need the driver's own
//! behaviour, not what FLIP's client makes of it.

use crate::hardware::DeviceError;
use crate::hardware::arm::proto::arm_client::ArmClient;
use crate::hardware::arm::proto::{self, State};
use crate::hardware::wire::Tap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::task::JoinHandle;
use tokio::time::timeout;
use tonic::transport::{Channel, Endpoint};
use tonic::{Response, Status};

/// Name used in messages.
const DEVICE: &str = "the arm";
/// Timeout for connecting, and for calls that move nothing.
pub(super) const CALL: Duration = Duration::from_secs(2);
/// Timeout for motions.
pub(super) const MOTION: Duration = Duration::from_secs(30);
/// Interval between renewals.
const RENEWAL: Duration = Duration::from_millis(50);

/// One connection to a driver, with its own threads.
pub(in crate::hardware) struct Raw {
    runtime: tokio::runtime::Runtime,
    client: ArmClient<Channel>,
    tap: Tap,
}

impl Raw {
    pub(in crate::hardware) fn connect(url: &str, tap: &Tap) -> Result<Self, DeviceError> {
        let lost =
            |cause: String| DeviceError::Lost { device: DEVICE, cause: format!("{url}: {cause}") };
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
        let runtime = runtime.map_err(|error| lost(error.to_string()))?;
        let endpoint =
            Endpoint::from_shared(url.to_owned()).map_err(|error| lost(error.to_string()))?;
        let endpoint = endpoint.connect_timeout(CALL).tcp_nodelay(true);
        let channel =
            runtime.block_on(endpoint.connect()).map_err(|error| lost(error.to_string()))?;
        Ok(Self { runtime, client: ArmClient::new(channel), tap: tap.clone() })
    }

    /// Begin a call; its answer is returned by [`Raw::wait`].
    pub(super) fn begin<A, F>(
        &self,
        what: &str,
        limit: Duration,
        call: impl FnOnce(ArmClient<Channel>) -> F,
    ) -> JoinHandle<Result<A, Status>>
    where
        A: std::fmt::Debug + Send + 'static,
        F: Future<Output = Result<Response<A>, Status>> + Send + 'static,
    {
        self.tap.sent(DEVICE, what);
        let (call, tap) = (call(self.client.clone()), self.tap.clone());
        self.runtime.spawn(async move {
            let late =
                || Status::deadline_exceeded(format!("no answer within {} s", limit.as_secs()));
            let answer = timeout(limit, call)
                .await
                .unwrap_or_else(|_| Err(late()))
                .map(Response::into_inner);
            match &answer {
                Ok(answer) => tap.received(DEVICE, format!("{answer:?}")),
                Err(status) => tap.received(DEVICE, told(status)),
            }
            answer
        })
    }

    pub(super) fn wait<A>(&self, begun: JoinHandle<Result<A, Status>>) -> Result<A, Status> {
        let ended = |error: tokio::task::JoinError| Err(Status::internal(error.to_string()));
        self.runtime.block_on(begun).unwrap_or_else(ended)
    }

    /// Make one call and wait for its answer.
    pub(super) fn ask<A, F>(
        &self,
        what: &str,
        limit: Duration,
        call: impl FnOnce(ArmClient<Channel>) -> F,
    ) -> Result<A, Status>
    where
        A: std::fmt::Debug + Send + 'static,
        F: Future<Output = Result<Response<A>, Status>> + Send + 'static,
    {
        self.wait(self.begin(what, limit, call))
    }

    /// Record the arm's states from now on.
    pub(in crate::hardware) fn watch(&self) -> Watch {
        let seen = Arc::<Mutex<Vec<Seen>>>::default();
        let (keep, mut client) = (seen.clone(), self.client.clone());
        let task = self.runtime.spawn(async move {
            let Ok(stream) = client.stream_state(proto::StreamStateRequest {}).await else {
                return;
            };
            let mut stream = stream.into_inner();
            while let Ok(Some(state)) = stream.message().await {
                locked(&keep).push(Seen { at: Instant::now(), state });
            }
        });
        Watch { seen, task }
    }

    /// Renew this lease until the returned value is dropped.
    pub(super) fn renew(&self, lease_id: &str) -> Renewals {
        let last = Arc::new(Mutex::new(Instant::now()));
        let (keep, mut client, lease_id) = (last.clone(), self.client.clone(), lease_id.to_owned());
        let task = self.runtime.spawn(async move {
            let mut ticks = tokio::time::interval(RENEWAL);
            loop {
                ticks.tick().await;
                let asked = Instant::now();
                if client.renew(proto::RenewRequest { lease_id: lease_id.clone() }).await.is_ok() {
                    *locked(&keep) = asked;
                }
            }
        });
        Renewals { last, task }
    }
}

/// A status as text, code first.
pub(super) fn told(status: &Status) -> String {
    format!("{:?}: {}", status.code(), status.message())
}

/// A state and its arrival time.
#[derive(Debug, Clone, Copy)]
pub(in crate::hardware) struct Seen {
    pub at: Instant,
    pub state: State,
}

/// The states received since this was made.
pub(in crate::hardware) struct Watch {
    seen: Arc<Mutex<Vec<Seen>>>,
    task: JoinHandle<()>,
}

impl Watch {
    /// All states from that moment on.
    pub(in crate::hardware) fn since(&self, from: Instant) -> Vec<Seen> {
        locked(&self.seen).iter().copied().filter(|seen| seen.at >= from).collect()
    }

    /// The first state from that moment on that satisfies `is_so`, waiting for it.
    pub(super) fn until(
        &self,
        from: Instant,
        limit: Duration,
        is_so: impl Fn(&State) -> bool,
    ) -> Option<Seen> {
        let until = Instant::now() + limit;
        loop {
            let found = self.since(from).into_iter().find(|seen| is_so(&seen.state));
            if found.is_some() || Instant::now() >= until {
                return found;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Renewals of one lease.
pub(super) struct Renewals {
    last: Arc<Mutex<Instant>>,
    task: JoinHandle<()>,
}

impl Renewals {
    /// Stop renewing; returns when the last accepted renewal was sent.
    pub(super) fn end(self) -> Instant {
        self.task.abort();
        *locked(&self.last)
    }
}

impl Drop for Renewals {
    fn drop(&mut self) {
        self.task.abort();
    }
}

fn locked<T>(value: &Mutex<T>) -> MutexGuard<'_, T> {
    value.lock().unwrap_or_else(PoisonError::into_inner)
}
