//! A connection to the driver process: asynchronous inside, synchronous to its callers, usable from
//! any thread.

use super::proto::arm_client::ArmClient;
use crate::hardware::DeviceError;
use crate::hardware::wire::Tap;
use std::error::Error as _;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::Duration;
use tokio::runtime::{Builder, Handle};
use tonic::transport::{Channel, Endpoint};
use tonic::{Code, Response, Status};

/// Name used in messages.
pub(super) const DEVICE: &str = "the arm";
/// Longest driver text that is passed on, characters.
const TEXT_MAX: usize = 200;
/// Keep-alive: interval between pings on an idle connection, and how long to wait for the reply
/// before giving up.
const ALIVE: Duration = Duration::from_secs(1);
/// Nice value of the thread that renews the lease: ahead of all computation, behind system threads.
const FIRST: i32 = -15;
/// How far past the deadline our own thread may answer.
const GRACE: Duration = Duration::from_millis(500);

/// A runtime thread for waiting on calls. It may be dropped anywhere, even where blocking is not
/// allowed.
pub(super) struct Runtime(Option<tokio::runtime::Runtime>);

impl Drop for Runtime {
    fn drop(&mut self) {
        if let Some(runtime) = self.0.take() {
            runtime.shutdown_background();
        }
    }
}

/// One connection. Clones share it.
#[derive(Clone)]
pub(super) struct Remote {
    /// Kept alive while anyone may still make a call.
    runtime: Arc<Runtime>,
    handle: Handle,
    client: ArmClient<Channel>,
    tap: Tap,
}

impl Remote {
    /// Connect, with a dedicated thread.
    pub(super) fn connect(url: &str, tap: Tap, limit: Duration) -> Result<Self, DeviceError> {
        Self::connect_by(Builder::new_multi_thread().thread_name("arm"), url, tap, limit)
    }

    /// Connect, with a thread of higher priority where the system allows it.
    pub(super) fn connect_first(url: &str, limit: Duration) -> Result<Self, DeviceError> {
        let mut builder = Builder::new_multi_thread();
        Self::connect_by(
            builder.thread_name("arm lease").on_thread_start(go_first),
            url,
            Tap::none(),
            limit,
        )
    }

    fn connect_by(
        builder: &mut Builder,
        url: &str,
        tap: Tap,
        limit: Duration,
    ) -> Result<Self, DeviceError> {
        let thread = builder.worker_threads(1).enable_all().build();
        let runtime = thread.map_err(|error| lost(error.to_string()))?;
        let handle = runtime.handle().clone();
        Self::open(Arc::new(Runtime(Some(runtime))), handle, url, tap, limit)
    }

    /// Another connection on the same thread.
    pub(super) fn beside(&self, url: &str, limit: Duration) -> Result<Self, DeviceError> {
        Self::open(self.runtime.clone(), self.handle.clone(), url, self.tap.clone(), limit)
    }

    fn open(
        runtime: Arc<Runtime>,
        handle: Handle,
        url: &str,
        tap: Tap,
        limit: Duration,
    ) -> Result<Self, DeviceError> {
        let endpoint = Endpoint::from_shared(url.to_owned())
            .map_err(|error| lost(format!("{url}: {error}")))?;
        let endpoint = endpoint
            .connect_timeout(limit)
            .tcp_nodelay(true)
            .http2_keep_alive_interval(ALIVE)
            .keep_alive_timeout(ALIVE)
            .keep_alive_while_idle(true);
        let connected =
            wait(&handle, limit, async move { endpoint.connect().await }).ok_or_else(silent)?;
        let channel = connected.map_err(|error| lost(format!("{url}: {}", root(&error))))?;
        Ok(Self { runtime, handle, client: ArmClient::new(channel), tap })
    }

    /// Make one call and wait for its answer; both are recorded by the tap.
    pub(super) fn ask<A, F>(
        &self,
        what: String,
        limit: Duration,
        call: impl FnOnce(ArmClient<Channel>) -> F,
    ) -> Result<A, DeviceError>
    where
        A: std::fmt::Debug + Send + 'static,
        F: Future<Output = Result<Response<A>, Status>> + Send + 'static,
    {
        self.tap.sent(DEVICE, what);
        let answer = match wait(&self.handle, limit, call(self.client.clone())) {
            Some(Ok(answer)) => Ok(answer.into_inner()),
            Some(Err(status)) => Err(refusal(&status)),
            None => Err(silent()),
        };
        match &answer {
            Ok(answer) => self.tap.received(DEVICE, format!("{answer:?}")),
            Err(error) => self.tap.received(DEVICE, error.to_string()),
        }
        answer
    }

    pub(super) fn handle(&self) -> &Handle {
        &self.handle
    }

    pub(super) fn client(&self) -> ArmClient<Channel> {
        self.client.clone()
    }
}

/// Raise the priority of this thread: renewals are a few bytes a second, and late ones end a dose.
/// Without permission the thread's priority is unchanged.
fn go_first() {
    let _ = rustix::process::setpriority_process(Some(rustix::thread::gettid()), FIRST);
}

/// Run `work` on the thread behind `handle` and return its result; `None` when the limit has
/// passed. The caller may be on any thread, including one that runs asynchronous code.
fn wait<A: Send + 'static>(
    handle: &Handle,
    limit: Duration,
    work: impl Future<Output = A> + Send + 'static,
) -> Option<A> {
    let (say, hear) = sync_channel(1);
    handle.spawn(async move {
        if let Ok(answer) = tokio::time::timeout(limit, work).await {
            // The caller may have given up.
            let _ = say.send(answer);
        }
    });
    hear.recv_timeout(limit + GRACE).ok()
}

/// The error that a status means to the caller.
pub(super) fn refusal(status: &Status) -> DeviceError {
    // A status with a source came from the local transport; the driver never sent it.
    if status.source().is_some() {
        return lost(root(status));
    }
    let text = shortened(status.message());
    match status.code() {
        Code::DeadlineExceeded => silent(),
        Code::Unavailable | Code::Cancelled => lost(text),
        Code::InvalidArgument
        | Code::FailedPrecondition
        | Code::PermissionDenied
        | Code::ResourceExhausted
        | Code::AlreadyExists => forbidden(text),
        Code::Unimplemented => DeviceError::Unsupported { device: DEVICE, cause: text },
        _ => DeviceError::Faulted { device: DEVICE, cause: text },
    }
}

/// A driver's text, shortened for passing on.
pub(super) fn shortened(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(TEXT_MAX).collect()
}

/// The innermost cause of an error: the system's message.
fn root(error: &dyn std::error::Error) -> String {
    let mut inner = error;
    while let Some(cause) = inner.source() {
        inner = cause;
    }
    inner.to_string()
}

pub(super) fn lost(cause: impl Into<String>) -> DeviceError {
    DeviceError::Lost { device: DEVICE, cause: cause.into() }
}

pub(super) fn latched(cause: String) -> DeviceError {
    DeviceError::Latched { device: DEVICE, cause }
}

pub(super) fn silent() -> DeviceError {
    DeviceError::Silent { device: DEVICE }
}

pub(super) fn forbidden(cause: impl Into<String>) -> DeviceError {
    DeviceError::Forbidden { device: DEVICE, cause: cause.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_status_says_what_a_caller_can_do_about_it() {
        let check = |code: Code, expected: DeviceError| {
            assert_eq!(refusal(&Status::new(code, "why")), expected)
        };
        check(Code::DeadlineExceeded, silent());
        check(Code::Unavailable, lost("why"));
        for code in [
            Code::InvalidArgument,
            Code::FailedPrecondition,
            Code::PermissionDenied,
            Code::ResourceExhausted,
        ] {
            check(code, forbidden("why"));
        }
        check(Code::AlreadyExists, forbidden("why"));
        for code in [Code::Aborted, Code::Internal, Code::Unknown, Code::DataLoss] {
            check(code, DeviceError::Faulted { device: DEVICE, cause: "why".to_owned() });
        }
    }

    #[test]
    fn a_drivers_text_is_cut_and_holds_no_control_characters() {
        let long = format!("\u{1b}[31m{}", "x".repeat(1000));
        let DeviceError::Faulted { cause, .. } = refusal(&Status::internal(long)) else {
            panic!("a fault")
        };
        assert!(cause.starts_with("[31mx") && cause.chars().count() == TEXT_MAX);
    }
}
