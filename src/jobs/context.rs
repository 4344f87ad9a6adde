//! The interface of a job's body to the outside: report progress, save, and check whether to stop.

use super::Functions;
use super::stop::StopFlag;
use flip_core::domain::job::Progress;
use flip_store::jobs::job_topic;
use flip_store::ledger::Lease;
use flip_store::{self as store, Store, Tx, now};
use serde::Serialize;
use std::ops::{AsyncFnOnce, ControlFlow};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::runtime::Handle;
use tokio::task::JoinHandle;

/// Minimum interval between progress reports.
const REPORT: Duration = Duration::from_millis(250);

/// Why a job's body did not succeed.
#[derive(Debug, thiserror::Error)]
pub enum JobError {
    /// An external cause; retrying may help.
    #[error("{0}")]
    Retry(String),
    /// It would end the same way every time.
    #[error("{0}")]
    Fail(String),
    /// It was asked to stop, and its results so far are saved.
    #[error("stopped on request")]
    Stopped,
}

impl From<store::Error> for JobError {
    fn from(error: store::Error) -> Self {
        match error {
            // The current holder of the lease will do it.
            store::Error::Fenced => Self::Stopped,
            store::Error::Corrupt(_) | store::Error::UnknownWord { .. } => {
                Self::Fail(error.to_string())
            }
            other => Self::Retry(other.to_string()),
        }
    }
}

/// The outside of one job, as its body sees it from a compute thread.
pub(super) struct JobContext {
    pub store: Store,
    pub functions: Functions,
    /// The bench is held: nothing on it starts.
    pub held: Arc<AtomicBool>,
    lease: Lease,
    stop: Arc<StopFlag>,
    runtime: Handle,
    reported: Mutex<Option<Instant>>,
    /// A report in progress that is not awaited.
    reporting: Mutex<Option<JoinHandle<store::Result<()>>>>,
}

impl JobContext {
    pub fn new(
        store: Store,
        functions: Functions,
        held: Arc<AtomicBool>,
        lease: Lease,
        stop: Arc<StopFlag>,
        runtime: Handle,
    ) -> Self {
        Self {
            store,
            functions,
            held,
            lease,
            stop,
            runtime,
            reported: Mutex::default(),
            reporting: Mutex::default(),
        }
    }

    /// Job id.
    pub fn id(&self) -> &str {
        &self.lease.job
    }

    /// Whether to continue.
    pub fn flow(&self) -> ControlFlow<()> {
        self.stop.flow()
    }

    /// Runs a query on the store.
    pub fn read<T>(&self, reading: impl Future<Output = store::Result<T>>) -> store::Result<T> {
        self.runtime.block_on(reading)
    }

    /// Reports progress, at most four times a second except for the last report.
    pub fn report(&self, progress: &Progress) -> store::Result<()> {
        match self.is_to_be_told(progress) {
            true => self.runtime.block_on(tell(
                self.store.clone(),
                self.lease.clone(),
                progress.clone(),
            )),
            false => Ok(()),
        }
    }

    /// The same without waiting for it: for a caller that has opened a gate and must notice a stop.
    /// Returns the result of the last finished report; while one is in progress no other is sent.
    ///
    /// # Errors
    /// [`store::Error`] of an earlier report.
    pub fn report_meanwhile(&self, progress: &Progress) -> store::Result<()> {
        let mut reporting = self.reporting.lock().unwrap_or_else(PoisonError::into_inner);
        if reporting.as_ref().is_some_and(|task| !task.is_finished()) {
            return Ok(());
        }
        if let Some(Ok(told)) = reporting.take().map(|task| self.runtime.block_on(task)) {
            told?;
        }
        if self.is_to_be_told(progress) {
            *reporting = Some(self.runtime.spawn(tell(
                self.store.clone(),
                self.lease.clone(),
                progress.clone(),
            )));
        }
        Ok(())
    }

    fn is_to_be_told(&self, progress: &Progress) -> bool {
        let mut reported = self.reported.lock().unwrap_or_else(PoisonError::into_inner);
        if reported.is_some_and(|last| last.elapsed() < REPORT) && progress.fraction < 1.0 {
            return false;
        }
        *reported = Some(Instant::now());
        true
    }

    /// Saves something in one transaction that verifies the lease first. `save` returns whether it
    /// was new: if so, the attempt was not fruitless.
    ///
    /// # Errors
    /// [`store::Error::Fenced`]: the lease is lost, nothing was written.
    pub fn save(
        &self,
        save: impl AsyncFnOnce(&mut Tx) -> store::Result<bool>,
    ) -> store::Result<()> {
        self.runtime.block_on(async {
            let mut tx = self.store.write().await?;
            tx.prove(&self.lease).await?;
            if save(&mut tx).await? {
                tx.advance(&self.lease).await?;
            }
            tx.commit().await
        })
    }

    /// Saves bytes to resume from: first the file, then the row that refers to it.
    pub fn checkpoint(&self, bytes: &[u8]) -> store::Result<()> {
        let sha256 = self.store.artifacts().put(bytes)?;
        self.runtime.block_on(async {
            let mut tx = self.store.write().await?;
            tx.set_checkpoint(&self.lease, &sha256).await?;
            tx.commit().await
        })
    }

    /// Saves the last items and the result, and ends the job, in one transaction.
    pub fn succeed<T: Serialize>(
        &self,
        result: &T,
        save: impl AsyncFnOnce(&mut Tx) -> store::Result<()>,
    ) -> store::Result<()> {
        let result = serde_json::to_string(result)
            .map_err(|error| store::Error::Corrupt(error.to_string()))?;
        self.runtime.block_on(async {
            let mut tx = self.store.write().await?;
            tx.prove(&self.lease).await?;
            save(&mut tx).await?;
            tx.succeed(&self.lease, &result, now()).await?;
            tx.commit().await
        })
    }

    /// Publishes an event about the job, within `tx`.
    pub async fn tell(&self, tx: &mut Tx, kind: &str, data: &impl Serialize) -> store::Result<()> {
        tx.emit(&job_topic(self.id()), kind, data).await
    }
}

async fn tell(store: Store, lease: Lease, progress: Progress) -> store::Result<()> {
    let mut tx = store.write().await?;
    tx.report(&lease, &progress).await?;
    tx.commit().await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(flavor = "multi_thread")]
    async fn a_report_that_waits_for_another_program_holds_up_no_open_gate() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).await.unwrap();
        let other =
            sqlx::sqlite::SqliteConnectOptions::new().filename(folder.path().join("flip.db"));
        let other = sqlx::SqlitePool::connect_with(other).await.unwrap();
        let held = other.begin_with("BEGIN IMMEDIATE").await.unwrap();
        sqlx::query("PRAGMA busy_timeout = 1").execute(store.writer().unwrap()).await.unwrap();
        let lease = Lease { job: "j".into(), fence: 1 };
        let (functions, free, stop) = (Functions::default(), Arc::default(), Arc::default());
        let context = JobContext::new(store, functions, free, lease, stop, Handle::current());
        let told = move || {
            let progress = Progress { fraction: 0.0, message: "the powder runs out".into() };
            let now = context.report_meanwhile(&progress);
            while context.reporting.lock().unwrap().as_ref().is_some_and(|task| !task.is_finished())
            {
                std::thread::yield_now();
            }
            (now, context.report_meanwhile(&progress))
        };
        let (now, later) = tokio::task::spawn_blocking(told).await.unwrap();
        assert!(now.is_ok(), "nobody waits: {now:?}");
        assert!(matches!(later, Err(store::Error::Locked)), "and it is not forgotten: {later:?}");
        held.rollback().await.unwrap();
    }
}
