//! Workers beside the process that serves a database: who computes what, and that the result is the
//! same whoever does.

use crate::harness::{calibration_of, ended, functions, heap, open, until};
use flip::app::{App, Crew, Functions, Hired, JobKind, JobState, Options, PageQuery, Storage};
use flip::jobs::heaps_on_cores;
use sqlx::AnyPool;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tempfile::TempDir;

/// A database on a server, whatever the other tests run on, with an app that computes nothing
/// itself, and a connection past it; `None`, and why, where there is no server.
pub async fn served() -> Option<(TempDir, Storage, App, AnyPool)> {
    let cluster = flip_testing::cluster().inspect_err(|why| println!("skipped: {why}")).ok()?;
    let folder = tempfile::tempdir().unwrap();
    let url = cluster.database_of(folder.path()).await;
    let storage = Storage::on_server(&url, folder.path()).unwrap();
    let app = App::open(&storage, Options::without_workers()).await.unwrap();
    sqlx::any::install_default_drivers();
    let pool = AnyPool::connect(&url).await.unwrap();
    Some((folder, storage, app, pool))
}

pub fn crew(name: &str) -> Crew {
    Crew { name: name.to_owned(), ..Crew::default() }
}

/// Heaps that take no longer than others, but wait while the gate is shut.
fn gated(gate: &Arc<AtomicBool>) -> Functions {
    let gate = gate.clone();
    let simulate = heaps_on_cores(move |set, settings, seed| {
        while !gate.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(5));
        }
        heap(set, settings, seed)
    });
    Functions { simulate, ..functions() }
}

#[tokio::test(flavor = "multi_thread")]
async fn workers_compute_what_the_server_would_to_the_same_result_and_are_listed() {
    let Some((_folder, storage, app, _)) = served().await else { return };
    let (_alone, one_process) = open(functions()).await;
    let hired = [
        Hired::start(&storage, crew("one"), functions()).await.unwrap(),
        Hired::start(&storage, crew("two"), functions()).await.unwrap(),
    ];
    for powder in ["sand", "salt", "sugar"] {
        let (job, _) = app.start_calibration(calibration_of(powder, 1)).await.unwrap();
        let (same, _) = one_process.start_calibration(calibration_of(powder, 1)).await.unwrap();
        assert_eq!(ended(&app, &job.id).await.state, JobState::Succeeded);
        assert_eq!(ended(&one_process, &same.id).await.state, JobState::Succeeded);
        let found = app.calibration(&job.id).await.unwrap().result.unwrap();
        let expected = one_process.calibration(&same.id).await.unwrap().result.unwrap();
        assert_eq!(found.sets, expected.sets, "{powder}");
    }
    let mut workers = app.workers().await.unwrap();
    workers.sort_by(|a, b| a.name.cmp(&b.name));
    let names: Vec<_> = workers.iter().map(|it| (it.name.as_str(), it.serves)).collect();
    assert_eq!(names, [("one", false), ("two", false)]);
    assert!(workers.iter().all(|it| it.ended_at.is_none() && it.heard_at >= it.started_at));
    assert!(workers.iter().all(|it| !it.kinds.contains(&JobKind::Repose)), "no bench is theirs");
    for worker in hired {
        worker.shutdown().await;
    }
    assert!(app.workers().await.unwrap().iter().all(|it| it.ended_at.is_some()));
    app.shutdown().await.unwrap();
    one_process.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_is_cancelled_at_the_server_ends_at_its_worker() {
    let Some((_folder, storage, app, _)) = served().await else { return };
    let slow = Functions {
        simulate: heaps_on_cores(|set, settings, seed| {
            std::thread::sleep(Duration::from_millis(100));
            heap(set, settings, seed)
        }),
        ..functions()
    };
    let hired = Hired::start(&storage, crew("one"), slow).await.unwrap();
    let (job, _) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    until("it runs", async || app.job(&job.id).await.unwrap().state == JobState::Running).await;
    assert_eq!(app.workers().await.unwrap()[0].jobs, [job.id.as_str()]);
    app.cancel_job(&job.id).await.unwrap();
    assert_eq!(ended(&app, &job.id).await.state, JobState::Cancelled);
    hired.shutdown().await;
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_goes_on_at_another_worker_when_its_own_is_stopped() {
    let Some((_folder, storage, app, _)) = served().await else { return };
    let gate = Arc::<AtomicBool>::default();
    let first = Hired::start(&storage, crew("first"), gated(&gate)).await.unwrap();
    let (job, _) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    until("it runs", async || app.job(&job.id).await.unwrap().state == JobState::Running).await;
    let second = Hired::start(&storage, crew("second"), functions()).await.unwrap();
    let stopping = tokio::spawn(first.shutdown());
    gate.store(true, Ordering::SeqCst);
    stopping.await.unwrap();
    let job = ended(&app, &job.id).await;
    assert_eq!((job.state, job.attempts), (JobState::Succeeded, 1), "{:?}", job.error);
    assert_eq!(app.jobs(Default::default(), PageQuery::default()).await.unwrap().items.len(), 1);
    second.shutdown().await;
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_takes_the_kinds_that_it_was_given_and_needs_a_database_that_is_served() {
    let Some((folder, storage, app, _)) = served().await else { return };
    let films = Crew { kinds: vec![JobKind::Film], ..crew("films") };
    let hired = Hired::start(&storage, films, functions()).await.unwrap();
    let (job, _) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    // It has looked at least once: it is listed after its first look.
    until("it is there", async || !app.workers().await.unwrap().is_empty()).await;
    tokio::time::sleep(Duration::from_millis(300)).await;
    assert_eq!(app.job(&job.id).await.unwrap().state, JobState::Queued);
    hired.shutdown().await;
    app.shutdown().await.unwrap();
    let refused = Hired::start(&folder.path().into(), crew("one"), functions()).await.err();
    assert!(refused.unwrap().to_string().contains("--database-url"));
    let cluster = flip_testing::cluster().unwrap();
    let empty = tempfile::tempdir().unwrap();
    let url = cluster.database_of(empty.path()).await;
    let storage = Storage::on_server(&url, empty.path()).unwrap();
    let refused = Hired::start(&storage, crew("one"), functions()).await.err();
    assert!(refused.unwrap().to_string().contains("start `flip serve`"));
}
