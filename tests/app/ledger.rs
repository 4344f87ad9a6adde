//! The ledger: attempts, fences, leases.

use crate::harness::{calibration_of, ended, functions, heap, open, until};
use flip::app::{Functions, JobState, PageQuery, SERIES_LIMIT_MAX};
use flip::jobs::heaps_on_cores;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_panics_fails_for_good_after_exactly_three_attempts() {
    let begun = Arc::new(AtomicUsize::new(0));
    let counted = begun.clone();
    let poison = Functions {
        simulate: heaps_on_cores(move |_, _, _| {
            counted.fetch_add(1, Ordering::SeqCst);
            panic!("poison");
        }),
        ..functions()
    };
    let (_folder, app) = open(poison).await;
    let (job, _) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    let job = ended(&app, &job.id).await;
    assert_eq!((job.state, job.attempts), (JobState::Failed, 3));
    let error = job.error.unwrap();
    assert!(error.contains("after 3 attempts") && error.contains("poison"), "{error}");
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_that_somebody_locks_for_a_while_costs_time_and_nothing_else() {
    let slow = Functions {
        simulate: heaps_on_cores(|set, settings, seed| {
            std::thread::sleep(Duration::from_millis(20));
            heap(set, settings, seed)
        }),
        ..functions()
    };
    let (folder, app) = open(slow).await;
    let (job, _) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    until("it runs", async || app.job(&job.id).await.unwrap().state == JobState::Running).await;
    // Longer than any of our connections waits: the current trial is not saved.
    let lock = flip_testing::locked(folder.path()).await;
    tokio::time::sleep(Duration::from_millis(6500)).await;
    lock.rollback().await.unwrap();
    let job = ended(&app, &job.id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    let found = app.calibration(&job.id).await.unwrap().result.unwrap();
    let trials = app.trials(&job.id, PageQuery::first(SERIES_LIMIT_MAX)).await.unwrap().items;
    assert_eq!(trials.len() as u32, found.evaluations + found.verification_runs);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_saves_something_in_each_attempt_is_not_given_up() {
    // Each life saves one batch of four trials, then dies in the next.
    let calls = Arc::new(AtomicUsize::new(0));
    let counted = calls.clone();
    let frail = Functions {
        simulate: heaps_on_cores(move |set, settings, seed| {
            let call = counted.fetch_add(1, Ordering::SeqCst);
            assert!(call % 9 != 8, "frail");
            heap(set, settings, seed)
        }),
        ..functions()
    };
    let (_folder, app) = open(frail).await;
    let (job, _) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    let job = ended(&app, &job.id).await;
    assert_eq!(job.state, JobState::Succeeded, "{:?}", job.error);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_starts_at_once_and_not_when_the_worker_looks_again() {
    let (_folder, app) = open(functions()).await;
    let first = app.start_calibration(calibration_of("sand", 1)).await.unwrap().0;
    ended(&app, &first.id).await;
    // The worker has just looked, and looks again in 2 s.
    tokio::time::sleep(Duration::from_millis(200)).await;
    let second = app.start_calibration(calibration_of("sand", 2)).await.unwrap().0;
    let second = ended(&app, &second.id).await;
    let waited_ms = second.started_at.unwrap().unix_ms() - second.created_at.unix_ms();
    assert!(waited_ms < 1000, "{waited_ms} ms");
    app.shutdown().await.unwrap();
}
