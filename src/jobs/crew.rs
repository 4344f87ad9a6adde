//! A process among those that compute jobs.

use super::lanes::Lanes;
use super::stop::Stop;
use super::{Functions, Shared, card, worker};
use flip_core::domain::job::JobKind;
use flip_store::workers::{Worker, machine_name};
use flip_store::{self as store, Store, new_id, now};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::Notify;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// What a process that computes jobs is like.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Crew {
    /// Its name.
    pub name: String,
    /// The kinds of jobs that it takes.
    pub kinds: Vec<JobKind>,
    /// On how many threads it computes.
    pub threads: u32,
    /// Whether it answers requests, too.
    pub serves: bool,
    /// For how long one thread computes a portion of a job that others help with, roughly. The longer,
    /// the less of it is spent on rows, and the later the last one ends.
    pub portion: Duration,
    /// Its graphics card, as others are told of it; it is looked for when the process starts.
    pub card: Option<String>,
}

impl Default for Crew {
    /// All that this machine can do, under its name.
    fn default() -> Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            name: machine_name(),
            kinds: JobKind::ALL.into_iter().filter(|kind| can_compute(*kind)).collect(),
            threads: cores as u32,
            serves: false,
            portion: Duration::from_secs(60),
            card: None,
        }
    }
}

/// Whether this program can compute jobs of this kind: one without libtorch cannot train.
fn can_compute(kind: JobKind) -> bool {
    cfg!(feature = "learn") || kind != JobKind::Training
}

/// Takes jobs and computes them. Dropping it without [`JobWorker::shutdown`] ends it too, but
/// without waiting.
pub struct JobWorker {
    shared: Arc<Shared>,
    task: Mutex<Option<JoinHandle<()>>>,
}

impl JobWorker {
    /// Starts to take the jobs that others queue, beside the process that serves what is stored.
    ///
    /// # Errors
    /// [`store::Error`]
    pub async fn beside(store: Store, functions: Functions, crew: Crew) -> store::Result<Self> {
        // A measurement on the bench is of the process that has the bench.
        let kinds = crew.kinds.into_iter().filter(|kind| *kind != JobKind::Repose).collect();
        let card = card::found(&functions).await.ok();
        let crew = Crew { kinds, serves: false, card, ..crew };
        let worker = Self::new(store, functions, Arc::default(), crew, false);
        worker.start().await?;
        Ok(worker)
    }

    /// One that has not started. `held` says whether the bench is held.
    pub(super) fn new(
        store: Store,
        functions: Functions,
        held: Arc<AtomicBool>,
        crew: Crew,
        gives_way: bool,
    ) -> Self {
        let lanes = Lanes::new(crew.kinds.clone(), crew.threads);
        let worker = Worker {
            // In a server's database, the owner of its bench.
            id: store.bench_owner().map_or_else(|| format!("flip-{}", new_id()), str::to_owned),
            name: crew.name,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            kinds: crew.kinds,
            threads: crew.threads,
            serves: crew.serves,
            card: crew.card,
            started_at: now(),
            heard_at: now(),
            ended_at: None,
            jobs: Vec::new(),
        };
        let shared = Shared {
            store,
            functions,
            held,
            running: Mutex::default(),
            lanes,
            worker,
            wake: Notify::new(),
            closing: CancellationToken::new(),
            gives_way,
            portion: crew.portion,
        };
        Self { shared: Arc::new(shared), task: Mutex::default() }
    }

    /// Starts to take jobs.
    pub(super) async fn start(&self) -> store::Result<()> {
        let mut tx = self.shared.store.write().await?;
        tx.insert_worker(&self.shared.worker).await?;
        tx.commit().await?;
        let task = tokio::spawn(worker::work(self.shared.clone()));
        *self.task.lock().unwrap_or_else(PoisonError::into_inner) = Some(task);
        Ok(())
    }

    pub(super) fn shared(&self) -> &Shared {
        &self.shared
    }

    /// Its id: the owner of the jobs that it computes.
    pub fn id(&self) -> &str {
        &self.shared.worker.id
    }

    /// Its graphics card, if it has one.
    pub fn card(&self) -> Option<&str> {
        self.shared.worker.card.as_deref()
    }

    /// Takes no more jobs, and asks those that run to save a checkpoint.
    pub(super) fn close(&self) {
        self.shared.closing.cancel();
        for running in self.shared.running().values() {
            running.stop.set(Stop::Shutdown);
        }
    }

    /// Takes no more jobs, lets running ones save a checkpoint and return to the queue.
    pub async fn shutdown(&self) {
        self.close();
        let task = self.task.lock().unwrap_or_else(PoisonError::into_inner).take();
        let Some(task) = task else { return };
        if let Err(error) = task.await {
            tracing::error!(%error, "the worker ended badly");
        }
        let ended = async {
            let mut tx = self.shared.store.write().await?;
            tx.worker_ended(&self.shared.worker.id, now()).await?;
            tx.commit().await
        };
        if let Err(error) = ended.await {
            tracing::warn!(%error, "that this worker ended was not recorded");
        }
    }
}

impl Drop for JobWorker {
    fn drop(&mut self) {
        self.shared.closing.cancel();
    }
}
