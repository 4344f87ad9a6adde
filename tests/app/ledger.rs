//! The ledger: attempts, fences, leases.

use crate::harness::{calibration_of, ended, functions, heap, open};
use flip::app::{Functions, JobState};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_panics_fails_for_good_after_exactly_three_attempts() {
    let begun = Arc::new(AtomicUsize::new(0));
    let counted = begun.clone();
    let poison = Functions {
        simulate: Arc::new(move |_, _, _| {
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
async fn a_job_that_saves_something_in_each_attempt_is_not_given_up() {
    // Each life saves one batch of four trials, then dies in the next.
    let calls = Arc::new(AtomicUsize::new(0));
    let counted = calls.clone();
    let frail = Functions {
        simulate: Arc::new(move |set, settings, seed| {
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
