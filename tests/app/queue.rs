//! The order of jobs: places in the queue, time left, what a restart leaves, starting again.

use crate::harness::{calibration_of, ended, functions, heap, open, open_in, storage, until};
use flip::app::{App, Error, Functions, JobState, JobsWanted, Options, PageQuery, TrainingRequest};
use flip::jobs::heaps_on_cores;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Heaps that fall only once the gate is open, 2 ms each.
fn gated(open: &Arc<AtomicBool>) -> Functions {
    let open = open.clone();
    let simulate = heaps_on_cores(move |set, settings, seed| {
        while !open.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(2));
        }
        std::thread::sleep(Duration::from_millis(2));
        heap(set, settings, seed)
    });
    Functions { simulate, ..functions() }
}

async fn state(app: &App, id: &str) -> JobState {
    app.job(id).await.unwrap().state
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_wait_in_the_order_of_their_requests_and_say_their_place_and_what_they_are_of() {
    let gate = Arc::<AtomicBool>::default();
    let (_folder, app) = open(gated(&gate)).await;
    let mut ids = Vec::new();
    for powder in ["sand", "salt", "sugar"] {
        ids.push(app.start_calibration(calibration_of(powder, 1)).await.unwrap().0.id);
    }
    until("the first runs", async || state(&app, &ids[0]).await == JobState::Running).await;
    let listed = app.jobs(JobsWanted::default(), PageQuery::default()).await.unwrap().items;
    let seen: Vec<_> =
        listed.iter().map(|job| (job.subject.powders.join(","), job.place)).collect();
    let expected = [("sugar", Some(2)), ("salt", Some(1)), ("sand", None)];
    assert_eq!(seen, expected.map(|(powder, place)| (powder.to_owned(), place)));
    assert_eq!(app.calibration(&ids[2]).await.unwrap().job.place, Some(2));
    assert_eq!(app.job(&ids[0]).await.unwrap().left_s, None, "no pace yet");

    app.cancel_job(&ids[1]).await.unwrap();
    assert_eq!(app.job(&ids[2]).await.unwrap().place, Some(1), "the next moves up");
    gate.store(true, Ordering::SeqCst);
    until("the pace is known", async || {
        let job = app.job(&ids[0]).await.unwrap();
        job.left_s.is_some_and(|left_s| left_s > 0.0) || job.state.is_terminal()
    })
    .await;
    let first = ended(&app, &ids[0]).await;
    assert_eq!((first.state, first.left_s, first.place), (JobState::Succeeded, None, None));
    let third = ended(&app, &ids[2]).await;
    assert!(third.started_at >= first.finished_at, "one after the other");
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cancelled_job_starts_again_with_the_same_inputs_behind_those_that_wait() {
    let gate = Arc::<AtomicBool>::default();
    let (_folder, app) = open(gated(&gate)).await;
    let (first, _) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    let (second, _) = app.start_calibration(calibration_of("salt", 1)).await.unwrap();
    let refused = app.start_again(&second.id, None).await.unwrap_err();
    assert!(matches!(refused, Error::Conflict { code: "job_not_over", .. }), "{refused}");
    app.cancel_job(&second.id).await.unwrap();
    let (third, _) = app.start_calibration(calibration_of("sugar", 1)).await.unwrap();
    let (again, created) = app.start_again(&second.id, None).await.unwrap();
    assert!(created && again.id != second.id);
    let again = app.job(&again.id).await.unwrap();
    assert_eq!(
        (again.again_of.as_deref(), &again.subject),
        (Some(second.id.as_str()), &second.subject)
    );
    assert_eq!((app.job(&third.id).await.unwrap().place, again.place), (Some(1), Some(2)));
    // Twice is once.
    let (same, created) = app.start_again(&second.id, None).await.unwrap();
    assert_eq!((same.id.as_str(), created), (again.id.as_str(), false));
    gate.store(true, Ordering::SeqCst);
    assert_eq!(ended(&app, &again.id).await.state, JobState::Succeeded);
    let (old, new) =
        (app.calibration(&second.id).await.unwrap(), app.calibration(&again.id).await.unwrap());
    assert_eq!((old.target, old.settings), (new.target, new.settings));
    let refused = app.start_again(&first.id, None).await.unwrap_err();
    assert!(refused.to_string().contains("succeeded"), "{refused}");
    assert!(matches!(app.start_again("none", None).await, Err(Error::NotFound { .. })));
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn trainings_do_not_wait_for_calibrations() {
    let gate = Arc::new(AtomicBool::new(true));
    let (_folder, app) = open(gated(&gate)).await;
    let (sand, _) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    ended(&app, &sand.id).await;
    gate.store(false, Ordering::SeqCst);
    app.start_calibration(calibration_of("salt", 1)).await.unwrap();
    let (waits, _) = app.start_calibration(calibration_of("sugar", 1)).await.unwrap();
    let request = TrainingRequest {
        powders: Some(vec!["sand".into()]),
        episodes: Some(3),
        ..TrainingRequest::default()
    };
    let (training, _) = app.start_training(request).await.unwrap();
    assert_eq!(training.subject.powders, ["sand"]);
    until("the training runs", async || state(&app, &training.id).await != JobState::Queued).await;
    assert_eq!(app.job(&waits.id).await.unwrap().state, JobState::Queued);
    gate.store(true, Ordering::SeqCst);
    assert_eq!(ended(&app, &training.id).await.state, JobState::Succeeded);
    app.shutdown().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_nothing_computes_waits_and_keeps_its_place() {
    let gate = Arc::<AtomicBool>::default();
    let (folder, app) = open(gated(&gate)).await;
    let (first, _) = app.start_calibration(calibration_of("sand", 1)).await.unwrap();
    let (second, _) = app.start_calibration(calibration_of("salt", 1)).await.unwrap();
    until("it runs", async || state(&app, &first.id).await == JobState::Running).await;
    gate.store(true, Ordering::SeqCst);
    app.shutdown().await.unwrap();
    drop(app);

    // What a process that was killed leaves: a row that says `running` under a lease that is over.
    let database = flip_testing::pool(folder.path()).await;
    sqlx::query("UPDATE job SET state = 'running', owner = 'gone', lease_until = 1 WHERE id = $1 AND state = 'queued'")
        .bind(&first.id)
        .execute(&database)
        .await
        .unwrap();
    database.close().await;
    let app = App::open(storage(folder.path()).await, Options::without_workers()).await.unwrap();
    let job = app.job(&first.id).await.unwrap();
    assert_eq!((job.state, job.place), (JobState::Queued, Some(1)), "{job:?}");
    assert!(job.progress.message.contains("waits"), "{job:?}");
    assert_eq!(app.job(&second.id).await.unwrap().place, Some(2));
    let queued = app.jobs(in_state(JobState::Queued), PageQuery::default()).await.unwrap().items;
    assert_eq!(queued.len(), 2);
    assert!(
        app.jobs(in_state(JobState::Running), PageQuery::default()).await.unwrap().items.is_empty()
    );
    app.shutdown().await.unwrap();
    drop(app);

    let app = open_in(folder.path(), functions()).await;
    let (one, two) = (ended(&app, &first.id).await, ended(&app, &second.id).await);
    assert_eq!((one.state, two.state), (JobState::Succeeded, JobState::Succeeded));
    assert!(one.finished_at <= two.started_at, "first come, first served, after a restart too");
    app.shutdown().await.unwrap();
}

fn in_state(state: JobState) -> JobsWanted {
    JobsWanted { state: Some(state), ..JobsWanted::default() }
}
