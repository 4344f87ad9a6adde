//! Delivery by apalis, on SQLite in the database file. Only this file knows the queue library: its
//! PostgreSQL sibling offers the same builder, and a delivery is only a hint, so replacing it
//! changes nothing else.
//!
//! What the library does not guarantee, and what handles it (as read in apalis-sqlite 1.0.0):
//!
//! | the library | here |
//! |-------------|------|
//! | its `setup` switches `synchronous` off | only its migrations run |
//! | its fence is the worker's name | a new name for every start of a worker |
//! | it redelivers without end what kills its process | the ledger counts attempts |
//! | one failed statement ends the worker and drops what it handles | `worker.rs` starts another; dropped work goes back |
//! | it takes ten tasks ahead | batches of one |
//! | while a task is handled it may hold a connection, with a transaction | a task is handled in milliseconds: computing is elsewhere |
//! | a worker may hang after a statement that failed | `silence` hears that its heart stands still; `worker.rs` starts another |

use apalis::layers::WorkerBuilderExt;
use apalis_core::backend::ext::BackendExt;
use apalis_core::error::{BoxDynError, WorkerError};
use apalis_core::task::builder::TaskBuilder;
use apalis_core::worker::builder::WorkerBuilder;
use apalis_sqlite::{Config, SqliteStorage};
use flip_core::domain::job::JobKind;
use flip_store::ledger::Lease;
use flip_store::{self as store, Store, Tx};
use futures::FutureExt;
use futures::future::BoxFuture;
use serde::{Deserialize, Serialize};
use std::time::{Duration, Instant};
use tokio_util::sync::CancellationToken;
use tower::limit::ConcurrencyLimitLayer;

const QUEUE: &str = "flip";
/// How often an idle worker looks for a delivery.
const POLL: Duration = Duration::from_millis(250);
/// A worker without a heartbeat for twice this long loses its deliveries.
const HEARTBEAT: Duration = Duration::from_secs(2);
/// A worker without a heartbeat for this long hangs.
const SILENCE: Duration = Duration::from_secs(7);

/// Payload of a delivery: only the job id and kind. The ledger holds the rest.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Delivery {
    /// Job id.
    pub job: String,
    /// Its kind, which determines what it has to wait for.
    pub kind: JobKind,
}

/// Creates or updates the queue's tables.
pub(super) async fn migrate(store: &Store) -> store::Result<()> {
    let mut migrations = SqliteStorage::migrations();
    // FLIP's own migrations are in the same table.
    migrations.set_ignore_missing(true);
    migrations.run(store.writer()?).await.map_err(sqlx::Error::from)?;
    Ok(())
}

/// Delivers a job as part of `tx`, once for each fence.
pub(super) async fn push(tx: &mut Tx, kind: JobKind, lease: &Lease) -> store::Result<()> {
    let delivery = Delivery { job: lease.job.clone(), kind };
    let args =
        serde_json::to_vec(&delivery).map_err(|error| store::Error::Corrupt(error.to_string()))?;
    let key = format!("job:{}:{}", lease.job, lease.fence);
    // One attempt: the ledger handles retries.
    let task = TaskBuilder::new(args).idempotency_key(key).max_attempts(1).build();
    apalis_sqlite::queries::push_tasks(tx.connection(), QUEUE, &[task]).await.map_err(library)
}

/// Removes processed deliveries, so that their keys are free.
pub(super) async fn forget_finished(tx: &mut Tx) -> store::Result<()> {
    let sql = "DELETE FROM Jobs WHERE job_type = ?1 AND status IN ('Done', 'Failed', 'Killed')";
    sqlx::query(sql).bind(QUEUE).execute(tx.connection()).await?;
    Ok(())
}

/// Removes every delivery. Sound only at start, when no other process can be handling one.
pub(super) async fn forget_deliveries(store: &Store) -> store::Result<()> {
    let mut tx = store.write().await?;
    sqlx::query("DELETE FROM Jobs WHERE job_type = ?1")
        .bind(QUEUE)
        .execute(tx.connection())
        .await?;
    sqlx::query("DELETE FROM Workers WHERE worker_type = ?1")
        .bind(QUEUE)
        .execute(tx.connection())
        .await?;
    tx.commit().await
}

/// Passes deliveries to `handle`, one at a time, until `closing`. It has to be quick: see the table
/// above.
///
/// The future is boxed here, where its types are named: inside another `async fn` the compiler
/// cannot see that it is `Send`.
///
/// # Errors
/// Any error that ended the worker early; the delivery it was handling has been dropped.
pub(super) fn run<H, F>(
    store: &Store,
    name: &str,
    handle: H,
    closing: CancellationToken,
) -> store::Result<BoxFuture<'static, Result<(), WorkerError>>>
where
    H: Fn(Delivery) -> F + Clone + Send + Sync + 'static,
    F: Future<Output = ()> + Send + 'static,
{
    let config = Config::default()
        .queue(QUEUE)
        .batch_size(1)
        .heartbeat_interval(HEARTBEAT)
        .missed_heartbeats(2);
    let storage = SqliteStorage::<Delivery>::new(store.writer()?)
        .with_config(config)
        .poll_with_interval(POLL);
    let handler = move |delivery: Delivery| {
        let handled = handle(delivery);
        async move {
            handled.await;
            Ok::<(), BoxDynError>(())
        }
    };
    let worker = WorkerBuilder::new(name)
        .backend(storage)
        .layer(ConcurrencyLimitLayer::new(1))
        .catch_panic()
        .build(handler);
    let closed = async move {
        closing.cancelled_owned().await;
        Ok::<(), WorkerError>(())
    };
    Ok(worker.run_until(closed).boxed())
}

/// Returns when the worker of this name, started just now, has had no heartbeat for some time.
pub(super) async fn silence(store: &Store, name: &str) {
    let mut heard = Instant::now();
    let mut last_seen = None;
    while heard.elapsed() < SILENCE {
        tokio::time::sleep(HEARTBEAT / 2).await;
        let sql = "SELECT last_seen FROM Workers WHERE id = ?1";
        let now: Option<i64> =
            sqlx::query_scalar(sql).bind(name).fetch_optional(store.reader()).await.ok().flatten();
        if now != last_seen {
            (heard, last_seen) = (Instant::now(), now);
        }
    }
}

fn library(error: apalis_sqlite::Error) -> store::Error {
    match error {
        apalis_sqlite::Error::Database(error) => error.into(),
        other => store::Error::Corrupt(format!("the queue: {other}")),
    }
}
