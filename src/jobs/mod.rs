//! Turns rows into work. The only place where the asynchronous outside and the synchronous inside
//! meet.
//!
//! ```text
//!  App -- a row --> [store: the ledger is the queue]
//!     | wakes             | the oldest row of each kind
//!     v                   v
//!  worker.rs   take a slot of its lane (lanes.rs) and claim the row: fence + lease;
//!     |        other processes may do the same, crew.rs says who is there
//!     |        lease.rs renews the lease from a thread of its own
//!     v
//!  a compute thread: train.rs, several at once | calibrate.rs, evaluate.rs, investigate.rs, one at a time | repose.rs, on the bench | film.rs, episode_film.rs
//!              load inputs, call the pure function, save what it finds
//!              host.rs: what such a body may ask for; leased.rs answers over the store, every write carries the fence
//!              runner.rs: who carries out the experiments that it hands over
//!              card.rs: doses on a graphics card, for jobs that ask for one
//!              spread.rs: other workers, too, where there are some; help.rs: their side
//! ```
//!
//! Weighings are not jobs: see `bench/`.

pub mod bench;
pub mod calibrate;
mod card;
mod conditions;
mod crew;
pub mod episode_film;
pub mod evaluate;
pub mod film;
mod heaps;
mod help;
mod host;
mod investigate;
mod lanes;
mod lease;
mod leased;
pub mod observe;
mod portion;
mod priority;
pub mod replays;
pub mod repose;
mod rows;
mod runner;
mod spec;
pub mod spoon;
mod spread;
mod stop;
pub mod train;
mod worker;

pub use card::{
    AllCards, Cards, HeapsByCard, SideBySide, can_compute, can_pour, local_cards, local_engine,
};
pub use conditions::Conditions;
pub use crew::{Crew, JobWorker};
pub use lanes::lane_of;
pub use priority::{compute_on, give_way_to_the_bench};
pub use runner::{
    Cores, DoseExperiment, DoseRunner, HeapExperiment, HeapRunner, ObservableExperiment,
    ObservableRunner, Run, Runner, SpoonRunner, doses_on_cores, heaps_on_cores,
    observables_on_cores, spoons_on_cores,
};
pub use spec::{
    CalibrationSpec, EpisodeFilmSpec, EvaluationPowder, EvaluationSpec, FilmSpec, HeapFilmSpec,
    Heaps, InvestigationSpec, JobSpec, ReposeSpec, SIMULATOR, SpoonSpec, TrainingSpec,
    simulator_on,
};

use bench::Bench;
use flip_bench::rig::{Rig, Simulated};
use flip_core::domain::labels::Labels;
use flip_store::jobs::Job;
use flip_store::ledger::Lease;
use flip_store::pan::Refused;
use flip_store::workers::Worker;
use flip_store::{self as store, Store, Tx, new_id, now};
use lanes::Lanes;
use std::collections::HashMap;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use stop::{Stop, StopFlag};
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

/// The functions that jobs and weighings compute with.
#[derive(Clone)]
pub struct Functions {
    /// The heap experiment.
    pub simulate: HeapRunner,
    /// The other experiments.
    pub observe: ObservableRunner,
    /// Spoonfuls, made again.
    pub replay: SpoonRunner,
    /// A training.
    pub train: train::Train,
    /// Doses on the simulator, as evaluations weigh them.
    pub weigh: DoseRunner,
    /// What the bench's lane moves.
    pub rig: Arc<dyn Rig>,
    /// The graphics card, for jobs that ask for one.
    pub card: Arc<dyn Cards>,
}

impl Default for Functions {
    fn default() -> Self {
        Self {
            simulate: heaps_on_cores(flip_sim::repose::repose),
            observe: observables_on_cores(flip_sim::observe::observe_under),
            replay: spoons_on_cores(flip_sim::replay::replay),
            train: train::simulated(),
            weigh: doses_on_cores(evaluate::simulated),
            rig: Arc::new(Simulated),
            card: Arc::new(AllCards::default()),
        }
    }
}

/// How jobs and weighings are carried out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Workers {
    /// Not in this process.
    None,
    /// On threads with the process's own priority: a command that computes and exits.
    #[default]
    Equal,
    /// On threads that yield to those that answer requests: a service.
    GiveWay,
}

/// The machinery behind jobs and weighings. Dropping it without [`Jobs::shutdown`] ends it too, but
/// without waiting.
pub struct Jobs {
    worker: JobWorker,
    bench: Bench,
    /// Whether this process computes jobs itself.
    computes: bool,
}

/// A running job: its lease, i.e. the right to write to its row, and the flag that stops it.
struct Running {
    lease: Lease,
    stop: Arc<StopFlag>,
}

/// State shared by the parts of the machinery.
struct Shared {
    store: Store,
    functions: Functions,
    /// The bench is held: nothing on it starts.
    held: Arc<AtomicBool>,
    /// Jobs being computed, by id.
    running: Mutex<HashMap<String, Running>>,
    lanes: Lanes,
    /// Who takes them: the owner of their leases.
    worker: Worker,
    /// Wakes the worker: a job waits, or a slot is free.
    wake: Notify,
    /// Cancelled when no more work is taken.
    closing: CancellationToken,
    /// Computing runs at a lower priority than answering.
    gives_way: bool,
    /// How long one thread computes a portion of a job.
    portion: Duration,
}

impl Jobs {
    /// Unless `workers` is none, takes up what the last process left and starts to work.
    ///
    /// # Errors
    /// [`store::Error`]
    pub async fn start(
        store: Store,
        functions: Functions,
        workers: Workers,
    ) -> store::Result<Self> {
        let held = Arc::<AtomicBool>::default();
        store.take_bench().await?;
        let bench = Bench::open(store.clone(), functions.rig.clone(), held.clone()).await?;
        let gives_way = workers == Workers::GiveWay;
        if gives_way {
            priority::make_pool_give_way();
        }
        let computes = workers != Workers::None;
        // A command that computes and exits announces nothing: it looks when a job asks for a card.
        let card = if gives_way { card::found(&functions).await.ok() } else { None };
        let crew = Crew { serves: true, card, ..Crew::default() };
        let worker = JobWorker::new(store, functions, held, crew, gives_way);
        let jobs = Self { worker, bench, computes };
        if computes {
            // No other process has this bench, so leases of the last one are free.
            jobs.shared().store.end_leases().await?;
            jobs.bench.start().await?;
            jobs.worker.start().await?;
        }
        Ok(jobs)
    }

    fn shared(&self) -> &Shared {
        self.worker.shared()
    }

    /// The id of this process among the workers.
    pub fn worker(&self) -> &str {
        &self.shared().worker.id
    }

    /// The card on which this process computes jobs that ask for one, or why it does not, in words that
    /// end with what to do.
    pub async fn card(&self) -> Result<String, String> {
        match self.computes {
            true => card::found(&self.shared().functions).await,
            false => Err("this process computes no jobs; use the CPU".to_owned()),
        }
    }

    /// Queues a job. `false`: the same job was requested before, and this is it, with these labels
    /// too.
    ///
    /// # Errors
    /// [`store::Error`]
    pub async fn enqueue(&self, spec: &JobSpec, labels: &Labels) -> store::Result<(Job, bool)> {
        self.queue(self.shared().store.write().await?, spec, (None, labels)).await
    }

    /// Queues a job with the specification and the labels of one that failed or was cancelled, linked
    /// to it.
    /// `false`: an equal job is queued, running or has succeeded meanwhile, and this is it.
    ///
    /// # Errors
    /// [`store::Error`]
    pub async fn enqueue_again(&self, spec: &JobSpec, before: &Job) -> store::Result<(Job, bool)> {
        let of = (Some(before.id.as_str()), &before.labels);
        self.queue(self.shared().store.write().await?, spec, of).await
    }

    /// As [`Self::enqueue`], or as [`Self::enqueue_again`] if it starts another job again, if the
    /// bench may be used under this reservation, or under none; otherwise returns why it may not.
    ///
    /// # Errors
    /// [`store::Error`]
    pub async fn enqueue_on_bench(
        &self,
        spec: &JobSpec,
        reservation: Option<&str>,
        of: (Option<&str>, &Labels),
    ) -> store::Result<Result<(Job, bool), Refused>> {
        let mut tx = self.shared().store.write().await?;
        match tx.may_use_bench(reservation, now()).await? {
            Some(refused) => Ok(Err(refused)),
            None => Ok(Ok(self.queue(tx, spec, of).await?)),
        }
    }

    async fn queue(
        &self,
        mut tx: Tx,
        spec: &JobSpec,
        of: (Option<&str>, &Labels),
    ) -> store::Result<(Job, bool)> {
        let (text, sha256) = spec.canonical();
        let (job, created) = tx
            .insert_job(&new_id(), spec.kind(), (&text, &sha256), &spec.subject(), of, now())
            .await?;
        if let (true, JobSpec::Training(TrainingSpec { goes_on_from: Some(sha256), .. })) =
            (created, spec)
        {
            tx.begin_from(&job.id, sha256).await?;
        }
        if created {
            let kind = serde_json::json!(spec.kind());
            let action = format!("start {}", kind.as_str().unwrap_or("job"));
            let mut said = serde_json::json!({ "job": job.id });
            if let Some(before) = of.0 {
                said["again_of"] = before.into();
            }
            tx.audit_deed(None, &action, said, now()).await?;
        }
        tx.commit().await?;
        if created {
            self.shared().wake.notify_one();
        }
        Ok((job, created))
    }

    /// Asks a job to end. `None`: it has ended already, or never existed.
    ///
    /// # Errors
    /// [`store::Error`]
    pub async fn cancel(&self, id: &str) -> store::Result<Option<Job>> {
        let mut tx = self.shared().store.write().await?;
        let job = tx.request_cancel(id, now()).await?;
        if job.is_some() {
            tx.audit_deed(None, "cancel job", serde_json::json!({ "job": id }), now()).await?;
        }
        tx.commit().await?;
        if let Some(running) = self.shared().running().get(id) {
            running.stop.set(Stop::Cancelled);
        }
        Ok(job)
    }

    /// The bench.
    pub fn bench(&self) -> &Bench {
        &self.bench
    }

    /// Cancelled when work ends: for anything that waits for events.
    pub fn closing(&self) -> CancellationToken {
        self.shared().closing.clone()
    }

    /// Stops the bench, takes no more jobs, lets running ones save a checkpoint and return to the
    /// queue.
    pub async fn shutdown(&self) {
        self.worker.close();
        self.bench.shutdown().await;
        self.worker.shutdown().await;
    }
}

impl Shared {
    fn running(&self) -> std::sync::MutexGuard<'_, HashMap<String, Running>> {
        self.running.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod body_tests;
