//! A command's hold on the application: opened, watched for Ctrl-C, shut down in order; or that of
//! a server, with `--server`.

use super::Common;
use super::benches::BenchArguments;
use super::failure::Failure;
use super::lab::Lab;
use super::server::Server;
use crate::app::{App, OpenError, Options, Who, Workers, acting, give_way_to_the_bench};
use tokio::signal::unix::{Signal, SignalKind, signal};

/// Runs `work` with the application open for writing and its workers running; closes it whatever
/// happens.
///
/// SIGTERM and Ctrl-C end the work early: running jobs save a checkpoint, the spoon is levelled,
/// and running the same command again continues from there.
pub(super) fn with_app<T>(
    common: &Common,
    work: impl AsyncFnOnce(&Lab) -> Result<T, Failure>,
) -> Result<T, Failure> {
    with_options(common, Options::default(), work)
}

/// As [`with_app`], with a bench other than the simulator.
pub(super) fn with_bench<T>(
    common: &Common,
    bench: &BenchArguments,
    work: impl AsyncFnOnce(&Lab) -> Result<T, Failure>,
) -> Result<T, Failure> {
    with_options(common, bench.options()?, work)
}

/// As [`with_app`], but leaves queued jobs and weighings where they are.
pub(super) fn with_writer<T>(
    common: &Common,
    work: impl AsyncFnOnce(&Lab) -> Result<T, Failure>,
) -> Result<T, Failure> {
    with_options(common, Options::without_workers(), work)
}

/// As [`with_writer`], with the bench chosen by the user.
pub(super) fn with_idle_bench<T>(
    common: &Common,
    bench: &BenchArguments,
    work: impl AsyncFnOnce(&Lab) -> Result<T, Failure>,
) -> Result<T, Failure> {
    with_options(common, Options { workers: Workers::None, ..bench.options()? }, work)
}

fn with_options<T>(
    common: &Common,
    options: Options,
    work: impl AsyncFnOnce(&Lab) -> Result<T, Failure>,
) -> Result<T, Failure> {
    if let Some(server) = common.server()? {
        return there(server, work);
    }
    runtime()?.block_on(async {
        let mut signals = StopSignals::catch()?;
        let app = App::open(common.storage()?, options).await.map_err(or_ask_it)?;
        let lab = Lab::from(&app);
        let result = tokio::select! {
            result = acting(Who::command_line(), work(&lab)) => result,
            signal = signals.received() => Err(interrupted(signal)),
        };
        closed(&app, result).await
    })
}

/// As [`with_writer`], but also while another process holds the folder: for changes that affect no
/// bench and no job.
pub(super) fn beside<T>(
    common: &Common,
    work: impl AsyncFnOnce(&Lab) -> Result<T, Failure>,
) -> Result<T, Failure> {
    if let Some(server) = common.server()? {
        return there(server, work);
    }
    runtime()?.block_on(async {
        let app = App::open_beside(common.storage()?).await?;
        let result = acting(Who::command_line(), work(&Lab::from(&app))).await;
        closed(&app, result).await
    })
}

/// Runs `work` with the application open for reading, even while another process holds the folder.
pub(super) fn with_reader<T>(
    common: &Common,
    work: impl AsyncFnOnce(&Lab) -> Result<T, Failure>,
) -> Result<T, Failure> {
    if let Some(server) = common.server()? {
        return there(server, work);
    }
    runtime()?.block_on(async {
        let app = App::open_to_read(common.storage()?).await?;
        let result = work(&Lab::from(&app)).await;
        closed(&app, result).await
    })
}

/// Closes the application whatever the result, which is returned.
async fn closed<T>(app: &App, result: Result<T, Failure>) -> Result<T, Failure> {
    let closed = app.shutdown().await;
    let result = result?;
    closed?;
    Ok(result)
}

/// Runs `work` with a server. SIGTERM and Ctrl-C end the command: a dose that it asked for is
/// stopped, a job goes on.
pub(super) fn there<T>(
    server: Server,
    work: impl AsyncFnOnce(&Lab) -> Result<T, Failure>,
) -> Result<T, Failure> {
    let runtime = runtime()?;
    let result = runtime.block_on(async {
        let mut signals = StopSignals::catch()?;
        let lab = Lab::There(server.clone());
        tokio::select! {
            result = work(&lab) => result,
            signal = signals.received() => Err(server.leave(signal).await),
        }
    });
    // A request that still waits for its answer does not keep the command.
    runtime.shutdown_background();
    result
}

/// The failure to open a folder; a server that holds it can be asked instead.
fn or_ask_it(error: OpenError) -> Failure {
    match error {
        OpenError::Held(message) => {
            Failure::NotNow(format!("{message}, as with --server http://ADDRESS"))
        }
        error => error.into(),
    }
}

/// A runtime for one command.
pub(super) fn runtime() -> Result<tokio::runtime::Runtime, Failure> {
    Ok(tokio::runtime::Builder::new_multi_thread().enable_all().build()?)
}

/// A runtime for the service. The bench and the front of the service start on the calling thread
/// and keep its priority.
pub(super) fn service_runtime() -> Result<tokio::runtime::Runtime, Failure> {
    Ok(tokio::runtime::Builder::new_multi_thread()
        .on_thread_start(give_way_to_the_bench)
        .enable_all()
        .build()?)
}

/// SIGTERM and Ctrl-C, caught from the moment this is created: create it before reporting that
/// anything has started.
pub(super) struct StopSignals {
    terminate: Signal,
    interrupt: Signal,
}

impl StopSignals {
    /// Starts catching them.
    pub(super) fn catch() -> std::io::Result<Self> {
        Ok(Self {
            terminate: signal(SignalKind::terminate())?,
            interrupt: signal(SignalKind::interrupt())?,
        })
    }

    /// Waits for a signal; returns which one it was.
    pub(super) async fn received(&mut self) -> &'static str {
        tokio::select! {
            _ = self.terminate.recv() => "SIGTERM",
            _ = self.interrupt.recv() => "Ctrl-C",
        }
    }
}

/// The failure of a command that was interrupted.
pub(super) fn interrupted(signal: &str) -> Failure {
    Failure::Failed(anyhow::anyhow!(
        "stopped by {signal}; run the same command again to go on from where it was"
    ))
}
