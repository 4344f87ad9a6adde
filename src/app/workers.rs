//! The processes that compute jobs, and one that does nothing else.

use super::{App, Functions, OpenError, Result, Storage};
use crate::jobs::{Crew, JobWorker};
use flip_store::workers::Worker;
use flip_store::{Store, now};

impl App {
    /// The processes of the last week that compute jobs, the one that started last first.
    ///
    /// # Errors
    /// [`Error::Internal`](super::Error::Internal)
    pub async fn workers(&self) -> Result<Vec<Worker>> {
        let mut workers = self.store().workers().await?;
        let ours = self.inner.jobs.as_ref().map(|jobs| jobs.worker());
        for worker in workers.iter_mut().filter(|it| Some(it.id.as_str()) == ours) {
            worker.heard_at = now();
        }
        Ok(workers)
    }
}

/// A process that computes the jobs of a database on a server, and does nothing else.
pub struct Hired {
    store: Store,
    worker: JobWorker,
}

impl Hired {
    /// Starts to take jobs.
    ///
    /// # Errors
    /// [`OpenError::Failed`]: the database is not on a server, has another version's schema, or is
    /// served by another version of FLIP.
    pub async fn start(
        storage: &Storage,
        crew: Crew,
        functions: Functions,
    ) -> std::result::Result<Self, OpenError> {
        let failed = |error| OpenError::of(storage, error);
        if !storage.is_on_server() {
            return Err(OpenError::Failed {
                what: format!("the data folder {storage}"),
                cause: "only the process that serves it computes its jobs; with a database on a server (--database-url) any number of workers do"
                    .to_owned(),
            });
        }
        let store = Store::open_beside(storage).await.map_err(failed)?;
        store.join_artifacts().await.map_err(failed)?;
        let ours = env!("CARGO_PKG_VERSION");
        let workers = store.workers().await.map_err(failed)?;
        let others = workers.iter().find(|it| it.serves && it.ended_at.is_none());
        if let Some(other) = others.filter(|it| it.version != ours) {
            return Err(OpenError::Failed {
                what: format!("the database {storage}"),
                cause: format!(
                    "it is served by FLIP {} on {}, and this is {ours}: the same seed must give the same result on every machine",
                    other.version, other.name
                ),
            });
        }
        let worker = JobWorker::beside(store.clone(), functions, crew).await.map_err(failed)?;
        Ok(Self { store, worker })
    }

    /// Its id: the owner of the jobs that it computes.
    pub fn id(&self) -> &str {
        self.worker.id()
    }

    /// Its graphics card, on which it computes jobs that ask for one.
    pub fn card(&self) -> Option<&str> {
        self.worker.card()
    }

    /// Takes no more jobs, lets running ones save a checkpoint and return to the queue.
    pub async fn shutdown(self) {
        self.worker.shutdown().await;
        self.store.close().await;
    }
}
